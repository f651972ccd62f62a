// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/given.h"

#include "satsurf/core/box_filters.h"
#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/classes.h"
#include "satsurf/scene/simulate/dress.h"
#include "satsurf/scene/simulate/noise.h"
#include "satsurf/scene/simulate/texture.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>

namespace satsurf::scene {
namespace simulate {
namespace {

constexpr std::size_t kMostParts = 65000;  // fewer than SurfaceCell::part can number

Index mirrored(Index k, Index n) {
  const Index period = 2 * n, m = ((k % period) + period) % period;
  return m < n ? m : period - 1 - m;
}

// Lowest value within a square, edges cut off; unknown cells do not count.
Tensor box_low(const Tensor& grid, Index radius) {
  const Index N = grid.dim(0);
  auto rows = Tensor::uninitialised({N, N}), out = Tensor::uninitialised({N, N});
  const auto sweep = [&](const Tensor& in, Tensor& to, Index major, Index minor) {
    for_range(N, 16, [&](Index begin, Index end) {
      for (Index i = begin; i < end; ++i) {
        for (Index j = 0; j < N; ++j) {
          float low = std::numeric_limits<float>::infinity();
          for (Index k = std::max(j - radius, Index{0}); k <= std::min(j + radius, N - 1); ++k) {
            const float v = in[i * major + k * minor];
            low = v < low ? v : low;
          }
          to[i * major + j * minor] = low;
        }
      }
    });
  };
  sweep(grid, rows, N, 1);
  sweep(rows, out, 1, N);
  return out;
}

class Dresser {
 public:
  Dresser(const GivenSurface& surface, const rpc::LocalFrame& frame, const CityPlan& plan,
          const Rng& rng)
      : rng_(rng), N_(plan.size), step_(static_cast<float>(plan.step)) {
    city_.field = {
        .z = Tensor::uninitialised({N_, N_}), .x0 = plan.x0, .y0 = plan.y0, .step = plan.step};
    const double half = 0.5 * plan.step * static_cast<double>(N_);
    city_.centre_x = plan.x0 + half;
    city_.centre_y = plan.y0 - half;
    city_.cells.resize(static_cast<std::size_t>(N_ * N_));
    classes_ = Tensor({N_, N_}, kGroundClass);
    const Index H = surface.z.dim(0), W = surface.z.dim(1);
    const double x0 = surface.grid.x0 - frame.easting0, y0 = surface.grid.y0 - frame.northing0,
                 step = surface.grid.step;
    for_range(N_, 32, [&](Index begin, Index end) {
      for (Index i = begin; i < end; ++i) {
        const double y = plan.y0 - (static_cast<double>(i) + 0.5) * plan.step;
        const Index r = mirrored(static_cast<Index>(std::floor((y0 - y) / step)), H);
        for (Index j = 0; j < N_; ++j) {
          const double x = plan.x0 + (static_cast<double>(j) + 0.5) * plan.step;
          const Index c = mirrored(static_cast<Index>(std::floor((x - x0) / step)), W);
          city_.field.z[i * N_ + j] =
              surface.z[r * W + c] - static_cast<float>(frame.h0);  // NaN stays
          if (!surface.classes.empty()) classes_[i * N_ + j] = surface.classes[r * W + c];
        }
      }
    });
    const auto noise = [&](double period, int octaves, std::uint64_t key) {
      return fractal_noise(N_, N_, plan.step,
                           {.period = period,
                            .octaves = octaves,
                            .seed = static_cast<std::uint32_t>(rng.fork(key).next_u64())});
    };
    fine_ = noise(1.3, 2, 1);
    middle_ = noise(14, 3, 2);
    wide_ = noise(90, 2, 3);
    cover_ = noise(45, 3, 4);
    seed_ = static_cast<std::uint32_t>(rng.fork(5).next_u64());
  }

  City run(bool classified) {
    find_ground();
    if (!classified) guess_classes();
    take_in_walls();
    find_roofs();
    city_.fine.resize(city_.cells.size());
    city_.patch.resize(city_.cells.size());
    for_range(N_, 32, [&](Index begin, Index end) {
      for (Index k = begin * N_; k < end * N_; ++k) dress(k);
    });
    city_.floor = city_.cells;
    city_.floor_z = city_.field.z.clone();
    for_range(N_, 32, [&](Index begin, Index end) {
      for (Index k = begin * N_; k < end * N_; ++k) {
        if (classes_[k] == kTreeClass) plant(k);
      }
    });
    shape_cells(city_);
    return std::move(city_);
  }

 private:
  // The lowest around, smoothed; what is unknown lies on it.
  void find_ground() {
    const auto cells = [&](float m) { return static_cast<Index>(std::lround(m / step_)); };
    Tensor low = box_low(city_.field.z, cells(25));
    for (float& v : low.values()) v = std::isfinite(v) ? v : 0.0f;
    ground_ = box_mean(low, cells(20));
    for (Index k = 0; k < N_ * N_; ++k) {
      float& z = city_.field.z[k];
      if (std::isnan(z)) z = ground_[k];
      ground_[k] = std::min(ground_[k], z);
    }
  }

  // What rises 2.5 m above the ground is a building where it is even, else a tree.
  void guess_classes() {
    Tensor uneven({N_, N_});
    const Tensor& z = city_.field.z;
    for (Index i = 1; i + 1 < N_; ++i) {
      for (Index j = 1; j + 1 < N_; ++j) {
        const Index k = i * N_ + j;
        // Second differences: a slope is even, and an edge counts for little.
        const float bend =
            std::abs(z[k - 1] + z[k + 1] - 2 * z[k]) + std::abs(z[k - N_] + z[k + N_] - 2 * z[k]);
        uneven[k] = std::min(bend, 1.5f);
      }
    }
    const Tensor rough = box_mean(uneven, static_cast<Index>(std::lround(1.5f / step_)));
    for (Index k = 0; k < N_ * N_; ++k) {
      if (z[k] - ground_[k] > 2.5f) classes_[k] = rough[k] > 0.7f ? kTreeClass : kBuildingClass;
    }
  }

  // Class rasters end where roofs do; the cells on which lidar met the wall are part of it.
  void take_in_walls() {
    const Tensor given = classes_.clone();
    const auto near = static_cast<Index>(std::lround(1.0f / step_));
    for_range(N_, 32, [&](Index begin, Index end) {
      for (Index i = begin; i < end; ++i) {
        for (Index j = 0; j < N_; ++j) {
          const Index k = i * N_ + j;
          if (given[k] == kTreeClass || given[k] == kBuildingClass || given[k] == kWaterClass ||
              city_.field.z[k] - ground_[k] < 2) {
            continue;
          }
          for (Index y = std::max(i - near, Index{0}); y <= std::min(i + near, N_ - 1); ++y) {
            for (Index x = std::max(j - near, Index{0}); x <= std::min(j + near, N_ - 1); ++x) {
              if (given[y * N_ + x] == kBuildingClass) classes_[k] = kBuildingClass;
            }
          }
        }
      }
    });
  }

  // Neighbouring cells of buildings within 0.5 m of height share a roof.
  void find_roofs() {
    roof_.assign(static_cast<std::size_t>(N_ * N_), 0);
    const Tensor& z = city_.field.z;
    std::vector<Index> open;
    Rng r = rng_.fork(6);
    for (Index start = 0; start < N_ * N_; ++start) {
      if (classes_[start] != kBuildingClass || roof_[static_cast<std::size_t>(start)] != 0)
        continue;
      const bool full = city_.parts.size() >= kMostParts;
      if (!full) city_.parts.push_back(part(r));
      const auto number = static_cast<std::uint16_t>(city_.parts.size());
      Part& p = city_.parts.back();
      float high = z[start], low = ground_[start];
      open.assign(1, start);
      roof_[static_cast<std::size_t>(start)] = number;
      while (!open.empty()) {
        const Index k = open.back(), i = k / N_, j = k % N_;
        open.pop_back();
        high = std::max(high, z[k]);
        low = std::min(low, ground_[k]);
        const std::array<Index, 4> around{i > 0 ? k - N_ : k, i + 1 < N_ ? k + N_ : k,
                                          j > 0 ? k - 1 : k, j + 1 < N_ ? k + 1 : k};
        for (const Index n : around) {
          std::uint16_t& other = roof_[static_cast<std::size_t>(n)];
          if (classes_[n] != kBuildingClass || other != 0 || std::abs(z[n] - z[k]) > 0.5f) continue;
          other = number;
          open.push_back(n);
        }
      }
      if (full) continue;
      p.base = low;
      p.eave = high;
    }
  }

  static Part part(Rng& r) {
    Part p{};
    dress_walls(r, p);
    if (r.chance(0.4)) {
      dress_membrane(r, p);
    } else {
      dress_flat_roof(r, p);
      p.texture = draw(r, 0.5, 1.5);
    }
    p.free_form = true;
    return p;
  }

  void paint(SurfaceCell& cell, Index k, const Colour& colour, Material m, float uneven = 1) {
    const Texture t = texture_of(m);
    const float grain = t.grain * bell(hash(static_cast<std::int32_t>(k / N_),
                                            static_cast<std::int32_t>(k % N_), seed_));
    cell.material = m;
    cell.set_albedo(colour, 1 + uneven * (grain + t.fine * fine_[k] + t.middle * middle_[k] +
                                          t.wide * wide_[k]));
  }

  void dress(Index k) {
    const auto at = static_cast<std::size_t>(k);
    const auto byte = [](float v) {
      return static_cast<std::int8_t>(std::clamp(100.0f * v, -127.0f, 127.0f));
    };
    city_.fine[at] = byte(fine_[k]);
    city_.patch[at] = byte(0.7f * middle_[k] + 0.7f * wide_[k]);
    SurfaceCell& cell = city_.cells[at];
    if (classes_[k] == kBuildingClass) {
      const Part& p = city_.parts[roof_[at] - 1u];
      cell.part = roof_[at];
      return paint(cell, k, p.roof_colour, Material::roof, p.texture);
    }
    if (classes_[k] == kWaterClass) return paint(cell, k, {0.03f, 0.045f, 0.05f}, Material::water);
    dress_ground(cell, k);
  }

  void dress_ground(SurfaceCell& cell, Index k) {
    const float cover = cover_[k] + 0.15f * middle_[k];
    if (cover < -0.1f) return paint(cell, k, {0.13f, 0.13f, 0.133f}, Material::asphalt);
    if (cover < 0.1f) return paint(cell, k, {0.27f, 0.26f, 0.24f}, Material::concrete);
    if (cover < 0.65f) return paint(cell, k, {0.10f, 0.125f, 0.06f}, Material::grass);
    paint(cell, k, {0.25f, 0.21f, 0.165f}, Material::soil);
  }

  // A crown over the ground that is seen through it.
  void plant(Index k) {
    const auto at = static_cast<std::size_t>(k);
    city_.floor_z[k] = ground_[k];
    SurfaceCell& cell = city_.cells[at];
    // Trees are not told apart: neighbours within some metres share their season.
    const auto tile = [&](Index v) {
      return static_cast<std::int32_t>(
          std::floor((static_cast<float>(v) * step_ + 3 * middle_[k]) / 7));
    };
    const std::uint32_t h = hash(tile(k / N_), tile(k % N_), seed_);
    const float rim = std::clamp(0.5f + 0.5f * middle_[k], 0.0f, 1.0f);
    cell.plant = static_cast<std::uint16_t>((h >> 8 & 0xFFu) << 8 | ((h & 1u) != 0 ? 128u : 0u) |
                                            static_cast<unsigned>(127.0f * rim));
    const float tone = 0.7f + 0.6f * unit(hash(3, 0, h));
    paint(cell, k, {0.045f * tone, 0.066f * tone, 0.032f * tone}, Material::tree);
  }

  City city_;
  Rng rng_;
  Index N_;
  float step_;
  std::uint32_t seed_ = 0;
  Tensor classes_, ground_, fine_, middle_, wide_, cover_;
  std::vector<std::uint16_t> roof_;  // 1 + number of the part, 0 for none
};

}  // namespace

City city_on(const GivenSurface& surface, const rpc::LocalFrame& frame, const CityPlan& plan,
             const Rng& rng) {
  return Dresser(surface, frame, plan, rng).run(!surface.classes.empty());
}

}  // namespace simulate

GivenSurface read_surface(const std::filesystem::path& dsm, const std::filesystem::path& classes) {
  // A raster without a system, as DFC2019's: its northing gives the latitude in any zone.
  const rpc::UtmZone unnamed{.number = 31, .north = true};
  rpc::GeoRaster heights = rpc::read_geo_raster(dsm, unnamed);
  Dims dim("surface");
  dim.match("heights", heights.values, "H W");
  rpc::require_heights(dsm, heights.values);
  GivenSurface surface{.z = heights.values, .classes = {}, .grid = heights.grid, .zone = unnamed};
  const std::optional<rpc::UtmZone> zone = rpc::zone_near_epsg(heights.grid.epsg);
  if (!zone)
    throw IoError(dsm.string() + ": EPSG:" + std::to_string(heights.grid.epsg) +
                  ", expected a zone of UTM or no system");
  surface.zone = *zone;
  Index known = 0;
  for (const float z : surface.z.values()) known += std::isfinite(z);
  if (2 * known < surface.z.count())
    throw IoError(dsm.string() + ": " + std::to_string(known) + " of " +
                  std::to_string(surface.z.count()) + " heights are known, expected half at least");
  if (classes.empty()) return surface;
  const rpc::GeoRaster labels = rpc::read_geo_raster(classes, unnamed);
  if (labels.values.shape() != surface.z.shape() || !(labels.grid == heights.grid)) {
    throw IoError(classes.string() + ": another grid, expected that of " + dsm.string());
  }
  surface.classes = labels.values;
  return surface;
}

}  // namespace satsurf::scene
