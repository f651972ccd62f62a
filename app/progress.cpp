// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/progress.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

namespace satsurf::app {
namespace {

constexpr double kLineEvery = 5;    // s between lines of a log
constexpr double kDrawEvery = 0.1;  // s between redraws of a bar

int terminal_columns() {
  winsize size{};
  return ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0 ? size.ws_col : 80;
}

double seconds_between(std::chrono::steady_clock::time_point a,
                       std::chrono::steady_clock::time_point b) {
  return std::chrono::duration<double>(b - a).count();
}

}  // namespace

std::string progress_line(const std::string& stage, double fraction, const std::string& detail,
                          double seconds, int columns, double begun) {
  constexpr int kBar = 24;
  const auto share = [](double x) { return std::isfinite(x) ? std::clamp(x, 0.0, 1.0) : 0; };
  const double f = share(fraction), done = f - share(begun);
  const int full = static_cast<int>(f * kBar);
  std::string line = stage + " [" + std::string(static_cast<std::size_t>(full), '#') +
                     std::string(static_cast<std::size_t>(kBar - full), '.') +
                     fmt::format("] {:3.0f} %", std::floor(100 * f));
  if (!detail.empty()) line += "  " + detail;
  if (done > 0 && f < 1 && seconds >= 1) {
    const long left = std::lround(seconds * (1 - f) / done);
    line += left >= 3600
                ? fmt::format("  {}:{:02}:{:02} left", left / 3600, left / 60 % 60, left % 60)
                : fmt::format("  {}:{:02} left", left / 60, left % 60);
  }
  return line.substr(0, static_cast<std::size_t>(std::max(columns, 1)));
}

Progress::Progress()
    : terminal_(isatty(STDERR_FILENO) == 1), last_drawn_(Clock::now()), last_line_(last_drawn_) {}

Progress::~Progress() { end_stage(Clock::now()); }

void Progress::end_stage(Clock::time_point now) {
  if (drawn_) std::fputc('\n', stderr);
  drawn_ = false;
  if (stage_.empty()) return;
  log_line(LogLevel::debug,
           fmt::format("{}: {:.2f} s", stage_, seconds_between(stage_start_, now)));
}

void Progress::update(const std::string& stage, double fraction, const std::string& detail) {
  const Clock::time_point now = Clock::now();
  const bool new_stage = stage != stage_;
  if (new_stage) {
    end_stage(now);
    stage_ = stage, stage_start_ = now, begun_ = fraction;
  }
  const double seconds = seconds_between(stage_start_, now);
  // a log gets lines only from work that takes a while
  if (seconds_between(last_line_, now) >= kLineEvery) {
    last_line_ = now;
    log_line(LogLevel::info, progress_line(stage, fraction, detail, seconds, 200, begun_),
             !terminal_);
  }
  const bool due = seconds_between(last_drawn_, now) >= kDrawEvery || new_stage || fraction >= 1;
  if (!terminal_ || !due || !stderr_shows(LogLevel::info)) return;
  last_drawn_ = now;
  std::fprintf(
      stderr, "\r\033[K%s",
      progress_line(stage, fraction, detail, seconds, terminal_columns() - 1, begun_).c_str());
  std::fflush(stderr);
  drawn_ = true;
}

void Progress::note(const std::string& text, LogLevel level) {
  if (drawn_) std::fputs("\r\033[K", stderr);
  drawn_ = false;
  log_line(level, text);
}

}  // namespace satsurf::app
