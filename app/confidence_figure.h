// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/evaluate/confidence.h"

#include <string>
#include <vector>

namespace satsurf::app {

/// Errors by confidence drawn as SVG: for each two pairs of bar charts, over bins of equal width and of equal
/// count. The upper one has the mean |error| with the root of the mean square marked, the lower one
/// the shares of the pixels with |error| < 1, 2.5, 7.5 m, one bar within the other.
std::string confidence_svg(const std::vector<evaluate::NamedConfidence>& all);

}  // namespace satsurf::app
