// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/interrupt.h"

#include "satsurf/app/log.h"

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <csignal>
#include <cstdlib>
#include <mutex>

namespace satsurf::app {
namespace {

std::atomic<int> signal_seen{0};

}  // namespace

void survive_file_limits() { std::signal(SIGXFSZ, SIG_IGN); }

void catch_interrupts() {
  struct sigaction action {};
  action.sa_handler = [](int signal) { signal_seen = signal; };
  action.sa_flags = static_cast<int>(SA_RESETHAND);  // the second one kills
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    struct sigaction before {};
    sigaction(signal, nullptr, &before);
    if (signal == SIGHUP && before.sa_handler == SIG_IGN) continue;  // nohup
    sigaction(signal, &action, nullptr);
  }
}

bool interrupted() { return signal_seen != 0; }
int interrupt_signal() { return signal_seen; }

void stop_if_interrupted() {
  if (interrupted()) throw Interrupted{};
}

EndsAtSignal::EndsAtSignal()
    : watch_([](const std::stop_token& over) {
        constexpr std::chrono::milliseconds kAsk{50};
        constexpr int kPatience = 5;  // times: whoever asks for signals has stopped by then
        std::mutex mutex;
        std::condition_variable_any wake;
        for (int seen = 0; !over.stop_requested();) {
          std::unique_lock lock(mutex);
          wake.wait_for(lock, over, kAsk, [] { return false; });
          if (!interrupted() || ++seen < kPatience || over.stop_requested()) continue;
          log_line(LogLevel::error, "stopped");
          std::_Exit(128 + interrupt_signal());  // without the destructors of work that goes on
        }
      }) {}

}  // namespace satsurf::app
