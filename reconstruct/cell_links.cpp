// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/cell_links.h"

#include "satsurf/core/parallel.h"

#include <algorithm>
#include <utility>

namespace satsurf::reconstruct {
namespace {

constexpr double kDamping = 0.8;  // of a Jacobi step
constexpr double kTolerance = 1e-4;
constexpr int kMostSteps = 200;
constexpr Index kRows = 4096;  // of a piece

using Vector = Eigen::VectorXd;

/// The squares of 2 x 2 that hold cells, and the one of each cell.
/// cells  of a grid of that width, ascending; become the squares in one of half the width
std::vector<Eigen::Index> halve(std::vector<Index>& cells, Index& width) {
  const Index half = (width + 1) / 2;
  std::vector<Index> of;
  for (const Index i : cells) of.push_back(i / width / 2 * half + i % width / 2);
  std::vector<Index> squares = of;
  std::ranges::sort(squares);
  squares.erase(std::ranges::unique(squares).begin(), squares.end());
  std::vector<Eigen::Index> out;
  for (const Index i : of) out.push_back(std::ranges::lower_bound(squares, i) - squares.begin());
  cells = std::move(squares), width = half;
  return out;
}

}  // namespace

LinkedCells::Level LinkedCells::level_of(Matrix matrix) {
  Vector inverse = matrix.diagonal().cwiseInverse();
  return {std::move(matrix), std::move(inverse), {}};
}

LinkedCells::LinkedCells(const std::vector<Index>& cells, Index width,
                         const std::vector<CellLink>& links, const Vector& weight)
    : weight_(weight) {
  std::vector<Eigen::Triplet<double>> entries;
  Vector diagonal = weight;
  for (const CellLink& l : links) {
    entries.emplace_back(l.a, l.b, -l.pull);
    entries.emplace_back(l.b, l.a, -l.pull);
    diagonal[l.a] += l.pull, diagonal[l.b] += l.pull;
  }
  for (Eigen::Index n = 0; n < weight.size(); ++n) entries.emplace_back(n, n, diagonal[n]);
  Matrix matrix(weight.size(), weight.size());
  matrix.setFromTriplets(entries.begin(), entries.end());
  levels_.push_back(level_of(std::move(matrix)));
  std::vector<Index> squares = cells;
  while (squares.size() > 1) {
    levels_.back().square = halve(squares, width);
    const Level& fine = levels_.back();
    entries.clear();
    for (Eigen::Index n = 0; n < fine.matrix.rows(); ++n)
      for (Matrix::InnerIterator it(fine.matrix, n); it; ++it)
        entries.emplace_back(fine.square[static_cast<std::size_t>(n)],
                             fine.square[static_cast<std::size_t>(it.col())], it.value());
    Matrix coarse(std::ssize(squares), std::ssize(squares));
    coarse.setFromTriplets(entries.begin(), entries.end());
    levels_.push_back(level_of(std::move(coarse)));
  }
}

Vector LinkedCells::product(const Matrix& matrix, const Vector& x) {
  Vector out(x.size());
  for_range(x.size(), kRows, [&](Index begin, Index end) {
    for (Index n = begin; n < end; ++n) {
      double sum = 0;
      for (Matrix::InnerIterator it(matrix, n); it; ++it) sum += it.value() * x[it.col()];
      out[n] = sum;
    }
  });
  return out;
}

/// About what solves the equations of a level, as a symmetric positive function of their right side.
Vector LinkedCells::cycle(std::size_t level, const Vector& right) const {
  const Level& l = levels_[level];
  if (l.square.empty()) return l.inverse_diagonal.cwiseProduct(right);  // one square
  Vector x = kDamping * l.inverse_diagonal.cwiseProduct(right);
  const Vector left = right - product(l.matrix, x);
  Vector sums = Vector::Zero(levels_[level + 1].matrix.rows());
  for (Eigen::Index n = 0; n < left.size(); ++n)
    sums[l.square[static_cast<std::size_t>(n)]] += left[n];
  const Vector coarse = cycle(level + 1, sums);
  for (Eigen::Index n = 0; n < x.size(); ++n) x[n] += coarse[l.square[static_cast<std::size_t>(n)]];
  x += kDamping * l.inverse_diagonal.cwiseProduct(right - product(l.matrix, x));
  return x;
}

Vector LinkedCells::evened(const Vector& found, const Vector& guess) const {
  // Solved for what is added to the values found: the tolerance is then a share of that, and not of
  // heights above some zero.
  const Matrix& A = levels_[0].matrix;
  const Vector right = weight_.cwiseProduct(found) - product(A, found);
  Vector added = guess - found;
  Vector left = right - product(A, added);
  Vector ahead = cycle(0, left), direction = ahead;
  double along = left.dot(ahead);
  const double enough = kTolerance * kTolerance * right.dot(cycle(0, right));
  for (int k = 0; k < kMostSteps && along > enough; ++k) {
    const Vector image = product(A, direction);
    const double way = along / direction.dot(image);
    added += way * direction, left -= way * image;
    ahead = cycle(0, left);
    const double next = left.dot(ahead);
    direction = ahead + next / along * direction;
    along = next;
  }
  return found + added;
}

}  // namespace satsurf::reconstruct
