// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/model.h"
#include "satsurf/train/dataset.h"
#include "satsurf/train/trainer.h"

#include <array>

namespace satsurf::train {

/// The training objective of one crop and what it says in numbers.
struct LossReport {
  Var total;               ///< scalar
  double height_mae = 0;   ///< of the last stage's heights against the truth, m; NaN without truth
  double colour_psnr = 0;  ///< of the target rendered from the last stage, dB; NaN without a target
};

/// The training objective:
///   L = sum_s w_s ( a smoothL1(H_s, H*) + b MSE(I_s, I*) + c smoothL1(H^_s, H*_target) )
/// with the true heights of the sources, and colour and height rendered in the target view; the
/// target's terms count only where the rendered surface is opaque (alpha > 0.5).
/// config  weights
/// stages  what the network made of the crop
/// crop    with its target and the truth
LossReport training_loss(const TrainConfig& config,
                         const std::array<nn::StageOutput<float>, 3>& stages, const Crop& crop);

}  // namespace satsurf::train
