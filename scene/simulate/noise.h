// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <cstdint>

namespace satsurf::scene::simulate {

/// Hash of a lattice point: well mixed bits that depend on nothing but the arguments.
/// Source: the 32-bit finaliser of MurmurHash3 (Appleby), over odd multiples of the coordinates.
inline std::uint32_t hash(std::int32_t x, std::int32_t y, std::uint32_t seed) {
  std::uint32_t h = static_cast<std::uint32_t>(x) * 0x8DA6B343u ^
                    static_cast<std::uint32_t>(y) * 0xD8163841u ^ seed * 0xCB1AB31Fu;
  h = (h ^ (h >> 16)) * 0x85EBCA6Bu;
  h = (h ^ (h >> 13)) * 0xC2B2AE35u;
  return h ^ (h >> 16);
}

/// The upper 24 bits as a number in [0, 1).
inline float unit(std::uint32_t h) { return static_cast<float>(h >> 8) * 0x1p-24f; }

/// The sum of the four bytes, centred and scaled: nearly normal, mean 0, variance 1, within +-3.5.
inline float bell(std::uint32_t h) {
  const auto sum =
      static_cast<int>((h & 255u) + ((h >> 8) & 255u) + ((h >> 16) & 255u) + (h >> 24));
  return (static_cast<float>(sum) - 510.0f) * (1.0f / 147.8f);
}

/// Octaves of noise, from coarse to fine.
struct Fractal {
  double period = 64;  ///< of the first octave, m; each further one has half of it
  int octaves = 4;
  float gain = 0.5f;  ///< amplitude of an octave over that of the one before
  std::uint32_t seed = 0;
};

/// Fractal value noise: mean 0, roughly within [-1, 1]. Periods below two steps are left out.
/// step     of the grid, m
/// returns  [H W]
Tensor fractal_noise(Index H, Index W, double step, const Fractal& fractal);

}  // namespace satsurf::scene::simulate
