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
#include <optional>
#include <utility>
#include <vector>

namespace satsurf::reconstruct {
namespace {

/// How many times smaller the images are that are looked at: two, which still shows towers, and up to
/// four where the range takes more than four times the least number of hypotheses even so.
/// times    the range is of what that number spans in whole images
/// largest  side of an image, px
Index factor_of(double times, Index largest) {
  constexpr double kMostPixels = 640, kMostTimes = 4, kLeast = 2, kMost = 4;
  return static_cast<Index>(std::max(std::clamp(std::ceil(times / kMostTimes), kLeast, kMost),
                                     std::ceil(static_cast<double>(largest) / kMostPixels)));
}

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

/// The heights on which views agree.
struct Agreed {
  std::vector<float> heights;  // local m
  double share = 0;            // of the pixels that show wanted ground
};

/// The heights on which a pixel that is rather sure and another view agree.
/// heights, confidence  [N h w] of stage pixels, every `stride` of the images
Agreed agreed_heights(const nn::NetworkInput& input, const Tensor& heights,
                      const Tensor& confidence, Index stride, const Unwanted& unwanted) {
  constexpr float kSure = 0.3f;
  const Index h = heights.dim(1), w = heights.dim(2), W = w * stride;
  const Tensor of_pixels = nn::along_slopes(heights, h * stride, W);
  const CrossCheck check(input, of_pixels);
  const double within = 2 / nn::mean_parallax(input);  // m of two pixels
  Agreed out;
  Index wanted = 0;
  for (std::size_t i = 0; i < input.sources.size(); ++i)
    for (Index q = 0; q < h * w; ++q) {
      const Index p = (q / w * W + q % w) * stride;
      if (!(input.sources[i].valid[p] > 0)) continue;
      const double z = check.height(i, p);
      const auto at = input.sources[i].local_from_pixel(static_cast<double>(p % W),
                                                        static_cast<double>(p / W), z);
      if (unwanted.holds(at[0], at[1])) continue;
      ++wanted;
      if (!(confidence[static_cast<Index>(i) * h * w + q] >= kSure)) continue;
      bool agrees = false;
      for (std::size_t j = 0; j < input.sources.size() && !agrees; ++j) {
        const Index there = j == i ? -1 : check.landing(i, j, p, z);
        agrees = there >= 0 && std::abs(check.height(j, there) - z) < within;
      }
      if (agrees) out.heights.push_back(static_cast<float>(z));
    }
  out.share =
      wanted == 0 ? 0 : static_cast<double>(out.heights.size()) / static_cast<double>(wanted);
  return out;
}

/// The heights on which the views of a scene agree.
/// searched  local m
std::vector<float> look_at(const nn::Model& model, const scene::Scene& scene,
                           const rpc::HeightRange& searched, const Unwanted& unwanted,
                           const std::function<void()>& poll) {
  std::vector<Index> sources(scene.views.size());
  std::iota(sources.begin(), sources.end(), Index{0});
  const std::array<double, 3> middle = middle_of(scene);
  const scene::WindowSize size =
      scene::rounded_up(scene::largest_image(scene, scene.frame.geodetic_from_local(middle)),
                        nn::size_multiple(model.config()));
  const scene::Crop crop = scene::make_crop(
      scene, {.sources = std::move(sources), .centre = middle, .size = size, .z_range = searched});
  const auto stages = model.forward(crop.input, poll, nullptr, nn::Wanted::coarse_heights);
  const auto& seen = stages[nn::stages_of(nn::Wanted::coarse_heights) - 1];
  return agreed_heights(crop.input, seen.height.value(),
                        nn::effective_confidence(model.config(), seen), seen.stride, unwanted)
      .heights;
}

/// How much of a range is worth keeping beside the heights on which views agree.
class Rest {
 public:
  explicit Rest(const scene::Scene& scene)
      : cameras_(scene::cameras_at(scene.views, scene.frame, middle_of(scene))),
        agreed_(scene.z_agreed),
        margin_(std::max(5.0, 2 / mean_parallax(cameras_))) {}

  /// Two pixels or more, m.
  double margin() const { return margin_; }
  /// m that the fewest hypotheses span in whole images
  double enough(const nn::ModelConfig& config) const {
    return span_of_hypotheses(config, cameras_);
  }
  /// Whether there is anything to be gained.
  bool worth(const rpc::HeightRange& range) const { return !(range.span() < 6 * margin_); }

  /// A part of the range, which holds what was found with so much more of it, and what stands above that
  /// where views were seen to agree before. Not what lies below: ground is wide, so that the network
  /// finds some of it, and what it does not find is rows of roofs or trees taken for one another.
  rpc::HeightRange around(const rpc::HeightRange& range, const rpc::HeightRange& found,
                          double below, double above) const {
    const double top = agreed_ ? agreed_->high : found.high;
    return {std::max(range.low, found.low - below),
            std::min(range.high, std::max(found.high + above, top))};
  }
  /// The part that remains in the end; nothing where it would save too little. Few heights count above
  /// what is believed, where they may be towers, and none below. Where some buildings are tall, others
  /// may be taller; flat ground with halls gains most.
  /// believed  of the heights on which views agree
  std::optional<rpc::HeightRange> last(const rpc::HeightRange& range,
                                       const rpc::HeightRange& believed,
                                       const std::vector<float>& agreed) const {
    constexpr double kTall = 40, kTaller = 25;  // m
    const rpc::HeightRange seen{believed.low,
                                std::max(believed.high, scene::span_of_all_but(kFew, agreed).high)};
    const double taller = seen.span() > kTall ? std::min(0.5 * seen.span(), kTaller) : 0;
    const rpc::HeightRange part = around(range, seen, margin_, std::max(2 * margin_, taller));
    return saves(part, range) ? std::optional(part) : std::nullopt;
  }
  /// Whether a range is worth cutting to a part of it.
  static bool saves(const rpc::HeightRange& part, const rpc::HeightRange& range) {
    constexpr double kWorth = 0.85;
    return part.span() < kWorth * range.span();
  }
  /// Whether some of the heights on which views agree, more than are wrong anyway, lie apart from the
  /// middle one: behind a margin with hardly any.
  bool some_apart(std::vector<float> agreed) const {
    constexpr double kHardly = 1e-3;
    std::ranges::sort(agreed);
    const auto n = static_cast<double>(agreed.size());
    const auto hardly = static_cast<std::ptrdiff_t>(kHardly * n),
               wrong = static_cast<std::ptrdiff_t>(kFew * n);
    const auto middle = agreed.begin() + std::ssize(agreed) / 2;
    for (auto from = middle, to = middle; from != agreed.end(); ++from) {
      while (to != agreed.end() && *to - *from <= margin_) ++to;
      if (to - from <= hardly + 1 && agreed.end() - to > wrong) return true;
    }
    for (auto from = middle, to = middle; from != agreed.begin(); --from) {
      while (to != agreed.begin() && *from - *std::prev(to) <= margin_) --to;
      if (from - to <= hardly && to - agreed.begin() > wrong) return true;
    }
    return false;
  }

 private:
  static constexpr double kFew = 2e-4;  ///< of the heights are wrong, or of masts, on either side

  std::vector<rpc::PixelJacobian> cameras_;
  std::optional<rpc::HeightRange> agreed_;
  double margin_;
};

constexpr std::size_t kFewest = 200;  // heights that agree
constexpr double kOnlyChance = 0.2;   // of a range, at least, holds no surface

}  // namespace

rpc::HeightRange narrowed_range(const nn::Model& model, const scene::Scene& scene,
                                const std::function<void()>& poll,
                                const std::function<Tensor(const Grid&)>& unwanted) {
  return looks_first(model.config(), scene) ? looked_range(model, scene, poll, unwanted)
                                            : scene.z_range;
}

bool looks_first(const nn::ModelConfig& config, const scene::Scene& scene) {
  constexpr double kWide = 1.5;  // of what the fewest hypotheses span
  const Rest rest(scene);
  return rest.worth(scene.z_range) && !(scene.z_range.span() < kWide * rest.enough(config));
}

rpc::HeightRange looked_range(const nn::Model& model, const scene::Scene& scene,
                              const std::function<void()>& poll,
                              const std::function<Tensor(const Grid&)>& unwanted) {
  constexpr int kLooks = 3;
  constexpr double kUnseen = 1.5;   // of what the fewest hypotheses span
  constexpr double kFurther = 0.7;  // a range is looked at again where no more of it would remain
  const Rest rest(scene);
  const double enough = rest.enough(model.config()), margin = rest.margin();
  rpc::HeightRange range = scene.z_range;
  if (!rest.worth(range)) return range;
  Index largest = 0;
  for (const scene::View& v : scene.views) largest = std::max({largest, v.height(), v.width()});
  const Unwanted left_out(unwanted, scene);
  std::optional<rpc::HeightRange> believed;
  for (int look = 0; look < kLooks; ++look) {
    const std::vector<float> agreed = look_at(
        model, smaller(scene, factor_of(range.span() / enough, largest)), range.widened(2 * margin),
        left_out, poll);  // the ends of a range are seldom chosen
    if (agreed.size() < kFewest) break;
    // What a look over more believed stays.
    const rpc::HeightRange found =
        scene::believable_span(agreed, range, scene::kLargestStep, kOnlyChance);
    believed = believed ? hull(*believed, found) : found;
    rpc::HeightRange next = rest.around(range, *believed, 2 * margin, 6 * margin);
    // Of a very generous range small towers may not be seen yet.
    next.high = std::min(range.high, std::max(next.high, next.low + kUnseen * enough));
    next.low = std::max(range.low, std::min(next.low, next.high - kUnseen * enough));
    // The narrower the range the fewer are wrong, and the more of the towers are seen.
    if (look + 1 < kLooks && next.span() < kFurther * range.span()) {
      range = next;
      continue;
    }
    return rest.last(range, *believed, agreed).value_or(range);
  }
  return range;
}

std::optional<rpc::HeightRange> range_left(const nn::ModelConfig& config, const scene::Scene& scene,
                                           const nn::NetworkInput& input,
                                           const nn::StageHeights<float>& first,
                                           const std::function<rpc::HeightRange()>& look,
                                           const std::function<Tensor(const Grid&)>& unwanted) {
  constexpr double kMostly = 0.5;  // of the pixels agree, or what is left out proves nothing
  const Rest rest(scene);
  const rpc::HeightRange& range = input.z_range;
  if (!rest.worth(range)) return std::nullopt;
  const Agreed agreed =
      agreed_heights(input, first.height.value(), nn::effective_confidence(config, first),
                     nn::kStrides[0], Unwanted(unwanted, scene));
  if (agreed.heights.size() < kFewest || agreed.share < kMostly) return std::nullopt;
  if (look && rest.some_apart(agreed.heights))
    if (const rpc::HeightRange looked = look(); rest.saves(looked, range)) return looked;
  return rest.last(range,
                   scene::believable_span(agreed.heights, range, scene::kLargestStep, kOnlyChance),
                   agreed.heights);
}

}  // namespace satsurf::reconstruct
