// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/rng.h"
#include "satsurf/nn/input.h"

namespace satsurf::train {

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
