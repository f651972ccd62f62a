// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>

#include <CLI/CLI.hpp>

namespace satsurf::app {

/// What every sub-command takes besides its own options.
struct CommonFlags {
  int threads = 0;
  bool quiet = false;
  std::string log_level = "info";
  std::filesystem::path log_file;
};

/// A sub-command with those options.
/// common  where their values go
CLI::App* add_command(CLI::App& app, CommonFlags& common, const std::string& name,
                      const std::string& about);

}  // namespace satsurf::app
