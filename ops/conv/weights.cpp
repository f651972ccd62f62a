// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/conv/weights.h"

#include "satsurf/core/parallel.h"
#include "satsurf/ops/conv/winograd.h"

#include <algorithm>
#include <utility>

namespace satsurf::conv {
namespace {

/// G applied to the rows of `count` kernels.
template <class T>
BasicTensor<T> mixed_weights(const Geometry& g, const Axis& rows, const T* weight, Index count) {
  using namespace winograd;
  const Index KD = g.kernel[0], KW = g.kernel[2];
  auto mixed = BasicTensor<T>::uninitialised({count, KD, kMixes, KW});
  for_range(count * KD, std::max<Index>(1, 1024 / KW), [&](Index begin, Index end) {
    for (Index n = begin; n < end; ++n)
      for (Index i = 0; i < kMixes; ++i)
        for (Index k = 0; k < KW; ++k) {
          double sum = 0;
          for (std::size_t t = 0; t < kTaps; ++t)
            sum += kG[i][t] * weight[(n * kTaps + rows.kernel_order[t]) * KW + k];
          mixed[(n * kMixes + i) * KW + k] = static_cast<T>(sum);
        }
  });
  return mixed;
}

}  // namespace

std::vector<PhaseTaps> list_phases(const Axes& axes, const std::array<Index, 3>& kernel) {
  std::vector<PhaseTaps> list;
  Index taps_before = 0;
  for (const AxisPhase& z : axes[0].phases)
    for (const AxisPhase& y : axes[1].phases)
      for (const AxisPhase& x : axes[2].phases) {
        std::vector<Index> taps;
        for (const AxisTap& i : z.taps)
          for (const AxisTap& j : y.taps)
            for (const AxisTap& k : x.taps)
              taps.push_back((i.tap * kernel[1] + j.tap) * kernel[2] + k.tap);
        const Index count = std::ssize(taps);
        list.push_back({&z, &y, &x, &y - axes[1].phases.data(), std::move(taps), taps_before});
        taps_before += count;
      }
  return list;
}

template <class T>
BasicTensor<T> packed_weights(const Geometry& g, const Axes& axes,
                              const std::vector<PhaseTaps>& phases, const WeightLayout& layout,
                              const T* weight) {
  const Index O = layout.O, C = layout.C, block = layout.block, blocks = ceil_div(O, block);
  const std::array<Index, 3> kernel = kernel_of(axes, g);
  const Index K = kernel[0] * kernel[1] * kernel[2];
  BasicTensor<T> mixed;
  if (axes[1].mixed) {
    mixed = mixed_weights(g, axes[1], weight, C * O);
    weight = mixed.data();
  }
  auto packed = BasicTensor<T>::uninitialised({blocks * C * K * block});
  for_range(blocks * C, std::max<Index>(1, 4096 / (K * block)), [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const Index b = i / C, c = i % C;
      const T* kernels = weight + c * layout.c_stride * K;
      for (const PhaseTaps& phase : phases) {
        T* to =
            packed.data() + ((b * K + phase.taps_before) * C + c * std::ssize(phase.taps)) * block;
        for (const Index t : phase.taps)
          for (Index o = b * block; o < (b + 1) * block; ++o)
            *to++ = o < O ? kernels[o * layout.o_stride * K + t] : T(0);
      }
    }
  });
  return packed;
}

template BasicTensor<float> packed_weights(const Geometry&, const Axes&,
                                           const std::vector<PhaseTaps>&, const WeightLayout&,
                                           const float*);
template BasicTensor<double> packed_weights(const Geometry&, const Axes&,
                                            const std::vector<PhaseTaps>&, const WeightLayout&,
                                            const double*);

}  // namespace satsurf::conv
