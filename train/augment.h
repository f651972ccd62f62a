// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"
#include "satsurf/core/rng.h"
#include "satsurf/nn/input.h"

namespace satsurf::train {

/// How unlike themselves the images are made that a network is shown.
struct AugmentConfig {
  double grey_share = 0.4;   ///< share of the samples made panchromatic
  double radiometry = 0.15;  ///< random gain, offset and gamma of a sample

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("grey_share", s.grey_share,
      Field{.help = "share of the samples made panchromatic", .min = 0, .max = 1});
    v("radiometry", s.radiometry,
      Field{.help = "random gain, offset and gamma of a sample", .min = 0, .max = 0.9});
  }
};

/// How a sample's images are made to look: c -> gain c^gamma + offset, clipped to [0, 1].
struct Radiometry {
  double gain = 1, offset = 0, gamma = 1;
  bool grey = false;  ///< luminance only
};
/// amount      largest relative change of gain and gamma, twice that of the offset
/// grey_share  how often it is grey
Radiometry random_radiometry(double amount, double grey_share, Rng& rng);
/// Changes the valid pixels of a view.
void apply(const Radiometry& radiometry, nn::PosedImage& view);

}  // namespace satsurf::train
