// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/log.h"

#include "satsurf/core/error.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <memory>

#include <spdlog/sinks/basic_file_sink.h>
#include <spdlog/spdlog.h>

namespace satsurf::app {
namespace {

constexpr std::array<const char*, 4> kNames{"error", "warning", "info", "debug"};
constexpr std::array kSpdlogLevels{spdlog::level::err, spdlog::level::warn, spdlog::level::info,
                                   spdlog::level::debug};

LogLevel stderr_level = LogLevel::error, file_level = LogLevel::info;
std::shared_ptr<spdlog::logger> file_log;

}  // namespace

void open_log(const std::string& level, bool quiet, const std::filesystem::path& file) {
  std::size_t i = 0;
  while (i < kNames.size() && level != kNames[i]) ++i;
  if (i == kNames.size())
    throw ConfigError("--log-level: " + level + ", expected error, warning, info or debug");
  file_level = static_cast<LogLevel>(i);
  stderr_level = quiet ? std::min(file_level, LogLevel::warning) : file_level;
  if (file.empty()) return;
  try {
    // the sink would make the missing folders of a mistyped path
    if (file.has_parent_path() && !std::filesystem::is_directory(file.parent_path()))
      throw IoError(file.string() + ": no folder " + file.parent_path().string());
    auto sink = std::make_shared<spdlog::sinks::basic_file_sink_mt>(file.string());
    file_log = std::make_shared<spdlog::logger>("satsurf", sink);
  } catch (const spdlog::spdlog_ex&) {
    throw IoError(file.string() + ": cannot be written");
  }
  file_log->set_pattern("%Y-%m-%dT%H:%M:%S.%e%z %-7l %v");
  file_log->set_level(spdlog::level::debug);
  file_log->flush_on(spdlog::level::debug);  // a crash must not take the last lines along
}

void log_line(LogLevel level, const std::string& text, bool on_stderr) {
  std::string line = text;
  for (char& c : line)
    if (c == '\n' || c == '\r') c = ' ';
  if (on_stderr && stderr_shows(level)) {
    const char* prefix = level == LogLevel::error     ? "satsurf: "
                         : level == LogLevel::warning ? "warning: "
                                                      : "";
    std::fprintf(stderr, "%s%s\n", prefix, line.c_str());
  }
  if (file_log && level <= file_level)
    file_log->log(kSpdlogLevels[static_cast<std::size_t>(level)], "{}", line);
}

bool stderr_shows(LogLevel level) { return level <= stderr_level; }

}  // namespace satsurf::app
