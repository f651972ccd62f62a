// SPDX-License-Identifier: Apache-2.0
#include "satsurf/mesh/tsdf.h"

#include "satsurf/core/error.h"
#include "satsurf/core/memory.h"
#include "satsurf/core/parallel.h"
#include "satsurf/mesh/sampled_view.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <limits>
#include <memory>
#include <string>

namespace satsurf::mesh {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr Index kTile = Tsdf::kTile;
// Layers kept above and below what a view sees: above for the gradient, below down to where its
// word ends.
constexpr int kAbove = 3, kBelow = 2;

/// Lowest and highest layer of every tile, raised by many threads: extremes do not depend on who
/// comes first.
class LayerRanges {
 public:
  explicit LayerRanges(Index tiles)
      : low_(std::make_unique<std::atomic<int>[]>(static_cast<std::size_t>(tiles))),
        high_(std::make_unique<std::atomic<int>[]>(static_cast<std::size_t>(tiles))) {
    for (std::size_t t = 0; t < static_cast<std::size_t>(tiles); ++t)
      low_[t] = std::numeric_limits<int>::max(), high_[t] = std::numeric_limits<int>::min();
  }
  void add(Index tile, int low, int high) {
    const auto t = static_cast<std::size_t>(tile);
    for (int seen = low_[t].load(std::memory_order_relaxed);
         low < seen && !low_[t].compare_exchange_weak(seen, low, std::memory_order_relaxed);) {
    }
    for (int seen = high_[t].load(std::memory_order_relaxed);
         high > seen && !high_[t].compare_exchange_weak(seen, high, std::memory_order_relaxed);) {
    }
  }
  int low(Index tile) const { return low_[static_cast<std::size_t>(tile)]; }
  int high(Index tile) const { return high_[static_cast<std::size_t>(tile)]; }

 private:
  std::unique_ptr<std::atomic<int>[]> low_, high_;
};

/// Notes in which layers of which tiles a view has its surface. Neighbouring pixels are joined,
/// for at the rim of a roof the surface follows the ray down to the ground.
void mark_layers(LayerRanges& ranges, const Tsdf& field, const SampledView& view) {
  const double voxel = field.voxel, side = voxel * kTile;
  const double x0 = (static_cast<double>(field.column) - 0.5) * voxel,
               y0 = (static_cast<double>(field.row) - 0.5) * voxel;
  const double margin = (field.truncation * view.reach() + 2) * voxel;
  const int below = static_cast<int>(std::ceil(field.truncation)) + kBelow;
  const auto tile_of = [&](double distance, Index count) {
    return std::clamp(static_cast<Index>(std::floor(distance / side)), Index{0}, count - 1);
  };
  // All tiles that a piece of surface, from one corner of a box to the other, comes near.
  const auto add = [&](const double* from, const double* to) {
    const int low = static_cast<int>(std::floor(std::min(from[2], to[2]) / voxel)) - below,
              high = static_cast<int>(std::ceil(std::max(from[2], to[2]) / voxel)) + kAbove;
    const Index i0 = tile_of(std::min(from[0], to[0]) - margin - x0, field.columns),
                i1 = tile_of(std::max(from[0], to[0]) + margin - x0, field.columns),
                j1 = tile_of(std::max(from[1], to[1]) + margin - y0, field.rows);
    for (Index j = tile_of(std::min(from[1], to[1]) - margin - y0, field.rows); j <= j1; ++j)
      for (Index i = i0; i <= i1; ++i) ranges.add(j * field.columns + i, low, high);
  };
  const Index H = view.height(), W = view.width();
  for_range(H, 16, [&](Index begin, Index end) {
    for (Index p = begin * W; p < end * W; ++p) {
      if (std::isnan(view.z(p))) continue;
      const auto point = [&](Index q) -> std::array<double, 3> {
        const auto xy = view.ground(q);
        return {static_cast<double>(xy[0]), static_cast<double>(xy[1]),
                static_cast<double>(view.z(q))};
      };
      const auto here = point(p);
      add(here.data(), here.data());
      const auto join = [&](Index q) {
        if (std::isnan(view.z(q))) return;
        const auto there = point(q);
        const double dx = std::abs(there[0] - here[0]), dy = std::abs(there[1] - here[1]),
                     dz = std::abs(there[2] - here[2]);
        if (std::max({dx, dy, dz}) <= voxel) return;  // within the margins
        const int steps = 1 + static_cast<int>(std::max(dx, dy) / side);
        auto from = here;
        for (int s = 1; s <= steps; ++s) {
          std::array<double, 3> to{};
          for (std::size_t a = 0; a < 3; ++a)
            to[a] = here[a] + (there[a] - here[a]) * static_cast<double>(s) / steps;
          add(from.data(), to.data());
          from = to;
        }
      };
      if (p % W + 1 < W) join(p + 1);
      if (p / W + 1 < H) join(p + W);
    }
  });
}

/// throws  Error if so many voxels do not fit into the memory
void check_voxels(double voxels) {
  constexpr double kBytes = 12;  // a voxel, with what the surface is found with
  char number[32];
  std::snprintf(number, sizeof number, "%.3g", voxels);
  check_memory("fuse: " + std::string(number) + " voxels need", kBytes * voxels,
               "give larger voxels");
}

/// Places the tiles over all that the views see.
/// throws  Error if they see nothing, or too much for the memory
void place_tiles(Tsdf& field, const std::vector<SampledView>& views) {
  double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY}, reach = 0;
  for (const SampledView& v : views) {
    reach = std::max(reach, v.reach());
    for (Index p = 0; p < v.height() * v.width(); ++p) {
      if (std::isnan(v.z(p))) continue;
      const auto at = v.ground(p);
      for (std::size_t a = 0; a < 2; ++a) {
        low[a] = std::min(low[a], static_cast<double>(at[a]));
        high[a] = std::max(high[a], static_cast<double>(at[a]));
      }
    }
  }
  if (!(low[0] <= high[0]))
    throw Error("fuse: no view has a height anywhere, expected views of a surface");
  // The least there will be: so many layers under every piece of ground of the widest view.
  const double layers = field.truncation + kAbove + kBelow;
  double area = 0;
  for (const SampledView& v : views) area = std::max(area, v.area());
  check_voxels(area / (field.voxel * field.voxel) * layers);
  const double margin = field.truncation * reach + 2;  // voxels
  // Of a tile its place and, while they are found, its lowest and highest layer.
  constexpr double kTileBytes = sizeof(Tsdf::Tile) + 2 * sizeof(int);
  const auto tiles = [&](std::size_t a) {
    return ((high[a] - low[a]) / field.voxel + 2 * margin) / kTile + 2;
  };
  char extent[120];
  std::snprintf(extent, sizeof extent, "fuse: %.0f x %.0f m in voxels of %g m need",
                high[0] - low[0], high[1] - low[1], field.voxel);
  check_memory(extent, kTileBytes * tiles(0) * tiles(1),
               "give larger voxels, or views of one place");
  const auto first = [&](double x) {
    return static_cast<Index>(std::floor((x / field.voxel - margin) / kTile)) * kTile;
  };
  const auto count = [&](double from, double to) {
    return (static_cast<Index>(std::ceil(to / field.voxel + margin)) - first(from)) / kTile + 1;
  };
  field.column = first(low[0]), field.row = first(low[1]);
  field.columns = count(low[0], high[0]), field.rows = count(low[1], high[1]);
}

/// Places the layers of the tiles in memory.
/// throws  Error if it does not suffice
void take_layers(Tsdf& field, const LayerRanges& ranges) {
  field.tiles.resize(static_cast<std::size_t>(field.columns * field.rows));
  std::size_t total = 0;
  for (std::size_t t = 0; t < field.tiles.size(); ++t) {
    const auto n = static_cast<Index>(t);
    const bool any = ranges.low(n) <= ranges.high(n);
    field.tiles[t] = {any ? ranges.low(n) : 0, any ? ranges.high(n) - ranges.low(n) + 1 : 0, total};
    total += static_cast<std::size_t>(field.tiles[t].layers * kTile * kTile);
  }
  check_voxels(static_cast<double>(total));
  field.values = Tensor::uninitialised({static_cast<Index>(total)});
}

/// The values of one tile. Columns are vertical, so along one a pixel is a quadratic of the layer.
void fuse_tile(Tsdf& field, Index index, const std::vector<SampledView>& sampled,
               std::span<const HeightImage> views) {
  const Tsdf::Tile& tile = field.tiles[static_cast<std::size_t>(index)];
  const Index L = tile.layers;
  if (L == 0) return;
  const double voxel = field.voxel;
  const auto x_of = [&](Index c) {
    return static_cast<double>(field.column + index % field.columns * kTile + c) * voxel;
  };
  const auto y_of = [&](Index r) {
    return static_cast<double>(field.row + index / field.columns * kTile + r) * voxel;
  };
  const double bottom = static_cast<double>(tile.bottom) * voxel,
               middle = bottom + 0.5 * static_cast<double>(L) * voxel;
  std::vector<double> slants;
  for (const SampledView& v : sampled)
    slants.push_back(v.slant(x_of(kTile / 2), y_of(kTile / 2), middle));

  const auto N = static_cast<std::size_t>(L);
  std::vector<double> sum(N), weight(N);
  for (Index column = 0; column < kTile * kTile; ++column) {
    const double x = x_of(column % kTile), y = y_of(column / kTile);
    std::fill(sum.begin(), sum.end(), 0.0);
    std::fill(weight.begin(), weight.end(), 0.0);
    for (std::size_t i = 0; i < sampled.size(); ++i) {
      const double half = 0.5 * static_cast<double>(L) * voxel;
      const auto a = views[i].pixel_from_local(x, y, middle - half),
                 b = views[i].pixel_from_local(x, y, middle),
                 c = views[i].pixel_from_local(x, y, middle + half);
      for (Index k = 0; k < L; ++k) {
        const double z = bottom + static_cast<double>(k) * voxel, t = (z - middle) / half;
        const auto along = [&](std::size_t n) {
          return b[n] + t * (0.5 * (c[n] - a[n]) + t * (0.5 * (a[n] + c[n]) - b[n]));
        };
        const auto answer = sampled[i].ask(along(0), along(1), z, slants[i]);
        const auto l = static_cast<std::size_t>(k);
        sum[l] += answer.weight * answer.distance;
        weight[l] += answer.weight;
      }
    }
    for (std::size_t l = 0; l < N; ++l) {
      const double v = weight[l] > 0 ? sum[l] / weight[l] : NAN;
      field.values[static_cast<Index>(tile.first + l * kTile * kTile) + column] =
          static_cast<float>(v);
    }
  }
}

}  // namespace

float Tsdf::at(Index i, Index j, Index k) const {
  if (i < 0 || j < 0 || i >= columns * kTile || j >= rows * kTile) return kNan;
  const Tile& tile = tiles[static_cast<std::size_t>(j / kTile * columns + i / kTile)];
  const Index l = k - tile.bottom;
  if (l < 0 || l >= tile.layers) return kNan;
  return values[static_cast<Index>(tile.first) + (l * kTile + j % kTile) * kTile + i % kTile];
}

Tsdf fuse(std::span<const HeightImage> views, const FusionOptions& options) {
  std::vector<SampledView> sampled = sampled_views(views, options);
  return fuse(sampled, views, options);
}

Tsdf fuse(std::vector<SampledView>& sampled, std::span<const HeightImage> views,
          const FusionOptions& options) {
  Tsdf field;
  field.voxel = options.voxel, field.truncation = options.truncation;
  place_tiles(field, sampled);
  {
    LayerRanges ranges(field.columns * field.rows);
    for (SampledView& v : sampled) {
      mark_layers(ranges, field, v);
      v.drop_ground();
    }
    take_layers(field, ranges);
  }
  for_each_index(field.columns * field.rows, [&](Index t) { fuse_tile(field, t, sampled, views); });
  return field;
}

void colour_vertices(Mesh& mesh, std::span<const HeightImage> views, const FusionOptions& options) {
  colour_vertices(mesh, sampled_views(views, options), views, options);
}

void colour_vertices(Mesh& mesh, const std::vector<SampledView>& sampled,
                     std::span<const HeightImage> views, const FusionOptions& options) {
  constexpr float kGrey = 0.5f;
  mesh.colours.clear();
  if (std::all_of(views.begin(), views.end(), [](const HeightImage& v) { return v.rgb.empty(); }))
    return;
  mesh.colours.resize(mesh.vertices.size());
  for_range(static_cast<Index>(mesh.vertices.size()), 4096, [&](Index begin, Index end) {
    for (auto n = static_cast<std::size_t>(begin); n < static_cast<std::size_t>(end); ++n) {
      const auto& p = mesh.vertices[n];
      const auto x = static_cast<double>(p[0]), y = static_cast<double>(p[1]),
                 z = static_cast<double>(p[2]);
      double sum[3] = {0, 0, 0}, weight = 0;
      for (std::size_t i = 0; i < views.size(); ++i) {
        const HeightImage& view = views[i];
        if (view.rgb.empty()) continue;
        const auto q = view.pixel_from_local(x, y, z);
        const auto answer = sampled[i].ask(q[0], q[1], z, sampled[i].slant(x, y, z));
        if (!(answer.weight > 0)) continue;
        // A view that sees past the vertex knows as little of its colour as one it is hidden from.
        const double past = std::max(0.0, answer.distance / options.voxel - 1);
        const double w = answer.weight / (1 + past * past * past);
        const Index H = view.rgb.dim(1), W = view.rgb.dim(2);
        const Index pixel = static_cast<Index>(q[1] + 0.5) * W + static_cast<Index>(q[0] + 0.5);
        const double rgb[3] = {static_cast<double>(view.rgb[pixel]),
                               static_cast<double>(view.rgb[H * W + pixel]),
                               static_cast<double>(view.rgb[2 * H * W + pixel])};
        if (!std::isfinite(rgb[0] + rgb[1] + rgb[2])) continue;
        for (std::size_t c = 0; c < 3; ++c) sum[c] += w * rgb[c];
        weight += w;
      }
      for (std::size_t c = 0; c < 3; ++c)
        mesh.colours[n][c] = weight > 0 ? static_cast<float>(sum[c] / weight) : kGrey;
    }
  });
}

}  // namespace satsurf::mesh
