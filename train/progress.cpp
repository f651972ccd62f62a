// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/progress.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include <sys/ioctl.h>
#include <unistd.h>

namespace satsurf::train {
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
                          double seconds, int columns) {
  constexpr int kBar = 24;
  const double f = std::isfinite(fraction) ? std::clamp(fraction, 0.0, 1.0) : 0;
  const int full = static_cast<int>(f * kBar);
  char percent[16];
  std::snprintf(percent, sizeof percent, "%3.0f %%", std::floor(100 * f));
  std::string line = stage + " [" + std::string(static_cast<std::size_t>(full), '#') +
                     std::string(static_cast<std::size_t>(kBar - full), '.') + "] " + percent;
  if (!detail.empty()) line += "  " + detail;
  if (f > 0 && f < 1 && seconds >= 1) {
    const long left = std::lround(seconds * (1 - f) / f);
    char text[32];
    if (left >= 3600)
      std::snprintf(text, sizeof text, "  %ld:%02ld:%02ld left", left / 3600, left / 60 % 60,
                    left % 60);
    else
      std::snprintf(text, sizeof text, "  %ld:%02ld left", left / 60, left % 60);
    line += text;
  }
  return line.substr(0, static_cast<std::size_t>(std::max(columns, 1)));
}

Progress::Progress(bool quiet)
    : quiet_(quiet), terminal_(isatty(STDERR_FILENO) == 1), last_(Clock::now()) {}

Progress::~Progress() {
  if (drawn_) std::fputc('\n', stderr);
}

void Progress::update(const std::string& stage, double fraction, const std::string& detail) {
  if (quiet_) return;
  const Clock::time_point now = Clock::now();
  const bool new_stage = stage != stage_;
  if (new_stage) {
    if (drawn_) std::fputc('\n', stderr);
    drawn_ = false, stage_ = stage, stage_start_ = now;
  }
  // a log gets lines only from work that takes a while
  const bool due = seconds_between(last_, now) >= (terminal_ ? kDrawEvery : kLineEvery);
  if (!due && !(terminal_ && (new_stage || fraction >= 1))) return;
  last_ = now;
  const double seconds = seconds_between(stage_start_, now);
  if (terminal_) {
    std::fprintf(stderr, "\r\033[K%s",
                 progress_line(stage, fraction, detail, seconds, terminal_columns() - 1).c_str());
    std::fflush(stderr);
    drawn_ = true;
  } else {
    std::fprintf(stderr, "%s\n", progress_line(stage, fraction, detail, seconds, 200).c_str());
  }
}

void Progress::note(const std::string& text) {
  if (quiet_) return;
  if (drawn_) std::fputs("\r\033[K", stderr);
  drawn_ = false;
  std::fprintf(stderr, "%s\n", text.c_str());
}

}  // namespace satsurf::train
