// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <memory>
#include <mutex>

#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#if defined(__SANITIZE_THREAD__)
#include <sanitizer/tsan_interface.h>
#endif

namespace satsurf {
namespace {

std::mutex arena_mutex;
std::shared_ptr<tbb::task_arena> arena;  // empty: the caller's own arena

std::shared_ptr<tbb::task_arena> current_arena() {
  const std::lock_guard lock(arena_mutex);
  return arena;
}

/// What TBB guarantees of a loop, told to the thread sanitizer, which cannot see it because TBB is
/// not compiled with it: what came before the loop happens before each piece, and each piece
/// before what follows the loop. Nothing orders the pieces among themselves.
class LoopOrder {
 public:
#if defined(__SANITIZE_THREAD__)
  LoopOrder() { __tsan_release(&begin_); }
  ~LoopOrder() { __tsan_acquire(&end_); }
  void enter_piece() { __tsan_acquire(&begin_); }
  void leave_piece() { __tsan_release(&end_); }

 private:
  char begin_ = 0, end_ = 0;  // only their addresses are used
#else
  void enter_piece() {}
  void leave_piece() {}
#endif
};

/// Leaves the piece by an exception too.
class InPiece {
 public:
  explicit InPiece(LoopOrder& order) : order_(order) { order_.enter_piece(); }
  InPiece(const InPiece&) = delete;
  ~InPiece() { order_.leave_piece(); }

 private:
  LoopOrder& order_;
};

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
  LoopOrder order;
  const auto loop = [&] {
    // Pieces are already sized by the caller; let TBB balance them one by one.
    tbb::parallel_for(
        tbb::blocked_range<Index>(0, pieces, 1),
        [&](const tbb::blocked_range<Index>& r) {
          const InPiece in_piece(order);
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
