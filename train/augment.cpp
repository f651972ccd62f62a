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

}  // namespace satsurf::train
