// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/model.h"

#include "satsurf/core/parallel.h"
#include "satsurf/nn/cost_net.h"
#include "satsurf/nn/feature_net.h"
#include "satsurf/nn/hypotheses.h"
#include "satsurf/nn/surfel_head.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/cost_volume.h"
#include "satsurf/ops/resize.h"
#include "satsurf/ops/softmax.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace satsurf::nn {
namespace {

constexpr std::array<Index, 3> kStrides{4, 2, 1};

/// One tensor [N ...] of a plane stack of every view.
template <class T>
BasicTensor<T> stacked(const std::vector<View>& views, const Tensor View::*member) {
  const Shape& one = (views[0].*member).shape();
  std::vector<Index> extents{static_cast<Index>(views.size())};
  extents.insert(extents.end(), one.extents().begin(), one.extents().end());
  auto out = BasicTensor<T>::uninitialised(Shape(std::span<const Index>(extents)));
  for (std::size_t n = 0; n < views.size(); ++n)
    for (Index i = 0; i < one.count(); ++i)
      out[static_cast<Index>(n) * one.count() + i] = static_cast<T>((views[n].*member)[i]);
  return out;
}

void check(const ModelConfig& config, const SceneInput& scene) {
  const std::size_t N = scene.sources.size();
  if (N < 2)
    throw ShapeError("model: " + std::to_string(N) + " source views, expected two or more");
  const Shape& first = scene.sources[0].rgb.shape();
  const Index multiple = size_multiple(config);
  for (const View& v : scene.sources) {
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
  if (!(scene.z_high > scene.z_low))
    throw ConfigError("model: height range " + std::to_string(scene.z_low) + " to " +
                      std::to_string(scene.z_high) + ", expected a positive span");
}

/// Notes the most tensor bytes of one part after the other, beyond those at its construction.
class MemoryMeter {
 public:
  explicit MemoryMeter(std::vector<PartMemory>* parts)
      : parts_(parts), before_(tensor_bytes()), most_(peak_tensor_bytes()) {
    if (parts_ == nullptr) return;
    parts_->clear();
    reset_peak_tensor_bytes();
  }
  void end(const std::string& part) {
    if (parts_ == nullptr) return;
    const std::size_t peak = peak_tensor_bytes();
    parts_->push_back({part, static_cast<double>(peak) - static_cast<double>(before_)});
    most_ = std::max(most_, peak);
    reset_peak_tensor_bytes();
  }
  ~MemoryMeter() {
    if (parts_ != nullptr) raise_peak_tensor_bytes(most_);
  }
  MemoryMeter(const MemoryMeter&) = delete;
  MemoryMeter& operator=(const MemoryMeter&) = delete;

 private:
  std::vector<PartMemory>* parts_;
  std::size_t before_, most_;
};

}  // namespace

template <class T>
struct BasicModel<T>::Parts {
  /// The parameters of one stage.
  struct Stage {
    CostNet<T> cost;
    SurfelHead<T> head;
  };

  Parts(const ModelConfig& c, std::uint64_t seed)
      : config(c), parameters(seed), features(parameters, c.base) {
    for (std::size_t s = 0; s < 3; ++s) {
      const std::string name = "stage" + std::to_string(s + 1);
      const Index channels = config.base * kStrides[s],
                  head_in = 3 + channels + config.hypotheses[s] + 1;
      stages.push_back({CostNet<T>(parameters, name + ".cost", channels, config.volume_base,
                                   config.volume_levels),
                        SurfelHead<T>(parameters, name + ".head", head_in, config.head_width[s])});
    }
  }

  ModelConfig config;
  ParameterSet<T> parameters;
  FeatureNet<T> features;
  std::vector<Stage> stages;
};

template <class T>
BasicModel<T>::BasicModel(const ModelConfig& config, std::uint64_t seed) {
  const Index halved = Index{1} << config.volume_levels;
  for (const Index d : config.hypotheses)
    if (d % halved != 0)
      throw ConfigError("model: " + std::to_string(d) + " hypotheses, expected a multiple of " +
                        std::to_string(halved) +
                        " (volume_levels = " + std::to_string(config.volume_levels) + ")");
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

template <class T>
std::array<StageOutput<T>, 3> BasicModel<T>::forward(const SceneInput& scene,
                                                     const std::function<void()>& poll,
                                                     std::vector<PartMemory>* memory) const {
  const ModelConfig& config = parts_->config;
  check(config, scene);
  const auto polled = [&poll] {
    if (poll) poll();
  };
  const std::size_t N = scene.sources.size();
  const Index views = static_cast<Index>(N), H = scene.sources[0].rgb.dim(1),
              W = scene.sources[0].rgb.dim(2);
  const std::array<double, 3> intervals = hypothesis_intervals(config, scene);
  const double z_mid = 0.5 * (scene.z_low + scene.z_high);
  MemoryMeter meter(memory);

  // Views pass through the 2D nets one after the other: that takes a third of the memory.
  std::array<std::vector<BasicVar<T>>, 3> levels;
  for (const View& v : scene.sources) {
    polled();
    const auto features = parts_->features(BasicVar<T>(standardised<T>(v)));
    for (std::size_t s = 0; s < 3; ++s) levels[s].push_back(features[s]);
  }
  std::array<BasicVar<T>, 3> pyramid;
  for (std::size_t s = 0; s < 3; ++s) pyramid[s] = concat(std::exchange(levels[s], {}), 0);
  const BasicVar<T> images(stacked<T>(scene.sources, &View::rgb));
  const BasicVar<T> valid(stacked<T>(scene.sources, &View::valid));
  meter.end("features");

  std::array<StageOutput<T>, 3> out;
  for (std::size_t s = 0; s < 3; ++s) {
    const Index stride = kStrides[s], h = H / stride, w = W / stride, D = config.hypotheses[s];
    StageOutput<T>& stage = out[s];
    stage.stride = stride;
    stage.interval = intervals[s];

    // 1. Which heights to try: the whole range first, then a narrow band around the previous
    // stage's surface.
    if (s == 0) {
      stage.hypotheses = uniform_hypotheses<T>(scene.z_low, scene.z_high, views, D, h, w);
    } else {
      const NoGrad no_grad;
      const BasicVar<T> centre = resize_bilinear(out[s - 1].height.detach(), h, w);
      // a surface at the very edge of the range stays inside the band
      const double margin = 2 * intervals[s];
      stage.hypotheses = narrowed_hypotheses(centre.value(), intervals[s], D, scene.z_low - margin,
                                             scene.z_high + margin);
    }

    // 2. Every view in turn is the reference: variance volume, regularisation, logits.
    const BasicTensor<T> seen = area_downsample(valid, stride).value();
    std::vector<BasicVar<T>> logits;
    for (std::size_t i = 0; i < N; ++i) {
      polled();
      std::vector<Quadratic> maps;
      for (std::size_t j = 0; j < N; ++j)
        maps.push_back(rescale_pixels(scene.transfer[i][j], static_cast<double>(stride),
                                      static_cast<double>(stride)));
      logits.push_back(parts_->stages[s].cost(
          plane_sweep_variance(pyramid[s], static_cast<Index>(i), maps,
                               stage.hypotheses.slice0(static_cast<Index>(i)), seen,
                               config.variance_includes_reference),
          poll));
    }

    // 3. Heights and confidence.
    {
      const BasicVar<T> all_logits = concat(std::exchange(logits, {}), 0);
      const auto distribution = height_distribution(all_logits, stage.hypotheses);
      stage.probability = distribution.probability;
      stage.height = distribution.height;
      stage.confidence = distribution.confidence;
    }
    meter.end("volumes " + std::to_string(s + 1));

    // 4. One surfel per pixel.
    const BasicVar<T> image = stride == 1 ? images : area_downsample(images, stride);
    std::vector<BasicVar<T>> raw;
    for (Index i = 0; i < views; ++i) {
      polled();
      const auto of_view = [i](const BasicVar<T>& x) { return slice(x, 0, i, i + 1); };
      raw.push_back(parts_->stages[s].head(
          concat<T>({of_view(image), of_view(pyramid[s]), of_view(stage.probability),
                     reshape(of_view(stage.confidence), Shape{1, 1, h, w})},
                    1)));
    }
    std::vector<PixelGeometry> geometry;
    for (const View& v : scene.sources) geometry.push_back(pixel_geometry(v, z_mid, stride));
    const BasicVar<T> all_raw = concat(std::exchange(raw, {}), 0);
    stage.surfels = surfels_from_maps(all_raw, stage.height, image.value(), stage.confidence,
                                      geometry, config.rotation == "camera+residual");
    meter.end("heads " + std::to_string(s + 1));
  }
  return out;
}

std::vector<PartMemory> forward_memory(const ModelConfig& config, Index views, Index height,
                                       Index width) {
  const double N = static_cast<double>(views), b = static_cast<double>(config.base),
               v = static_cast<double>(config.volume_base),
               pixels = static_cast<double>(height * width);
  constexpr double kSurfel = 13, kRaw = 10;  // floats of a surfel, outputs of the head
  constexpr double kScratch = 2e5;           // floats a thread's 3D convolution works in
  std::vector<PartMemory> parts;
  const auto add = [&](const std::string& part, double floats_per_pixel) {
    parts.push_back({part, static_cast<double>(sizeof(float)) * floats_per_pixel * pixels});
  };
  // The last view's features are made beside those of the others: at full resolution a sum of two
  // terms of 4 b channels, from three maps of b, b / 2 and b / 4 and what is kept of them.
  add("features", (N - 1) * 1.75 * b + 10.75 * b + 3);
  double kept = N * (1.75 * b + 3 + 1);  // features, images, validity
  for (std::size_t s = 0; s < 3; ++s) {
    const double p = 1 / static_cast<double>(kStrides[s] * kStrides[s]);
    const double C = static_cast<double>(config.base * kStrides[s]);
    const double D = static_cast<double>(config.hypotheses[s]);
    const double w = static_cast<double>(config.head_width[s]);
    const std::string stage = " " + std::to_string(s + 1);
    kept += N * p * D;  // hypotheses
    // One view's volume and what the first convolution makes of it, or the sum at the U-Net's end;
    // then logits, their concatenation and the probabilities of all views.
    const double scratch = std::min(kScratch * threads(), 0.25 * D * p * v * pixels) / pixels;
    const double volume = N * D + D * std::max(C + v, 2.3 * v), distribution = 2 * N * D + 2 * N;
    add("volumes" + stage, kept + std::max(p * volume + scratch, p * distribution));
    kept += N * p * (D + 2);  // probability, height, confidence
    // One view's input, once more in parts, and three layers of the head; then all raw attributes,
    // packed surfels and their attributes.
    const double images = s < 2 ? 3 * N : 0;
    const double head = 2 * (4 + C + D) + 3 * w + kRaw * (N - 1),
                 surfels = N * (kRaw + 2 * kSurfel);
    add("heads" + stage, kept + p * (images + std::max(head, surfels)));
    kept += p * N * kSurfel;
  }
  return parts;
}

double forward_bytes(const ModelConfig& config, Index views, Index height, Index width) {
  double most = 0;
  for (const PartMemory& part : forward_memory(config, views, height, width))
    most = std::max(most, part.bytes);
  return most;
}

template <class T>
splat::BasicRender<T> render_view(const splat::BasicSurfels<T>& surfels,
                                  const Quadratic& pixel_from_local, Index height, Index width,
                                  Index stride) {
  const auto projection = splat::project(
      surfels.means.value(), rescale_pixels(pixel_from_local, 1, static_cast<double>(stride)));
  return splat::rasterize(surfels, projection,
                          {.height = height / stride, .width = width / stride});
}

template class BasicModel<float>;
template class BasicModel<double>;
template splat::BasicRender<float> render_view(const splat::BasicSurfels<float>&, const Quadratic&,
                                               Index, Index, Index);
template splat::BasicRender<double> render_view(const splat::BasicSurfels<double>&,
                                                const Quadratic&, Index, Index, Index);

}  // namespace satsurf::nn
