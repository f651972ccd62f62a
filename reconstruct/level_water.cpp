// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/level_water.h"

#include "satsurf/core/box_filters.h"
#include "satsurf/reconstruct/quantile.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <span>
#include <utility>
#include <vector>

namespace satsurf::reconstruct {
namespace {

constexpr float kDoubtful = 3, kSure = 1;  // expected errors, m
constexpr float kUnconfirmed = 0.3f;       // confidence
constexpr double kAround = 3.5;            // m, within which half is in doubt
constexpr double kLeastArea = 2000;        // m²
constexpr double kGrowth = 10;             // m
constexpr int kShore = 3;                  // cells
constexpr double kSquare = 20;             // m, a side of the parts of a shore
constexpr Index kLeastCells = 20;          // sure ones of a square
constexpr std::size_t kLeastSquares = 5;
constexpr double kLow = 0.1;  // share of a square's heights below its shore: houses stand on it
constexpr float kLevel = 1;   // m either way
constexpr float kAbove = 1;   // m that the low tenth of what was found may be higher: woods are
constexpr float kExpected = 1.5f;    // m
constexpr double kLeastSure = 0.5;   // share of the rim
constexpr double kLeastLevel = 0.5;  // share of the squares
constexpr double kBeside = 50;       // m around a piece
constexpr double kMostLower = 0.1;   // share of the sure cells there that are lower
constexpr float kLower = 3;          // m by which

enum class State : std::uint8_t { other, doubtful, piece, rim };

/// The cells of a grid and what became of them.
struct Cells {
  Index height, width;
  std::vector<State> state;

  /// Calls `visit` with every neighbour of a cell, corners as well.
  template <class Visit>
  void around(Index cell, Visit&& visit) const {
    const Index y = cell / width, x = cell % width;
    for (Index v = std::max<Index>(y - 1, 0); v <= std::min(y + 1, height - 1); ++v)
      for (Index u = std::max<Index>(x - 1, 0); u <= std::min(x + 1, width - 1); ++u)
        if (v != y || u != x) visit(v * width + u);
  }
  /// Moves on from the last cells of a list to neighbours that are wanted and in state `from`: they get
  /// state `to` and join the list.
  /// first  where the last cells begin
  template <class Wanted>
  void spread(std::vector<Index>& list, std::size_t first, State from, State to, Wanted&& wanted) {
    const std::size_t last = list.size();
    for (std::size_t i = first; i < last; ++i)
      around(list[i], [&](Index next) {
        if (state[static_cast<std::size_t>(next)] != from || !wanted(next)) return;
        state[static_cast<std::size_t>(next)] = to;
        list.push_back(next);
      });
  }
  void set(std::span<const Index> list, State to) {
    for (const Index i : list) state[static_cast<std::size_t>(i)] = to;
  }
};

/// Cells around which most are in doubt, but for those that are sure: boats and bridges.
Cells doubtful_cells(const Tensor& heights, const Tensor& doubt, const Tensor& confidence,
                     double step) {
  const Shape& shape = heights.shape();
  Tensor known(shape), doubtful(shape);
  for (Index i = 0; i < heights.count(); ++i) {
    if (!std::isfinite(heights[i])) continue;
    known[i] = 1;
    doubtful[i] = doubt[i] > kDoubtful && confidence[i] < kUnconfirmed;
  }
  const Index radius = std::max<Index>(1, std::lround(kAround / step));
  const Tensor all = box_mean(known, radius), some = box_mean(doubtful, radius);
  Cells out{heights.dim(0), heights.dim(1),
            std::vector<State>(static_cast<std::size_t>(heights.count()))};
  for (Index i = 0; i < heights.count(); ++i)
    if (known[i] > 0 && doubt[i] > kSure && 2 * some[i] > all[i])
      out.state[static_cast<std::size_t>(i)] = State::doubtful;
  return out;
}

/// The height of a level shore; NaN for another.
/// rim   cells around a piece
float level_of(const std::vector<Index>& rim, const Tensor& heights, const Tensor& doubt,
               double step) {
  const Index width = heights.dim(1);
  const auto square = [&](Index cell) {
    return std::pair{static_cast<Index>(static_cast<double>(cell / width) * step / kSquare),
                     static_cast<Index>(static_cast<double>(cell % width) * step / kSquare)};
  };
  std::map<std::pair<Index, Index>, std::vector<float>> squares;
  std::size_t sure = 0;
  for (const Index i : rim)
    if (doubt[i] < kSure) squares[square(i)].push_back(heights[i]), ++sure;
  std::vector<float> shore;
  for (auto& [place, found] : squares)
    if (std::ssize(found) >= kLeastCells) shore.push_back(quantile(found, kLow));
  if (shore.size() < kLeastSquares ||
      static_cast<double>(sure) < kLeastSure * static_cast<double>(rim.size()))
    return NAN;
  const float level = quantile(shore, 0.5);
  const auto near =
      std::ranges::count_if(shore, [&](float z) { return std::abs(z - level) <= kLevel; });
  return static_cast<double>(near) < kLeastLevel * static_cast<double>(shore.size()) ? NAN : level;
}

/// Whether little lies lower around a piece, as around water.
bool lies_low(const Cells& cells, const std::vector<Index>& piece, float level,
              const Tensor& heights, const Tensor& doubt, double step) {
  Index top = cells.height, bottom = 0, left = cells.width, right = 0;
  for (const Index i : piece) {
    const Index y = i / cells.width, x = i % cells.width;
    top = std::min(top, y), bottom = std::max(bottom, y + 1);
    left = std::min(left, x), right = std::max(right, x + 1);
  }
  const Index beside = std::lround(kBeside / step);
  Index sure = 0, lower = 0;
  for (Index y = std::max<Index>(top - beside, 0); y < std::min(bottom + beside, cells.height); ++y)
    for (Index x = std::max<Index>(left - beside, 0); x < std::min(right + beside, cells.width);
         ++x) {
      const Index i = y * cells.width + x;
      if (cells.state[static_cast<std::size_t>(i)] == State::piece || !(doubt[i] < kSure)) continue;
      ++sure, lower += heights[i] < level - kLower;
    }
  return static_cast<double>(lower) <= kMostLower * static_cast<double>(sure);
}

/// What a piece is made of, and around it.
struct Piece {
  std::vector<Index> cells;
  std::size_t core = 0;  ///< the first of them: those in doubt, before it grew
  std::vector<Index> rim;
};

/// All cells in doubt that hang together with one.
Piece piece_of(Cells& cells, Index cell) {
  cells.state[static_cast<std::size_t>(cell)] = State::piece;
  Piece out{{cell}, 0, {}};
  for (std::size_t first = 0; first < out.cells.size(); first = out.core) {
    out.core = out.cells.size();
    cells.spread(out.cells, first, State::doubtful, State::piece, [](Index) { return true; });
  }
  return out;
}

/// Gives a piece the cells around it that are not sure, and its rim.
/// heights, doubt  of all cells
void grow(Piece& piece, Cells& cells, const Tensor& heights, const Tensor& doubt, double step) {
  const auto known = [&](Index i) { return std::isfinite(heights[i]); };
  const auto unsure = [&](Index i) { return known(i) && doubt[i] > kSure; };
  std::size_t first = 0;
  for (double way = step; way <= kGrowth; way += step) {
    const std::size_t end = piece.cells.size();
    cells.spread(piece.cells, first, State::other, State::piece, unsure);
    first = end;
  }
  std::vector<Index> all = piece.cells;
  first = 0;
  for (int k = 0; k < kShore; ++k) {
    const std::size_t end = all.size();
    cells.spread(all, first, State::other, State::rim, known);
    first = end;
  }
  piece.rim.assign(all.begin() + std::ssize(piece.cells), all.end());
  cells.set(piece.rim, State::other);  // they may be the next one's as well
}

}  // namespace

Index level_water(Tensor& heights, Tensor& sigma, Tensor& doubt, const Tensor& confidence,
                  double step) {
  Cells cells = doubtful_cells(heights, doubt, confidence, step);
  const auto least = static_cast<std::size_t>(std::ceil(kLeastArea / (step * step)));
  Index levelled = 0;
  for (Index i = 0; i < heights.count(); ++i) {
    if (cells.state[static_cast<std::size_t>(i)] != State::doubtful) continue;
    Piece piece = piece_of(cells, i);
    if (piece.core < least) continue;
    grow(piece, cells, heights, doubt, step);
    const float level = level_of(piece.rim, heights, doubt, step);
    if (!std::isfinite(level)) continue;
    std::vector<float> found;
    for (std::size_t k = 0; k < piece.core; ++k) found.push_back(heights[piece.cells[k]]);
    if (quantile(found, kLow) > level + kAbove ||
        !lies_low(cells, piece.cells, level, heights, doubt, step))
      continue;
    for (const Index k : piece.cells) heights[k] = level, sigma[k] = doubt[k] = kExpected;
    levelled += std::ssize(piece.cells);
  }
  return levelled;
}

}  // namespace satsurf::reconstruct
