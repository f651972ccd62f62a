// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

/// Winograd's minimal filtering F(4, 3): four outputs y of a filter w of three taps from six
/// products instead of twelve. Internal to ops/conv.
///
///   y = A [(G w) * (B x)]      y[j] = w[0] x[j] + w[1] x[j + 1] + w[2] x[j + 2]
///
/// with matrices from the Cook-Toom construction at the points 0, a, -a, b, -b and infinity.
/// Source:  Lavin and Gray 2016, "Fast Algorithms for Convolutional Neural Networks", eq. 5 and 8,
///          with other points: theirs (a = 1, b = 2) double the rounding errors of direct sums,
///          these add half to them.
namespace satsurf::conv::winograd {

inline constexpr Index kOutputs = 4, kTaps = 3, kMixes = 6;
inline constexpr double kA = 0.75, kB = 1.5;
inline constexpr double kA2 = kA * kA, kB2 = kB * kB;

/// G: product i belongs to point i, the last one to infinity.
inline constexpr double kG[kMixes][kTaps] = {
    {1 / (kA2 * kB2), 0, 0},
    {1 / (2 * kA2 * (kA2 - kB2)), kA / (2 * kA2 * (kA2 - kB2)), kA2 / (2 * kA2 * (kA2 - kB2))},
    {1 / (2 * kA2 * (kA2 - kB2)), -kA / (2 * kA2 * (kA2 - kB2)), kA2 / (2 * kA2 * (kA2 - kB2))},
    {1 / (2 * kB2 * (kB2 - kA2)), kB / (2 * kB2 * (kB2 - kA2)), kB2 / (2 * kB2 * (kB2 - kA2))},
    {1 / (2 * kB2 * (kB2 - kA2)), -kB / (2 * kB2 * (kB2 - kA2)), kB2 / (2 * kB2 * (kB2 - kA2))},
    {0, 0, 1}};

}  // namespace satsurf::conv::winograd
