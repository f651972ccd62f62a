// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/commands.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/preview.h"
#include "satsurf/core/error.h"
#include "satsurf/core/var.h"
#include "satsurf/nn/model.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/rpc/read.h"
#include "satsurf/splat/ply.h"
#include "satsurf/splat/view.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

/// Smallest and largest element of one column of [P 3].
std::pair<double, double> column_range(const Tensor& means, Index column) {
  double low = INFINITY, high = -INFINITY;
  for (Index i = column; i < means.count(); i += 3)
    if (std::isfinite(means[i]))
      low = std::min(low, static_cast<double>(means[i])),
      high = std::max(high, static_cast<double>(means[i]));
  return {low, high};
}

/// throws Error for a picture that is too large to render
void check_cells(const std::string& where, Index width, Index height, const char* hint) {
  constexpr Index kLargest = 1 << 28;  // a GeoTIFF of 1 GB
  if (height > kLargest / width)
    throw Error(where + std::to_string(width) + " x " + std::to_string(height) +
                " pixels to render, expected fewer than " + std::to_string(kLargest) + hint);
}

}  // namespace

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
  check_output_file("--out", options.out, options.overwrite, inputs);
  const NoGrad no_grad;
  const splat::PlyContent content = splat::read_ply(options.surfels);
  const rpc::LocalFrame frame = frame_from_comments(content.comments, options.surfels.string());
  const Tensor& means = content.surfels.means.value();
  const auto [z_low, z_high] = column_range(means, 2);
  const rpc::HeightRange z_range{z_low, z_high};
  if (!(z_range.low <= z_range.high))
    throw IoError(options.surfels.string() + ": no surfels, expected a surface");

  if (image) {
    check_cells(options.image.string() + ": ", image->width, image->height, "");
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
    Tensor colour = render.colour.value().clone();
    if (png) return write_png(options.out, colour);
    for (float& v : colour.values()) v *= 255;
    return rpc::write_rpc_geotiff(options.out, colour, rpc::PixelType::uint8, *image->rpc);
  }

  const double step = options.resolution > 0 ? options.resolution : 0.5;
  const auto [x_low, x_high] = column_range(means, 0);
  const auto [y_low, y_high] = column_range(means, 1);
  const auto W = static_cast<Index>(std::ceil((x_high - x_low) / step)) + 1;
  const auto H = static_cast<Index>(std::ceil((y_high - y_low) / step)) + 1;
  const scene::HeightField grid{
      {}, std::floor(x_low / step) * step, std::ceil(y_high / step) * step, step};
  check_cells("render: ", W, H, "; give a larger --resolution");
  const auto render =
      splat::render_view(content.surfels, splat::nadir_camera(grid.x0, grid.y0, step), H, W, 1);
  if (png) return write_png(options.out, render.colour.value());
  write_field(options.out, splat::surface_heights(render), grid, frame, frame.h0,
              rpc::ellipsoidal_height("Surface heights"));
}

}  // namespace satsurf::app
