// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/ortho.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/rpc/model.h"
#include "satsurf/scene/sight_lines.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

namespace satsurf::reconstruct {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

/// Centre of a cell's top.
std::array<double, 3> centre_of(const scene::HeightField& surface, Index k) {
  const Index W = surface.z.dim(1);
  return {surface.x0 + (static_cast<double>(k % W) + 0.5) * surface.step,
          surface.y0 - (static_cast<double>(k / W) + 0.5) * surface.step,
          static_cast<double>(surface.z[k])};
}

/// Metres aside per metre of height of the ray through a pixel.
double slant(const nn::PosedImage& image, const std::array<double, 2>& pixel, double z) {
  const auto j = image.local_from_pixel.jacobian(pixel[0], pixel[1], z);
  return std::hypot(j[0][2], j[1][2]);
}

/// The four pixels around a position inside an image, and the way between them.
struct Between {
  std::array<Index, 2> x, y;
  float fx, fy;
};
Between between(const std::array<double, 2>& q, Index width, Index height) {
  const double x = std::clamp(q[0], 0.0, static_cast<double>(width - 1)),
               y = std::clamp(q[1], 0.0, static_cast<double>(height - 1));
  const auto left = static_cast<Index>(x), top = static_cast<Index>(y);
  return {{left, std::min(left + 1, width - 1)},
          {top, std::min(top + 1, height - 1)},
          static_cast<float>(x - static_cast<double>(left)),
          static_cast<float>(y - static_cast<double>(top))};
}

/// The pixel nearest to a position inside an image.
Index nearest(const std::array<double, 2>& q, Index width, Index height) {
  return std::clamp<Index>(std::lround(q[1]), 0, height - 1) * width +
         std::clamp<Index>(std::lround(q[0]), 0, width - 1);
}

}  // namespace

Visibility find_visibility(const scene::HeightField& surface,
                           const std::vector<nn::PosedImage>& images, const Exposures& exposures) {
  const Index H = surface.z.dim(0), W = surface.z.dim(1);
  Visibility out{Tensor({H, W}, kNan), std::vector<Index>(static_cast<std::size_t>(H * W), -1)};
  std::vector<scene::LitView> views;
  for (const nn::PosedImage& image : images) views.push_back({image});
  const scene::SightLines lines(surface, views);
  if (lines.empty()) return out;
  const Outvoted outvoted(surface, images, lines, exposures);
  for_range(H, 4, [&](Index begin, Index end) {
    for (Index k = begin * W; k < end * W; ++k) {
      if (!std::isfinite(surface.z[k])) continue;
      const auto p = centre_of(surface, k);
      // images that are outvoted come after all others
      std::pair<bool, double> least{true, std::numeric_limits<double>::infinity()};
      Index count = 0;
      for (std::size_t i = 0; i < images.size(); ++i) {
        if (!lines.sees(i, k / W, k % W)) continue;
        const auto q = images[i].pixel_from_local(p[0], p[1], p[2]);
        const Index width = images[i].valid.dim(1), height = images[i].valid.dim(0);
        if (!(images[i].valid[nearest(q, width, height)] > 0)) continue;
        ++count;
        const std::pair how{outvoted(i, k / W, k % W), slant(images[i], q, p[2])};
        if (how < least) least = how, out.best[static_cast<std::size_t>(k)] = static_cast<Index>(i);
      }
      out.views[k] = static_cast<float>(count);
    }
  });
  return out;
}

Tensor orthophoto(const scene::HeightField& surface, const std::vector<nn::PosedImage>& images,
                  const Visibility& visibility, const std::function<Tensor(Index)>& pixels) {
  const Index H = surface.z.dim(0), W = surface.z.dim(1), P = H * W;
  Tensor out;
  for (Index i = 0; i < static_cast<Index>(images.size()); ++i) {
    if (std::ranges::find(visibility.best, i) == visibility.best.end()) continue;
    const nn::PosedImage& image = images[static_cast<std::size_t>(i)];
    const Tensor values = pixels(i);
    Dims dim("orthophoto");
    dim.match("valid", image.valid, "h w").match("pixels", values, "C h w");
    const Index C = dim["C"], h = dim["h"], w = dim["w"];
    if (out.empty()) out = Tensor({C, H, W}, kNan);
    if (out.dim(0) != C)
      throw ShapeError("orthophoto: " + std::to_string(C) + " channels of image " +
                       std::to_string(i) + ", expected " + std::to_string(out.dim(0)));
    for_range(H, 4, [&](Index begin, Index end) {
      for (Index k = begin * W; k < end * W; ++k) {
        if (visibility.best[static_cast<std::size_t>(k)] != i) continue;
        const auto p = centre_of(surface, k);
        const auto q = image.pixel_from_local(p[0], p[1], p[2]);
        const Between b = between(q, w, h);
        bool whole = true;
        for (const Index y : b.y)
          for (const Index x : b.x) whole = whole && image.valid[y * w + x] > 0;
        for (Index c = 0; c < C; ++c) {
          const float* from = values.data() + c * h * w;
          const auto row = [&](Index y) {
            return from[y * w + b.x[0]] + b.fx * (from[y * w + b.x[1]] - from[y * w + b.x[0]]);
          };
          const float top = row(b.y[0]);
          out[c * P + k] = whole ? top + b.fy * (row(b.y[1]) - top) : from[nearest(q, w, h)];
        }
      }
    });
  }
  return out;
}

}  // namespace satsurf::reconstruct
