// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/hypotheses.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>

namespace satsurf::nn {

double mean_parallax(const NetworkInput& scene) {
  const std::size_t N = scene.sources.size();
  const double x = (static_cast<double>(scene.sources[0].rgb.dim(2)) - 1) / 2,
               y = (static_cast<double>(scene.sources[0].rgb.dim(1)) - 1) / 2;
  double sum = 0;
  for (std::size_t i = 0; i < N; ++i)
    for (std::size_t j = 0; j < N; ++j) {
      if (i == j) continue;
      const auto jac = scene.transfer[i][j].jacobian(x, y, scene.z_range.middle());
      sum += std::hypot(jac[0][2], jac[1][2]);
    }
  return sum / static_cast<double>(N * (N - 1));
}

std::array<double, 3> hypothesis_intervals(const ModelConfig& config, const NetworkInput& scene) {
  constexpr double kNoParallax = 1e-6;  // px per m; views from one direction carry no height
  const double last = std::clamp(config.interval_px / std::max(mean_parallax(scene), kNoParallax),
                                 config.interval_min, config.interval_max);
  return {scene.z_range.span() / static_cast<double>(config.hypotheses[0] - 1), 2 * last, last};
}

template <class T>
BasicTensor<T> uniform_hypotheses(double low, double high, Index N, Index D, Index H, Index W) {
  auto out = BasicTensor<T>::uninitialised({N, D, H, W});
  for_each_index(N * D, [&](Index nd) {
    const double t = static_cast<double>(nd % D) / static_cast<double>(D - 1);
    std::fill_n(out.data() + nd * H * W, H * W, static_cast<T>(low + t * (high - low)));
  });
  return out;
}

template <class T>
BasicTensor<T> narrowed_hypotheses(const BasicTensor<T>& centre, double interval, Index D,
                                   double low, double high) {
  const Index N = centre.dim(0), H = centre.dim(1), W = centre.dim(2), P = H * W;
  auto out = BasicTensor<T>::uninitialised({N, D, H, W});
  const double half = 0.5 * interval * static_cast<double>(D - 1);
  for_each_index(N, [&](Index n) {
    for (Index i = 0; i < P; ++i) {
      double c = static_cast<double>(centre[n * P + i]);
      // A range narrower than the window stays centred.
      c = low + half > high - half ? 0.5 * (low + high) : std::clamp(c, low + half, high - half);
      for (Index d = 0; d < D; ++d)
        out[(n * D + d) * P + i] = static_cast<T>(c - half + interval * static_cast<double>(d));
    }
  });
  return out;
}

template <class T>
BasicTensor<T> probability_within(const BasicTensor<T>& probability,
                                  const BasicTensor<T>& hypotheses, const BasicTensor<T>& height,
                                  double interval, double reach) {
  Dims dim("probability_within");
  dim.match("probability", probability, "N D H W")
      .match("hypotheses", hypotheses, "N D H W")
      .match("height", height, "N H W");
  const Index D = dim["D"], P = dim["H"] * dim["W"];
  auto out = BasicTensor<T>::uninitialised(height.shape());
  const T scale = static_cast<T>(1 / interval), most = static_cast<T>(reach / interval + 0.5);
  for_range(height.count(), 1 << 12, [&](Index begin, Index end) {
    for (Index from = begin; from < end;) {  // pixels of one map
      const Index n = from / P, to = std::min(end, (n + 1) * P);
      std::fill(out.data() + from, out.data() + to, T(0));
      for (Index d = 0; d < D; ++d) {
        const Index at = (n * D + d - n) * P;  // from a pixel of the maps to one of the volume
        for (Index i = from; i < to; ++i) {
          const T far = std::abs(hypotheses[at + i] - height[i]) * scale;
          out[i] += probability[at + i] * std::clamp(most - far, T(0), T(1));
        }
      }
      // probabilities add up to 1 but for rounding
      for (Index i = from; i < to; ++i) out[i] = std::min(out[i], T(1));
      from = to;
    }
  });
  return out;
}

template BasicTensor<float> uniform_hypotheses(double, double, Index, Index, Index, Index);
template BasicTensor<double> uniform_hypotheses(double, double, Index, Index, Index, Index);
template BasicTensor<float> narrowed_hypotheses(const BasicTensor<float>&, double, Index, double,
                                                double);
template BasicTensor<double> narrowed_hypotheses(const BasicTensor<double>&, double, Index, double,
                                                 double);
template Tensor probability_within(const Tensor&, const Tensor&, const Tensor&, double, double);
template BasicTensor<double> probability_within(const BasicTensor<double>&,
                                                const BasicTensor<double>&,
                                                const BasicTensor<double>&, double, double);

}  // namespace satsurf::nn
