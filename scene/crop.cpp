// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/crop.h"

#include "satsurf/core/parallel.h"
#include "satsurf/rpc/fit.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace satsurf::scene {
namespace {

/// [a, b) of a window clipped to [0, n).
Tensor cut(const Tensor& image, Index x0, Index y0, Index size) {
  const bool planes = image.rank() == 3;
  const Index C = planes ? image.dim(0) : 1, H = image.dim(planes ? 1 : 0),
              W = image.dim(planes ? 2 : 1);
  Tensor out(planes ? Shape{C, size, size} : Shape{size, size});
  const Index x_begin = std::max<Index>(0, -x0), x_end = std::min(size, W - x0);
  for (Index c = 0; c < C; ++c)
    for (Index y = std::max<Index>(0, -y0); y < std::min(size, H - y0); ++y)
      if (x_end > x_begin)
        std::copy_n(image.data() + (c * H + y0 + y) * W + x0 + x_begin, x_end - x_begin,
                    out.data() + (c * size + y) * size + x_begin);
  return out;
}

}  // namespace

Crop make_crop(const Scene& scene, const std::vector<Index>& sources, std::optional<Index> target,
               double x, double y, double z, Index size, double z_low, double z_high,
               bool with_truth) {
  const rpc::Geodetic centre = scene.frame.geodetic_from_local({x, y, z});
  const rpc::HeightRange range{z_low + scene.frame.h0, z_high + scene.frame.h0};
  const rpc::Window window{0, 0, static_cast<double>(size), static_cast<double>(size)};

  std::vector<Index> chosen = sources;
  if (target) chosen.push_back(*target);
  const std::size_t N = sources.size(), all = chosen.size();
  std::vector<rpc::Rpc> cameras(all);
  std::vector<nn::PosedImage> views(all);
  for_each_index(static_cast<Index>(all), [&](Index k) {
    const auto i = static_cast<std::size_t>(k);
    const View& from = scene.views[static_cast<std::size_t>(chosen[i])];
    const rpc::Pixel pixel = from.rpc.project(centre);
    const double half = (static_cast<double>(size) - 1) / 2;
    const double x0 = std::round(pixel.x - half), y0 = std::round(pixel.y - half);
    cameras[i] = from.rpc.cropped(x0, y0);
    views[i] = {cut(from.rgb, static_cast<Index>(x0), static_cast<Index>(y0), size),
                cut(from.valid, static_cast<Index>(x0), static_cast<Index>(y0), size),
                rpc::fit_localisation(cameras[i], scene.frame, window, range),
                rpc::fit_projection(cameras[i], scene.frame, window, range)};
  });

  Crop crop;
  crop.input.z_low = z_low;
  crop.input.z_high = z_high;
  crop.input.transfer.assign(N, std::vector<Quadratic>(N));
  for_each_index(static_cast<Index>(N * N), [&](Index k) {
    const auto i = static_cast<std::size_t>(k) / N, j = static_cast<std::size_t>(k) % N;
    if (i != j)
      crop.input.transfer[i][j] =
          rpc::fit_transfer(cameras[i], cameras[j], scene.frame, window, range);
  });
  if (with_truth && scene.truth) {
    for (const Index stride : {Index{4}, Index{2}, Index{1}}) {
      auto& stage = crop.source_truth.emplace_back();
      for (std::size_t i = 0; i < N; ++i)
        stage.push_back(heights_in_view(
            *scene.truth, rescale_pixels(views[i].local_from_pixel, static_cast<double>(stride), 1),
            size / stride, size / stride));
    }
    if (target)
      crop.target_truth = heights_in_view(*scene.truth, views[N].local_from_pixel, size, size);
  }
  if (target) crop.target = std::move(views[N]);
  views.resize(N);
  crop.input.sources = std::move(views);
  return crop;
}

}  // namespace satsurf::scene
