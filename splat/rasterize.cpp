// SPDX-License-Identifier: Apache-2.0
#include "satsurf/splat/rasterize.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"
#include "satsurf/splat/bin.h"
#include "satsurf/splat/rasterize_kernels.h"
#include "satsurf/splat/surfel_kernels.h"

#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace satsurf::splat {
namespace {

constexpr Index kSurfelGrain = 2048;  // surfels per piece of the passes over surfels

/// What the backward pass needs besides inputs and output.
template <class T>
struct Saved {
  BasicTensor<T> records, aux, jacobians, pixels;
  std::vector<Box> boxes;
  TileLists tiles;
  Scene<T> scene;

  TileJob job(Index tile) const {
    return {tile % tiles.columns * kTile, tile / tiles.columns * kTile,
            tiles.surfels.data() + tiles.first[tile], tiles.count(tile)};
  }
};

template <class T>
void check(const BasicSurfels<T>& s, const BasicProjection<T>& projection,
           const RasterOptions& options) {
  const std::pair<const char*, const BasicVar<T>*> needed[] = {{"means", &s.means},
                                                               {"quats", &s.quats},
                                                               {"scales", &s.scales},
                                                               {"opacity", &s.opacity},
                                                               {"colours", &s.colours}};
  for (const auto& [name, value] : needed)
    if (value->empty())
      throw ShapeError(std::string("rasterize: ") + name + " is missing, expected all but aux");
  Dims dim("rasterize");
  dim.match("means", s.means, "P 3")
      .match("quats", s.quats, "P 4")
      .match("scales", s.scales, "P 2")
      .match("opacity", s.opacity, "P")
      .match("colours", s.colours, "P 3")
      .match("pixels", projection.pixels, "P 2")
      .match("jacobians", projection.jacobians, "P 2 3");
  if (!s.aux.empty()) dim.match("aux", s.aux, "P K");
  if (dim["P"] > std::numeric_limits<std::int32_t>::max())
    throw ShapeError("rasterize: " + std::to_string(dim["P"]) +
                     " surfels, expected fewer than 2^31");
  // Pixel coordinates must be exact in float, with room for the pixels between them.
  constexpr Index kSide = Index{1} << 20;
  if (options.height < 1 || options.width < 1 || options.height > kSide || options.width > kSide)
    throw ShapeError("rasterize: image of " + std::to_string(options.height) + " x " +
                     std::to_string(options.width) + " pixels, expected 1 to " +
                     std::to_string(kSide) + " each way");
}

/// first[p]..first[p+1]-1 are the slots of surfel p, one per tile of its box.
std::vector<Index> slots_of(const std::vector<Box>& boxes) {
  std::vector<Index> first(boxes.size() + 1);
  for (std::size_t p = 0; p < boxes.size(); ++p)
    first[p + 1] = first[p] + tiles_of(boxes[p]).count();
  return first;
}

template <class T>
void backward(const Saved<T>& saved, Node<T>& n) {
  const Index K = saved.scene.aux_channels, P = std::ssize(saved.boxes);
  const std::vector<Index> first_slot = slots_of(saved.boxes);
  auto slots = BasicTensor<T>::uninitialised({first_slot.back(), kSlot + K});
  const T* g = n.grad.data();
  for_each_index(saved.tiles.rows * saved.tiles.columns, [&](Index tile) {
    if (saved.tiles.count(tile) == 0) return;
    auto scratch = BasicTensor<T>::uninitialised({kBackwardPlanes + 2 * K, kTile, kTile});
    active_kernels<TileKernels<T>>().backward(saved.scene, saved.job(tile), n.value.data(), g,
                                              first_slot.data(), scratch.data(), slots.data());
  });
  const SurfelArrays<T> in{n.in(0),
                           n.in(1),
                           n.in(2),
                           n.in(3),
                           n.in(4),
                           saved.aux.data(),
                           saved.pixels.data(),
                           saved.jacobians.data(),
                           K};
  const SurfelGradients<T> out{n.grad_in(0), n.grad_in(1), n.grad_in(2),
                               n.grad_in(3), n.grad_in(4), n.grad_in(5)};
  for_range(P, kSurfelGrain, [&](Index begin, Index end) {
    active_kernels<SurfelKernels<T>>().gather(in, first_slot.data(), slots.data(), begin, end, out);
  });
}

}  // namespace

template <class T>
BasicRender<T> rasterize(const BasicSurfels<T>& surfels, const BasicProjection<T>& projection,
                         const RasterOptions& options) {
  check(surfels, projection, options);
  const Index P = surfels.means.dim(0), K = surfels.aux.empty() ? 0 : surfels.aux.dim(1);
  const Index H = options.height, W = options.width;

  const auto saved = std::make_shared<Saved<T>>();
  saved->records = BasicTensor<T>::uninitialised({P, kRecord});
  saved->boxes.resize(P);
  saved->jacobians = projection.jacobians;
  saved->pixels = projection.pixels;
  if (K > 0) saved->aux = surfels.aux.value();
  saved->scene = {saved->records.data(),
                  saved->boxes.data(),
                  saved->aux.data(),
                  K,
                  H,
                  W,
                  {static_cast<T>(options.background[0]), static_cast<T>(options.background[1]),
                   static_cast<T>(options.background[2])},
                  options.smooth_cutoffs};
  const SurfelArrays<T> in{
      surfels.means.value().data(),   surfels.quats.value().data(),   surfels.scales.value().data(),
      surfels.opacity.value().data(), surfels.colours.value().data(), saved->aux.data(),
      saved->pixels.data(),           saved->jacobians.data(),        K};
  for_range(P, kSurfelGrain, [&](Index begin, Index end) {
    active_kernels<SurfelKernels<T>>().prepare(in, H, W, options.smooth_cutoffs, begin, end,
                                               saved->records.data(), saved->boxes.data());
  });
  saved->tiles = bin(saved->boxes,
                     front_to_back(saved->boxes, saved->records.data() + kHeight, kRecord), H, W);

  auto maps = BasicTensor<T>::uninitialised({kMaps + K, H, W});
  BasicRender<T> out;
  out.median_height = BasicTensor<T>::uninitialised({H, W});
  for_each_index(saved->tiles.rows * saved->tiles.columns, [&](Index tile) {
    auto scratch = BasicTensor<T>::uninitialised({kForwardPlanes + K, kTile, kTile});
    active_kernels<TileKernels<T>>().forward(saved->scene, saved->job(tile), scratch.data(),
                                             maps.data(), out.median_height.data());
  });

  const auto packed = BasicVar<T>::record(
      "rasterize", std::move(maps),
      {surfels.means, surfels.quats, surfels.scales, surfels.opacity, surfels.colours, surfels.aux},
      [saved](Node<T>& n) { backward(*saved, n); });
  out.colour = slice(packed, 0, kMapColour, kMapColour + 3);
  out.height = reshape(slice(packed, 0, kMapHeight, kMapHeight + 1), {H, W});
  out.alpha = reshape(slice(packed, 0, kMapAlpha, kMapAlpha + 1), {H, W});
  out.normal = slice(packed, 0, kMapNormal, kMapNormal + 3);
  if (!surfels.aux.empty()) out.aux = slice(packed, 0, kMaps, kMaps + K);
  return out;
}

template BasicRender<float> rasterize(const BasicSurfels<float>&, const BasicProjection<float>&,
                                      const RasterOptions&);
template BasicRender<double> rasterize(const BasicSurfels<double>&, const BasicProjection<double>&,
                                       const RasterOptions&);

}  // namespace satsurf::splat
