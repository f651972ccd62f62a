// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/interrupt.h"

#include <atomic>
#include <csignal>

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

}  // namespace satsurf::app
