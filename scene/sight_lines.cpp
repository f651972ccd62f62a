// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/sight_lines.h"

#include "satsurf/core/parallel.h"
#include "satsurf/rpc/model.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace satsurf::scene {
namespace {

/// The surface with its unknown cells too low to be in the way.
HeightField known_only(const HeightField& surface) {
  HeightField out = surface;
  out.z = surface.z.clone();
  float low = std::numeric_limits<float>::infinity();
  for (const float z : surface.z.values()) low = z < low ? z : low;
  for (float& z : out.z.values())
    if (!std::isfinite(z) && std::isfinite(low)) z = low;
  return out;
}

/// Heights from which a straight line out of a cell's centre meets no other cell, whatever its
/// direction: none rises above a cone around it. Spares most of the rays.
/// z        [H W] m, all known
/// step     of the grid, m
/// slope    m that lines run at most for each they rise
/// returns  [H W] m
Tensor clear_heights(const Tensor& z, double step, double slope) {
  const Index H = z.dim(0), W = z.dim(1), pitch = W + 2;
  const auto rise = static_cast<float>(step / slope);  // of a line over a cell, at least
  // highest at each cell of the cones below all others, with a margin of one cell around the grid
  Tensor cones({H + 2, pitch}, -std::numeric_limits<float>::infinity());
  const auto row = [&](Index i) { return cones.data() + (i + 1) * pitch + 1; };
  for (Index i = 0; i < H; ++i) std::copy_n(z.data() + i * W, W, row(i));
  // each cell takes from the neighbours before it, downwards, then upwards from the others
  const auto raise = [&](float* own, const float* before) {
    for (Index j = 0; j < W; ++j)
      own[j] = std::max(own[j], std::max({before[j - 1], before[j], before[j + 1]}) - rise);
  };
  for (Index i = 0; i < H; ++i) {
    raise(row(i), row(i - 1));
    for (Index j = 0; j < W; ++j) row(i)[j] = std::max(row(i)[j], row(i)[j - 1] - rise);
  }
  for (Index i = H; i-- > 0;) {
    raise(row(i), row(i + 1));
    for (Index j = W; j-- > 0;) row(i)[j] = std::max(row(i)[j], row(i)[j + 1] - rise);
  }
  auto out = Tensor::uninitialised({H, W});
  for_range(H, 16, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const float *above = row(i - 1), *own = row(i), *below = row(i + 1);
      for (Index j = 0; j < W; ++j)  // from the centre the next cell is half a cell away
        out[i * W + j] = std::max({above[j - 1], above[j], above[j + 1], own[j - 1], own[j + 1],
                                   below[j - 1], below[j], below[j + 1]}) -
                         0.5f * rise;
    }
  });
  return out;
}

}  // namespace

SightLines::SightLines(const HeightField& surface, const std::vector<LitView>& views)
    : surface_(surface), views_(views), solid_(known_only(surface)), columns_(solid_) {
  double rays = 0, light = 0;
  for (const LitView& view : views) {
    const Tensor& image = view.image.rgb;
    for (const Index x : {Index{0}, image.dim(2)})
      for (const Index y : {Index{0}, image.dim(1)}) {
        const auto j = view.image.local_from_pixel.jacobian(
            static_cast<double>(x), static_cast<double>(y), columns_.high());
        rays = std::max(rays, std::hypot(j[0][2], j[1][2]));
      }
    if (view.to_sun) light = std::max(light, std::hypot((*view.to_sun)[0], (*view.to_sun)[1]));
  }
  constexpr double kMargin = 1.01;  // rays of one image differ by less
  clear_of_rays_ = clear_heights(solid_.z, surface.step, kMargin * rays);
  clear_of_light_ = clear_heights(solid_.z, surface.step, kMargin * light);
}

std::array<double, 3> SightLines::centre(Index row, Index col) const {
  return {surface_.x0 + (static_cast<double>(col) + 0.5) * surface_.step,
          surface_.y0 - (static_cast<double>(row) + 0.5) * surface_.step,
          static_cast<double>(surface_.z[row * surface_.z.dim(1) + col])};
}

bool SightLines::sees(std::size_t view, Index row, Index col) const {
  const nn::PosedImage& image = views_[view].image;
  const auto p = centre(row, col);
  const auto q = image.pixel_from_local(p[0], p[1], p[2]);
  if (!rpc::inside_image({q[0], q[1]}, image.rgb.dim(2), image.rgb.dim(1))) return false;
  const Index k = row * surface_.z.dim(1) + col;
  return surface_.z[k] >= clear_of_rays_[k] || reaches(image, q, row, col, p);
}

Sight SightLines::at(Index row, Index col) const {
  const Index k = row * surface_.z.dim(1) + col;
  const bool sunlit = surface_.z[k] >= clear_of_light_[k];
  const auto [x, y, z] = centre(row, col);
  const double up = columns_.high() - z, down = columns_.low() - z;
  Sight out;
  for (std::size_t i = 0; i < views_.size(); ++i) {
    const LitView& view = views_[i];
    const nn::PosedImage& image = view.image;
    const auto q = image.pixel_from_local(x, y, z);
    if (!rpc::inside_image({q[0], q[1]}, image.rgb.dim(2), image.rgb.dim(1))) continue;
    ++out.contain;
    out.see += sees(i, row, col);
    if (sunlit || out.shaded || !view.to_sun) continue;
    const auto [east, north] = *view.to_sun;
    out.shaded =
        !reached(row, col, {x + up * east, y + up * north}, {x + down * east, y + down * north});
  }
  return out;
}

bool SightLines::reaches(const nn::PosedImage& image, const std::array<double, 2>& q, Index row,
                         Index col, const std::array<double, 3>& p) const {
  // the camera's two maps are inverse to each other but for the residuals of their fits; the ray
  // goes through the point all the same
  const auto at = image.local_from_pixel(q[0], q[1], p[2]),
             top = image.local_from_pixel(q[0], q[1], columns_.high()),
             bottom = image.local_from_pixel(q[0], q[1], columns_.low());
  return reached(row, col, {p[0] + top[0] - at[0], p[1] + top[1] - at[1]},
                 {p[0] + bottom[0] - at[0], p[1] + bottom[1] - at[1]});
}

bool SightLines::reached(Index row, Index col, const std::array<double, 2>& top,
                         const std::array<double, 2>& bottom) const {
  const auto hit = columns_.walk(top[0], top[1], bottom[0], bottom[1]);
  return hit.row == row && hit.col == col;
}

}  // namespace satsurf::scene
