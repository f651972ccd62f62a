// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/interrupt.h"

#include <array>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <optional>
#include <thread>

#include <doctest/doctest.h>
#include <sys/wait.h>
#include <unistd.h>

using namespace satsurf::app;
using namespace std::chrono_literals;

namespace {

// The thread sanitizer does not bear new threads in a child; tests/cli/run.sh stops the program itself.
#ifdef __SANITIZE_THREAD__
constexpr bool kForks = false;
#else
constexpr bool kForks = true;
#endif

/// Exit code of a process that is told to stop while it works on, deaf.
/// guarded  whether an `EndsAtSignal` lives meanwhile
/// asks     whether it asks for signals itself, each time it has worked for a tenth of a second
int exit_code(bool guarded, bool asks) {
  std::array<int, 2> ready{};
  REQUIRE(::pipe(ready.data()) == 0);
  const pid_t child = ::fork();
  REQUIRE(child >= 0);
  if (child == 0) {
    catch_interrupts();
    std::optional<EndsAtSignal> stops;
    if (guarded) stops.emplace();
    if (::write(ready[1], "x", 1) != 1) std::_Exit(9);
    for (int i = 0; i < 20; ++i) {
      std::this_thread::sleep_for(100ms);
      if (asks && interrupted()) std::_Exit(7);
    }
    std::_Exit(0);
  }
  ::close(ready[1]);  // so that a child that dies ends the wait
  char byte = 0;
  REQUIRE(::read(ready[0], &byte, 1) == 1);
  ::close(ready[0]);
  ::kill(child, SIGTERM);
  int status = 0;
  REQUIRE(::waitpid(child, &status, 0) == child);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
}

}  // namespace

TEST_CASE("work that asks for no signal is ended by one, but not by one that it asks for itself" *
          doctest::skip(!kForks)) {
  CHECK(exit_code(false, false) == 0);  // what would happen otherwise
  CHECK(exit_code(true, false) == 128 + SIGTERM);
  CHECK(exit_code(true, true) == 7);
}

TEST_CASE("without a signal nothing ends") {
  const auto start = std::chrono::steady_clock::now();
  {
    const EndsAtSignal stops;
    std::this_thread::sleep_for(400ms);
  }
  CHECK(std::chrono::steady_clock::now() - start < 10s);  // nor is the end waited for
}
