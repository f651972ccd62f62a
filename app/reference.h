// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/program.h"

#include <string>

namespace satsurf::app {

/// The manual of everything that can be asked for and that is written, in Markdown: commands and
/// their flags as declared, files, columns, exit codes, environment. It is docs/reference.md.
std::string reference(const Program& program);

}  // namespace satsurf::app
