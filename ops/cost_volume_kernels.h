// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"
#include "satsurf/core/shape.h"

#include <cstdint>

// The plane sweep of one reference row, for cost_volume.cpp alone. Features are held channels-last,
// so a bilinear sample of all channels is four contiguous loads. The channel stride Cs is C rounded
// up to 4, 8 or a multiple of 16; the channels in between are 0.

namespace satsurf {

/// Reference pixels worked on together: four cache lines of float.
inline constexpr Index kSweepTile = 64;

/// A quadratic map restricted to one reference row, in the normalised column a = x ax + a0 and the
/// normalised height t = (z - z0) tz:
///   u = (u[0] + a (u[1] + a u[2])) + t ((u[3] + a u[4]) + t u[5]), likewise v
struct SweepMap {
  double ax, a0, tz, z0;
  double u[6], v[6];
};

/// The map of each pixel of a tile:
///   u = u[0] + t (u[1] + t u2), likewise v
template <class T>
struct SweepLines {
  T u[2][kSweepTile], v[2][kSweepTile], u2, v2, tz, z0;
};

/// One source view's samples of a tile at one height hypothesis: upper left neighbour, nearest
/// pixel in the row-major map, bilinear weights (all 0 where the sample does not count) and 1 where it counts.
template <class T>
struct SweepTaps {
  std::int32_t x[kSweepTile], y[kSweepTile], nearest[kSweepTile];
  T weight[4][kSweepTile], counts[kSweepTile];
};

/// Numbers between the pixels' channels of the best pair in a tile; the last are not used.
inline constexpr Index kPairStride = 8;
/// Numbers in which the distance of a pixel to one source is summed, at most: the channels read
/// together; and in how many parts it is handed on.
inline constexpr Index kDistanceLanes = 16, kDistanceParts = 4;

/// One reference row: what is read, and scratch.
template <class T>
struct SweepRow {
  Index H, W, C, Cs, D, J;  ///< J source views, that is all but the reference
  const SweepMap* maps;     ///< [J]
  const T* const* sources;  ///< [J] -> [H W Cs]
  const T* const* valid;    ///< [J] -> [H W], or nullptr for everywhere
  const T* reference;       ///< [W Cs] the reference's row
  T reference_counts;       ///< 1, or 0 if the variance is over the source views alone
  const T* heights;         ///< row of [D H W]
  Index plane;              ///< numbers between the planes of what is written forward
  /// Row of [D H W]: the source that looks most like the reference, -1 for none; nullptr where the
  /// best pair is not asked for. Written forward, read backward.
  std::int8_t* best;
  // Scratch.
  SweepLines<T>* lines;  ///< [J]
  SweepTaps<T>* taps;    ///< [J]
  T* tile;               ///< [kSweepTile Cs]
  T* reference_tile;     ///< [kSweepTile Cs], backward only
  T* samples;            ///< [J Cs]
  T* pair_tile;          ///< [kSweepTile kPairStride], backward only
  T* sums;               ///< [J kDistanceLanes] of one pixel, forward only
  T* distances;          ///< [J kSweepTile kDistanceParts], forward only
};

/// The loops of cost_volume.cpp for one instruction set.
template <class T>
struct SweepKernels {
  /// Writes the row of `out`, C x D planes, or C + kPairChannels x D with the best pair; touched[2 j],
  /// touched[2 j + 1] become the first and last row of source j that was read (H and -1 if none),
  /// unless `touched` is nullptr.
  void (*forward)(const SweepRow<T>& s, T* out, std::int32_t* touched);
  /// Adds to the row of `d_reference` [C H W] and to `d_sources`[j], which hold the rows from
  /// first_row[j] on, channels-last; `g` is the row of the upstream gradient [C D H W].
  void (*backward)(const SweepRow<T>& s, const T* g, T* d_reference, T* const* d_sources,
                   const std::int32_t* first_row);
  /// [C W] with plane_stride between channels to [W Cs]; the channels from C on become 0.
  void (*to_pixels)(const T* planes, Index plane_stride, Index W, Index C, Index Cs, T* pixels);
  /// Adds the sum of `count` channels-last rows, in order, to [C W]; `tile` as in SweepRow.
  void (*add_rows)(const T* const* rows, Index count, Index W, Index C, Index Cs, T* planes,
                   Index plane_stride, T* tile);

  template <Isa isa>
  static SweepKernels compiled_for();
};

}  // namespace satsurf
