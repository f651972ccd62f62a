// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/conv/axes.h"

#include "satsurf/ops/conv/winograd.h"

#include <algorithm>

namespace satsurf::conv {
namespace {

constexpr Index kFewOutputs = 1024;  // of a channel; below this mixing the kernels takes too long

void finish(Axis& axis) {
  for (const AxisPhase& phase : axis.phases) {
    axis.most_outputs = std::max(axis.most_outputs, phase.count);
    for (const AxisTap& t : phase.taps) axis.max_shift = std::max(axis.max_shift, t.shift);
  }
}

}  // namespace

Axes correlation_axes(const Geometry& g) {
  Axes axes;
  for (std::size_t a = 0; a < 3; ++a) {
    Axis& axis = axes[a];
    axis.size = g.x_size[a];
    axis.input_phases = g.stride[a];
    axis.left = g.padding[a];
    AxisPhase all{.count = g.y_size[a], .taps = {}};
    for (Index k = 0; k < g.kernel[a]; ++k)
      all.taps.push_back({k, k % axis.input_phases, k / axis.input_phases});
    axis.phases.push_back(all);
    finish(axis);
  }
  return axes;
}

Axes adjoint_axes(const Geometry& g) {
  Axes axes;
  for (std::size_t a = 0; a < 3; ++a) {
    Axis& axis = axes[a];
    const Index s = g.stride[a], p = g.padding[a];
    axis.size = g.y_size[a];
    // x[f + s m] gathers weight[k] y[m + (f + p - k) / s] over the k for which that divides.
    Index lowest = p / s;
    for (Index f = 0; f < s; ++f)
      for (Index k = 0; k < g.kernel[a]; ++k)
        if ((f + p - k) % s == 0) lowest = std::min(lowest, (f + p - k) / s);
    axis.left = -lowest;
    for (Index f = 0; f < s; ++f) {
      AxisPhase phase{.count = std::max<Index>(0, (g.x_size[a] - f + s - 1) / s), .taps = {}};
      for (Index k = 0; k < g.kernel[a]; ++k)
        if ((f + p - k) % s == 0) phase.taps.push_back({k, 0, (f + p - k) / s - lowest});
      axis.phases.push_back(phase);
    }
    finish(axis);
  }
  return axes;
}

Axes with_mixed_rows(Axes axes, Index B) {
  using namespace winograd;
  Axis& row = axes[1];
  const Axis& column = axes[2];
  if (row.input_phases != 1 || row.phases.size() != 1 || row.phases[0].taps.size() != kTaps)
    return axes;
  // a row is mixed whole, without gaps and with zeros around it only
  if (column.input_phases != 1 || column.phases.size() != 1 || column.left < 0 ||
      column.left + column.size > row_pitch(column))
    return axes;
  const Index groups = ceil_div(row.most_outputs, kOutputs);
  if (groups * kMixes >= row.most_outputs * kTaps) return axes;
  if (B * axes[0].most_outputs * row.most_outputs * column.most_outputs < kFewOutputs) return axes;
  for (const AxisTap& t : row.phases[0].taps) row.kernel_order[t.shift] = t.tap;
  row.mixed = true;
  row.input_phases = kMixes;
  row.most_outputs = groups;
  row.max_shift = 0;
  row.phases.clear();
  for (Index i = 0; i < kMixes; ++i)
    row.phases.push_back({.count = groups, .taps = {{.tap = i, .phase = i, .shift = 0}}});
  return axes;
}

Axes with_whole_columns(Axes axes, const Geometry& g) {
  Axis& column = axes[2];
  column.input_phases = 1;
  column.most_outputs =
      (g.y_size[2] - 1) * g.stride[2] + 1;  // positions from the first output to the last
  column.max_shift = g.kernel[2] - 1;
  for (AxisTap& t : column.phases[0].taps) t = {t.tap, 0, t.tap};
  return axes;
}

Index row_pitch(const Axis& axis) {
  const auto input = [&](Index i, Index phase) {
    return i * axis.input_phases + phase - axis.left;
  };
  const Index end = axis.most_outputs + axis.max_shift;
  // With a pitch one smaller, index `pitch - 1` and those behind it would alias the next row's
  // first ones.
  const auto may_shrink = [&](Index pitch) {
    for (Index i = pitch - 1; i < end; ++i)
      for (Index f = 0; f < axis.input_phases; ++f)
        if (input(i, f) < axis.size || input(i - (pitch - 1), f) >= 0) return false;
    return true;
  };
  Index pitch = end;
  while (pitch > axis.most_outputs && may_shrink(pitch)) --pitch;
  return pitch;
}

std::array<Index, 3> kernel_of(const Axes& axes, const Geometry& g) {
  return {g.kernel[0], axes[1].mixed ? winograd::kMixes : g.kernel[1], g.kernel[2]};
}

}  // namespace satsurf::conv
