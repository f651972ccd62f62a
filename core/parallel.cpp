// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <memory>
#include <mutex>
#include <utility>

#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#if defined(__SANITIZE_THREAD__)
#include <atomic>
#include <exception>
#include <thread>
#include <vector>
#endif

namespace satsurf {
namespace {

std::mutex arena_mutex;
std::shared_ptr<tbb::task_arena> arena;  // empty: the caller's own arena

thread_local bool on_one_thread = false;

std::shared_ptr<tbb::task_arena> current_arena() {
  const std::lock_guard lock(arena_mutex);
  return arena;
}

#if defined(__SANITIZE_THREAD__)
/// TBB is not compiled with the thread sanitizer, which therefore sees nothing of the order TBB
/// guarantees; plain threads it knows. Loops inside loops run where they are.
void run_on_plain_threads(Index pieces, const std::function<void(Index)>& piece, int threads) {
  static thread_local bool inside = false;
  std::atomic<Index> next = 0;
  std::mutex failure_mutex;
  std::exception_ptr failure;
  const auto work = [&] {
    const bool outer = std::exchange(inside, true);
    try {
      for (Index p = next++; p < pieces; p = next++) piece(p);
    } catch (...) {
      next = pieces;
      const std::lock_guard lock(failure_mutex);
      failure = std::current_exception();
    }
    inside = outer;
  };
  std::vector<std::thread> workers;
  for (int i = 1; i < threads && !inside; ++i) workers.emplace_back(work);
  work();
  for (std::thread& w : workers) w.join();
  if (failure) std::rethrow_exception(failure);
}
#endif

}  // namespace

OnOneThread::OnOneThread() : before_(std::exchange(on_one_thread, true)) {}
OnOneThread::~OnOneThread() { on_one_thread = before_; }

void set_threads(int threads) {
  const std::lock_guard lock(arena_mutex);
  // TBB has no more workers than cores and would complain about a larger request.
  const int most = tbb::info::default_concurrency();
  arena = threads > 0 ? std::make_shared<tbb::task_arena>(std::min(threads, most)) : nullptr;
}

int threads() {
  if (on_one_thread) return 1;
  const auto a = current_arena();
  return a ? a->max_concurrency() : tbb::this_task_arena::max_concurrency();
}

void detail::run_pieces(Index pieces, const std::function<void(Index)>& piece) {
  if (on_one_thread) {
    for (Index p = 0; p < pieces; ++p) piece(p);
    return;
  }
#if defined(__SANITIZE_THREAD__)
  run_on_plain_threads(pieces, piece, threads());
#else
  const auto a = current_arena();
  const auto loop = [&] {
    // Pieces are already sized by the caller; let TBB balance them one by one.
    tbb::parallel_for(
        tbb::blocked_range<Index>(0, pieces, 1),
        [&](const tbb::blocked_range<Index>& r) {
          for (Index p = r.begin(); p != r.end(); ++p) piece(p);
        },
        tbb::simple_partitioner{});
  };
  if (a)
    a->execute(loop);
  else
    loop();
#endif
}

}  // namespace satsurf
