// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/hash.h"
#include "satsurf/core/rng.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <vector>

#include <doctest/doctest.h>

using namespace satsurf;

TEST_CASE("rng: the known answers published with Philox4x32-10") {
  // kat_vectors of Random123: counter 0, key 0 -> 6627e8d5 e169c58d bc57ac4c 9b00dbd8.
  CHECK(Rng(0).next_u64() == 0x6627e8d5'e169c58dU);
  // Counter and key all ones -> 408f276d 41c83b0e a20bc7c6 6d5451fd.
  Rng ones(~std::uint64_t{0}, ~std::uint64_t{0});
  ones.set_counter(~std::uint64_t{0});
  CHECK(ones.next_u64() == 0x408f276d'41c83b0eU);
  // Counter 243f6a88 85a308d3 13198a2e 03707344, key a4093822 299f31d0 -> d16cfe09 94fdcceb ...
  Rng pi(0x299f31d0'a4093822U, 0x03707344'13198a2eU);
  pi.set_counter(0x85a308d3'243f6a88U);
  CHECK(pi.next_u64() == 0xd16cfe09'94fdccebU);
}

TEST_CASE("rng: a draw is a function of seed, stream and counter alone") {
  Rng a(7, 3);
  std::vector<std::uint64_t> first;
  for (int i = 0; i < 10; ++i) first.push_back(a.next_u64());
  CHECK(a.counter() == 10);
  a.set_counter(4);
  CHECK(a.next_u64() == first[4]);
  CHECK(Rng(7, 4).next_u64() != first[0]);
  CHECK(Rng(8, 3).next_u64() != first[0]);
  CHECK(std::set(first.begin(), first.end()).size() == 10);
}

TEST_CASE("rng: forks are independent of the parent's draws and of each other") {
  Rng a(7);
  const std::uint64_t before = a.fork(1).next_u64();
  a.next_u64();
  CHECK(a.fork(1).next_u64() == before);
  std::set<std::uint64_t> seen;
  for (std::uint64_t key = 0; key < 1000; ++key) seen.insert(a.fork(key).next_u64());
  for (std::uint64_t key = 0; key < 1000; ++key) seen.insert(a.fork(0).fork(key).next_u64());
  CHECK(seen.size() == 2000);
}

TEST_CASE("rng: moments") {
  constexpr int kDraws = 20'000;
  Rng rng(11);
  double sum = 0, squares = 0, fourth = 0, low = 1, high = 0, uniform_sum = 0;
  int hits = 0;
  std::vector<int> counts(7);
  for (int i = 0; i < kDraws; ++i) {
    const double x = rng.normal(), u = rng.uniform();
    sum += x;
    squares += x * x;
    fourth += x * x * x * x;
    low = std::min(low, u);
    high = std::max(high, u);
    uniform_sum += u;
    hits += rng.chance(0.3) ? 1 : 0;
    ++counts[static_cast<std::size_t>(rng.below(7))];
  }
  // Five standard errors each: the seed is fixed, the bounds are those of a correct generator.
  CHECK(std::abs(sum / kDraws) < 5 / std::sqrt(kDraws));
  CHECK(std::abs(squares / kDraws - 1) < 5 * std::sqrt(2.0 / kDraws));
  CHECK(std::abs(fourth / kDraws - 3) < 5 * std::sqrt(96.0 / kDraws));
  CHECK(std::abs(uniform_sum / kDraws - 0.5) < 5 * std::sqrt(1.0 / 12 / kDraws));
  CHECK(low >= 0);
  CHECK(low < 1e-3);
  CHECK(high < 1);
  CHECK(high > 1 - 1e-3);
  CHECK(std::abs(hits - 0.3 * kDraws) < 5 * std::sqrt(0.21 * kDraws));
  for (const int c : counts) CHECK(std::abs(c - kDraws / 7.0) < 5 * std::sqrt(kDraws * 6.0 / 49));
}

TEST_CASE("rng: names that have a stream of their own are hashed as published") {
  // the vectors of FNV's authors for 64 bits, and one by the definition: a byte is never negative
  CHECK(fnv1a("") == 0xcbf29ce484222325U);
  CHECK(fnv1a("a") == 0xaf63dc4c8601ec8cU);
  CHECK(fnv1a("foobar") == 0x85944171f73967e8U);
  CHECK(fnv1a("\xff") == 0xaf64724c8602eb6eU);
}

TEST_CASE("rng: tensors are filled in order, uniform draws keep to their interval") {
  Rng a(5), b(5);
  const auto t = normal_tensor<double>({3, 2}, a);
  for (Index i = 0; i < 6; ++i) CHECK(t[i] == b.normal());
  const auto f = uniform_tensor<float>({1000}, a, -2, 3);
  const auto [low, high] = std::ranges::minmax(f.values());
  CHECK(low >= -2);
  CHECK(low < -1.95F);
  CHECK(high < 3);
  CHECK(high > 2.95F);
  // a draw of 1 - 4.5e-9, which is 1 as a float
  for (const double end : {1.0, 3.0}) {
    Rng near(0);
    near.set_counter(38'471'471);
    CHECK(uniform_tensor<float>({1}, near, -end, end)[0] ==
          std::nextafter(static_cast<float>(end), 0.F));
  }
  CHECK_THROWS_WITH_AS(a.below(0), "Rng::below: n = 0, expected at least 1", Error);
}
