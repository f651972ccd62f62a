// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/program.h"

#include <string>

namespace satsurf::app {

/// The manual page of the program and all its commands, satsurf(1), as troff.
std::string man_page(const Program& program);

}  // namespace satsurf::app
