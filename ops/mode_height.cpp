// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/mode_height.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cstdint>
#include <string>
#include <type_traits>
#include <vector>

namespace satsurf {
namespace {

/// The first and last hypothesis near each mode, and the probability of them together.
template <class T>
struct Modes {
  std::vector<std::int16_t> first, last;  ///< [B H W]
  BasicTensor<T> mass;                    ///< [B H W]
};

}  // namespace

template <class T>
BasicVar<T> mode_height(const BasicVar<T>& probability, const BasicTensor<T>& heights,
                        Index radius) {
  Dims dim("mode_height");
  dim.match("probability", probability, "B D H W").match("heights", heights, "B D H W");
  const Index B = dim["B"], D = dim["D"], H = dim["H"], W = dim["W"], P = H * W;
  if (D == 0)
    throw ShapeError("mode_height: probability has shape " + probability.shape().str() +
                     ", expected at least one hypothesis");
  if (radius < 0)
    throw ConfigError("mode_height: radius is " + std::to_string(radius) + ", expected 0 or more");
  Modes<T> modes;
  modes.first.resize(static_cast<std::size_t>(B * P));
  modes.last.resize(modes.first.size());
  modes.mass = BasicTensor<T>::uninitialised({B, H, W});
  auto out = BasicTensor<T>::uninitialised({B, H, W});
  // As wide as what is compared, so that one vector chooses in both.
  using Place = std::conditional_t<sizeof(T) == 4, std::int32_t, std::int64_t>;
  const T *p = probability.value().data(), *h = heights.data();
  for_each_index(B * H, [&](Index row) {
    const Index at = row / H * D * P + row % H * W;  // of the volume
    std::vector<T> highest(static_cast<std::size_t>(W), T(-1));
    std::vector<Place> mode(highest.size(), 0);
    // With the hypotheses next to it. The loops have no branch, so that vectors can take them.
    const auto compare = [&](Index d, const auto& together) {
      const T* const here = p + at + d * P;
      T* const most = highest.data();
      Place* const where = mode.data();
      const auto place = static_cast<Place>(d);
      for (Index x = 0; x < W; ++x) {
        const T sum = together(here + x), before = most[x];
        const Place higher = -static_cast<Place>(sum > before);  // all bits or none
        most[x] = std::max(before, sum);
        where[x] = (place & higher) | (where[x] & ~higher);
      }
    };
    for (Index d = 0; d < D; ++d) {
      const bool below = radius > 0 && d > 0, above = radius > 0 && d + 1 < D;
      if (below && above)
        compare(d, [P](const T* here) { return here[0] + here[-P] + here[P]; });
      else if (below)
        compare(d, [P](const T* here) { return here[0] + here[-P]; });
      else if (above)
        compare(d, [P](const T* here) { return here[0] + here[P]; });
      else
        compare(d, [](const T* here) { return here[0]; });
    }
    for (Index x = 0; x < W; ++x) {
      const Index at_mode = static_cast<Index>(mode[x]),
                  first = std::max<Index>(0, at_mode - radius),
                  last = std::min(D - 1, at_mode + radius);
      T mass = 0, moment = 0;
      for (Index d = first; d <= last; ++d) {
        mass += p[at + d * P + x];
        moment += p[at + d * P + x] * h[at + d * P + x];
      }
      const Index pixel = row * W + x;
      out[pixel] = moment / mass;  // no smaller than 1 / D
      modes.mass[pixel] = mass;
      modes.first[pixel] = static_cast<std::int16_t>(first);
      modes.last[pixel] = static_cast<std::int16_t>(last);
    }
  });
  return BasicVar<T>::record(
      "mode_height", out, {probability}, [=, modes = std::move(modes)](Node<T>& n) {
        T* dp = n.grad_in(0);
        if (dp == nullptr) return;
        for_each_index(B * H, [&](Index row) {
          const Index at = row / H * D * P + row % H * W;
          for (Index x = 0; x < W; ++x) {
            const Index pixel = row * W + x;
            const T factor = n.grad[pixel] / modes.mass[pixel];
            for (Index d = modes.first[pixel]; d <= modes.last[pixel]; ++d)
              dp[at + d * P + x] += factor * (heights[at + d * P + x] - n.value[pixel]);
          }
        });
      });
}

template Var mode_height(const Var&, const Tensor&, Index);
template BasicVar<double> mode_height(const BasicVar<double>&, const BasicTensor<double>&, Index);

}  // namespace satsurf
