// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/confidence.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/resize.h"

#include <algorithm>
#include <cmath>

namespace satsurf::nn {

template <class T>
BasicTensor<T> effective_confidence(const ModelConfig& config, const StageHeights<T>& stage) {
  if (config.confidence == Confidence::joint) return stage.joint_confidence;
  if (config.confidence == Confidence::raw) return stage.confidence.value();
  const T floor = T(1) / static_cast<T>(stage.choices);
  BasicTensor<T> out = stage.confidence.value().clone();
  for (T& c : out.values()) c = (c - floor) / (T(1) - floor);
  return out;
}

template <class T>
BasicVar<T> head_confidence(const ModelConfig& config, const StageHeights<T>& stage) {
  if (config.confidence == Confidence::raw) return stage.confidence;
  return BasicVar<T>(effective_confidence(config, stage));
}

template <class T>
BasicTensor<T> probability_within(const StageHeights<T>& stage, double reach) {
  const BasicTensor<T>&probability = stage.probability.value(), &hypotheses = stage.hypotheses,
        &height = stage.height.value();
  Dims dim("probability_within");
  dim.match("probability", probability, "N D H W")
      .match("hypotheses", hypotheses, "N D H W")
      .match("height", height, "N H W");
  const Index D = dim["D"], P = dim["H"] * dim["W"];
  auto out = BasicTensor<T>::uninitialised(height.shape());
  const T scale = static_cast<T>(1 / stage.interval),
          most = static_cast<T>(reach / stage.interval + 0.5);
  for_range(height.count(), 1 << 12, [&](Index begin, Index end) {
    for (Index from = begin; from < end;) {  // pixels of one map
      const Index n = from / P, to = std::min(end, (n + 1) * P);
      std::fill(out.data() + from, out.data() + to, T(0));
      for (Index d = 0; d < D; ++d) {
        const Index at = (n * D + d - n) * P;  // from a pixel of the maps to one of the volume
        const T *p = probability.data() + at, *h = hypotheses.data() + at, *z = height.data();
        T* const sum = out.data();
        for (Index i = from; i < to; ++i) {
          // two choices instead of std::clamp, which keeps the compiler from using vectors
          T share = most - std::abs(h[i] - z[i]) * scale;
          share = share > T(0) ? share : T(0);
          share = share < T(1) ? share : T(1);
          sum[i] += p[i] * share;
        }
      }
      // probabilities add up to 1 but for rounding
      for (Index i = from; i < to; ++i) out[i] = std::min(out[i], T(1));
      from = to;
    }
  });
  return out;
}

template <class T>
JointProbability<T> joint_probability(const StageHeights<T>& stage, double next_reach,
                                      const BasicTensor<T>& in_search) {
  const NoGrad no_grad;
  BasicVar<T> before;
  if (!in_search.empty())
    before = resize_bilinear(BasicVar<T>(in_search), stage.height.dim(1), stage.height.dim(2));
  const auto joint = [&](double reach) {
    const BasicTensor<T> own = probability_within(stage, reach);
    return before.empty() ? own : (BasicVar<T>(own) * before).value();
  };
  JointProbability<T> out{joint(stage.interval), {}};
  if (next_reach > 0) out.in_next_search = joint(next_reach);
  return out;
}

template Tensor effective_confidence(const ModelConfig&, const StageHeights<float>&);
template BasicTensor<double> effective_confidence(const ModelConfig&, const StageHeights<double>&);
template Var head_confidence(const ModelConfig&, const StageHeights<float>&);
template BasicVar<double> head_confidence(const ModelConfig&, const StageHeights<double>&);
template Tensor probability_within(const StageHeights<float>&, double);
template BasicTensor<double> probability_within(const StageHeights<double>&, double);
template JointProbability<float> joint_probability(const StageHeights<float>&, double,
                                                   const Tensor&);
template JointProbability<double> joint_probability(const StageHeights<double>&, double,
                                                    const BasicTensor<double>&);

}  // namespace satsurf::nn
