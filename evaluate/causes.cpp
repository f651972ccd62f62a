// SPDX-License-Identifier: Apache-2.0
#include "satsurf/evaluate/causes.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/evaluate/fill.h"
#include "satsurf/evaluate/metrics.h"
#include "satsurf/scene/classes.h"
#include "satsurf/scene/sight_lines.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace satsurf::evaluate {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kStep = 2;                              // m, what makes a rim
constexpr double kMediumRoof = 400, kLargeRoof = 2000;  // m^2

constexpr std::uint16_t bit(Cause cause) {
  return static_cast<std::uint16_t>(1u << static_cast<unsigned>(cause));
}

using Marks = std::vector<char>;

/// Marks of a grid, each grown to a square of 2 radius + 1 cells.
Marks grown(const Marks& marks, Index H, Index W, Index radius) {
  Marks out(marks.size(), 0);
  for_range(H, 16, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i)
      for (Index r = std::max<Index>(0, i - radius); r <= std::min(H - 1, i + radius); ++r)
        for (Index j = 0; j < W; ++j) {
          if (marks[static_cast<std::size_t>(r * W + j)] == 0) continue;
          const auto first = out.begin() + i * W + std::max<Index>(0, j - radius),
                     last = out.begin() + i * W + std::min(W - 1, j + radius);
          std::fill(first, last + 1, char{1});
        }
  });
  return out;
}

/// The cells on either side of a step of the surface.
Marks steps_of(const Tensor& z) {
  const Index H = z.dim(0), W = z.dim(1);
  Marks out(static_cast<std::size_t>(z.count()), 0);
  for_range(H, 16, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i)
      for (Index j = 0; j < W; ++j) {
        const auto differs = [&](Index r, Index c) {
          return r >= 0 && r < H && c >= 0 && c < W &&
                 std::abs(z[r * W + c] - z[i * W + j]) > kStep;  // false where one is unknown
        };
        out[static_cast<std::size_t>(i * W + j)] =
            differs(i - 1, j) || differs(i + 1, j) || differs(i, j - 1) || differs(i, j + 1);
      }
  });
  return out;
}

/// For each marked cell how many belong to its region, joined along edges; 0 for the others.
std::vector<Index> region_sizes(const Marks& marks, Index H, Index W) {
  std::vector<Index> sizes(marks.size(), 0);
  std::vector<Index> region;
  for (Index seed = 0; seed < H * W; ++seed) {
    const auto open = [&](Index k) {
      return marks[static_cast<std::size_t>(k)] != 0 && sizes[static_cast<std::size_t>(k)] == 0;
    };
    if (!open(seed)) continue;
    region.assign(1, seed);
    sizes[static_cast<std::size_t>(seed)] = 1;
    const auto reach = [&](Index k) {
      if (!open(k)) return;
      sizes[static_cast<std::size_t>(k)] = 1;
      region.push_back(k);
    };
    for (std::size_t next = 0; next < region.size(); ++next) {
      const Index k = region[next];
      if (k >= W) reach(k - W);
      if (k + W < H * W) reach(k + W);
      if (k % W > 0) reach(k - 1);
      if (k % W + 1 < W) reach(k + 1);
    }
    for (const Index k : region) sizes[static_cast<std::size_t>(k)] = std::ssize(region);
  }
  return sizes;
}

/// The causes that rays tell.
std::uint16_t causes_of(const scene::Sight& sight) {
  std::uint16_t flags = 0;
  if (sight.see < sight.contain) flags |= bit(Cause::hidden);
  if (sight.see < sight.contain && sight.see <= 1) flags |= bit(Cause::seen_by_one);
  if (sight.shaded) flags |= bit(Cause::shadow);
  return flags;
}

/// Adds what the classes say. Those of rays and rims are known by now.
void add_classes(const Tensor& classes, double cell_area, CauseFlags& flags) {
  const Index H = flags.height, W = flags.width;
  Marks building(flags.cells.size()), outside(flags.cells.size());
  for (std::size_t k = 0; k < building.size(); ++k) {
    building[k] = classes[static_cast<Index>(k)] == scene::kBuildingClass;
    outside[k] = building[k] == 0;
  }
  const std::vector<Index> sizes = region_sizes(building, H, W);
  const Marks near_outside = grown(outside, H, W, 2);
  const auto in_the_way =
      static_cast<std::uint16_t>(bit(Cause::hidden) | bit(Cause::shadow) | bit(Cause::rim));
  for (std::size_t k = 0; k < flags.cells.size(); ++k) {
    std::uint16_t& cell = flags.cells[k];
    const float c = classes[static_cast<Index>(k)];
    if (near_outside[k] == 0) {
      const double area = cell_area * static_cast<double>(sizes[k]);
      cell |= bit(area < kMediumRoof   ? Cause::roof_small
                  : area <= kLargeRoof ? Cause::roof_medium
                                       : Cause::roof_large);
    }
    if (c == scene::kTreeClass) cell |= bit(Cause::tree);
    if (c == scene::kWaterClass) cell |= bit(Cause::water);
    if (c == scene::kGroundClass && (cell & in_the_way) == 0) cell |= bit(Cause::open_ground);
  }
}

}  // namespace

std::optional<std::array<double, 2>> slope_to_sun(const scene::View& view,
                                                  const rpc::LocalFrame& frame) {
  constexpr double kRadian = std::numbers::pi / 180;
  if (view.sun_elevation_deg <= 0) return std::nullopt;
  const double turn = rpc::grid_convergence_deg(frame, frame.geodetic_from_local({0, 0, 0})),
               azimuth = (view.sun_azimuth_deg - turn) * kRadian,
               run = 1 / std::tan(view.sun_elevation_deg * kRadian);
  return std::array{run * std::sin(azimuth), run * std::cos(azimuth)};
}

Tensor CauseFlags::of(Cause cause) const {
  Tensor out({height, width});
  for (std::size_t k = 0; k < cells.size(); ++k)
    out[static_cast<Index>(k)] = (cells[k] & bit(cause)) != 0 ? 1.f : 0.f;
  return out;
}

CauseFlags find_causes(const scene::HeightField& truth, const Tensor& classes,
                       const std::vector<LitView>& views, const Tensor& mask) {
  Dims dims("find_causes");
  dims.match("truth", truth.z, "H W");
  if (!classes.empty()) dims.match("classes", classes, "H W");
  if (!mask.empty()) dims.match("mask", mask, "H W");
  const Index H = dims["H"], W = dims["W"];
  CauseFlags flags{H, W, std::vector<std::uint16_t>(static_cast<std::size_t>(H * W), 0), {}};
  flags.known.fill(!classes.empty());
  const auto know = [&](Cause cause, bool is) {
    flags.known[static_cast<std::size_t>(cause)] = is;
  };
  for (const Cause cause : {Cause::hidden, Cause::seen_by_one, Cause::rim, Cause::other})
    know(cause, true);
  know(Cause::shadow,
       std::ranges::any_of(views, [](const LitView& v) { return v.to_sun.has_value(); }));

  const scene::SightLines lines(truth, views);
  const Marks rim = grown(steps_of(truth.z), H, W, 1);
  if (!lines.empty())
    for_range(H, 4, [&](Index begin, Index end) {
      for (Index k = begin * W; k < end * W; ++k) {
        std::uint16_t& cell = flags.cells[static_cast<std::size_t>(k)];
        if (std::isfinite(truth.z[k]) && (mask.empty() || mask[k] != 0))
          cell = causes_of(lines.at(k / W, k % W));
        if (rim[static_cast<std::size_t>(k)] != 0) cell |= bit(Cause::rim);
      }
    });
  if (!classes.empty()) add_classes(classes, truth.step * truth.step, flags);
  for (Index k = 0; k < H * W; ++k) {
    std::uint16_t& cell = flags.cells[static_cast<std::size_t>(k)];
    if (!mask.empty() && mask[k] == 0)
      cell = 0;
    else if (cell == 0)
      cell = bit(Cause::other);
  }
  return flags;
}

CauseScores score_causes(const Tensor& surface, const Tensor& truth, const Tensor& mask,
                         const CauseFlags& flags) {
  Dims("score_causes")
      .match("truth", truth, "H W")
      .match("surface", surface, "H W")
      .match("mask", mask, "H W");
  if (truth.shape() != Shape{flags.height, flags.width})
    throw ShapeError("score_causes: flags are of a grid " + Shape{flags.height, flags.width}.str() +
                     ", expected the truth's " + truth.shape().str());
  const HeightScores all = score_heights(surface, truth, mask);
  const double sum = all.mae * static_cast<double>(all.compared);
  CauseScores out;
  for_each_index(static_cast<Index>(kCauses), [&](Index cause) {
    const auto k = static_cast<std::size_t>(cause);
    if (!flags.known[k]) return;
    Tensor own = flags.of(static_cast<Cause>(cause));
    for (Index i = 0; i < own.count(); ++i) own[i] *= mask[i];
    const HeightScores s = score_heights(surface, truth, own);
    const auto cells = static_cast<double>(s.truth), compared = static_cast<double>(s.compared);
    out[k] = {.cells = cells,
              .share = cells / static_cast<double>(all.truth),
              .mae = s.mae,
              .median = s.median,
              .pag2_5 = s.pag2_5,
              .error_share = (s.compared > 0 ? s.mae * compared : 0) / sum};
  });
  return out;
}

OracleScore score_oracle(const Tensor& means, const std::array<double, 3>& shift,
                         const scene::HeightField& truth, const Tensor& mask) {
  const Index H = truth.z.dim(0), W = truth.z.dim(1);
  Tensor best({H, W}, kNan);
  for (Index p = 0; p < means.dim(0); ++p) {
    const auto at = [&](Index axis) {
      return static_cast<double>(means[3 * p + axis]) + shift[static_cast<std::size_t>(axis)];
    };
    const double col = std::floor((at(0) - truth.x0) / truth.step),
                 row = std::floor((truth.y0 - at(1)) / truth.step);
    if (!(row >= 0 && row < static_cast<double>(H) && col >= 0 && col < static_cast<double>(W)))
      continue;
    const Index k = static_cast<Index>(row) * W + static_cast<Index>(col);
    const auto z = static_cast<float>(at(2));
    // where the truth is not known any height will do, for a hole beside it may be filled from it
    if (!(std::abs(best[k] - truth.z[k]) <= std::abs(z - truth.z[k]))) best[k] = z;
  }
  return {score_heights(best, truth.z, mask).completeness,
          score_heights(filled(best), truth.z, mask).mae};
}

std::array<double, 2> lost_by_stage(const std::array<nn::StageOutput<float>, 3>& stages,
                                    const std::vector<std::vector<Tensor>>& truth) {
  std::array<double, 2> out{std::nan(""), std::nan("")};
  for (std::size_t s = 0; s < out.size(); ++s) {
    std::size_t next = s + 1;
    while (next < stages.size() && stages[next].hypotheses.empty()) ++next;
    if (stages[s].hypotheses.empty() || next == stages.size()) continue;
    const Tensor& tried = stages[next].hypotheses;
    const Index N = tried.dim(0), D = tried.dim(1), P = tried.dim(2) * tried.dim(3);
    const double margin = 0.5 * stages[next].interval;
    Index known = 0, lost = 0;
    for (Index n = 0; n < N; ++n) {
      const Tensor& z = truth.at(next).at(static_cast<std::size_t>(n));
      if (z.shape() != Shape{tried.dim(2), tried.dim(3)})
        throw ShapeError("lost_by_stage: truth has shape " + z.shape().str() + ", expected " +
                         Shape{tried.dim(2), tried.dim(3)}.str() + " of the stage");
      for (Index p = 0; p < P; ++p) {
        if (!std::isfinite(z[p])) continue;
        const auto height = static_cast<double>(z[p]),
                   low = static_cast<double>(tried[n * D * P + p]),
                   high = static_cast<double>(tried[(n * D + D - 1) * P + p]);
        known += 1;
        lost += height < low - margin || height > high + margin;
      }
    }
    if (known > 0) out[s] = static_cast<double>(lost) / static_cast<double>(known);
  }
  return out;
}

}  // namespace satsurf::evaluate
