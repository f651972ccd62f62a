// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/augment.h"

#include <algorithm>
#include <cmath>

namespace satsurf::train {

Radiometry random_radiometry(double amount, double grey_share, Rng& rng) {
  Radiometry r;
  r.gain = rng.uniform(1 - amount, 1 + amount);
  r.offset = rng.uniform(-amount / 2, amount / 2);
  r.gamma = std::exp(rng.uniform(-amount, amount));
  r.grey = rng.chance(grey_share);
  return r;
}

void apply(const Radiometry& r, nn::PosedImage& view) {
  const Index P = view.valid.count();
  for (Index i = 0; i < P; ++i) {
    if (view.valid[i] <= 0) continue;
    double c[3];
    for (Index k = 0; k < 3; ++k)
      c[k] = std::clamp(
          r.gain * std::pow(static_cast<double>(view.rgb[k * P + i]), r.gamma) + r.offset, 0.0,
          1.0);
    if (r.grey) c[0] = c[1] = c[2] = 0.299 * c[0] + 0.587 * c[1] + 0.114 * c[2];  // Rec. 601 luma
    for (Index k = 0; k < 3; ++k) view.rgb[k * P + i] = static_cast<float>(c[k]);
  }
}

Tensor turned(const Tensor& map, Index symmetry) {
  const Index axes = map.rank(), S = axes < 2 ? 0 : map.dim(axes - 1);
  if (axes < 2 || axes > 3 || map.dim(axes - 2) != S)
    throw ShapeError("turned: map has shape " + map.shape().str() + ", expected [S S] or [C S S]");
  auto out = Tensor::uninitialised(map.shape());
  for (Index i = 0; i < map.count(); ++i) {
    Index row = i / S % S, column = i % S;
    if (symmetry & 1) column = S - 1 - column;
    if (symmetry & 2) row = S - 1 - row;
    if (symmetry & 4) std::swap(row, column);
    out[i] = map[i / (S * S) * S * S + row * S + column];
  }
  return out;
}

}  // namespace satsurf::train
