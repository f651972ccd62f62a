// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/cell_mode.h"
#include "satsurf/reconstruct/fusion.h"

#include <cstddef>
#include <span>
#include <vector>

namespace satsurf::reconstruct {

/// Surfels on a grid: those of a cell lie together, and cells row by row.
class SurfelCells {
 public:
  struct Surfel {
    float x, y, z, weight, confidence;
  };

  /// Keeps a reference to the grid, which must outlive this object.
  /// means, confidence, evidence  as `fuse_surfels`
  SurfelCells(const Tensor& means, const Tensor& confidence, const SurfelEvidence& evidence,
              const FusionGrid& grid);

  /// Cell of a place, -1 outside the grid.
  Index cell_of(double x, double y) const;
  Index cell(Index k) const { return cell_[static_cast<std::size_t>(k)]; }
  /// The surfels of cells (row, from) to (row, to), both included.
  std::span<const Surfel> in_row(Index row, Index from, Index to) const;
  /// Takes a surfel's weight.
  void drop(Index k) {
    surfels_[static_cast<std::size_t>(place_[static_cast<std::size_t>(k)])].weight = 0;
  }

 private:
  const FusionGrid& grid_;
  std::vector<Index> first_, cell_, place_;
  std::vector<Surfel> surfels_;
};

/// Gathers the surfels that reach a cell: those whose square of 1.5 pixels overlaps it.
class CellReach {
 public:
  /// Keeps references to both.
  CellReach(const SurfelCells& cells, const FusionGrid& grid);

  /// Cells on each side whose surfels may reach a cell.
  Index cells() const { return reach_; }
  /// Half width of the kernel over heights, m: finer would split the noise of one surface.
  double bandwidth() const;
  /// What reaches one cell, each with its weight times the overlap.
  /// candidates  is filled, after what it held is forgotten
  void operator()(Index row, Index column, std::vector<CellCandidate>& candidates) const;

 private:
  const SurfelCells& surfels_;
  const FusionGrid& grid_;
  double side_, most_, half_;
  Index reach_;
};

}  // namespace satsurf::reconstruct
