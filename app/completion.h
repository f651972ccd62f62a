// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/program.h"

#include <string>

namespace satsurf::app {

/// A script that has bash complete commands, their flags, and the values of those that have a
/// choice; for other values it offers files.
std::string bash_completion(const Program& program);

}  // namespace satsurf::app
