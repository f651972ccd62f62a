// SPDX-License-Identifier: Apache-2.0
#include "satsurf/splat/rasterize_kernels.h"

#include "satsurf/core/simd.h"
namespace satsurf::SATSURF_KERNEL_ISA {
namespace {

using splat::Box;
using splat::kTile;
using splat::Scene;
using splat::TileJob;

// A vector holds a block of pixels as square as it can be: the squarer, the fewer blocks a surfel
// meets.
template <class T>
inline constexpr Index kBlockWidth = kLanes<T> < 4 ? kLanes<T> : 4;
template <class T>
inline constexpr Index kBlockHeight = kLanes<T> / kBlockWidth<T>;
template <class T>
inline constexpr Index kBlockColumns = kTile / kBlockWidth<T>;
template <class T>
inline constexpr Index kBlocks = kTile * kTile / kLanes<T>;
/// Numbers of one plane of tile state, block after block.
inline constexpr Index kPlane = kTile * kTile;

/// Place of the tile's pixel (x, y) in a plane.
template <class T>
inline Index in_plane(Index x, Index y) {
  return ((y / kBlockHeight<T>)*kBlockColumns<T> + x / kBlockWidth<T>)*kLanes<T> +
         (y % kBlockHeight<T>)*kBlockWidth<T> + x % kBlockWidth<T>;
}

template <class T>
inline Batch<T> load(const T* plane, Index block) {
  return Batch<T>::load_aligned(plane + block * kLanes<T>);
}
template <class T>
inline void store(const Batch<T>& x, T* plane, Index block) {
  x.store_aligned(plane + block * kLanes<T>);
}

/// Pixel coordinates of a block's lanes relative to the block's first pixel.
template <class T>
struct LaneOffsets {
  Batch<T> x, y;
  LaneOffsets() {
    alignas(64) T column[kLanes<T>], row[kLanes<T>];
    for (Index l = 0; l < kLanes<T>; ++l) {
      column[l] = static_cast<T>(l % kBlockWidth<T>);
      row[l] = static_cast<T>(l / kBlockWidth<T>);
    }
    x = Batch<T>::load_aligned(column);
    y = Batch<T>::load_aligned(row);
  }
};

/// The cutoffs, or values at which they never act.
template <class T>
struct Cutoffs {
  T alpha_min, alpha_max, transmittance_min, exponent_min;
  explicit Cutoffs(bool smooth)
      : alpha_min(smooth ? T(0) : static_cast<T>(splat::kAlphaMin)),
        alpha_max(smooth ? T(2) : static_cast<T>(splat::kAlphaMax)),
        transmittance_min(smooth ? T(0) : static_cast<T>(splat::kTransmittanceMin)),
        exponent_min(smooth ? T(-1e30) : T(-5.55)) {}  // exp(-5.55) is just below 1/255
};

/// A surfel in a block of pixels. Products are fused by hand, not by the compiler's choice, so that
/// the backward pass meets exactly the numbers of the forward pass.
template <class T>
struct Footprint {
  using B = Batch<T>;
  B dx, dy;  // pixel - centre
  B u, v;    // the same on the disc, in standard deviations
  typename B::batch_bool_type
      on_disc;  // the disc itself is seen, not the pixel filter around its centre
  B exponent;   // ln(opacity) - rho / 2

  Footprint(const T* record, const B& x, const B& y)
      : dx(x - B(record[splat::kPixelX])),
        dy(y - B(record[splat::kPixelY])),
        u(xsimd::fma(B(record[splat::kInverse]), dx, B(record[splat::kInverse + 1]) * dy)),
        v(xsimd::fma(B(record[splat::kInverse + 2]), dx, B(record[splat::kInverse + 3]) * dy)) {
    const B disc = xsimd::fma(u, u, v * v), near = xsimd::fma(dx, dx, dy * dy);
    const B filter = near + near;
    on_disc = disc <= filter;
    exponent =
        xsimd::fma(B(T(-0.5)), xsimd::select(on_disc, disc, filter), B(record[splat::kLogOpacity]));
  }
  B height(const T* record) const {
    const B z(record[splat::kHeight]);
    const B on_plane =
        xsimd::fma(u, B(record[splat::kSlope]), xsimd::fma(v, B(record[splat::kSlope + 1]), z));
    return xsimd::select(on_disc, on_plane, z);
  }
};

/// What a surfel does to the transmittance of a block's pixels; a finished pixel's is not positive.
template <class T>
struct Blend {
  using B = Batch<T>;
  B raw, alpha, next, weight;
  typename B::batch_bool_type takes, stops;

  Blend(const B& exponent, const B& transmittance, const Cutoffs<T>& cut) {
    raw = xsimd::exp(exponent);
    alpha = xsimd::min(raw, B(cut.alpha_max));
    next = xsimd::fnma(alpha, transmittance, transmittance);
    const auto contributes = (alpha >= B(cut.alpha_min)) & (transmittance > B(T(0)));
    takes = contributes & (next >= B(cut.transmittance_min));
    stops = contributes & (next < B(cut.transmittance_min));
    weight = xsimd::select(takes, alpha * transmittance, B(T(0)));
  }
};

/// A tile's surfels lie all over memory: they are fetched this many earlier.
inline constexpr Index kAhead = 16;

/// Columns x0..x1 and rows y0..y1, both included, of the tile's blocks that a box meets.
struct BlockSpan {
  Index x0, y0, x1, y1;
};
template <class T>
inline BlockSpan blocks_of(const Box& box, const TileJob& tile) {
  const Index x0 = box.x0 - tile.x0, y0 = box.y0 - tile.y0, x1 = box.x1 - tile.x0,
              y1 = box.y1 - tile.y0;
  return {(x0 < 0 ? 0 : x0) / kBlockWidth<T>, (y0 < 0 ? 0 : y0) / kBlockHeight<T>,
          (x1 < kTile ? x1 : kTile - 1) / kBlockWidth<T>,
          (y1 < kTile ? y1 : kTile - 1) / kBlockHeight<T>};
}

/// Calls copy(plane offset, map offset, n) for each run of pixels that lie side by side in a plane
/// and in a [H W] map, as far as they are inside the image.
template <class T, class Copy>
inline void for_runs(const Scene<T>& scene, const TileJob& tile, const Copy& copy) {
  constexpr Index kRun = kBlockWidth<T>;
  const Index rows = scene.height - tile.y0, columns = scene.width - tile.x0;
  for (Index y = 0; y < (rows < kTile ? rows : kTile); ++y)
    for (Index x = 0; x < kTile; x += kRun) {
      const Index at = (tile.y0 + y) * scene.width + tile.x0 + x, n = columns - x;
      if (n >= kRun)
        copy(in_plane<T>(x, y), at, kRun);  // a constant: unrolled
      else if (n > 0)
        copy(in_plane<T>(x, y), at, n);
    }
}

/// Copies a tile's part of a map into a plane; pixels outside the image become zero.
template <class T>
void read_plane(const T* map, const Scene<T>& scene, const TileJob& tile, T* plane) {
  if (tile.x0 + kTile > scene.width || tile.y0 + kTile > scene.height)
    for (Index i = 0; i < kPlane; ++i) plane[i] = T(0);
  for_runs(scene, tile, [&](Index to, Index from, Index n) {
    for (Index i = 0; i < n; ++i) plane[to + i] = map[from + i];
  });
}
template <class T>
void write_plane(const T* plane, const Scene<T>& scene, const TileJob& tile, T* map) {
  for_runs(scene, tile, [&](Index from, Index to, Index n) {
    for (Index i = 0; i < n; ++i) map[to + i] = plane[from + i];
  });
}
/// One inside the image, zero outside.
template <class T>
void transmittance_plane(const Scene<T>& scene, const TileJob& tile, T* plane) {
  for (Index i = 0; i < kPlane; ++i) plane[i] = T(0);
  for_runs(scene, tile, [&](Index to, Index, Index n) {
    for (Index i = 0; i < n; ++i) plane[to + i] = T(1);
  });
}

// ---- forward ------------------------------------------------------------------------------------

/// Surfels copied next to each other: they stay in the first-level cache.
inline constexpr Index kChunk = 128;

/// Planes of the forward state: the maps in their order, then these two, then the auxiliary maps.
enum ForwardPlane : Index { kTransmittance = splat::kMaps, kMedian, kAuxPlane };
static_assert(kAuxPlane == splat::kForwardPlanes);

/// Blends the surfels `list` of a chunk, front to back, into one block.
template <class T>
void blend_block(const Scene<T>& scene, const T* records, const std::int32_t* surfels,
                 const std::uint8_t* list, Index count, const Batch<T>& x, const Batch<T>& y,
                 const Cutoffs<T>& cut, Index block, T* planes) {
  using B = Batch<T>;
  const auto plane = [&](Index p) { return planes + p * kPlane; };
  B transmittance = load(plane(kTransmittance), block);
  if (!xsimd::any(transmittance > B(T(0)))) return;
  B sum[splat::kMaps], median = load(plane(kMedian), block);
  for (Index m = 0; m < splat::kMaps; ++m) sum[m] = load(plane(m), block);

  for (Index i = 0; i < count; ++i) {
    const T* record = records + list[i] * splat::kRecord;
    const Footprint<T> foot(record, x, y);
    if (!xsimd::any(foot.exponent > B(cut.exponent_min))) continue;
    const Blend<T> blend(foot.exponent, transmittance, cut);
    const B height = foot.height(record), half(T(0.5));
    for (Index c = 0; c < 3; ++c) {
      sum[splat::kMapColour + c] =
          xsimd::fma(blend.weight, B(record[splat::kColour + c]), sum[splat::kMapColour + c]);
      sum[splat::kMapNormal + c] =
          xsimd::fma(blend.weight, B(record[splat::kNormal + c]), sum[splat::kMapNormal + c]);
    }
    sum[splat::kMapHeight] = xsimd::fma(blend.weight, height, sum[splat::kMapHeight]);
    sum[splat::kMapAlpha] += blend.weight;
    for (Index k = 0; k < scene.aux_channels; ++k) {
      const B a(scene.aux[surfels[list[i]] * scene.aux_channels + k]);
      T* p = plane(kAuxPlane + k);
      store(xsimd::fma(blend.weight, a, load(p, block)), p, block);
    }
    median =
        xsimd::select(blend.takes & (transmittance > half) & (blend.next <= half), height, median);
    // A finished pixel keeps its transmittance with the sign turned.
    transmittance = xsimd::select(blend.takes, blend.next,
                                  xsimd::select(blend.stops, -transmittance, transmittance));
    if (!xsimd::any(transmittance > B(T(0)))) break;
  }
  store(transmittance, plane(kTransmittance), block);
  store(median, plane(kMedian), block);
  for (Index m = 0; m < splat::kMaps; ++m) store(sum[m], plane(m), block);
}

template <class T>
void forward(const Scene<T>& scene, const TileJob& tile, T* planes, T* maps, T* median) {
  using B = Batch<T>;
  const auto plane = [&](Index p) { return planes + p * kPlane; };
  const Index K = scene.aux_channels;
  for (Index i = 0; i < (splat::kForwardPlanes + K) * kPlane; ++i) planes[i] = T(0);
  for (Index i = 0; i < kPlane; ++i) plane(kMedian)[i] = static_cast<T>(__builtin_nanf(""));
  transmittance_plane(scene, tile, plane(kTransmittance));

  const Cutoffs<T> cut(scene.smooth);
  const LaneOffsets<T> offsets;
  alignas(64) T records[kChunk * splat::kRecord];
  std::uint8_t lists[kBlocks<T>][kChunk];
  Index counts[kBlocks<T>];
  for (Index begin = 0; begin < tile.count; begin += kChunk) {
    const Index n = tile.count - begin < kChunk ? tile.count - begin : kChunk;
    const std::int32_t* surfels = tile.surfels + begin;
    for (Index& c : counts) c = 0;
    for (Index i = 0; i < n; ++i) {
      if (begin + i + kAhead < tile.count) {
        const Index next = surfels[i + kAhead];
        __builtin_prefetch(scene.records + next * splat::kRecord);
        __builtin_prefetch(scene.boxes + next);
      }
      const T* from = scene.records + surfels[i] * splat::kRecord;
      for (Index f = 0; f < splat::kRecord; ++f) records[i * splat::kRecord + f] = from[f];
      const BlockSpan span = blocks_of<T>(scene.boxes[surfels[i]], tile);
      for (Index by = span.y0; by <= span.y1; ++by)
        for (Index bx = span.x0; bx <= span.x1; ++bx) {
          const Index b = by * kBlockColumns<T> + bx;
          lists[b][counts[b]++] = static_cast<std::uint8_t>(i);
        }
    }
    for (Index b = 0; b < kBlocks<T>; ++b) {
      if (counts[b] == 0) continue;
      const B x = offsets.x + B(static_cast<T>(tile.x0 + b % kBlockColumns<T> * kBlockWidth<T>));
      const B y = offsets.y + B(static_cast<T>(tile.y0 + b / kBlockColumns<T> * kBlockHeight<T>));
      blend_block(scene, records, surfels, lists[b], counts[b], x, y, cut, b, planes);
    }
  }

  for (Index b = 0; b < kBlocks<T>; ++b) {
    const B behind = xsimd::abs(load(plane(kTransmittance), b));
    for (Index c = 0; c < 3; ++c) {
      T* p = plane(splat::kMapColour + c);
      store(xsimd::fma(behind, B(scene.background[c]), load(p, b)), p, b);
    }
    const B alpha = load(plane(splat::kMapAlpha), b);
    T* h = plane(splat::kMapHeight);
    store(load(h, b) / xsimd::max(alpha, B(static_cast<T>(splat::kOpacityFloor))), h, b);
  }
  const Index HW = scene.height * scene.width;
  for (Index m = 0; m < splat::kMaps; ++m) write_plane(plane(m), scene, tile, maps + m * HW);
  for (Index k = 0; k < K; ++k)
    write_plane(plane(kAuxPlane + k), scene, tile, maps + (splat::kMaps + k) * HW);
  write_plane(plane(kMedian), scene, tile, median);
}

// ---- backward -----------------------------------------------------------------------------------

/// Planes of the backward state; then the upstream auxiliary maps, then K accumulators.
enum BackwardPlane : Index {
  kBackTransmittance,
  kBehind,  // what the surfels not yet visited and the background add to the objective
  kUpColour,
  kUpNormal = kUpColour + 3,
  kUpHeight = kUpNormal + 3,  // on the weighted sum of heights
  kReference,                 // expected height where it is a true mean, else 0
  kUpAlpha,
  kUpAux
};
static_assert(kUpAux == splat::kBackwardPlanes);

/// Loads the upstream gradients and the state before the first surfel.
template <class T>
void start_backward(const Scene<T>& scene, const TileJob& tile, const T* maps, const T* g,
                    T* planes) {
  using B = Batch<T>;
  const auto plane = [&](Index p) { return planes + p * kPlane; };
  const Index K = scene.aux_channels, HW = scene.height * scene.width;
  const auto upstream = [&](Index map, Index to) {
    read_plane(g + map * HW, scene, tile, plane(to));
  };
  transmittance_plane(scene, tile, plane(kBackTransmittance));
  for (Index c = 0; c < 3; ++c) {
    upstream(splat::kMapColour + c, kUpColour + c);
    upstream(splat::kMapNormal + c, kUpNormal + c);
  }
  upstream(splat::kMapHeight, kUpHeight);
  upstream(splat::kMapAlpha, kUpAlpha);
  for (Index k = 0; k < K; ++k) upstream(splat::kMaps + k, kUpAux + k);

  // The sum of weight times payload over all surfels, from the maps; K + kMaps reads of a spare
  // plane.
  T* value = plane(kReference);
  T* behind = plane(kBehind);
  for (Index i = 0; i < kPlane; ++i) behind[i] = T(0);
  const auto add = [&](Index map, Index up) {
    read_plane(maps + map * HW, scene, tile, value);
    for (Index b = 0; b < kBlocks<T>; ++b)
      store(xsimd::fma(load(plane(up), b), load(value, b), load(behind, b)), behind, b);
  };
  for (Index c = 0; c < 3; ++c) {
    add(splat::kMapColour + c, kUpColour + c);
    add(splat::kMapNormal + c, kUpNormal + c);
  }
  for (Index k = 0; k < K; ++k) add(splat::kMaps + k, kUpAux + k);
  add(splat::kMapAlpha, kUpAlpha);

  // height = sum(w h) / max(sum(w), floor): above the floor its derivative to a weight is
  // (h - height) / sum(w), which adds up to nothing over all surfels.
  alignas(64) T alpha[kPlane];
  read_plane(maps + splat::kMapAlpha * HW, scene, tile, alpha);
  read_plane(maps + splat::kMapHeight * HW, scene, tile, value);
  const B floor(static_cast<T>(splat::kOpacityFloor)), zero(T(0));
  for (Index b = 0; b < kBlocks<T>; ++b) {
    const B a = load(alpha, b), h = load(value, b), up = load(plane(kUpHeight), b);
    const auto mean = a > floor;
    store(load(behind, b) + xsimd::select(mean, zero, up * h), behind, b);
    store(xsimd::select(mean, h, zero), plane(kReference), b);
    store(up / xsimd::select(mean, a, floor), plane(kUpHeight), b);
  }
}

/// Lane l of the result is the sum of the lanes of rows[l * Stride], l < N, repeated for N <
/// kLanes.
template <class T, Index N, Index Stride = 1>
inline Batch<T> transpose_sum(const Batch<T>* rows) {
  if constexpr (N == 1) {
    return rows[0];
  } else {
    const Batch<T> even = transpose_sum<T, N / 2, 2 * Stride>(rows);
    const Batch<T> odd = transpose_sum<T, N / 2, 2 * Stride>(rows + Stride);
    return interleave_low(even, odd) + interleave_high(even, odd);
  }
}

/// Adds what one block contributes to a surfel's slot and moves the block's state behind the
/// surfel.
template <class T>
inline void back_block(const Scene<T>& scene, const T* record, const T* aux, const Batch<T>& x,
                       const Batch<T>& y, const Cutoffs<T>& cut, Index block, T* planes,
                       Batch<T>* slot) {
  using B = Batch<T>;
  const auto plane = [&](Index p) { return planes + p * kPlane; };
  const Footprint<T> foot(record, x, y);
  const B transmittance = load(plane(kBackTransmittance), block), zero(T(0));
  const auto open = (foot.exponent > B(cut.exponent_min)) & (transmittance > zero);
  if (!xsimd::any(open)) return;
  const Blend<T> blend(foot.exponent, transmittance, cut);
  store(xsimd::select(blend.takes, blend.next, xsimd::select(blend.stops, zero, transmittance)),
        plane(kBackTransmittance), block);

  const B w = blend.weight, up_height = load(plane(kUpHeight), block);
  B payload = xsimd::fma(up_height, foot.height(record) - load(plane(kReference), block),
                         load(plane(kUpAlpha), block));
  for (Index c = 0; c < 3; ++c) {
    const B colour = load(plane(kUpColour + c), block), normal = load(plane(kUpNormal + c), block);
    payload = xsimd::fma(colour, B(record[splat::kColour + c]), payload);
    payload = xsimd::fma(normal, B(record[splat::kNormal + c]), payload);
    slot[splat::kSlotColour + c] = xsimd::fma(w, colour, slot[splat::kSlotColour + c]);
    slot[splat::kSlotNormal + c] = xsimd::fma(w, normal, slot[splat::kSlotNormal + c]);
  }
  for (Index k = 0; k < scene.aux_channels; ++k) {
    const B up = load(plane(kUpAux + k), block);
    T* sum = plane(kUpAux + scene.aux_channels + k);  // one vector
    payload = xsimd::fma(up, B(aux[k]), payload);
    store(xsimd::fma(w, up, load(sum, 0)), sum, 0);
  }
  const B behind = xsimd::fnma(w, payload, load(plane(kBehind), block));
  store(behind, plane(kBehind), block);

  // d/d(rho) = -alpha/2 d/d(alpha), nothing where alpha is saturated
  const B dalpha = transmittance * payload - behind / (B(T(1)) - blend.alpha);
  const auto moves = blend.takes & (blend.raw <= B(cut.alpha_max));
  const B drho = xsimd::select(moves, B(T(-0.5)) * blend.alpha * dalpha, zero);
  const B on_disc = xsimd::select(foot.on_disc, drho, zero), off_disc = drho - on_disc;
  const B dheight = w * up_height, slope = xsimd::select(foot.on_disc, dheight, zero);
  const B u = on_disc * foot.u, v = on_disc * foot.v;
  const B du = xsimd::fma(slope, B(record[splat::kSlope]), u + u);
  const B dv = xsimd::fma(slope, B(record[splat::kSlope + 1]), v + v);
  const B four_off = B(T(-4)) * off_disc;
  const auto add = [&](Index field, const B& value) { slot[field] += value; };
  const auto fused = [&](Index field, const B& a, const B& b) {
    slot[field] = xsimd::fma(a, b, slot[field]);
  };
  add(splat::kSlotRho, drho);
  add(splat::kSlotHeight, dheight);
  fused(splat::kSlotMoment, u, foot.u);
  fused(splat::kSlotMoment + 1, u, foot.v);
  fused(splat::kSlotMoment + 2, v, foot.v);
  fused(splat::kSlotSlope, slope, foot.u);
  fused(splat::kSlotSlope + 1, slope, foot.v);
  const B k00(record[splat::kInverse]), k01(record[splat::kInverse + 1]);
  const B k10(record[splat::kInverse + 2]), k11(record[splat::kInverse + 3]);
  add(splat::kSlotPixel, xsimd::fnma(k00, du, xsimd::fnma(k10, dv, four_off * foot.dx)));
  add(splat::kSlotPixel + 1, xsimd::fnma(k01, du, xsimd::fnma(k11, dv, four_off * foot.dy)));
}

template <class T>
void backward(const Scene<T>& scene, const TileJob& tile, const T* maps, const T* g,
              const Index* first_slot, T* planes, T* slots) {
  using B = Batch<T>;
  const Index K = scene.aux_channels, stride = splat::kSlot + K;
  T* aux_sums = planes + (kUpAux + K) * kPlane;
  start_backward(scene, tile, maps, g, planes);
  const Cutoffs<T> cut(scene.smooth);
  const LaneOffsets<T> offsets;
  const B zero(T(0));
  for (Index i = 0; i < tile.count; ++i) {
    if (i + kAhead < tile.count) {
      const Index next = tile.surfels[i + kAhead];
      __builtin_prefetch(scene.records + next * splat::kRecord);
      __builtin_prefetch(scene.boxes + next);
      __builtin_prefetch(first_slot + next);
    }
    const Index p = tile.surfels[i];
    const Box& box = scene.boxes[p];
    const Index left = box.x0 / kTile, columns = box.x1 / kTile - left + 1;
    T* out = slots + stride * (first_slot[p] + (tile.y0 / kTile - box.y0 / kTile) * columns +
                               tile.x0 / kTile - left);
    const T* record = scene.records + p * splat::kRecord;
    const BlockSpan span = blocks_of<T>(box, tile);
    B slot[splat::kSlot];
    for (B& s : slot) s = zero;
    for (Index k = 0; k < K; ++k) store(zero, aux_sums + k * kPlane, 0);
    for (Index by = span.y0; by <= span.y1; ++by)
      for (Index bx = span.x0; bx <= span.x1; ++bx) {
        const B x = offsets.x + B(static_cast<T>(tile.x0 + bx * kBlockWidth<T>));
        const B y = offsets.y + B(static_cast<T>(tile.y0 + by * kBlockHeight<T>));
        back_block(scene, record, scene.aux + p * K, x, y, cut, by * kBlockColumns<T> + bx, planes,
                   slot);
      }
    for (Index f = 0; f < splat::kSlot; f += kLanes<T>)
      transpose_sum<T, kLanes<T>>(slot + f).store_unaligned(out + f);
    for (Index k = 0; k < K; ++k) {
      T sum = T(0);
      for (Index l = 0; l < kLanes<T>; ++l) sum += aux_sums[k * kPlane + l];
      out[splat::kSlot + k] = sum;
    }
  }
}

}  // namespace
}  // namespace satsurf::SATSURF_KERNEL_ISA

namespace satsurf::splat {

template <class T>
template <Isa isa>
TileKernels<T> TileKernels<T>::compiled_for() {
  return {.forward = here::forward<T>, .backward = here::backward<T>};
}
template TileKernels<float> TileKernels<float>::compiled_for<kIsa>();
template TileKernels<double> TileKernels<double>::compiled_for<kIsa>();

}  // namespace satsurf::splat
