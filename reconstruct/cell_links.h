// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

#include <vector>

#include <Eigen/Core>
#include <Eigen/SparseCore>

namespace satsurf::reconstruct {

/// Two cells, by their numbers, whose values are pulled together; each pair once.
struct CellLink {
  Index a, b;
  double pull;  ///< positive
};

/// The equations of the values x on some cells of a grid for which
///   sum over cells weight (x - found)^2 + sum over links pull (x_a - x_b)^2
/// is least, with its solver: conjugate gradients behind a V-cycle over squares of 2, 4, 8 ... cells,
/// for which a region of a million cells is not much harder than one of a hundred. The same bits on any
/// number of threads.
class LinkedCells {
 public:
  /// cells   index in a grid of each number, ascending
  /// width   of the grid
  /// links   between neighbours in the grid
  /// weight  of each cell, positive
  LinkedCells(const std::vector<Index>& cells, Index width, const std::vector<CellLink>& links,
              const Eigen::VectorXd& weight);

  /// found    value of each cell
  /// guess    what to begin with
  /// returns  x, but for 1e-4 of what there is to even out
  Eigen::VectorXd evened(const Eigen::VectorXd& found, const Eigen::VectorXd& guess) const;

 private:
  using Matrix = Eigen::SparseMatrix<double, Eigen::RowMajor>;
  struct Level {
    Matrix matrix;
    Eigen::VectorXd inverse_diagonal;
    /// Of the next level, that each number is in; empty in the last.
    std::vector<Eigen::Index> square;
  };

  static Eigen::VectorXd product(const Matrix& matrix, const Eigen::VectorXd& x);
  static Level level_of(Matrix matrix);
  Eigen::VectorXd cycle(std::size_t level, const Eigen::VectorXd& right) const;

  Eigen::VectorXd weight_;
  std::vector<Level> levels_;  ///< the cells themselves, then ever larger squares, up to one
};

}  // namespace satsurf::reconstruct
