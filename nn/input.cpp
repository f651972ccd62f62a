// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/input.h"

#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>

namespace satsurf::nn {

template <class T>
BasicTensor<T> standardised(const PosedImage& v) {
  const Index H = v.rgb.dim(1), W = v.rgb.dim(2), P = H * W;
  double sum = 0, squares = 0, count = 0;
  for (Index c = 0; c < 3; ++c)
    for (Index i = 0; i < P; ++i) {
      const double x = static_cast<double>(v.rgb[c * P + i]);
      if (v.valid[i] <= 0) continue;
      sum += x;
      squares += x * x;
      count += 1;
    }
  const double mean = count > 0 ? sum / count : 0;
  const double variance = count > 0 ? std::max(squares / count - mean * mean, 0.0) : 0;
  constexpr double kFlat = 1e-3;
  const double inverse = 1 / (std::sqrt(variance) + kFlat);
  auto out = BasicTensor<T>::uninitialised({1, 3, H, W});
  for_each_index(3 * H, [&](Index row) {
    for (Index i = row * W; i < (row + 1) * W; ++i)
      out[i] = v.valid[i % P] > 0 ? static_cast<T>((static_cast<double>(v.rgb[i]) - mean) * inverse)
                                  : T(0);
  });
  return out;
}

template BasicTensor<float> standardised(const PosedImage&);
template BasicTensor<double> standardised(const PosedImage&);

}  // namespace satsurf::nn
