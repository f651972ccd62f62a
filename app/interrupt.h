// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <thread>

namespace satsurf::app {

/// Thrown out of a command that was told to stop, e.g. by Ctrl-C.
struct Interrupted {};

/// Lets a write beyond the limit of a file's size (`ulimit -f`) fail as one to a full disk does,
/// instead of ending the program.
void survive_file_limits();

/// From now on the first SIGINT, SIGTERM or SIGHUP is noted and the second of its kind kills; a
/// SIGHUP that nohup has the program ignore stays ignored.
void catch_interrupts();
/// Whether one has come since.
bool interrupted();
/// The signal noted, 0 for none.
int interrupt_signal();
/// throws  Interrupted if one has come
void stop_if_interrupted();

/// While one lives, a signal ends the program within half a second, even inside a call that asks for
/// none: a library that reads a raster, a sum over 10^9 cells. For work that has nothing to put away:
/// no file is open for writing.
class EndsAtSignal {
 public:
  EndsAtSignal();
  EndsAtSignal(const EndsAtSignal&) = delete;
  EndsAtSignal& operator=(const EndsAtSignal&) = delete;

 private:
  std::jthread watch_;
};

}  // namespace satsurf::app
