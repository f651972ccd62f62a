// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/rendered_view.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/splat/view.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace satsurf::reconstruct {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

}  // namespace

RenderedView rendered_view(const splat::Surfels& surfels, const nn::PosedImage& image) {
  const Index H = image.rgb.dim(1), W = image.rgb.dim(2);
  RenderedView out;
  const auto render = splat::render_view(surfels, image.pixel_from_local, H, W, 1);
  out.colour = splat::surface_colours(render);
  out.heights.pixel_from_local = image.pixel_from_local;
  out.heights.local_from_pixel = image.local_from_pixel;
  out.heights.height = splat::surface_heights(render);
  // confidence by what stops the light there: thin surfaces are doubtful ones
  out.heights.confidence = render.aux.value().reshaped({H, W});
  out.heights.rgb = image.rgb.clone();
  for_each_index(H, [&](Index y) {
    for (Index p = y * W; p < (y + 1) * W; ++p)
      for (Index c = 0; c < 3; ++c)
        if (!(image.valid[p] > 0)) out.heights.rgb[c * H * W + p] = kNan;
  });
  return out;
}

Tensor draped_view(const scene::HeightField& surface, const Tensor& colours,
                   const nn::PosedImage& image) {
  Dims dim("draped_view");
  dim.match("surface", surface.z, "H W").match("colours", colours, "3 H W");
  const Index H = dim["H"], W = dim["W"], h = image.rgb.dim(1), w = image.rgb.dim(2);
  const Tensor z = scene::heights_in_view(surface, image.local_from_pixel, h, w);
  Tensor out({3, h, w});
  for_each_index(h, [&](Index y) {
    for (Index x = 0; x < w; ++x) {
      if (!std::isfinite(z[y * w + x])) continue;
      const auto p = image.local_from_pixel(static_cast<double>(x), static_cast<double>(y),
                                            static_cast<double>(z[y * w + x]));
      // a ray that ends on a wall may be a rounding beyond its cell
      const Index v = std::clamp<Index>(
                      static_cast<Index>(std::floor((surface.y0 - p[1]) / surface.step)), 0, H - 1),
                  u = std::clamp<Index>(
                      static_cast<Index>(std::floor((p[0] - surface.x0) / surface.step)), 0, W - 1);
      for (Index c = 0; c < 3; ++c)
        if (const float colour = colours[(c * H + v) * W + u]; std::isfinite(colour))
          out[(c * h + y) * w + x] = colour;
    }
  });
  return out;
}

mesh::HeightImage true_view(const scene::HeightField& truth, const nn::PosedImage& image) {
  mesh::HeightImage out;
  out.pixel_from_local = image.pixel_from_local;
  out.local_from_pixel = image.local_from_pixel;
  out.height =
      scene::heights_in_view(truth, image.local_from_pixel, image.rgb.dim(1), image.rgb.dim(2));
  return out;
}

void keep_inside(mesh::HeightImage& view, const scene::HeightField& field, const Tensor& mask) {
  const Index H = view.height.dim(0), W = view.height.dim(1);
  for_each_index(H, [&](Index y) {
    for (Index x = 0; x < W; ++x) {
      float& z = view.height[y * W + x];
      if (!std::isfinite(z)) continue;
      const auto p = view.local_from_pixel(static_cast<double>(x), static_cast<double>(y),
                                           static_cast<double>(z));
      const double row = std::floor((field.y0 - p[1]) / field.step),
                   col = std::floor((p[0] - field.x0) / field.step);
      const bool inside = row >= 0 && col >= 0 && row < static_cast<double>(mask.dim(0)) &&
                          col < static_cast<double>(mask.dim(1));
      if (!inside || !(mask[static_cast<Index>(row) * mask.dim(1) + static_cast<Index>(col)] > 0))
        z = kNan;
    }
  });
}

}  // namespace satsurf::reconstruct
