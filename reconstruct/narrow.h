// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/model.h"
#include "satsurf/reconstruct/plan.h"
#include "satsurf/scene/scene.h"

#include <functional>

namespace satsurf::reconstruct {

/// See plan.h, in the middle of the first view.
double span_of_hypotheses(const nn::ModelConfig& config, const scene::Scene& scene);

/// Heights that a scene's surface lies between, of a range that may be far too generous: the first
/// stage shares its hypotheses out over all of it, and what it wastes on empty air it lacks on the
/// surface. Where the range is more than `span_of_hypotheses`, the images are looked at in a quarter
/// of their resolution or less first, up to three times, and the range that remains is the
/// believable span (`scene::believable_span`) of the heights on which two views agree there, with a
/// margin of 20 m above and 10 m below, and with what the hypotheses can span besides, upwards
/// first: towers are too few pixels to be sure to show. It holds what the images agreed on when the
/// range was found (`Scene::z_agreed`). Else, or where hardly anything agrees, it is
/// the scene's own range.
/// poll      called between layers, may throw to stop
/// unwanted  ground on which heights do not count, see ReconstructOptions; may be empty
/// returns   a part of `scene.z_range`, local m
rpc::HeightRange narrowed_range(const nn::Model& model, const scene::Scene& scene,
                                const std::function<void()>& poll = {},
                                const std::function<Tensor(const Grid&)>& unwanted = {});

}  // namespace satsurf::reconstruct
