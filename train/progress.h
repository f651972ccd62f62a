// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <string>

namespace satsurf::train {

/// Tells on stderr how far a long piece of work is: one bar that redraws itself on a terminal, else
/// a line every few seconds. Nothing at all when quiet.
class Progress {
 public:
  explicit Progress(bool quiet);
  /// Ends the bar, so that what follows starts on its own line.
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// stage     what is being done
  /// fraction  in [0, 1] of that stage
  /// detail    anything worth a few words: a loss, a count
  void update(const std::string& stage, double fraction, const std::string& detail = {});
  /// A remark on a line of its own, for instance a warning.
  void note(const std::string& text);

 private:
  using Clock = std::chrono::steady_clock;
  bool quiet_, terminal_, drawn_ = false;
  std::string stage_;
  Clock::time_point stage_start_, last_;
};

/// The bar itself: `stage  [####....]  42 %  detail  0:12 left`.
/// fraction  in [0, 1]; at 0 no time is given
/// seconds   since the stage began
/// columns   the line's width at most
std::string progress_line(const std::string& stage, double fraction, const std::string& detail,
                          double seconds, int columns);

}  // namespace satsurf::train
