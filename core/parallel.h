// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

#include <functional>
#include <vector>

namespace satsurf {

/// Caps the threads of every loop below. The only global state of the engine. Results never depend
/// on it: loops are cut into the same pieces whatever runs them.
/// threads  0, or more than there are cores, means all cores
void set_threads(int threads);
/// Threads in use now (the cap, or what the caller's TBB arena offers).
int threads();

/// Loops that the calling thread starts while one of these lives run on that thread alone: for
/// work that is parallel at a coarser level.
class OnOneThread {
 public:
  OnOneThread();
  ~OnOneThread();
  OnOneThread(const OnOneThread&) = delete;
  OnOneThread& operator=(const OnOneThread&) = delete;

 private:
  bool before_;
};

namespace detail {
void run_pieces(Index pieces, const std::function<void(Index)>& piece);
}

/// Runs a loop over [0, n) in parallel, in pieces that depend on n and grain alone.
/// grain  iterations of a piece, at most
/// body   called as body(begin, end); each output element must be written by one piece
template <class Body>
void for_range(Index n, Index grain, const Body& body) {
  if (n <= 0) return;
  const Index g = grain < 1 ? 1 : grain, pieces = (n + g - 1) / g;
  if (pieces == 1) return body(Index{0}, n);
  detail::run_pieces(pieces, [&](Index p) { body(p * g, p * g + g < n ? p * g + g : n); });
}

/// Runs body(i) for every i in [0, n) in parallel.
/// body  at least some microseconds of work each
template <class Body>
void for_each_index(Index n, const Body& body) {
  for_range(n, 1, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) body(i);
  });
}

/// Sum over [0, n) that is the same for any number of threads.
/// grain    iterations of a piece, at most
/// init     what the pieces' values are added to, in order
/// part     called as part(begin, end); returns a piece's value
/// returns  the sum
template <class Value, class Part>
Value ordered_reduce(Index n, Index grain, Value init, const Part& part) {
  if (n <= 0) return init;
  const Index g = grain < 1 ? 1 : grain, pieces = (n + g - 1) / g;
  std::vector<Value> partial(pieces);
  for_range(n, g, [&](Index begin, Index end) { partial[begin / g] = part(begin, end); });
  for (const Value& v : partial) init += v;
  return init;
}

}  // namespace satsurf
