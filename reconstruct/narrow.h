// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/model.h"
#include "satsurf/reconstruct/plan.h"
#include "satsurf/scene/scene.h"

#include <functional>
#include <optional>

namespace satsurf::reconstruct {

/// Heights that a scene's surface lies between, of a range that may be far too generous: the more
/// heights are tried, the more look right by chance, above all on large roofs without texture. The
/// first two stages of the network look at smaller images first: in half of the resolution, in which
/// towers show, or, of a range that takes too many hypotheses there, in a third or a quarter, and again
/// as long as that narrows the range by far. What remains are the heights on which two views agree
/// there and that are believed, now or by an earlier look over more (`scene::believable_span`), with 5 m
/// more below and 10 m more above, or two and four pixels of parallax where that is more. Above, all but
/// two in ten thousand count, and what the images agreed on when the range was found (`Scene::z_agreed`):
/// they may be towers. Below, only what is believed: the ground is wide, and what lies lower is for the
/// most part rows of roofs or trees taken for one another. Where all that spans more than 40 m, some
/// tower may not have been seen, and there is half of it more above, up to 25 m. The scene's own range
/// is kept where it is less than six margins, where hardly anything agrees, and where less than 15 %
/// would be saved: what is cut off is lost, a tower that no look has seen, too. It is also kept, without
/// a look, where it is less than one and a half times what the fewest hypotheses span: then the first
/// stage can as well search all of it (`range_left`).
/// poll      called between layers, may throw to stop
/// unwanted  ground on which heights do not count, see ReconstructOptions; may be empty
/// returns   a part of `scene.z_range`, local m
rpc::HeightRange narrowed_range(const nn::Model& model, const scene::Scene& scene,
                                const std::function<void()>& poll = {},
                                const std::function<Tensor(const Grid&)>& unwanted = {});

/// Whether `narrowed_range` looks at all.
bool looks_first(const nn::ModelConfig& config, const scene::Scene& scene);

/// `narrowed_range`, but it looks at any range of six margins or more, however few hypotheses that takes.
rpc::HeightRange looked_range(const nn::Model& model, const scene::Scene& scene,
                              const std::function<void()>& poll = {},
                              const std::function<Tensor(const Grid&)>& unwanted = {});

/// What the first stage of the network leaves to the others of the range it searched, by the rules of
/// the last look; nothing where that would save less than 15 %, where the range is less than six margins
/// or where views agree at less than half of the pixels, or at hardly any. Costs no search, but asks for
/// a look where some of the heights on which views agree lie apart from the others: they may be towers,
/// or a roof without texture, which looks alike at all heights and gets the same in every view.
/// scene     of the views, the top of whose `z_agreed` is kept
/// input     windows of all of them
/// first     what the first stage found there
/// look      what `looked_range` leaves of the scene's range; may be empty
/// unwanted  as above
/// returns   a part of `input.z_range`, local m
std::optional<rpc::HeightRange> range_left(const nn::ModelConfig& config, const scene::Scene& scene,
                                           const nn::NetworkInput& input,
                                           const nn::StageHeights<float>& first,
                                           const std::function<rpc::HeightRange()>& look = {},
                                           const std::function<Tensor(const Grid&)>& unwanted = {});

}  // namespace satsurf::reconstruct
