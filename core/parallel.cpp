// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <memory>
#include <mutex>

#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

namespace satsurf {
namespace {

std::mutex arena_mutex;
std::shared_ptr<tbb::task_arena> arena;  // empty: the caller's own arena

std::shared_ptr<tbb::task_arena> current_arena() {
  const std::lock_guard lock(arena_mutex);
  return arena;
}

}  // namespace

void set_threads(int threads) {
  const std::lock_guard lock(arena_mutex);
  // TBB has no more workers than cores and would complain about a larger request.
  const int most = tbb::info::default_concurrency();
  arena = threads > 0 ? std::make_shared<tbb::task_arena>(std::min(threads, most)) : nullptr;
}

int threads() {
  const auto a = current_arena();
  return a ? a->max_concurrency() : tbb::this_task_arena::max_concurrency();
}

void detail::run_pieces(Index pieces, const std::function<void(Index)>& piece) {
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
}

}  // namespace satsurf
