// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/model.h"

#include "satsurf/nn/features.h"
#include "satsurf/nn/fusion.h"
#include "satsurf/nn/guidance.h"
#include "satsurf/nn/hypotheses.h"
#include "satsurf/nn/search.h"
#include "satsurf/nn/surfel_head.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/resize.h"
#include "satsurf/splat/select.h"

#include <algorithm>
#include <optional>
#include <string>
#include <utility>

namespace satsurf::nn {
namespace {

void check_input(const ModelConfig& config, const NetworkInput& scene) {
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
  if (config.interval_min > config.interval_max)
    throw ConfigError("model: interval_min is " + std::to_string(config.interval_min) +
                      ", expected no more than interval_max, which is " +
                      std::to_string(config.interval_max));
}

/// Means of stride x stride pixels; nothing of nothing.
template <class T>
BasicTensor<T> downsampled(const BasicTensor<T>& x, Index stride) {
  return stride == 1 || x.empty() ? x : area_downsample(BasicVar<T>(x), stride).value();
}

template <class T>
BasicVar<T> of_view(const BasicVar<T>& x, Index i) {
  return slice(x, 0, i, i + 1);
}

/// The parts of one stage that have parameters.
template <class T>
struct StageParts {
  HeightSearch<T> search;
  SurfelHead<T> head;
  std::optional<FeatureFusion<T>> fusion;         ///< where the configuration has one
  std::optional<CrossStageGuidance<T>> guidance;  ///< alike
};

/// stage          counts from 0
/// mono_channels  of the monocular features at that stage
template <class T>
StageParts<T> make_stage(ParameterSet<T>& p, const ModelConfig& config, std::size_t stage,
                         Index mono_channels) {
  const std::string name = "stage" + std::to_string(stage + 1);
  const Index features = config.base * kStrides[stage],
              head_in = 3 + features + config.hypotheses[stage];  // and the confidence
  StageParts<T> parts{HeightSearch<T>(p, name + ".cost", config, stage),
                      SurfelHead<T>(p, name + ".head", head_in + 1, config.head_width[stage]),
                      {},
                      {}};
  if (stage > 0 && config.fusion != Fusion::none)
    parts.fusion.emplace(p, name + ".fusion", config, features, mono_channels);
  if (stage > 0 && config.guidance != Guidance::none)
    parts.guidance.emplace(p, name + ".guidance", config, head_in);
  return parts;
}

/// The cameras of a stage's pixels.
std::vector<PixelGeometry> stage_geometry(const NetworkInput& scene, const StageGrid& grid) {
  std::vector<PixelGeometry> geometry;
  for (const PosedImage& v : scene.sources)
    geometry.push_back(pixel_geometry(v, scene.z_range.middle(), grid.stride));
  return geometry;
}

/// Forgets what only the stage behind it, and surfels of many forms, ask of a stage.
template <class T>
void drop_distribution(StageHeights<T>& stage) {
  stage.hypotheses = {};
  stage.probability = {};
}

/// Those that a stage hands on: its own, and behind them those of the stages before if all are kept.
template <class T>
splat::BasicSurfels<T> kept_surfels(Keep keep, const splat::BasicSurfels<T>& own,
                                    const StageOutput<T>* previous) {
  if (keep == Keep::last || previous == nullptr) return own;
  return splat::joined<T>({own, previous->surfels});
}

}  // namespace

template <class T>
struct BasicModel<T>::Parts {
  Parts(const ModelConfig& c, std::uint64_t seed)
      : config(c), parameters(seed), extract_features(parameters, c) {
    for (std::size_t s = 0; s < 3; ++s)
      stages.push_back(make_stage(parameters, config, s, extract_features.mono_channels(s)));
  }

  /// The figure of the method: features of all views, then three times CMMF, hypotheses, search,
  /// CSRG and surfels, each stage told by the one before where to look.
  std::array<StageOutput<T>, 3> run(const NetworkInput& scene, const std::function<void()>& poll,
                                    std::vector<PartMemory>* memory, Wanted wanted,
                                    const NarrowSearch<T>& narrow) const;

  ModelConfig config;
  ParameterSet<T> parameters;
  FeatureExtractor<T> extract_features;  ///< FPN and monocular branch
  std::vector<StageParts<T>> stages;
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

template <class T>
std::array<StageOutput<T>, 3> BasicModel<T>::Parts::run(const NetworkInput& scene,
                                                        const std::function<void()>& poll,
                                                        std::vector<PartMemory>* memory,
                                                        Wanted wanted,
                                                        const NarrowSearch<T>& narrow) const {
  MemoryMeter meter(memory);
  const std::array<StageGrid, 3> grids = stage_grids(config, scene, wanted);
  FeatureMaps<T> features = extract_features(scene, poll, wanted);
  meter.end("features");

  std::array<StageOutput<T>, 3> out;
  rpc::HeightRange range = scene.z_range;
  BasicTensor<T> in_search;  // probability that the surface lies where the next stage searches
  BasicTensor<T> images;     // of all views, once surfels are coloured
  for (std::size_t s = 0; s < stages_of(wanted); ++s) {
    const StageParts<T>& part = stages[s];
    const StageGrid& grid = grids[s];
    const StageOutput<T>* previous = s == 0 ? nullptr : &out[s - 1];

    // CMMF: matching features take from the monocular ones where the stage before is in doubt
    if (part.fusion)
      features.fpn[s] =
          part.fusion->fuse_views(features.fpn[s], std::exchange(features.mono[s], {}),
                                  effective_confidence(config, *previous));
    const BasicVar<T>& matching = features.fpn[s];

    // search: variance volumes, 3D U-Net, distribution of heights, confidence
    const BasicTensor<T> validity = downsampled(features.validity, grid.stride);
    BasicTensor<T> hypotheses = stage_hypotheses<T>(range, grid, previous, config.centre);
    if (wanted == Wanted::discs && s > 0) drop_distribution(out[s - 1]);
    SearchOutput<T> found = part.search(
        scene, grid, {matching, validity, std::move(hypotheses), previous, in_search}, poll);
    if (const auto left = s == 0 && narrow ? narrow(found.heights) : std::nullopt) {
      range = *left;
      found = part.search.within(range, grid, std::move(found));
    }
    in_search = std::move(found.in_next_search);
    meter.end("volumes " + std::to_string(s + 1));
    out[s] = {
        std::move(found.heights), grid.stride, {}, downsampled(features.mono_height, grid.stride)};
    const StageHeights<T>& heights = out[s];
    if (wanted != Wanted::surfels) features.fpn[s] = {};  // the heads alone read them again
    if (wanted == Wanted::discs && s == 2) drop_distribution(out[s]);
    if (wanted != Wanted::surfels && !(wanted == Wanted::discs && s == 2)) continue;
    if (images.empty()) images = stacked_images<T>(scene);
    const BasicVar<T> image(downsampled(images, grid.stride));
    const BasicVar<T> confidence = head_confidence(config, heights);
    if (wanted == Wanted::discs) {
      out[s].surfels = discs_from_maps(heights.height, image.value(), confidence.detach(),
                                       stage_geometry(scene, grid));
      meter.end("discs");
      continue;
    }

    // CSRG: what the rendered surface of the stage before says about these heights
    BasicVar<T> residual;
    if (part.guidance)
      residual = part.guidance->residual(
          {image.value(), heights.height.value(), confidence.value(), validity, grid.interval},
          *previous, scene.sources);

    // surfels: one view after the other, for what is in between is large
    std::vector<BasicVar<T>> raw;
    for (Index i = 0; i < grid.views; ++i) {
      if (poll) poll();
      std::vector<BasicVar<T>> x{of_view(image, i), of_view(matching, i)};
      if (!heights.probability.empty()) x.push_back(of_view(heights.probability, i));
      if (part.guidance) {
        const BasicVar<T> unguided = concat(std::exchange(x, {}), 1);
        x.push_back((*part.guidance)(unguided, of_view(residual, i)));
      }
      x.push_back(reshape(of_view(confidence, i), Shape{1, 1, grid.height, grid.width}));
      raw.push_back(part.head(concat(x, 1)));
    }
    const SurfelMaps<T> maps{concat(std::exchange(raw, {}), 0), heights.height, image.value(),
                             confidence.detach()};
    out[s].surfels = kept_surfels(
        config.keep, surfels_from_maps(maps, stage_geometry(scene, grid), config.rotation),
        previous);
    meter.end("heads " + std::to_string(s + 1));
  }
  return out;
}

template <class T>
std::array<StageOutput<T>, 3> BasicModel<T>::forward(const NetworkInput& scene,
                                                     const std::function<void()>& poll,
                                                     std::vector<PartMemory>* memory, Wanted wanted,
                                                     const NarrowSearch<T>& narrow) const {
  check_input(parts_->config, scene);
  return parts_->run(scene, poll, memory, wanted, narrow);
}

template class BasicModel<float>;
template class BasicModel<double>;

}  // namespace satsurf::nn
