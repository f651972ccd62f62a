// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/search.h"

#include "satsurf/core/parallel.h"
#include "satsurf/nn/confidence.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/mode_height.h"
#include "satsurf/ops/resize.h"
#include "satsurf/ops/softmax.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

namespace satsurf::nn {
namespace {

/// The heights of the stage before at this stage's size.
template <class T>
StageHeights<T> interpolated(const StageHeights<T>& previous, const StageGrid& grid) {
  StageHeights<T> out;
  out.interval = grid.interval;
  out.height = resize_bilinear(previous.height, grid.height, grid.width);
  out.confidence = resize_bilinear(previous.confidence, grid.height, grid.width);
  out.choices = previous.choices;
  if (previous.joint_confidence.empty()) return out;
  const NoGrad no_grad;
  out.joint_confidence =
      resize_bilinear(BasicVar<T>(previous.joint_confidence), grid.height, grid.width).value();
  return out;
}

}  // namespace

template <class T>
HeightSearch<T>::HeightSearch(ParameterSet<T>& p, const std::string& name,
                              const ModelConfig& config, std::size_t stage)
    : sweep_{.include_reference = config.variance_includes_reference,
             .best_pair = config.best_pair},
      joint_(config.confidence == Confidence::joint),
      height_(config.height) {
  if (config.hypotheses[stage] == 0) return;
  cost_.emplace(p, name,
                CostNetOptions{.channels = config.base * kStrides[stage],
                               .more = config.best_pair ? kPairChannels : 0,
                               .pairs = config.visible_pairs ? kPairChannels : 0,
                               .base = config.volume_base,
                               .levels = config.volume_levels,
                               .context = config.context});
  if (config.visible_pairs) pairs_.emplace(p, name + ".pairs");
}

template <class T>
BasicVar<T> HeightSearch<T>::logits(const NetworkInput& scene, const StageGrid& grid,
                                    const SearchInput<T>& in,
                                    const std::function<void()>& poll) const {
  const double stride = static_cast<double>(grid.stride);
  std::vector<BasicVar<T>> of_views;
  for (Index i = 0; i < grid.views; ++i) {
    if (poll) poll();
    std::vector<Quadratic> maps;
    for (const Quadratic& q : scene.transfer[static_cast<std::size_t>(i)])
      maps.push_back(rescale_pixels(q, stride, stride));
    const BasicTensor<T> heights = in.hypotheses.slice0(i);
    const BasicVar<T> reference = slice(in.features, 0, i, i + 1);
    if (NoGrad::active() && !pairs_) {
      of_views.push_back(
          (*cost_)(PlaneSweep<T>(in.features.value(), i, maps, heights, in.validity, sweep_),
                   reference, poll));
      continue;
    }
    BasicVar<T> volume = plane_sweep_variance(in.features, i, maps, heights, in.validity, sweep_);
    if (pairs_)
      volume = concat<T>({volume, (*pairs_)(in.features, i, maps, heights, in.validity)}, 0);
    of_views.push_back((*cost_)(std::exchange(volume, {}), reference, poll));
  }
  return concat(std::exchange(of_views, {}), 0);
}

template <class T>
SearchOutput<T> HeightSearch<T>::operator()(const NetworkInput& scene, const StageGrid& grid,
                                            const SearchInput<T>& in,
                                            const std::function<void()>& poll) const {
  if (!cost_) return {interpolated(*in.previous, grid), in.in_search};
  return found(logits(scene, grid, in, poll), in.hypotheses, grid, in.in_search);
}

template <class T>
SearchOutput<T> HeightSearch<T>::found(const BasicVar<T>& logits, const BasicTensor<T>& hypotheses,
                                       const StageGrid& grid,
                                       const BasicTensor<T>& in_search) const {
  const auto distribution = height_distribution(logits, hypotheses);
  StageHeights<T> heights;
  heights.interval = grid.interval;
  heights.hypotheses = hypotheses;
  heights.probability = distribution.probability;
  heights.height = height_ == HeightOf::mean
                       ? distribution.height
                       : mode_height(distribution.probability, hypotheses, kModeRadius);
  heights.confidence = distribution.confidence;
  heights.choices = grid.hypotheses;
  if (!joint_) return {heights, {}};
  JointProbability<T> joint = joint_probability(heights, grid.next_reach, in_search);
  heights.joint_confidence = joint.confidence;
  return {heights, joint.in_next_search};
}

template <class T>
SearchOutput<T> HeightSearch<T>::within(const rpc::HeightRange& range, const StageGrid& grid,
                                        SearchOutput<T> found) const {
  constexpr T kLeast = T(1e-30), kNever = T(-1e4);
  const NoGrad no_grad;
  const BasicTensor<T> hypotheses = found.heights.hypotheses;
  const rpc::HeightRange left = range.widened(0.5 * grid.interval);
  // A softmax of logarithms is what is left of the probabilities, shared anew.
  BasicTensor<T> logs = std::exchange(found.heights.probability, {}).value();
  for_range(logs.count(), 1 << 14, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const auto z = static_cast<double>(hypotheses[i]);
      logs[i] = z >= left.low && z <= left.high ? std::log(std::max(logs[i], kLeast)) : kNever;
    }
  });
  return this->found(BasicVar<T>(std::move(logs)), hypotheses, grid, {});
}

template class HeightSearch<float>;
template class HeightSearch<double>;

}  // namespace satsurf::nn
