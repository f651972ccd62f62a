// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <cstdint>

namespace satsurf {

/// Counter-based random numbers: draw number n of stream (seed, stream) is a pure function of the
/// three, so it is the same on every library, for any number of threads, and can be saved as two
/// integers.
/// Source: Salmon et al. 2011, Philox4x32-10.
class Rng {
 public:
  explicit Rng(std::uint64_t seed, std::uint64_t stream = 0) : seed_(seed), stream_(stream) {}

  /// 64 random bits.
  std::uint64_t next_u64();
  /// In [0, 1), 53 bits.
  double uniform();
  /// In [low, high).
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  /// In [0, n).
  Index below(Index n);
  /// Standard normal, Box-Muller without a cached half: one call, two draws.
  double normal();
  /// True with the given probability.
  bool chance(double probability) { return uniform() < probability; }
  /// An independent generator, a pure function of this one's seed and stream and of `key`.
  Rng fork(std::uint64_t key) const;

  /// The number of the next draw: with seed and stream, the whole state.
  std::uint64_t counter() const { return counter_; }
  void set_counter(std::uint64_t counter) { counter_ = counter; }

 private:
  std::uint64_t seed_, stream_, counter_ = 0;
};

/// Elements are independent standard normals.
template <class T>
BasicTensor<T> normal_tensor(const Shape& shape, Rng& rng);
/// Elements are uniform in [low, high).
template <class T>
BasicTensor<T> uniform_tensor(const Shape& shape, Rng& rng, double low, double high);

}  // namespace satsurf
