// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/log.h"

#include <chrono>
#include <string>

namespace satsurf::app {

/// Tells how far a long piece of work is: on a terminal one bar that redraws itself, elsewhere a
/// line of the log every few seconds. At level debug the log says how long each stage took.
class Progress {
 public:
  Progress();
  /// Ends the bar, so that what follows starts on its own line.
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// stage     what is being done
  /// fraction  in [0, 1] of that stage
  /// detail    anything worth a few words: a loss, a count
  void update(const std::string& stage, double fraction, const std::string& detail = {});
  /// A finding or a warning, on a line of its own.
  void note(const std::string& text, LogLevel level = LogLevel::info);

 private:
  using Clock = std::chrono::steady_clock;
  void end_stage(Clock::time_point now);

  bool terminal_, drawn_ = false;
  std::string stage_;
  double begun_ = 0;  // fraction that the stage began with
  Clock::time_point stage_start_, last_drawn_, last_line_;
};

/// The bar itself: `stage  [####....]  42 %  detail  0:12 left`.
/// fraction  in [0, 1]; at 0 no time is given
/// seconds   since the stage began
/// columns   the line's width at most
/// begun     fraction that it began with: what goes on where it stopped
std::string progress_line(const std::string& stage, double fraction, const std::string& detail,
                          double seconds, int columns, double begun = 0);

}  // namespace satsurf::app
