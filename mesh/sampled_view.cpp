// SPDX-License-Identifier: Apache-2.0
#include "satsurf/mesh/sampled_view.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/mesh/geometry.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

namespace satsurf::mesh {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr double kLeastSure = 1e-3;  // a doubtful view still speaks where it is the only one
// A pixel whose neighbours lie this obliquely to its ray, as on the rim of a skyscraper, shows no
// surface but a jump or a mistake.
constexpr double kLeastCosine = 0.03;
// Behind a surface a view's word counts fully for one voxel, which evens out noise, and little from
// 2.5 on: enough against a single wrong pixel, not enough to push a wall.
constexpr double kFull = 1, kFaded = 2.5, kBehind = 0.01;

void check_fusion(const FusionOptions& options) {
  char text[120];
  if (!(options.voxel > 0) || !std::isfinite(options.voxel)) {
    std::snprintf(text, sizeof text, "fuse: voxel %g, expected a positive number of metres",
                  options.voxel);
    throw ConfigError(text);
  }
  if (!(options.truncation >= 2 && options.truncation <= 8)) {
    std::snprintf(text, sizeof text, "fuse: truncation %g, expected 2 to 8 voxels",
                  options.truncation);
    throw ConfigError(text);
  }
}

}  // namespace

SampledView::SampledView(const HeightImage& view, const FusionOptions& options)
    : projection_(view.pixel_from_local),
      localisation_(view.local_from_pixel),
      voxel_(options.voxel),
      limit_(options.truncation * options.voxel) {
  Dims dim("fuse");
  dim.match("height", view.height, "H W");
  H_ = dim["H"], W_ = dim["W"];
  if (!view.confidence.empty()) dim.match("confidence", view.confidence, "H W");
  if (!view.rgb.empty()) dim.match("rgb", view.rgb, "3 H W");
  samples_.resize(static_cast<std::size_t>(H_ * W_));
  ground_.resize(samples_.size());
  for_range(H_, 16, [&](Index begin, Index end) {
    for (Index p = begin * W_; p < end * W_; ++p) {
      const float z = view.height[p];
      auto& at = ground_[static_cast<std::size_t>(p)];
      samples_[static_cast<std::size_t>(p)] = {std::isfinite(z) ? z : kNan, 0};
      at = {kNan, kNan};
      if (!std::isfinite(z)) continue;
      const auto xy = localisation_(static_cast<double>(p % W_), static_cast<double>(p / W_),
                                    static_cast<double>(z));
      at = {static_cast<float>(xy[0]), static_cast<float>(xy[1])};
    }
  });
  weigh(view.confidence);
  for (const double x : {0.0, static_cast<double>(W_ - 1)})
    for (const double y : {0.0, static_cast<double>(H_ - 1)}) {
      const auto j = localisation_.jacobian(x, y, 0);
      reach_ = std::max(reach_, std::hypot(j[0][2], j[1][2]));
    }
  const auto j =
      localisation_.jacobian(static_cast<double>(W_ - 1) / 2, static_cast<double>(H_ - 1) / 2, 0);
  const auto known = std::count_if(samples_.begin(), samples_.end(),
                                   [](const Sample& s) { return !std::isnan(s.z); });
  area_ = static_cast<double>(known) * std::abs(j[0][0] * j[1][1] - j[0][1] * j[1][0]);
}

void SampledView::weigh(const Tensor& confidence) {
  // Step from the neighbour before to the one behind, as far as they are known.
  const auto step = [&](Index p, Index stride, bool before, bool behind) -> Point {
    const auto known = [&](Index q) { return std::isfinite(z(q)); };
    const Index a = before && known(p - stride) ? p - stride : p,
                b = behind && known(p + stride) ? p + stride : p;
    const auto ga = ground(a), gb = ground(b);
    return {static_cast<double>(gb[0] - ga[0]), static_cast<double>(gb[1] - ga[1]),
            static_cast<double>(z(b) - z(a))};
  };
  // Whether a pixel stands out from both neighbours by more than the truncation: a mistake.
  const auto stands_out = [&](Index p, Index stride, bool inner) {
    if (!inner) return false;
    const auto a = static_cast<double>(z(p) - z(p - stride)),
               b = static_cast<double>(z(p) - z(p + stride));
    return a * b > 0 && std::min(std::abs(a), std::abs(b)) > limit_;
  };
  for_range(H_, 16, [&](Index begin, Index end) {
    for (Index r = begin; r < end; ++r) {
      // The ray's direction changes by far less than a degree within a row.
      const auto j =
          localisation_.jacobian(static_cast<double>(W_ - 1) / 2, static_cast<double>(r), 0);
      const Point ray{j[0][2], j[1][2], 1};
      for (Index c = 0; c < W_; ++c) {
        const Index p = r * W_ + c;
        Sample& s = samples_[static_cast<std::size_t>(p)];
        if (!std::isfinite(s.z)) continue;
        const Point n = cross(step(p, 1, c > 0, c + 1 < W_), step(p, W_, r > 0, r + 1 < H_));
        const double length = std::sqrt(dot(n, n) * dot(ray, ray));
        const double cosine = length > 0 ? std::abs(dot(n, ray)) / length : 0;
        if (!(cosine >= kLeastCosine) || stands_out(p, 1, c > 0 && c + 1 < W_) ||
            stands_out(p, W_, r > 0 && r + 1 < H_))
          continue;
        const double sure = confidence.empty()
                                ? 1
                                : std::clamp(static_cast<double>(confidence[p]), kLeastSure, 1.0);
        s.weight = static_cast<float>(cosine * sure);
      }
    }
  });
}

double SampledView::slant(double x, double y, double z) const {
  // Along the ray the pixel stays: J_xy v_xy + J_z = 0.
  const auto j = projection_.jacobian(x, y, z);
  const double det = j[0][0] * j[1][1] - j[0][1] * j[1][0];
  const double vx = (j[0][1] * j[1][2] - j[1][1] * j[0][2]) / det,
               vy = (j[1][0] * j[0][2] - j[0][0] * j[1][2]) / det;
  return std::sqrt(1 + vx * vx + vy * vy);
}

double SampledView::height_at(double x, double y, Index nearest) const {
  const double fx = std::floor(x), fy = std::floor(y);
  const Index x0 = std::max<Index>(0, static_cast<Index>(fx)),
              y0 = std::max<Index>(0, static_cast<Index>(fy));
  const Index x1 = std::min(static_cast<Index>(fx) + 1, W_ - 1),
              y1 = std::min(static_cast<Index>(fy) + 1, H_ - 1);
  const double a = static_cast<double>(z(y0 * W_ + x0)), b = static_cast<double>(z(y0 * W_ + x1)),
               c = static_cast<double>(z(y1 * W_ + x0)), d = static_cast<double>(z(y1 * W_ + x1));
  const double low = std::min(std::min(a, b), std::min(c, d)),
               high = std::max(std::max(a, b), std::max(c, d));
  // False with a NaN among them as well.
  if (!(a - b + c - d < INFINITY && high - low <= limit_)) return static_cast<double>(z(nearest));
  const double u = x - fx, v = y - fy;
  return (a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + d * u) * v;
}

SampledView::Answer SampledView::ask(double x, double y, double z, double slant) const {
  if (!(x > -0.5 && y > -0.5 && x < static_cast<double>(W_) - 0.5 &&
        y < static_cast<double>(H_) - 0.5))
    return {};
  const Index nearest =
      static_cast<Index>(y + 0.5) * W_ + static_cast<Index>(x + 0.5);  // both are above zero
  const Sample& sample = samples_[static_cast<std::size_t>(nearest)];
  if (!(sample.weight > 0)) return {};
  const double d = (z - height_at(x, y, nearest)) * slant;
  const double fade = std::clamp((d / voxel_ + kFaded) / (kFaded - kFull), kBehind, 1.0);
  return {std::clamp(d, -limit_, limit_), static_cast<double>(sample.weight) * fade};
}

std::vector<SampledView> sampled_views(std::span<const HeightImage> views,
                                       const FusionOptions& options) {
  check_fusion(options);
  std::vector<SampledView> sampled;
  sampled.reserve(views.size());
  for (const HeightImage& v : views) sampled.emplace_back(v, options);
  return sampled;
}

}  // namespace satsurf::mesh
