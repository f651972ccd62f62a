// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/pointing.h"

#include <string>

#include <nlohmann/json.hpp>

namespace satsurf::app {

/// How cameras agree before and after their shifts, in one line.
std::string pointing_line(const scene::Pointing& pointing);
/// What a reconstruction would do about cameras that were only measured.
std::string correction_line(const scene::Pointing& pointing);
/// How one pair agrees: tie points and residuals, in words.
std::string pair_line(const scene::PairResidual& pair);
/// The same as `pointing_line` for the record of a run.
nlohmann::ordered_json pointing_json(const scene::Pointing& pointing);

}  // namespace satsurf::app
