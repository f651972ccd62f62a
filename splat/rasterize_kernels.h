// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"
#include "satsurf/splat/bin.h"

#include <cstdint>

namespace satsurf::splat {

/// One surfel as the tiles see it: 16 numbers, one cache line in float.
enum RecordField : Index {
  kPixelX,  ///< centre, px
  kPixelY,
  /// 4 numbers, row-major: (pixel - centre) -> coordinates on the disc in standard deviations.
  kInverse,
  kLogOpacity = kInverse + 4,
  kHeight,  ///< of the centre, m
  kSlope,   ///< 2 numbers: height gained per standard deviation along t_u and t_v, m
  kColour = kSlope + 2,
  kNormal = kColour + 3,  ///< towards the camera
  kRecord = kNormal + 3
};

/// Channels of the packed output, [kMaps + K][H][W].
enum Map : Index { kMapColour, kMapHeight = 3, kMapAlpha, kMapNormal, kMaps = kMapNormal + 3 };

/// Gradient of one surfel gathered over the pixels of one tile; the auxiliary channels follow.
enum SlotField : Index {
  kSlotRho,    ///< sum of d/d(rho), for the opacity
  kSlotPixel,  ///< 2 numbers: d/d(centre), px
  /// uu, uv, vv of sum d/d(rho) xi xi^T where the disc itself is seen.
  kSlotMoment = kSlotPixel + 2,
  kSlotHeight = kSlotMoment + 3,
  kSlotSlope,  ///< 2 numbers: sum d/d(height) xi
  kSlotColour = kSlotSlope + 2,
  kSlotNormal = kSlotColour + 3,
  kSlotSpare = kSlotNormal + 3,  ///< always zero: whole vectors are stored
  kSlot
};

/// Below this opacity a surfel leaves no trace in a pixel.
inline constexpr double kAlphaMin = 1.0 / 255;
/// Above it alpha saturates, so that transmittance never reaches zero.
inline constexpr double kAlphaMax = 0.99;
/// A pixel is finished before its transmittance falls below this.
inline constexpr double kTransmittanceMin = 1e-4;
/// Expected heights divide by at least this much opacity.
inline constexpr double kOpacityFloor = 1e-6;

/// What all tiles of one image share.
template <class T>
struct Scene {
  const T* records;    ///< [P kRecord]
  const Box* boxes;    ///< [P]
  const T* aux;        ///< [P K]
  Index aux_channels;  ///< K
  Index height, width;
  T background[3];
  bool smooth;  ///< RasterOptions::smooth_cutoffs
};
/// One tile: its first pixel and its surfels, front to back.
struct TileJob {
  Index x0, y0;
  const std::int32_t* surfels;
  Index count;
};

/// Planes of kTile^2 numbers of 64-byte aligned scratch that the tile kernels need besides one per
/// auxiliary channel (the backward pass: two per channel).
inline constexpr Index kForwardPlanes = 10, kBackwardPlanes = 11;

/// The passes over the pixels of one tile, for one instruction set.
template <class T>
struct TileKernels {
  /// Fills the tile's part of maps [kMaps+K H W] and median [H W].
  void (*forward)(const Scene<T>& scene, const TileJob& tile, T* scratch, T* maps, T* median);
  /// Fills the slot of every entry of the tile, kSlot + K numbers each. The slot of a surfel in
  /// this tile is number first_slot[surfel] + rank of the tile within the surfel's box.
  void (*backward)(const Scene<T>& scene, const TileJob& tile, const T* maps, const T* g,
                   const Index* first_slot, T* scratch, T* slots);

  template <Isa isa>
  static TileKernels compiled_for();
};

}  // namespace satsurf::splat
