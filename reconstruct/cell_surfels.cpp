// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/cell_surfels.h"

#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>

namespace satsurf::reconstruct {

SurfelCells::SurfelCells(const Tensor& means, const Tensor& confidence,
                         const SurfelEvidence& evidence, const FusionGrid& grid)
    : grid_(grid), first_(static_cast<std::size_t>(grid.height * grid.width + 1), 0) {
  constexpr Index kGrain = 1 << 14;  // surfels of one piece of work
  const Index P = means.dim(0);
  cell_.resize(static_cast<std::size_t>(P));
  for_range(P, kGrain, [&](Index begin, Index end) {
    for (Index k = begin; k < end; ++k)
      cell_[static_cast<std::size_t>(k)] =
          cell_of(static_cast<double>(means[3 * k]), static_cast<double>(means[3 * k + 1]));
  });
  // Every band of cells looks through all surfels for its own: reading is little beside what is
  // written all over memory.
  const Index cells = grid.height * grid.width, bands = std::clamp<Index>(P / kGrain, 1, threads());
  const auto in_bands = [&](const auto& visit) {
    for_each_index(bands, [&](Index b) {
      const Index low = b * cells / bands, high = (b + 1) * cells / bands;
      for (Index k = 0; k < P; ++k)
        if (const Index cell = cell_[static_cast<std::size_t>(k)]; cell >= low && cell < high)
          visit(k, static_cast<std::size_t>(cell));
    });
  };
  in_bands([&](Index, std::size_t cell) { ++first_[cell + 1]; });
  for (std::size_t c = 1; c < first_.size(); ++c) first_[c] += first_[c - 1];
  std::vector<Index> next(first_.begin(), first_.end() - 1);
  surfels_.resize(static_cast<std::size_t>(first_.back()));
  place_.assign(static_cast<std::size_t>(P), -1);
  in_bands([&](Index k, std::size_t cell) {
    const Index at = next[cell]++;
    place_[static_cast<std::size_t>(k)] = at;
    surfels_[static_cast<std::size_t>(at)] = {means[3 * k], means[3 * k + 1], means[3 * k + 2],
                                              evidence.weight[k], confidence[k]};
  });
}

Index SurfelCells::cell_of(double x, double y) const {
  const double column = (x - grid_.east) / grid_.step, row = (grid_.north - y) / grid_.step;
  if (!(row >= 0 && column >= 0 && row < static_cast<double>(grid_.height) &&
        column < static_cast<double>(grid_.width)))
    return -1;
  return static_cast<Index>(row) * grid_.width + static_cast<Index>(column);
}

std::span<const SurfelCells::Surfel> SurfelCells::in_row(Index row, Index from, Index to) const {
  const Index a = first_[static_cast<std::size_t>(row * grid_.width + from)],
              b = first_[static_cast<std::size_t>(row * grid_.width + to + 1)];
  return {surfels_.data() + a, static_cast<std::size_t>(b - a)};
}

CellReach::CellReach(const SurfelCells& cells, const FusionGrid& grid)
    : surfels_(cells),
      grid_(grid),
      side_(1.5 * grid.footprint),
      most_(std::min(side_, grid.step)),
      half_(0.5 * (side_ + grid.step)),
      reach_(std::max<Index>(1, static_cast<Index>(std::ceil(half_ / grid.step - 0.5)))) {}

double CellReach::bandwidth() const { return std::clamp(grid_.interval, 0.3, 2.0); }

void CellReach::operator()(Index row, Index column, std::vector<CellCandidate>& candidates) const {
  candidates.clear();
  const double x = grid_.east + (static_cast<double>(column) + 0.5) * grid_.step,
               y = grid_.north - (static_cast<double>(row) + 0.5) * grid_.step;
  // Length of a cell's side that a surfel's square covers, from the distance of their centres.
  const auto overlap = [this](double distance) {
    return std::max(0.0, std::min(half_ - std::abs(distance), most_));
  };
  const Index from = std::max<Index>(0, column - reach_),
              to = std::min(grid_.width - 1, column + reach_);
  for (Index r = std::max<Index>(0, row - reach_); r <= std::min(grid_.height - 1, row + reach_);
       ++r)
    for (const SurfelCells::Surfel& s : surfels_.in_row(r, from, to)) {
      const double weight = static_cast<double>(s.weight) * overlap(static_cast<double>(s.x) - x) *
                            overlap(static_cast<double>(s.y) - y);
      if (weight > 0)
        candidates.push_back({static_cast<double>(s.z), weight, static_cast<double>(s.confidence)});
    }
}

}  // namespace satsurf::reconstruct
