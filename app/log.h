// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"

#include <array>
#include <filesystem>
#include <string>

namespace satsurf::app {

/// How much a message matters; a level includes those before it.
enum class LogLevel {
  error,    ///< why the program stopped
  warning,  ///< results may not be what was hoped for
  info,     ///< progress and findings
  debug     ///< how long the parts of the work took
};

/// Sends messages up to `level` to stderr and, if `file` is given, with the time to the end of it.
/// quiet   nothing but errors and warnings on stderr; the file still gets everything
/// throws  IoError if the file cannot be written
void open_log(LogLevel level, bool quiet, const std::filesystem::path& file);

/// One message on a line of its own, whatever a library put into it. Errors go to stderr and no
/// file until open_log was called.
/// on_stderr  false where the terminal shows the same in another form
void log_line(LogLevel level, const std::string& text, bool on_stderr = true);

/// Whether stderr gets messages of this level.
bool stderr_shows(LogLevel level);

}  // namespace satsurf::app

template <>
struct satsurf::EnumNames<satsurf::app::LogLevel> {
  static constexpr std::array names{"error", "warning", "info", "debug"};
};
