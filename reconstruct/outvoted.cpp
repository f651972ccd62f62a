// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/outvoted.h"

#include "satsurf/core/parallel.h"
#include "satsurf/reconstruct/image_agreement.h"
#include "satsurf/reconstruct/shown_place.h"
#include "satsurf/scene/sight_lines.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

namespace satsurf::reconstruct {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr double kSquare = 8;                 // px along a square
constexpr Index kPoints = 4;                  // along it
constexpr Index kWindow = 3 * kPoints;        // of points, of a square and those around it
constexpr double kDiffers = 1, kLeans = 0.5;  // spreads of brightness
constexpr Index kNearby = 3;                  // squares either way whose structure counts
constexpr Index kLeastJudged = 5;             // of these, to go by
constexpr double kAlone = 0.6, kKnown = 0.3;  // share of them that shows nothing known, or enough
constexpr Index kLeastSpot = 36, kLeastSeeds = 9;  // squares
constexpr Index kRim = 6, kFringe = 2;  // squares that a spot reaches further, leaning and any

Exposures::Level level_of(std::vector<float>& values) {
  constexpr std::size_t kLeastPoints = 100;
  constexpr double kLeastSpread = 0.02;  // five grey levels: between less images differ by noise
  if (values.size() < kLeastPoints) return {};
  const auto median = [&] {
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
  };
  const float middle = median();
  for (float& v : values) v = std::abs(v - middle);
  return {static_cast<double>(middle), std::max(kLeastSpread, static_cast<double>(median()))};
}

/// Mean brightness of some pixels around a place; NaN where one of them shows nothing.
float brightness_around(const nn::PosedImage& image, const std::array<double, 2>& place) {
  constexpr double kApart = 3;  // px
  float sum = 0;
  for (const double dy : {-kApart, 0.0, kApart})
    for (const double dx : {-kApart, 0.0, kApart})
      sum += shown_brightness(image, {place[0] + dx, place[1] + dy});
  return sum / 9;
}

/// Rectangle around what the images see at one height: least x and y, largest x and y, local m.
std::array<double, 4> seen_by(const std::vector<nn::PosedImage>& images, double z) {
  std::array<double, 4> out{INFINITY, INFINITY, -INFINITY, -INFINITY};
  for (const nn::PosedImage& image : images)
    for (const Index row : {Index{0}, image.valid.dim(0)})
      for (const Index column : {Index{0}, image.valid.dim(1)}) {
        const auto p =
            image.local_from_pixel(static_cast<double>(column), static_cast<double>(row), z);
        out = {std::min(out[0], p[0]), std::min(out[1], p[1]), std::max(out[2], p[0]),
               std::max(out[3], p[1])};
      }
  return out;
}

/// What one square says of every image.
struct Judgement {
  bool differs = false;  ///< in brightness
  bool leans = false;    ///< that way, by half as much
  bool judged = false;   ///< two others confirm each other
  bool alone = false;    ///< and nobody this one
};

/// What every image shows of a square and those around it.
struct Shown {
  std::vector<std::array<float, kWindow * kWindow>> points;  ///< brightness, NaN where not seen
  std::vector<double> light;                                 ///< its mean, NaN for too few points

  explicit Shown(std::size_t images) : points(images), light(images) {}
  void find_light() {
    for (std::size_t v = 0; v < points.size(); ++v) {
      double sum = 0, count = 0;
      for (const float b : points[v])
        if (std::isfinite(b)) sum += static_cast<double>(b), count += 1;
      light[v] = 2 * count >= kWindow * kWindow ? sum / count : std::nan("");
    }
  }
};

/// Judges every image by the others.
/// out  [N]
void judge(const Shown& shown, const Exposures& exposures, std::vector<Judgement>& out) {
  const std::size_t N = out.size();
  // How far apart two images are, in spreads of brightness; NaN where nobody can tell.
  const auto apart = [&](std::size_t i, std::size_t j) {
    const Exposures::Level &a = exposures.level(i, j), &b = exposures.level(j, i);
    if (!(a.spread > 0 && b.spread > 0)) return std::nan("");
    return std::abs((shown.light[i] - a.middle) / a.spread -
                    (shown.light[j] - b.middle) / b.spread);
  };
  std::vector<double> like(N * N, -2), best(N, -2);  // correlations; -2 for none
  for (std::size_t i = 0; i < N; ++i)
    for (std::size_t j = 0; j < i; ++j)
      if (const auto c = correlation(shown.points[i], shown.points[j])) {
        like[i * N + j] = like[j * N + i] = *c;
        best[i] = std::max(best[i], *c), best[j] = std::max(best[j], *c);
      }
  for (std::size_t i = 0; i < N; ++i) {
    out[i] = {};
    double nearest = INFINITY;  // other image, by brightness
    for (std::size_t j = 0; j < N; ++j)
      if (const double d = j == i ? std::nan("") : apart(i, j); std::isfinite(d))
        nearest = std::min(nearest, d);
    for (std::size_t j = 0; j < N; ++j)
      for (std::size_t k = 0; k < j; ++k) {
        if (i == j || i == k) continue;
        const bool agree = std::isfinite(nearest) && 2 * apart(j, k) < nearest;
        out[i].differs |= agree && nearest > kDiffers;
        out[i].leans |= agree && nearest > kLeans;
        out[i].judged |= best[i] > -2 && like[j * N + k] >= kConfirmed;
      }
    out[i].alone = out[i].judged && best[i] < kUnlike;
  }
}

/// Where an image is outvoted: spots that differ in brightness, grown from where their structure is
/// nobody else's and as far as it is not the others', and a rim that leans towards them.
/// squares  [rows columns] of the image
/// flags    [rows columns] takes 1 there
void find_spots(const std::vector<Judgement>& squares, Index rows, Index columns, float* flags) {
  const auto around = [&](Index at, Index reach, auto&& visit) {
    const Index r = at / columns, c = at % columns;
    for (Index v = std::max<Index>(0, r - reach); v <= std::min(rows - 1, r + reach); ++v)
      for (Index u = std::max<Index>(0, c - reach); u <= std::min(columns - 1, c + reach); ++u)
        visit(v * columns + u);
  };
  std::vector<char> open(squares.size()), seed(squares.size());
  for (Index at = 0; at < rows * columns; ++at) {
    const auto n = static_cast<std::size_t>(at);
    if (!squares[n].differs) continue;
    double judged = 0, alone = 0;
    around(at, kNearby, [&](Index to) {
      judged += squares[static_cast<std::size_t>(to)].judged ? 1 : 0;
      alone += squares[static_cast<std::size_t>(to)].alone ? 1 : 0;
    });
    const bool known = judged >= kLeastJudged;
    seed[n] = known && alone >= kAlone * judged ? 1 : 0;
    open[n] = known && alone < kKnown * judged ? 0 : 1;
  }
  std::vector<Index> spot, accepted;
  for (Index start = 0; start < rows * columns; ++start) {
    spot.clear();
    const auto take = [&](Index at) {
      if (std::exchange(open[static_cast<std::size_t>(at)], char{0}) != 0) spot.push_back(at);
    };
    take(start);
    Index seeds = 0;
    for (std::size_t n = 0; n < spot.size(); ++n) {
      seeds += seed[static_cast<std::size_t>(spot[n])];
      around(spot[n], 1, take);
    }
    if (std::ssize(spot) < kLeastSpot || seeds < kLeastSeeds) continue;
    for (const Index at : spot) flags[at] = 1;
    accepted.insert(accepted.end(), spot.begin(), spot.end());
  }
  std::size_t first = 0;
  for (Index step = 0; step < kRim + kFringe; ++step) {
    const std::size_t end = accepted.size();
    for (; first < end; ++first)
      around(accepted[first], 1, [&](Index to) {
        if (flags[to] > 0 || (step < kRim && !squares[static_cast<std::size_t>(to)].leans)) return;
        flags[to] = 1, accepted.push_back(to);
      });
    if (step + 1 == kRim) first = 0;  // beyond, from all of it
  }
}

double mean_height(const Tensor& heights) {
  double sum = 0, count = 0;
  for (const float v : heights.values())
    if (std::isfinite(v)) sum += static_cast<double>(v), count += 1;
  return sum / count;
}

/// What is left of the grid's origin before the first cell, in cells of a whole square.
Index shift_of(double corner, double step, Index side) {
  const auto cells = static_cast<Index>(std::lround(corner / step));
  return ((cells % side) + side) % side;
}

}  // namespace

Exposures Exposures::among(const std::vector<std::size_t>& chosen) const {
  if (empty()) return {};
  Exposures out{.images = chosen.size(), .levels = {}};
  for (const std::size_t i : chosen)
    for (const std::size_t j : chosen) out.levels.push_back(level(i, j));
  return out;
}

Exposures exposures_of(const std::vector<nn::PosedImage>& images, double z) {
  constexpr Index kTried = 128;  // points a side
  const std::size_t N = images.size();
  if (N < 3) return {};  // nobody is outvoted by one other
  const auto [x0, y0, x1, y1] = seen_by(images, z);
  std::vector<float> shown(N * kTried * kTried);
  for_each_index(static_cast<Index>(N) * kTried, [&](Index line) {
    const nn::PosedImage& image = images[static_cast<std::size_t>(line / kTried)];
    const double y = y0 + (static_cast<double>(line % kTried) + 0.5) / kTried * (y1 - y0);
    for (Index k = 0; k < kTried; ++k) {
      const double x = x0 + (static_cast<double>(k) + 0.5) / kTried * (x1 - x0);
      shown[static_cast<std::size_t>(line * kTried + k)] =
          brightness_around(image, image.pixel_from_local(x, y, z));
    }
  });
  Exposures out{.images = N, .levels = std::vector<Exposures::Level>(N * N)};
  for_each_index(static_cast<Index>(N * N), [&](Index pair) {
    const float* mine = shown.data() + pair / static_cast<Index>(N) * kTried * kTried;
    const float* theirs = shown.data() + pair % static_cast<Index>(N) * kTried * kTried;
    std::vector<float> common;
    for (Index k = 0; k < kTried * kTried; ++k)
      if (std::isfinite(mine[k]) && std::isfinite(theirs[k])) common.push_back(mine[k]);
    out.levels[static_cast<std::size_t>(pair)] = level_of(common);
  });
  return out;
}

Outvoted::Outvoted(const scene::HeightField& surface, const std::vector<nn::PosedImage>& images,
                   const scene::SightLines& lines, const Exposures& exposures) {
  const std::size_t N = images.size();
  if (lines.empty() || N < 3 || exposures.images != N) return;
  const Index H = surface.z.dim(0), W = surface.z.dim(1), count = static_cast<Index>(N);
  side_ = std::max<Index>(
      1, std::lround(kSquare * mean_footprint(images, mean_height(surface.z)) / surface.step));
  shift_row_ = shift_of(-surface.y0, surface.step, side_);
  shift_col_ = shift_of(surface.x0, surface.step, side_);
  rows_ = (H - 1 + shift_row_) / side_ + 1, columns_ = (W - 1 + shift_col_) / side_ + 1;
  const Index lines_of_points = rows_ * kPoints, points_of_line = columns_ * kPoints;
  // The cells in which points lie, -1 beside the grid.
  const auto cell_of = [&](Index point, Index shift, Index cells) {
    const Index cell = (2 * point + 1) * side_ / (2 * kPoints) - shift;
    return cell >= 0 && cell < cells ? cell : -1;
  };
  Tensor points({count, lines_of_points, points_of_line}, kNan);
  for_each_index(lines_of_points, [&](Index line) {
    const Index i = cell_of(line, shift_row_, H);
    for (Index k = 0; k < points_of_line && i >= 0; ++k) {
      const Index j = cell_of(k, shift_col_, W);
      if (j < 0 || !std::isfinite(surface.z[i * W + j])) continue;
      const double x = surface.x0 + (static_cast<double>(j) + 0.5) * surface.step,
                   y = surface.y0 - (static_cast<double>(i) + 0.5) * surface.step,
                   z = static_cast<double>(surface.z[i * W + j]);
      for (Index v = 0; v < count; ++v) {
        const auto n = static_cast<std::size_t>(v);
        if (lines.sees(n, i, j))
          points[(v * lines_of_points + line) * points_of_line + k] =
              shown_brightness(images[n], images[n].pixel_from_local(x, y, z));
      }
    }
  });
  const Index P = rows_ * columns_;
  std::vector<std::vector<Judgement>> squares(N,
                                              std::vector<Judgement>(static_cast<std::size_t>(P)));
  for_each_index(rows_, [&](Index r) {
    Shown shown(N);
    std::vector<Judgement> judgements(N);
    for (Index c = 0; c < columns_; ++c) {
      for (Index v = 0; v < count; ++v)
        for (Index k = 0; k < kWindow * kWindow; ++k) {
          const Index y = (r - 1) * kPoints + k / kWindow, x = (c - 1) * kPoints + k % kWindow;
          const bool inside = y >= 0 && x >= 0 && y < lines_of_points && x < points_of_line;
          shown.points[static_cast<std::size_t>(v)][static_cast<std::size_t>(k)] =
              inside ? points[(v * lines_of_points + y) * points_of_line + x] : kNan;
        }
      shown.find_light();
      judge(shown, exposures, judgements);
      for (std::size_t v = 0; v < N; ++v)
        squares[v][static_cast<std::size_t>(r * columns_ + c)] = judgements[v];
    }
  });
  squares_ = Tensor({count, rows_, columns_});
  for_each_index(count, [&](Index v) {
    find_spots(squares[static_cast<std::size_t>(v)], rows_, columns_, squares_.data() + v * P);
  });
  if (std::ranges::none_of(squares_.values(), [](float flag) { return flag > 0; }))
    squares_ = Tensor();
}

}  // namespace satsurf::reconstruct
