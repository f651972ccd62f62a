// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

using namespace satsurf;

namespace {

/// Runs `f` under each number of threads and restores the default.
template <class F>
void with_threads(std::initializer_list<int> counts, const F& f) {
  for (const int n : counts) {
    set_threads(n);
    CAPTURE(n);
    f();
  }
  set_threads(0);
}

}  // namespace

TEST_CASE("parallel: every index is visited once, in pieces of the same extent") {
  with_threads({1, 2, 3}, [] {
    for (const Index n : {0, 1, 7, 64, 1001}) {
      for (const Index grain : {0, 1, 5, 64, 5000}) {
        CAPTURE(n);
        CAPTURE(grain);
        std::vector<std::atomic<int>> visits(static_cast<std::size_t>(n));
        std::atomic<bool> aligned{true};
        for_range(n, grain, [&](Index begin, Index end) {
          const Index g = std::max<Index>(grain, 1);
          if (begin % g != 0 || end != std::min(begin + g, n)) aligned = false;
          for (Index i = begin; i < end; ++i) ++visits[static_cast<std::size_t>(i)];
        });
        CHECK(aligned);
        CHECK(std::ranges::all_of(visits, [](const auto& v) { return v == 1; }));
      }
    }
  });
  for_range(-3, 2, [](Index, Index) { FAIL("a negative range has no pieces"); });
}

TEST_CASE("parallel: sums have the same bits for any number of threads") {
  const auto part = [](Index begin, Index end) {
    float sum = 0;
    for (Index i = begin; i < end; ++i) sum += std::sin(static_cast<float>(i)) / 3.0F;
    return sum;
  };
  set_threads(1);
  const float one = ordered_reduce(Index{100'003}, 97, 0.1F, part);
  CHECK(one != 0.1F);
  with_threads({2, 3, 0}, [&] {
    for (int repeat = 0; repeat < 5; ++repeat) {
      const float many = ordered_reduce(Index{100'003}, 97, 0.1F, part);
      CHECK(std::memcmp(&one, &many, sizeof one) == 0);
    }
  });
  CHECK(ordered_reduce(Index{0}, 4, 2.5F, part) == 2.5F);
  CHECK(ordered_reduce(Index{-9}, 4, 2.5F, part) == 2.5F);
}

TEST_CASE("parallel: two pieces run at the same time, each on a thread of its own") {
  set_threads(2);
  if (threads() < 2) {
    MESSAGE("skipped: there is one core");
    return set_threads(0);
  }
  std::array<std::thread::id, 2> ran;
  std::atomic<int> there = 0;
  for_each_index(2, [&](Index i) {
    ran[static_cast<std::size_t>(i)] = std::this_thread::get_id();
    ++there;
    // a piece that were done before the other begins would show nothing
    const auto enough = std::chrono::steady_clock::now() + std::chrono::seconds(5);
    while (there < 2 && std::chrono::steady_clock::now() < enough) std::this_thread::yield();
  });
  set_threads(0);
  CHECK(ran[0] != ran[1]);
}

TEST_CASE("parallel: loops nest") {
  with_threads({1, 2}, [] {
    std::vector<int> cells(35);
    for_each_index(5, [&](Index i) {
      for_each_index(7, [&](Index j) { cells[static_cast<std::size_t>(i * 7 + j)] += 1; });
    });
    CHECK(std::ranges::all_of(cells, [](int c) { return c == 1; }));
  });
}

TEST_CASE("parallel: an exception of a piece reaches the caller") {
  with_threads({1, 2}, [] {
    CHECK_THROWS_WITH_AS(for_each_index(100,
                                        [](Index i) {
                                          if (i == 57) throw std::runtime_error("piece 57");
                                        }),
                         "piece 57", std::runtime_error);
  });
}

TEST_CASE("parallel: the cap on threads is reported and lifted") {
  set_threads(0);
  const int most = threads();  // all cores
  set_threads(1);
  CHECK(threads() == 1);
  set_threads(2);
  CHECK(threads() == std::min(2, most));
  set_threads(0);
  CHECK(threads() >= 1);
}

TEST_CASE("parallel: a thread can be told to run its loops alone") {
  std::vector<std::thread::id> ran(64);
  {
    const OnOneThread alone;
    CHECK(threads() == 1);
    { const OnOneThread nested; }
    for_each_index(64,
                   [&](Index i) { ran[static_cast<std::size_t>(i)] = std::this_thread::get_id(); });
  }
  for (const auto& id : ran) CHECK(id == std::this_thread::get_id());
  CHECK(threads() >= 1);
  CHECK_THROWS_WITH(
      [] {
        const OnOneThread alone;
        for_each_index(3, [](Index i) {
          if (i == 1) throw std::runtime_error("piece 1");
        });
      }(),
      "piece 1");
}
