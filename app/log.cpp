// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/log.h"

#include "satsurf/core/error.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdio>
#include <memory>
#include <mutex>
#include <string_view>
#include <system_error>
#include <utility>

#include <spdlog/logger.h>
#include <spdlog/pattern_formatter.h>
#include <spdlog/sinks/base_sink.h>
#include <spdlog/sinks/stdout_sinks.h>

namespace satsurf::app {
namespace {

using spdlog::level::level_enum;

level_enum spdlog_level(LogLevel level) {
  constexpr std::array kLevels{spdlog::level::err, spdlog::level::warn, spdlog::level::info,
                               spdlog::level::debug};
  return kLevels[static_cast<std::size_t>(level)];
}

/// What a line on stderr begins with.
class Prefix : public spdlog::custom_flag_formatter {
 public:
  void format(const spdlog::details::log_msg& message, const std::tm&,
              spdlog::memory_buf_t& out) override {
    const std::string_view text = message.level == spdlog::level::err    ? "satsurf: "
                                  : message.level == spdlog::level::warn ? "warning: "
                                                                         : "";
    out.append(text.data(), text.data() + text.size());
  }
  std::unique_ptr<custom_flag_formatter> clone() const override {
    return std::make_unique<Prefix>();
  }
};

spdlog::logger& terminal_log() {
  static spdlog::logger log = [] {
    auto formatter = std::make_unique<spdlog::pattern_formatter>();
    formatter->add_flag<Prefix>('*').set_pattern("%*%v");
    spdlog::logger made("terminal", std::make_shared<spdlog::sinks::stderr_sink_mt>());
    made.set_formatter(std::move(formatter));
    made.set_level(spdlog::level::err);
    return made;
  }();
  return log;
}

/// The end of a file, a line at a time: a crash must not take the last ones along. spdlog's own does
/// not notice that a disk is full.
class FileSink : public spdlog::sinks::base_sink<std::mutex> {
 public:
  explicit FileSink(const std::filesystem::path& file)
      : file_(file), stream_(std::fopen(file.c_str(), "ab")) {
    if (stream_ == nullptr) throw IoError(file_.string() + ": cannot be written");
  }
  ~FileSink() override { std::fclose(stream_); }

 protected:
  void sink_it_(const spdlog::details::log_msg& message) override {
    spdlog::memory_buf_t line;
    formatter_->format(message, line);
    if (std::fwrite(line.data(), 1, line.size(), stream_) == line.size() &&
        std::fflush(stream_) == 0)
      return;
    const int code = errno;
    if (!std::exchange(told_, true))
      terminal_log().warn("{}: messages are missing from here on, as it cannot be written ({})",
                          file_.string(), std::generic_category().message(code));
  }
  void flush_() override {}

 private:
  std::filesystem::path file_;
  std::FILE* stream_;
  bool told_ = false;
};

std::unique_ptr<spdlog::logger> file_log;

}  // namespace

void open_log(LogLevel level, bool quiet, const std::filesystem::path& file) {
  terminal_log().set_level(spdlog_level(quiet ? std::min(level, LogLevel::warning) : level));
  if (file.empty()) return;
  if (file.has_parent_path() && !std::filesystem::is_directory(file.parent_path()))
    throw IoError(file.string() + ": no folder " + file.parent_path().string());
  file_log = std::make_unique<spdlog::logger>("file", std::make_shared<FileSink>(file));
  file_log->set_pattern("%Y-%m-%dT%H:%M:%S.%e%z %-7l %v");
  file_log->set_level(spdlog_level(level));
}

void log_line(LogLevel level, const std::string& text, bool on_stderr) {
  std::string line = text;
  for (char& c : line)
    if (c == '\n' || c == '\r') c = ' ';
  const spdlog::string_view_t view(line);
  if (on_stderr) terminal_log().log(spdlog_level(level), view);
  if (file_log) file_log->log(spdlog_level(level), view);
}

bool stderr_shows(LogLevel level) { return terminal_log().should_log(spdlog_level(level)); }

}  // namespace satsurf::app
