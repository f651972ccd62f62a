// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/fusion.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/nn/hypotheses.h"
#include "satsurf/reconstruct/cell_surfels.h"
#include "satsurf/reconstruct/cross_check.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

namespace satsurf::reconstruct {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr Index kGrain = 1 << 14;  // surfels of one piece of work

/// Metres of height that move a point of view i by one pixel in view j, in the middle of the window,
/// within what is worth comparing: less is below the network's noise, and where two views look
/// alike more would call everything agreement.
double tolerance(const nn::NetworkInput& input, std::size_t i, std::size_t j) {
  constexpr double kLeast = 0.5, kMost = 2.5;  // m
  const Tensor& valid = input.sources[i].valid;
  const auto d = input.transfer[i][j].jacobian(0.5 * static_cast<double>(valid.dim(1)),
                                               0.5 * static_cast<double>(valid.dim(0)),
                                               input.z_range.middle());
  return std::clamp(1 / std::hypot(d[0][2], d[1][2]), kLeast, kMost);
}

/// Largest (or smallest) known height of each cell and its eight neighbours; NaN where none is.
Tensor extreme_of_neighbours(const Tensor& heights, bool largest) {
  const Index H = heights.dim(0), W = heights.dim(1);
  const auto pick = [&](float a, float b) { return largest ? std::fmax(a, b) : std::fmin(a, b); };
  auto rows = Tensor::uninitialised({H, W}), out = Tensor::uninitialised({H, W});
  for_each_index(H, [&](Index i) {
    const float* z = heights.data() + i * W;
    for (Index j = 0; j < W; ++j)
      rows[i * W + j] = pick(z[j], pick(z[std::max<Index>(0, j - 1)], z[std::min(W - 1, j + 1)]));
  });
  for_each_index(H, [&](Index i) {
    const Index above = std::max<Index>(0, i - 1) * W, below = std::min(H - 1, i + 1) * W;
    for (Index j = 0; j < W; ++j)
      out[i * W + j] = pick(rows[i * W + j], pick(rows[above + j], rows[below + j]));
  });
  return out;
}

/// Which surfels a surface leaves room for.
class Sieve {
 public:
  Sieve(const Tensor& heights, const FusionGrid& grid, double slack)
      : grid_(grid),
        slack_(slack),
        low_(extreme_of_neighbours(heights, false)),
        high_(extreme_of_neighbours(heights, true)) {
    const Index rows = (grid.height + kFar - 1) / kFar, columns = (grid.width + kFar - 1) / kFar;
    auto blocks = Tensor({rows, columns}, kNan);
    for_each_index(rows, [&](Index r) {
      for (Index i = r * kFar; i < std::min((r + 1) * kFar, grid.height); ++i)
        for (Index j = 0; j < grid.width; ++j) {
          float& top = blocks[r * columns + j / kFar];
          top = std::fmax(top, heights[i * grid.width + j]);
        }
    });
    top_ = extreme_of_neighbours(blocks, true);
  }

  /// Whether a surfel of a cell is near the surface and seen along its ray.
  bool passes(const SurfelCells& cells, Index cell, const float* mean, const float* ray) const {
    const double z = static_cast<double>(mean[2]);
    if (z > static_cast<double>(high_[cell]) + slack_ ||
        z < static_cast<double>(low_[cell]) - slack_)
      return false;
    const double along_x = static_cast<double>(ray[0]), along_y = static_cast<double>(ray[1]),
                 lean = std::hypot(along_x, along_y);
    // Straight up no other cell is passed.
    if (!(lean > 1e-3)) return true;
    const double rise = grid_.step / lean,
                 top = static_cast<double>(
                     top_[cell / grid_.width / kFar * top_.dim(1) + cell % grid_.width / kFar]);
    for (Index n = 1; n <= kFar; ++n) {
      const double up = static_cast<double>(n) * rise;
      if (z + up + slack_ >= top) return true;
      const Index there = cells.cell_of(static_cast<double>(mean[0]) + up * along_x,
                                        static_cast<double>(mean[1]) + up * along_y);
      if (there < 0) return true;
      if (static_cast<double>(low_[there]) > z + up + slack_) return false;
    }
    return true;
  }

 private:
  static constexpr Index kFar = 32;  // cells that a ray is followed

  const FusionGrid& grid_;
  double slack_;
  Tensor low_, high_;  ///< of each cell and its neighbours
  Tensor top_;         ///< highest of the blocks of kFar x kFar cells around each
};

/// The cells within reach of any in a list of flags.
std::vector<char> reached(const std::vector<char>& flags, const FusionGrid& grid, Index reach) {
  std::vector<char> rows(flags.size()), out(flags.size());
  const auto at = [&](Index i, Index j) { return static_cast<std::size_t>(i * grid.width + j); };
  for_each_index(grid.height, [&](Index i) {
    for (Index j = 0; j < grid.width; ++j)
      for (Index c = std::max<Index>(0, j - reach); c <= std::min(grid.width - 1, j + reach); ++c)
        rows[at(i, j)] = static_cast<char>(rows[at(i, j)] | flags[at(i, c)]);
  });
  for_each_index(grid.height, [&](Index i) {
    for (Index r = std::max<Index>(0, i - reach); r <= std::min(grid.height - 1, i + reach); ++r)
      for (Index j = 0; j < grid.width; ++j)
        out[at(i, j)] = static_cast<char>(out[at(i, j)] | rows[at(r, j)]);
  });
  return out;
}

}  // namespace

SurfelEvidence surfel_evidence(const nn::NetworkInput& input, const Tensor& heights,
                               const Tensor& confidence, const std::vector<Index>& keep) {
  Dims dim("surfel_evidence");
  dim.match("heights", heights, "N H W").match("confidence", confidence, "N H W");
  const std::size_t N = input.sources.size();
  const Index H = dim["H"], W = dim["W"], P = H * W, kept = std::ssize(keep);
  const CrossCheck check(input, heights);
  std::vector<double> within(N * N);
  for (std::size_t i = 0; i < N; ++i)
    for (std::size_t j = 0; j < N; ++j)
      if (i != j) within[i * N + j] = tolerance(input, i, j);
  SurfelEvidence out{Tensor::uninitialised({kept}), Tensor::uninitialised({kept, 2})};
  std::atomic<Index> compared = 0, agreed = 0;
  for_range(kept, kGrain, [&](Index begin, Index end) {
    Index landed = 0, agreeing = 0;
    for (Index n = begin; n < end; ++n) {
      const Index k = keep[static_cast<std::size_t>(n)], p = k % P;
      const auto i = static_cast<std::size_t>(k / P);
      const double z = check.height(i, p);
      double agree = 0, contradict = 0;
      for (std::size_t j = 0; j < N; ++j) {
        if (j == i) continue;
        const Index there = check.landing(i, j, p, z);
        if (there < 0) continue;
        const double sure = static_cast<double>(confidence[static_cast<Index>(j) * P + there]),
                     e = (check.height(j, there) - z) / within[i * N + j];
        ++landed;
        if (std::abs(e) <= 1) agree += sure * (1 - 0.5 * e * e), ++agreeing;
        if (e < -1) contradict += sure * std::min(1.0, -e - 1);
      }
      out.weight[n] =
          confidence[k] * static_cast<float>((1 + agree) / (1 + agree + 2 * contradict));
      const auto ground = input.sources[i].local_from_pixel.jacobian(static_cast<double>(p % W),
                                                                     static_cast<double>(p / W), z);
      out.rays[2 * n] = static_cast<float>(ground[0][2]);
      out.rays[2 * n + 1] = static_cast<float>(ground[1][2]);
    }
    compared += landed, agreed += agreeing;
  });
  out.compared = compared, out.agreed = agreed;
  return out;
}

double parallax_interval(const nn::NetworkInput& input) { return 1 / nn::mean_parallax(input); }

FusedSurface fuse_surfels(const Tensor& means, const Tensor& confidence,
                          const SurfelEvidence& evidence, const FusionGrid& grid) {
  Dims dim("fuse_surfels");
  dim.match("means", means, "P 3").match("confidence", confidence, "P");
  dim.match("weight", evidence.weight, "P").match("rays", evidence.rays, "P 2");
  const Index P = dim["P"], H = grid.height, W = grid.width;
  SurfelCells cells(means, confidence, evidence, grid);
  const CellReach gather(cells, grid);
  const double bandwidth = gather.bandwidth();
  FusedSurface out{Tensor({H, W}, kNan), Tensor({H, W}, kNan), {}};
  const auto fuse_where = [&](const auto& wanted) {
    for_each_index(H, [&](Index i) {
      std::vector<CellCandidate> candidates;
      for (Index j = 0; j < W; ++j) {
        if (!wanted(i * W + j)) continue;
        gather(i, j, candidates);
        const CellMode mode = densest_mode(candidates, bandwidth);
        out.heights[i * W + j] = static_cast<float>(mode.height);
        out.confidence[i * W + j] = static_cast<float>(mode.confidence);
      }
    });
  };
  fuse_where([](Index) { return true; });

  const Sieve sieve(out.heights, grid, bandwidth);
  std::vector<char> passed(static_cast<std::size_t>(P), 1);
  for_range(P, kGrain, [&](Index begin, Index end) {
    for (Index k = begin; k < end; ++k)
      if (cells.cell(k) >= 0)
        passed[static_cast<std::size_t>(k)] =
            sieve.passes(cells, cells.cell(k), means.data() + 3 * k, evidence.rays.data() + 2 * k);
  });
  std::vector<char> changed(static_cast<std::size_t>(H * W), 0);
  for (Index k = 0; k < P; ++k) {
    if (passed[static_cast<std::size_t>(k)] != 0) {
      out.kept.push_back(k);
      continue;
    }
    cells.drop(k);
    changed[static_cast<std::size_t>(cells.cell(k))] = 1;
  }
  const std::vector<char> again = reached(changed, grid, gather.cells());
  fuse_where([&](Index cell) { return again[static_cast<std::size_t>(cell)] != 0; });
  return out;
}

}  // namespace satsurf::reconstruct
