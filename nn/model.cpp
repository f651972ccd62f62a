// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/model.h"

#include "satsurf/core/parallel.h"
#include "satsurf/nn/cost_net.h"
#include "satsurf/nn/feature_net.h"
#include "satsurf/nn/fusion.h"
#include "satsurf/nn/guidance.h"
#include "satsurf/nn/hypotheses.h"
#include "satsurf/nn/surfel_head.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/cost_volume.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/resize.h"
#include "satsurf/ops/softmax.h"
#include "satsurf/splat/select.h"
#include "satsurf/splat/view.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

namespace satsurf::nn {
namespace {

/// One tensor [N ...] of a plane stack of every view.
template <class T>
BasicTensor<T> stacked(const std::vector<PosedImage>& views, const Tensor PosedImage::*member) {
  const Shape& one = (views[0].*member).shape();
  std::vector<Index> extents{static_cast<Index>(views.size())};
  extents.insert(extents.end(), one.extents().begin(), one.extents().end());
  auto out = BasicTensor<T>::uninitialised(Shape(std::span<const Index>(extents)));
  for (std::size_t n = 0; n < views.size(); ++n)
    for (Index i = 0; i < one.count(); ++i)
      out[static_cast<Index>(n) * one.count() + i] = static_cast<T>((views[n].*member)[i]);
  return out;
}

void check(const ModelConfig& config, const NetworkInput& scene) {
  const std::size_t N = scene.sources.size();
  if (N < 2)
    throw ShapeError("model: " + std::to_string(N) + " source views, expected two or more");
  const Shape& first = scene.sources[0].rgb.shape();
  const Index multiple = size_multiple(config);
  for (const PosedImage& v : scene.sources) {
    if (v.rgb.shape() != first || first.rank() != 3 || first[0] != 3)
      throw ShapeError("model: a view has shape " + v.rgb.shape().str() +
                       ", expected [3 H W], the same for all");
    if (v.valid.shape() != Shape{first[1], first[2]})
      throw ShapeError("model: a validity mask has shape " + v.valid.shape().str() +
                       ", expected [H W] of its view");
  }
  if (first[1] % multiple != 0 || first[2] % multiple != 0)
    throw ShapeError("model: views are " + first.str() + ", expected multiples of " +
                     std::to_string(multiple));
  if (scene.transfer.size() != N || std::any_of(scene.transfer.begin(), scene.transfer.end(),
                                                [N](const auto& row) { return row.size() != N; }))
    throw ShapeError("model: expected a pixel transfer for every pair of views");
  if (!scene.z_range.has_span())
    throw ConfigError("model: height range " + std::to_string(scene.z_range.low) + " to " +
                      std::to_string(scene.z_range.high) + ", expected a positive span");
}

/// The constructor of the model refuses what no network can be built from.
void check_hypotheses(const ModelConfig& config) {
  const Index halved = Index{1} << config.volume_levels;
  for (const Index d : config.hypotheses)
    if (d % halved != 0)
      throw ConfigError("model: " + std::to_string(d) + " hypotheses, expected a multiple of " +
                        std::to_string(halved) +
                        " (volume_levels = " + std::to_string(config.volume_levels) + ")");
  if (config.hypotheses[0] == 0)
    throw ConfigError("model: no hypotheses at the first stage, expected " +
                      std::to_string(halved) + " or more: there is nothing to interpolate");
}

Rotation rotation_of(const ModelConfig& config) {
  return config.rotation == "camera"     ? Rotation::camera
         : config.rotation == "gradient" ? Rotation::gradient
                                         : Rotation::residual;
}

}  // namespace

template <class T>
BasicTensor<T> effective_confidence(const ModelConfig& config, const StageOutput<T>& stage) {
  if (config.confidence == "joint") return stage.within;
  if (config.confidence == "raw") return stage.confidence.value();
  const T floor = T(1) / static_cast<T>(stage.choices);
  BasicTensor<T> out = stage.confidence.value().clone();
  for (T& c : out.values()) c = (c - floor) / (T(1) - floor);
  return out;
}

template <class T>
struct BasicModel<T>::Parts {
  /// The parameters of one stage.
  struct Stage {
    std::optional<CostNet<T>> cost;  ///< where the stage searches
    SurfelHead<T> head;
    std::optional<FeatureFusion<T>> fusion;
    std::optional<Guidance<T>> guidance;
  };
  class Pass;

  Parts(const ModelConfig& c, std::uint64_t seed)
      : config(c), parameters(seed), features(parameters, c.base) {
    if (config.mono != "none") mono.emplace(parameters, "mono", config.mono_net);
    for (std::size_t s = 0; s < 3; ++s) {
      const std::string name = "stage" + std::to_string(s + 1);
      const Index channels = config.base * kStrides[s],
                  head_in = 3 + channels + config.hypotheses[s] + 1;
      std::optional<CostNet<T>> cost;
      if (config.hypotheses[s] > 0)
        cost.emplace(parameters, name + ".cost", channels, config.volume_base, config.volume_levels,
                     config.context == "reference");
      stages.push_back({std::move(cost),
                        SurfelHead<T>(parameters, name + ".head", head_in, config.head_width[s]),
                        {},
                        {}});
      if (s == 0) continue;
      const Index mono_channels = !mono    ? 0
                                  : s == 1 ? mono->half_channels()
                                           : mono->full_channels();
      if (config.fusion != "none")
        stages[s].fusion.emplace(parameters, name + ".fusion", config, channels, mono_channels);
      if (config.guidance != "none")
        stages[s].guidance.emplace(parameters, name + ".guidance", head_in - 1);
    }
  }

  ModelConfig config;
  ParameterSet<T> parameters;
  FeatureNet<T> features;
  std::optional<MonoNet<T>> mono;
  std::vector<Stage> stages;
};

template <class T>
BasicModel<T>::BasicModel(const ModelConfig& config, std::uint64_t seed) {
  check_hypotheses(config);
  parts_ = std::make_unique<Parts>(config, seed);
}

template <class T>
BasicModel<T>::~BasicModel() = default;
template <class T>
BasicModel<T>::BasicModel(BasicModel&&) noexcept = default;
template <class T>
BasicModel<T>& BasicModel<T>::operator=(BasicModel&&) noexcept = default;
template <class T>
const ModelConfig& BasicModel<T>::config() const {
  return parts_->config;
}
template <class T>
ParameterSet<T>& BasicModel<T>::parameters() {
  return parts_->parameters;
}
template <class T>
const ParameterSet<T>& BasicModel<T>::parameters() const {
  return parts_->parameters;
}

/// One forward pass: what it works on, and its steps.
template <class T>
class BasicModel<T>::Parts::Pass {
 public:
  Pass(const Parts& net, const NetworkInput& scene, const std::function<void()>& poll,
       std::vector<PartMemory>* memory)
      : net_(net),
        config_(net.config),
        scene_(scene),
        poll_(poll),
        meter_(memory),
        views_(static_cast<Index>(scene.sources.size())),
        intervals_(hypothesis_intervals(config_, scene)) {}

  std::array<StageOutput<T>, 3> run() {
    extract();
    meter_.end("features");
    for (std::size_t s = 0; s < 3; ++s) {
      const std::string number = " " + std::to_string(s + 1);
      StageOutput<T>& stage = out_[s];
      stage.stride = kStrides[s];
      stage.interval = intervals_[s];
      if (!taps_[0].empty()) stage.mono_height = downsampled(taps_[0], stage.stride).value();
      if (s > 0) fuse(s);
      const BasicTensor<T> seen = downsampled(valid_, stage.stride).value();
      if (config_.hypotheses[s] > 0) {
        propose(s);
        search(s, seen);
      } else {
        interpolate(s);
      }
      meter_.end("volumes" + number);
      make_surfels(s, seen);
      meter_.end("heads" + number);
    }
    return std::move(out_);
  }

 private:
  void polled() const {
    if (poll_) poll_();
  }
  Index height(std::size_t s) const { return scene_.sources[0].rgb.dim(1) / kStrides[s]; }
  Index width(std::size_t s) const { return scene_.sources[0].rgb.dim(2) / kStrides[s]; }

  static BasicVar<T> downsampled(const BasicVar<T>& x, Index stride) {
    return stride == 1 ? x : area_downsample(x, stride);
  }
  static BasicVar<T> of_view(const BasicVar<T>& x, Index i) { return slice(x, 0, i, i + 1); }

  /// Features of all views. They pass through the 2D nets one after the other: that takes a third
  /// of the memory.
  void extract() {
    std::array<std::vector<BasicVar<T>>, 3> levels, mono;  // mono: heights, taps of stages 2 and 3
    for (const PosedImage& v : scene_.sources) {
      polled();
      const BasicVar<T> image(standardised<T>(v));
      const auto features = net_.features(image);
      for (std::size_t s = 0; s < 3; ++s) levels[s].push_back(features[s]);
      if (!net_.mono) continue;
      polled();
      const NoGrad no_grad;  // the branch is trained by itself
      const MonoOutput<T> seen = (*net_.mono)(image);
      mono[0].push_back(seen.height);
      if (config_.fusion == "none") continue;
      mono[1].push_back(seen.tap_half);
      mono[2].push_back(seen.tap_full);
    }
    for (std::size_t s = 0; s < 3; ++s) {
      pyramid_[s] = concat(std::exchange(levels[s], {}), 0);
      if (!mono[s].empty()) taps_[s] = concat(std::exchange(mono[s], {}), 0);
    }
    images_ = BasicVar<T>(stacked<T>(scene_.sources, &PosedImage::rgb));
    valid_ = BasicVar<T>(stacked<T>(scene_.sources, &PosedImage::valid));
  }

  /// Joins the stage's features with those of the monocular branch, where the configuration does.
  void fuse(std::size_t s) {
    const auto& fusion = net_.stages[s].fusion;
    const BasicVar<T> tap = std::exchange(taps_[s], {});
    if (!fusion) return;
    const Index h = height(s), w = width(s);
    BasicTensor<T> confidence;
    {
      const NoGrad no_grad;
      confidence =
          resize_bilinear(BasicVar<T>(effective_confidence(config_, out_[s - 1])), h, w).value();
    }
    std::vector<BasicVar<T>> parts;  // view by view: what is in between is large
    for (Index i = 0; i < views_; ++i)
      parts.push_back((*fusion)(of_view(pyramid_[s], i), tap.empty() ? tap : of_view(tap, i),
                                confidence.slice0(i).reshaped({1, h, w})));
    pyramid_[s] = concat(parts, 0);
  }

  /// Which heights to try: the whole range first, then a narrow band around the surface of the
  /// stage before.
  void propose(std::size_t s) {
    const Index D = config_.hypotheses[s], h = height(s), w = width(s);
    StageOutput<T>& stage = out_[s];
    stage.choices = D;
    if (s == 0) {
      stage.hypotheses =
          uniform_hypotheses<T>(scene_.z_range.low, scene_.z_range.high, views_, D, h, w);
      return;
    }
    const NoGrad no_grad;
    const BasicVar<T> centre = resize_bilinear(out_[s - 1].height.detach(), h, w);
    // a surface at the very edge of the range stays inside the band
    const double margin = 2 * intervals_[s];
    stage.hypotheses =
        narrowed_hypotheses(centre.value(), intervals_[s], D, scene_.z_range.low - margin,
                            scene_.z_range.high + margin);
  }

  /// Every view in turn is the reference: variance volume, regularisation, logits; then heights and
  /// confidence of all.
  void search(std::size_t s, const BasicTensor<T>& seen) {
    StageOutput<T>& stage = out_[s];
    const double stride = static_cast<double>(kStrides[s]);
    std::vector<BasicVar<T>> logits;
    for (Index i = 0; i < views_; ++i) {
      polled();
      std::vector<Quadratic> maps;
      for (const Quadratic& q : scene_.transfer[static_cast<std::size_t>(i)])
        maps.push_back(rescale_pixels(q, stride, stride));
      logits.push_back((*net_.stages[s].cost)(
          plane_sweep_variance(pyramid_[s], i, maps, stage.hypotheses.slice0(i), seen,
                               config_.variance_includes_reference),
          of_view(pyramid_[s], i), poll_));
    }
    const BasicVar<T> all = concat(std::exchange(logits, {}), 0);
    const auto distribution = height_distribution(all, stage.hypotheses);
    stage.probability = distribution.probability;
    stage.height = distribution.height;
    stage.confidence = distribution.confidence;
    if (config_.confidence == "joint") chain(s);
  }

  /// A sharp peak says little where the stage before looked in the wrong place: the probabilities
  /// of all stages multiply.
  void chain(std::size_t s) {
    StageOutput<T>& stage = out_[s];
    const auto within = [&](double reach) {
      return probability_within(stage.probability.value(), stage.hypotheses, stage.height.value(),
                                stage.interval, reach);
    };
    const NoGrad no_grad;
    BasicVar<T> before;  // probability that the surface is in this stage's band
    if (s > 0) before = resize_bilinear(BasicVar<T>(in_band_), height(s), width(s));
    const auto joint = [&](const BasicTensor<T>& own) {
      return s == 0 ? own : (BasicVar<T>(own) * before).value();
    };
    stage.within = joint(within(stage.interval));
    std::size_t next = s + 1;
    while (next < 3 && config_.hypotheses[next] == 0) ++next;
    if (next < 3)
      in_band_ =
          joint(within(0.5 * static_cast<double>(config_.hypotheses[next]) * intervals_[next]));
  }

  void interpolate(std::size_t s) {
    const StageOutput<T>& previous = out_[s - 1];
    out_[s].height = resize_bilinear(previous.height, height(s), width(s));
    out_[s].confidence = resize_bilinear(previous.confidence, height(s), width(s));
    out_[s].choices = previous.choices;
    if (previous.within.empty()) return;
    const NoGrad no_grad;
    out_[s].within = resize_bilinear(BasicVar<T>(previous.within), height(s), width(s)).value();
  }

  /// What the surface of the stage before, rendered into the source views, tells this one; empty
  /// without guidance.
  BasicVar<T> residual(std::size_t s, const BasicVar<T>& image, const BasicTensor<T>& sure,
                       const BasicTensor<T>& seen) const {
    if (!net_.stages[s].guidance) return {};
    const NoGrad no_grad;
    const StageOutput<T>&stage = out_[s], &previous = out_[s - 1];
    const bool photometric = config_.guidance == "photometric";
    std::vector<BasicVar<T>> maps, alphas;
    for (const PosedImage& view : scene_.sources) {
      const auto render = splat::render_view(previous.surfels, view.pixel_from_local,
                                             view.rgb.dim(1), view.rgb.dim(2), previous.stride);
      const Index h = render.alpha.dim(0), w = render.alpha.dim(1);
      maps.push_back(photometric ? reshape(render.colour, Shape{1, 3, h, w})
                                 : reshape(render.height, Shape{1, h, w}));
      alphas.push_back(reshape(render.alpha, Shape{1, h, w}));
    }
    const BasicTensor<T> rendered = concat(maps, 0).value(), alpha = concat(alphas, 0).value();
    if (photometric) return BasicVar<T>(photometric_residual(image.value(), seen, rendered, alpha));
    const GuidanceNorm norm =
        config_.guidance_norm == "interval" ? GuidanceNorm::interval : GuidanceNorm::robust;
    return BasicVar<T>(
        guidance_residual(stage.height.value(), sure, seen, rendered, alpha, norm, stage.interval));
  }

  /// One surfel per pixel.
  void make_surfels(std::size_t s, const BasicTensor<T>& seen) {
    StageOutput<T>& stage = out_[s];
    const auto& guidance = net_.stages[s].guidance;
    const BasicVar<T> image = downsampled(images_, stage.stride);
    // the heads' losses reach the search by the published confidence alone
    const BasicVar<T> sure = config_.confidence == "raw"
                                 ? stage.confidence
                                 : BasicVar<T>(effective_confidence(config_, stage));
    const BasicVar<T> rendered = residual(s, image, sure.value(), seen);
    std::vector<BasicVar<T>> raw;
    for (Index i = 0; i < views_; ++i) {
      polled();
      std::vector<BasicVar<T>> input{of_view(image, i), of_view(pyramid_[s], i)};
      if (!stage.probability.empty()) input.push_back(of_view(stage.probability, i));
      if (guidance) {
        const BasicVar<T> plain = concat(std::exchange(input, {}), 1);
        input.push_back((*guidance)(plain, of_view(rendered, i)));
      }
      input.push_back(reshape(of_view(sure, i), Shape{1, 1, height(s), width(s)}));
      raw.push_back(net_.stages[s].head(concat(input, 1)));
    }
    const double z_mid = scene_.z_range.middle();
    std::vector<PixelGeometry> geometry;
    for (const PosedImage& v : scene_.sources)
      geometry.push_back(pixel_geometry(v, z_mid, stage.stride));
    const BasicVar<T> all = concat(std::exchange(raw, {}), 0);
    stage.surfels = surfels_from_maps(all, stage.height, image.value(), BasicVar<T>(sure.value()),
                                      geometry, rotation_of(config_));
    if (s > 0 && config_.keep == "all")
      stage.surfels = splat::joined<T>({stage.surfels, out_[s - 1].surfels});
  }

  const Parts& net_;
  const ModelConfig& config_;
  const NetworkInput& scene_;
  const std::function<void()>& poll_;
  MemoryMeter meter_;
  const Index views_;
  const std::array<double, 3> intervals_;
  std::array<BasicVar<T>, 3> pyramid_, taps_;  ///< taps: relative heights, features of stages 2, 3
  BasicVar<T> images_, valid_;
  BasicTensor<T> in_band_;  ///< [N h w] that the surface is where the next stage searches
  std::array<StageOutput<T>, 3> out_;
};

template <class T>
std::array<StageOutput<T>, 3> BasicModel<T>::forward(const NetworkInput& scene,
                                                     const std::function<void()>& poll,
                                                     std::vector<PartMemory>* memory) const {
  check(parts_->config, scene);
  return typename Parts::Pass(*parts_, scene, poll, memory).run();
}

template BasicTensor<float> effective_confidence(const ModelConfig&, const StageOutput<float>&);
template BasicTensor<double> effective_confidence(const ModelConfig&, const StageOutput<double>&);
template class BasicModel<float>;
template class BasicModel<double>;

}  // namespace satsurf::nn
