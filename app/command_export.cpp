// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/from_above.h"
#include "satsurf/app/interrupt.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/products.h"
#include "satsurf/app/program.h"
#include "satsurf/core/error.h"
#include "satsurf/core/var.h"
#include "satsurf/mesh/glb.h"
#include "satsurf/mesh/ply.h"
#include "satsurf/mesh/simplify.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/rpc/read.h"
#include "satsurf/splat/ply.h"
#include "satsurf/splat/view.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <memory>
#include <string>
#include <utility>

#include <fmt/format.h>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

struct ExportOptions {
  fs::path mesh, dsm, ortho, surfels, to;
  double resolution = 0.5;  ///< of the surface of surfels, m
  Index max_faces = 0;
  bool overwrite = false;

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("mesh", s.mesh, Field{.help = "mesh.ply of a reconstruction"});
    v("dsm", s.dsm, Field{.help = "raster of heights, instead of a mesh"});
    v("ortho", s.ortho, Field{.help = "raster of colours on the grid of --dsm"});
    v("surfels", s.surfels,
      Field{.help = "surfels.ply of a reconstruction, instead of a mesh: the surface they show "
                    "from above, with their colours (rasters of it: satsurf render --nadir)"});
    v("resolution", s.resolution,
      Field{.help = "cell of the surface of --surfels", .unit = "m", .min = 0.01, .max = 1000});
    v("to", s.to, Field{.help = "file to write, .glb or .ply (required)"});
    v("max_faces", s.max_faces,
      Field{.help = "most triangles that the file may have; vertices near each other become one",
            .min = 1,
            .automatic = "all",
            .flag = "--max-faces"});
    v("overwrite", s.overwrite,
      Field{.help = "replace the file if it exists", .flag = "--overwrite"});
  }
};

/// Of a cell that becomes a vertex with normal and colour and two faces, and of what is sorted where
/// there are to be fewer.
constexpr double kMeshBytes = 180;

/// A mesh around an origin, so that floats suffice, and where that is.
struct PlacedMesh {
  mesh::Mesh mesh;
  std::string crs;
  std::array<double, 3> origin{};  ///< easting, northing and height, m
  std::string heights;             ///< what they are above; empty if nobody knows
};

PlacedMesh in_frame(mesh::Mesh mesh, const rpc::LocalFrame& frame) {
  return {std::move(mesh),
          "EPSG:" + std::to_string(frame.zone.epsg()),
          {frame.easting0, frame.northing0, frame.h0},
          "the WGS84 ellipsoid"};
}

PlacedMesh mesh_of_dsm(const ExportOptions& options) {
  rpc::GeoRaster dsm = rpc::read_geo_raster(options.dsm);
  if (dsm.values.rank() != 2)
    throw IoError(options.dsm.string() + ": " + std::to_string(dsm.values.dim(0)) +
                  " bands, expected one of heights");
  rpc::require_heights(options.dsm, dsm.values);
  const Index H = dsm.values.dim(0), W = dsm.values.dim(1);
  check_rendered_size("a mesh: ", W, H, kMeshBytes, "give a coarser one (gdalwarp -tr)");
  Tensor colour;
  if (!options.ortho.empty()) {
    const rpc::GeoRaster ortho = rpc::read_geo_raster(options.ortho);
    const std::size_t rank = ortho.values.rank();
    if (ortho.values.dim(rank - 2) != H || ortho.values.dim(rank - 1) != W ||
        ortho.grid != dsm.grid)
      throw IoError(options.ortho.string() + ": another grid, expected that of " +
                    options.dsm.string());
    colour = rpc::to_rgb(rpc::read_image(options.ortho));
  }
  double low = INFINITY;
  for (const float v : dsm.values.values())
    if (std::isfinite(v)) low = std::min(low, static_cast<double>(v));
  const double base = std::isfinite(low) ? std::floor(low) : 0;
  const double width = dsm.grid.step * static_cast<double>(W),
               height = dsm.grid.step * static_cast<double>(H);
  for (float& v : dsm.values.values()) v -= static_cast<float>(base);
  return {mesh::mesh_from_heights(dsm.values, -width / 2, height / 2, dsm.grid.step, colour),
          dsm.grid.epsg == 0 ? "unknown" : "EPSG:" + std::to_string(dsm.grid.epsg),
          {dsm.grid.x0 + width / 2, dsm.grid.y0 - height / 2, base},
          ""};
}

PlacedMesh mesh_of_surfels(const ExportOptions& options) {
  const NoGrad no_grad;
  const splat::PlyContent content = splat::read_ply(options.surfels);
  const rpc::LocalFrame frame = frame_from_comments(content.comments, options.surfels.string());
  heights_of(content.surfels, options.surfels.string());
  const GridFromAbove grid = grid_from_above(content.surfels, options.resolution);
  const splat::Render render = render_from_above(content.surfels, grid, kMeshBytes);
  return in_frame(
      mesh::mesh_from_heights(splat::surface_heights(render), grid.field.x0, grid.field.y0,
                              grid.field.step, splat::surface_colours(render)),
      frame);
}

PlacedMesh mesh_of(const ExportOptions& options) {
  if (!options.mesh.empty()) {
    mesh::PlyContent content = mesh::read_ply(options.mesh);
    return in_frame(std::move(content.mesh),
                    frame_from_comments(content.comments, options.mesh.string()));
  }
  const fs::path& from = options.dsm.empty() ? options.surfels : options.dsm;
  try {
    return options.dsm.empty() ? mesh_of_surfels(options) : mesh_of_dsm(options);
  } catch (const IoError&) {
    throw;
  } catch (const Error& e) {
    throw IoError(from.string() + ": " + e.what());
  }
}

void write(const fs::path& path, const PlacedMesh& placed) {
  if (path.extension() == ".ply")
    return mesh::write_ply(path, placed.mesh,
                           place_comments(placed.crs, placed.origin, placed.heights),
                           stop_if_interrupted);
  mesh::write_glb(
      path, placed.mesh,
      {{"crs", placed.crs},
       {"origin_easting_northing_height", fmt::format("{:.17g} {:.17g} {:.17g}", placed.origin[0],
                                                      placed.origin[1], placed.origin[2])},
       {"axes", "x east, y up, -z north, m from the origin" +
                    (placed.heights.empty() ? "" : "; heights above " + placed.heights)}},
      stop_if_interrupted);
}

void run_export(const ExportOptions& options) {
  if (options.to.extension() != ".glb" && options.to.extension() != ".ply")
    throw ConfigError("--to: " + options.to.string() + ", expected a name ending in .glb or .ply" +
                      (options.surfels.empty() ? "" : "; satsurf render --nadir makes rasters"));
  check_output_file("--to", options.to, options.overwrite,
                    {options.mesh, options.dsm, options.ortho, options.surfels});
  std::size_t before = 0;
  const PlacedMesh surface = [&] {
    const EndsAtSignal stops;
    PlacedMesh made = mesh_of(options);
    before = made.mesh.faces.size();
    if (options.max_faces > 0) made.mesh = mesh::simplified(made.mesh, options.max_faces);
    if (made.mesh.faces.empty() && before > 0)
      throw ConfigError("--max-faces: " + std::to_string(options.max_faces) + " leaves none of " +
                        std::to_string(before) + " faces, expected more");
    return made;
  }();
  write(options.to, surface);
  std::printf("%zu of %zu faces, %zu vertices\n", surface.mesh.faces.size(), before,
              surface.mesh.vertices.size());
}

}  // namespace

void add_export(Program& program) {
  Command& command =
      program.add("export", "a surface for browsers and 3D programs: binary glTF or PLY");
  command.files = {{"--to *.glb",
                    "triangles with normals and colours, y up; asset.extras names the reference "
                    "system and the origin"},
                   {"--to *.ply", "the same, z up; comment lines of the header name them"}};
  const auto options = std::make_shared<ExportOptions>();
  Flags& flags = command.flags;
  flags.add(collect_fields(*options));
  CLI::App& app = flags.command();
  app.get_option("--mesh")->excludes(app.get_option("--dsm"));
  app.get_option("--surfels")->excludes(app.get_option("--mesh"), app.get_option("--dsm"));
  app.get_option("--ortho")->needs(app.get_option("--dsm"));
  app.get_option("--resolution")->needs(app.get_option("--surfels"));
  program.when_called(command, [&flags, options]() -> std::function<void()> {
    flags.read(collect_fields(*options));
    if (options->mesh.empty() && options->dsm.empty() && options->surfels.empty())
      throw CLI::RequiredError("--mesh, --dsm or --surfels");
    Flags::require("--to", options->to);
    return [options] { run_export(*options); };
  });
}

}  // namespace satsurf::app
