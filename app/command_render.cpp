// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/from_above.h"
#include "satsurf/app/interrupt.h"
#include "satsurf/app/legend.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/preview.h"
#include "satsurf/app/products.h"
#include "satsurf/app/program.h"
#include "satsurf/app/surface_files.h"
#include "satsurf/core/error.h"
#include "satsurf/core/files.h"
#include "satsurf/core/var.h"
#include "satsurf/nn/model.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/rpc/read.h"
#include "satsurf/splat/ply.h"
#include "satsurf/splat/view.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

}  // namespace

/// What a view from above shows.
enum class NadirContent { automatic, colours, heights };

}  // namespace satsurf::app

template <>
struct satsurf::EnumNames<satsurf::app::NadirContent> {
  static constexpr std::array names{"automatic", "colours", "heights"};
};

namespace satsurf::app {
namespace {

/// What to render.
struct RenderConfig {
  fs::path surfels, image;
  bool nadir = false;  ///< from straight above, instead of into `image`
  std::vector<fs::path> image_dirs;
  double resolution = 0;  ///< of the view from above, m; 0 for that of `grid`
  fs::path grid;          ///< raster whose cells the view from above has; empty for dsm.tif beside
  NadirContent show = NadirContent::automatic;

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("surfels", s.surfels,
      Field{.help = "surfels.ply of a reconstruction (required unless --print-config)"});
    v("image", s.image,
      Field{.help = "take the camera and the size of this image", .placeholder = "IMG"});
    v("nadir", s.nadir, Field{.help = "look straight down", .flag = "--nadir"});
    v("image_dirs", s.image_dirs,
      Field{.help = "where else to look for the image a JSON file names",
            .flag = "--image-dir",
            .placeholder = "DIR"});
    v("resolution", s.resolution,
      Field{.help = "cell of the view from above",
            .unit = "m",
            .min = 0.01,
            .max = 1000,
            .automatic = "as --grid"});
    v("grid", s.grid,
      Field{
          .help = "give the view from above the cells of this raster, instead of --resolution",
          .automatic = "dsm.tif beside the surfels if it is of their UTM zone, else cells of 0.5 m",
          .placeholder = "FILE"});
    v("show", s.show,
      Field{.help =
                "what the view from above shows; automatic is colours as .png, heights as .tif"});
  }
};

struct RenderCommand : RenderConfig {
  fs::path out;
  bool overwrite = false;

  /// Of the options those that are no configuration.
  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("out", s.out,
      Field{.help = "colours as .png; as .tif the colours with the image's camera, or the heights "
                    "from above (required unless --print-config)"});
    v("overwrite", s.overwrite,
      Field{.help = "replace the file if it exists", .flag = "--overwrite"});
  }
};

/// The cells that --grid or --resolution ask for, or those of the surface that lies beside the surfels.
/// throws  IoError for a --grid of another reference system
GridFromAbove grid_of(const RenderConfig& options, const rpc::LocalFrame& frame,
                      const splat::Surfels& surfels) {
  constexpr double kCell = 0.5;  // m
  const fs::path beside = options.surfels.parent_path() / "dsm.tif";
  const bool named = !options.grid.empty();
  if (named || (options.resolution == 0 && path_exists(beside))) {
    const rpc::GeoRaster raster = rpc::read_geo_raster(named ? options.grid : beside);
    const std::size_t rank = raster.values.rank();
    if (raster.grid.epsg == frame.zone.epsg())
      return {
          {{}, raster.grid.x0 - frame.easting0, raster.grid.y0 - frame.northing0, raster.grid.step},
          raster.values.dim(rank - 2),
          raster.values.dim(rank - 1)};
    if (named)
      throw IoError(options.grid.string() + ": EPSG:" + std::to_string(raster.grid.epsg) +
                    ", expected EPSG:" + std::to_string(frame.zone.epsg()) + " of " +
                    options.surfels.string());
  }
  return grid_from_above(surfels, options.resolution > 0 ? options.resolution : kCell);
}

/// Writes colours or heights, each as a GeoTIFF or as a PNG with world files.
template <class Render>
void write_from_above(const RenderCommand& options, const Render& render,
                      const scene::HeightField& grid, const rpc::LocalFrame& frame) {
  const bool png = options.out.extension() == ".png";
  const bool heights =
      options.show == NadirContent::heights || (options.show == NadirContent::automatic && !png);
  if (heights && png) {
    const Tensor z = splat::surface_heights(render);
    const ColourScale scale = height_scale(z, frame.h0);
    return write_map(options.out, height_picture(z), &scale, geo_grid(grid, frame));
  }
  if (heights)
    return write_field(options.out, splat::surface_heights(render), grid, frame, frame.h0,
                       rpc::ellipsoidal_height("Surface heights"));
  if (png) {
    write_png(options.out, splat::surface_colours(render));
    return write_world_files(options.out, geo_grid(grid, frame));
  }
  Tensor colour = splat::surface_colours(render);
  const Tensor z = splat::surface_heights(render);
  for (Index i = 0; i < colour.count(); ++i)
    colour[i] = std::isfinite(z[i % z.count()]) ? 255 * colour[i] : std::nanf("");
  rpc::GeoTags tags;
  tags.unit = "", tags.description = "The surface from above", tags.type = rpc::CellType::uint8;
  tags.nodata = 0;
  keep_off_nodata(colour, tags);
  write_field(options.out, colour, grid, frame, 0, tags);
}

void run_render(const RenderCommand& options) {
  const std::string extension = options.out.extension().string();
  const bool png = extension == ".png", tif = extension == ".tif" || extension == ".tiff";
  if (!png && !tif)
    throw ConfigError("--out: " + options.out.string() +
                      ", expected a name ending in .png or .tif");
  std::optional<rpc::RasterInfo> image;
  if (!options.image.empty()) image = rpc::view_info(options.image, options.image_dirs);
  std::vector<fs::path> inputs = image ? image->files : std::vector<fs::path>();
  inputs.push_back(options.surfels);
  inputs.push_back(options.grid);
  for (const fs::path& file : png && !image ? map_files(options.out) : std::vector{options.out})
    check_output_file("--out", file, options.overwrite, inputs);
  const NoGrad no_grad;
  std::optional<EndsAtSignal> stops(std::in_place);
  const splat::PlyContent content = splat::read_ply(options.surfels);
  const rpc::LocalFrame frame = frame_from_comments(content.comments, options.surfels.string());
  const rpc::HeightRange z_range = heights_of(content.surfels, options.surfels.string());

  if (image) {
    check_rendered_size(options.image.string() + ": ", image->width, image->height, kRenderBytes,
                        "crop the image");
    constexpr double kMargin = 1;  // m; a flat surface still needs a span to fit a camera over
    const rpc::Window whole{0, 0, static_cast<double>(image->width),
                            static_cast<double>(image->height)};
    const Quadratic camera =
        rpc::fit_projection(*image->rpc, frame, whole, z_range.widened(kMargin));
    const auto render = splat::render_view(content.surfels, camera, image->height, image->width, 1);
    const auto alpha = render.alpha.value().values();
    if (std::none_of(alpha.begin(), alpha.end(), [](float a) { return a > 0.05f; }))
      throw Error("render: " + options.image.string() + " sees nothing of " +
                  options.surfels.string() + ", expected an image of that place");
    Tensor colour = splat::surface_colours(render);
    stops.reset();
    if (png) return write_png(options.out, colour);
    for (float& v : colour.values()) v *= 255;
    return rpc::write_rpc_geotiff(options.out, colour, rpc::PixelType::uint8, *image->rpc);
  }

  const GridFromAbove above = grid_of(options, frame, content.surfels);
  const splat::Render render = render_from_above(content.surfels, above);
  stops.reset();
  write_from_above(options, render, above.field, frame);
}

/// What only one of the two views has to say.
std::vector<Mode> views_of(RenderConfig& config) {
  std::vector<Mode> views{{"--image", {}}, {"--nadir", {}}};
  for (const FieldRef& field : collect_fields(config)) {
    if (field.name == "image_dirs") views[0].fields.push_back(field);
    if (field.name == "resolution" || field.name == "grid" || field.name == "show")
      views[1].fields.push_back(field);
  }
  return views;
}

/// A flag takes the place of what the file says of where to look from, and of what it says of the cells.
void read_render(const Flags& flags, RenderCommand& options) {
  RenderConfig& config = options;
  flags.read(collect_fields(options));
  read_config(flags, config);
  if (flags.given("--nadir")) config.image.clear();
  if (flags.given("--image")) config.nadir = false;
  if (flags.given("--grid")) config.resolution = 0;
  if (flags.given("--resolution")) config.grid.clear();
  if (config.nadir == config.image.empty()) {
    const std::vector<Mode> views = views_of(config);
    refuse_others(flags, views, views[config.nadir ? 1 : 0]);
  }
  if (config.resolution > 0 && !config.grid.empty())
    throw ConfigError(flags.config_file().string() + ": both resolution and grid, expected one");
  if (config.nadir && !config.image.empty())
    throw ConfigError(flags.config_file().string() + ": nadir is true and image is " +
                      config.image.string() + ", expected one of them");
  if (flags.print_config()) return;
  Flags::require("--surfels", config.surfels);
  if (config.image.empty() && !config.nadir) throw CLI::RequiredError("--image or --nadir");
  Flags::require("--out", options.out);
}

}  // namespace

void add_render(Program& program) {
  Command& command =
      program.add("render", "a reconstructed surface as a camera sees it, or from above");
  command.files = {{"--out *.png", "colours"},
                   {"--out *.tif",
                    "with --image the colours, 8 bit, and the image's camera in the RPC tag; with "
                    "--nadir the heights, m above the ellipsoid, Float32, or the colours, 8 bit, "
                    "georeferenced; see --show"},
                   {"*.pgw, *.png.aux.xml", "where a .png of --nadir lies, for GIS programs"}};
  const auto options = std::make_shared<RenderCommand>();
  RenderConfig& config = *options;
  Flags& flags = command.flags;
  flags.add(collect_fields(*options));
  flags.add_config();
  flags.add(collect_fields(config), "Configuration");
  CLI::App& app = flags.command();
  app.get_option("--nadir")->excludes(app.get_option("--image"));
  app.get_option("--grid")->excludes(app.get_option("--resolution"));
  program.when_called(command, [&flags, options]() -> std::function<void()> {
    read_render(flags, *options);
    if (flags.print_config())
      return [options] { print_config(static_cast<const RenderConfig&>(*options)); };
    return [options] { run_render(*options); };
  });
}

}  // namespace satsurf::app
