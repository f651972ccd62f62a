// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/parallel.h"

#include <future>
#include <utility>

namespace satsurf::app {

/// Does some work beside what follows, on a thread of its own from now on; where the program may use
/// one thread only, when the result is waited for.
/// returns  ends when it is done, at the latest when it is destroyed; `get` throws what the work threw
template <class Work>
std::future<void> beside(Work work) {
  return std::async(threads() > 1 ? std::launch::async : std::launch::deferred, std::move(work));
}

}  // namespace satsurf::app
