// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/narrow.h"

#include "satsurf/core/whole.h"
#include "satsurf/nn/confidence.h"
#include "satsurf/nn/hypotheses.h"
#include "satsurf/ops/resize.h"
#include "satsurf/reconstruct/cross_check.h"
#include "satsurf/scene/believable_span.h"
#include "satsurf/scene/crop.h"
#include "satsurf/scene/view_geometry.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>
#include <vector>

namespace satsurf::reconstruct {
namespace {

constexpr Index kMostPixels = 384;  // side of the images that are looked at first
constexpr double kLeastFactor = 4;

/// The scene with smaller images.
scene::Scene smaller(const scene::Scene& scene, Index factor) {
  scene::Scene out;
  out.frame = scene.frame, out.z_range = scene.z_range;
  for (const scene::View& v : scene.views) {
    const Index H = v.height() / factor * factor, W = v.width() / factor * factor;
    scene::View view;
    Tensor rgb({1, 3, H, W}), valid({1, 1, H, W});
    for (Index i = 0; i < H; ++i) {
      for (Index c = 0; c < 3; ++c)
        std::copy_n(v.rgb.data() + (c * v.height() + i) * v.width(), W,
                    rgb.data() + (c * H + i) * W);
      std::copy_n(v.valid.data() + i * v.width(), W, valid.data() + i * W);
    }
    view.rgb =
        area_downsample(Var(std::move(rgb)), factor).value().reshaped({3, H / factor, W / factor});
    view.valid =
        area_downsample(Var(std::move(valid)), factor).value().reshaped({H / factor, W / factor});
    for (float& x : view.valid.values()) x = x < 1 ? 0.f : 1.f;
    view.rpc = v.rpc.resized(1 / static_cast<double>(factor));
    out.views.push_back(std::move(view));
  }
  return out;
}

/// The ground point in the middle of the first view.
std::array<double, 3> middle_of(const scene::Scene& scene) {
  const scene::View& v = scene.views[0];
  const double z = scene.z_range.middle();
  const auto p = scene.frame.local_from_geodetic(
      v.rpc.localize({0.5 * static_cast<double>(v.width()), 0.5 * static_cast<double>(v.height())},
                     z + scene.frame.h0));
  return {p[0], p[1], z};
}

/// Unwanted ground around the middle of a scene, by cells of a few pixels.
class Unwanted {
 public:
  Unwanted(const std::function<Tensor(const Grid&)>& of, const scene::Scene& scene) {
    constexpr Index kCells = 1024;  // a side
    if (!of) return;
    const std::array<double, 3> middle = middle_of(scene);
    double reach = 0;  // of the views from there, m
    for (const scene::View& v : scene.views)
      for (const double x : {0.0, static_cast<double>(v.width())})
        for (const double y : {0.0, static_cast<double>(v.height())})
          for (const double z : {scene.z_range.low, scene.z_range.high}) {
            const auto p =
                scene.frame.local_from_geodetic(v.rpc.localize({x, y}, z + scene.frame.h0));
            reach = std::max({reach, std::abs(p[0] - middle[0]), std::abs(p[1] - middle[1])});
          }
    grid_ = {middle[0] - reach, middle[1] + reach, 2 * reach / static_cast<double>(kCells), kCells,
             kCells};
    cells_ = of(grid_);
  }
  bool holds(double x, double y) const {
    if (cells_.empty()) return false;
    const Index u = floored((x - grid_.east) / grid_.step),
                v = floored((grid_.north - y) / grid_.step);
    return u >= 0 && v >= 0 && u < grid_.width && v < grid_.height &&
           cells_[v * grid_.width + u] > 0;
  }

 private:
  Grid grid_;
  Tensor cells_;
};

/// The heights on which a pixel that is rather sure and another view agree.
std::vector<float> agreed_heights(const nn::NetworkInput& input, const Tensor& heights,
                                  const Tensor& confidence, const Unwanted& unwanted) {
  constexpr float kSure = 0.3f;
  const CrossCheck check(input, heights);
  const Index P = heights.dim(1) * heights.dim(2);
  const double within = 2 / nn::mean_parallax(input);  // m of two pixels
  std::vector<float> out;
  for (std::size_t i = 0; i < input.sources.size(); ++i)
    for (Index p = 0; p < P; ++p) {
      if (!(input.sources[i].valid[p] > 0)) continue;
      if (!(confidence[static_cast<Index>(i) * P + p] >= kSure)) continue;
      const double z = check.height(i, p);
      bool agrees = false;
      for (std::size_t j = 0; j < input.sources.size() && !agrees; ++j) {
        const Index there = j == i ? -1 : check.landing(i, j, p, z);
        agrees = there >= 0 && std::abs(check.height(j, there) - z) < within;
      }
      if (!agrees) continue;
      const Index W = input.sources[i].valid.dim(1);
      const auto at = input.sources[i].local_from_pixel(static_cast<double>(p % W),
                                                        static_cast<double>(p / W), z);
      if (!unwanted.holds(at[0], at[1])) out.push_back(static_cast<float>(z));
    }
  return out;
}

}  // namespace

double span_of_hypotheses(const nn::ModelConfig& config, const scene::Scene& scene) {
  return span_of_hypotheses(config, scene::cameras_at(scene.views, scene.frame, middle_of(scene)));
}

rpc::HeightRange narrowed_range(const nn::Model& model, const scene::Scene& scene,
                                const std::function<void()>& poll,
                                const std::function<Tensor(const Grid&)>& unwanted) {
  constexpr int kLooks = 3;
  constexpr std::size_t kFewest = 200;
  constexpr double kBelow = 10, kAbove = 20;  // m
  const double most = span_of_hypotheses(model.config(), scene);
  if (scene.z_range.span() <= most) return scene.z_range;

  Index largest = 0;
  for (const scene::View& v : scene.views) largest = std::max({largest, v.height(), v.width()});
  const auto factor = static_cast<Index>(std::max(
      kLeastFactor, std::ceil(static_cast<double>(largest) / static_cast<double>(kMostPixels))));
  scene::Scene small = smaller(scene, factor);
  const scene::WindowSize size = scene::rounded_up(
      scene::largest_image(small, small.frame.geodetic_from_local(middle_of(small))),
      nn::size_multiple(model.config()));
  std::vector<Index> sources(small.views.size());
  std::iota(sources.begin(), sources.end(), Index{0});
  const Unwanted left_out(unwanted, scene);
  // The narrower the range the fewer are wrong, so that the next look may narrow it further.
  for (int look = 0; look < kLooks && small.z_range.span() > most; ++look) {
    const rpc::HeightRange& range = small.z_range;
    const scene::Crop crop = scene::make_crop(
        small, {.sources = sources, .centre = middle_of(small), .size = size, .z_range = range});
    const auto stages = model.forward(crop.input, poll, nullptr, nn::Wanted::heights);
    std::vector<float> agreed =
        agreed_heights(crop.input, stages[2].height.value(),
                       nn::effective_confidence(model.config(), stages[2]), left_out);
    if (agreed.size() < kFewest) break;
    const rpc::HeightRange found = scene::believable_span(std::move(agreed), range);
    rpc::HeightRange next{std::max(range.low, found.low - kBelow),
                          std::min(range.high, found.high + kAbove)};
    // What the hypotheses span anyway costs nothing, and towers, few pixels and tall, may be there.
    next.high = std::min(range.high, std::max(next.high, next.low + most));
    next.low = std::max(range.low, std::min(next.low, next.high - most));
    if (scene.z_agreed) next = hull(next, *scene.z_agreed);
    const bool done = next.span() > 0.9 * range.span();
    small.z_range = next;
    if (done) break;
  }
  return small.z_range;
}

}  // namespace satsurf::reconstruct
