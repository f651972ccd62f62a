// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/grey_pyramid.h"

#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>

namespace satsurf::scene {
namespace {

Grey grey_of(const View& view) {
  const Index H = view.height(), W = view.width(), P = H * W;
  Grey out{.height = H, .width = W, .values = std::vector<float>(static_cast<std::size_t>(P))};
  const float *rgb = view.rgb.data(), *valid = view.valid.data();
  for_range(H, 64, [&](Index begin, Index end) {
    for (Index i = begin * W; i < end * W; ++i)
      out.values[static_cast<std::size_t>(i)] =
          valid[i] > 0 ? (rgb[i] + rgb[P + i] + rgb[2 * P + i]) / 3 : std::nanf("");
  });
  return out;
}

Grey halved(const Grey& from) {
  Grey out{.height = from.height / 2, .width = from.width / 2};
  out.values.resize(static_cast<std::size_t>(out.height * out.width));
  for_range(out.height, 64, [&](Index begin, Index end) {
    for (Index y = begin; y < end; ++y) {
      const float *a = from.row(2 * y), *b = from.row(2 * y + 1);
      float* to = out.row(y);
      for (Index x = 0; x < out.width; ++x)
        to[x] = (a[2 * x] + a[2 * x + 1] + b[2 * x] + b[2 * x + 1]) / 4;
    }
  });
  return out;
}

}  // namespace

std::vector<Grey> grey_pyramid(const View& view, Index levels) {
  std::vector<Grey> out{grey_of(view)};
  for (Index l = 1; l < levels; ++l) out.push_back(halved(out.back()));
  return out;
}

std::vector<std::array<double, 2>> spread_corners(const Grey& image, Index cell, Index border) {
  constexpr Index kRadius = 2;     // px, of the window
  constexpr float kLeast = 1e-5f;  // of grey values from 0 to 1, squared, per window
  const Index H = image.height, W = image.width;
  const Index rows = (H - 2 * border) / cell, columns = (W - 2 * border) / cell;
  if (rows < 1 || columns < 1) return {};
  std::vector<std::array<double, 2>> found(static_cast<std::size_t>(rows * columns), {-1, -1});
  for_each_index(rows, [&](Index r) {
    // Sums over the columns of a window, moved down one row at a time.
    const Index top = border + r * cell;
    std::vector<float> best(static_cast<std::size_t>(columns), kLeast);
    std::vector<float> xx(static_cast<std::size_t>(W)), xy(xx), yy(xx);
    for (Index y = top; y < top + cell; ++y) {
      std::fill(xx.begin(), xx.end(), 0.f), std::fill(xy.begin(), xy.end(), 0.f),
          std::fill(yy.begin(), yy.end(), 0.f);
      for (Index v = y - kRadius; v <= y + kRadius; ++v) {
        const float *above = image.row(v - 1), *here = image.row(v), *below = image.row(v + 1);
        for (Index x = 1; x + 1 < W; ++x) {
          const float dx = here[x + 1] - here[x - 1], dy = below[x] - above[x];
          const auto k = static_cast<std::size_t>(x);
          xx[k] += dx * dx, xy[k] += dx * dy, yy[k] += dy * dy;
        }
      }
      for (Index c = 0; c < columns; ++c)
        for (Index x = border + c * cell; x < border + (c + 1) * cell; ++x) {
          float a = 0, b = 0, d = 0;
          for (Index u = x - kRadius; u <= x + kRadius; ++u) {
            const auto k = static_cast<std::size_t>(u);
            a += xx[k], b += xy[k], d += yy[k];
          }
          const float smaller = 0.5f * (a + d) - std::sqrt(0.25f * (a - d) * (a - d) + b * b);
          float& most = best[static_cast<std::size_t>(c)];
          if (!(smaller > most)) continue;  // nor where it is NaN
          most = smaller;
          found[static_cast<std::size_t>(r * columns + c)] = {static_cast<double>(x),
                                                              static_cast<double>(y)};
        }
    }
  });
  std::erase_if(found, [](const std::array<double, 2>& p) { return p[0] < 0; });
  return found;
}

}  // namespace satsurf::scene
