// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/common_flags.h"

#include <functional>

#include <CLI/CLI.hpp>

namespace satsurf::app {

/// Adds `evaluate`: one command, four things to score, each with options of its own. Those of the
/// others are refused.
/// run  becomes what was asked for, once the command line is read
void add_evaluate(CLI::App& app, CommonFlags& common, std::function<void()>& run);

}  // namespace satsurf::app
