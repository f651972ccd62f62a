// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/evaluate/evaluate.h"

#include <vector>

namespace satsurf::evaluate {

/// Scores heights in the source views and heights and colours in the rendered target, in a window
/// around the middle of the truth.
/// sources     views the network is given, the scene's first; the next one is the target
/// surfels     what was reconstructed from them, whole, in the scene's frame
/// out         takes the scores; without a target its numbers are NaN
/// confidence  the pixels are added to it, unless nullptr
/// throws      IoError if the window is too small for LPIPS
void score_views(const nn::Model& model, const scene::Scene& scene, const EvaluateOptions& options,
                 const std::vector<Index>& sources, const splat::Surfels& surfels, SceneScores& out,
                 ConfidenceScores* confidence);

}  // namespace satsurf::evaluate
