// SPDX-License-Identifier: Apache-2.0
#include "satsurf/evaluate/metrics.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include <Eigen/QR>

namespace satsurf::evaluate {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

/// Middle value, mean of the two middle ones for an even count; NaN of nothing. Reorders its
/// argument.
double median_of(std::vector<double>& values) {
  if (values.empty()) return kNan;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  if (values.size() % 2 == 1) return *middle;
  return 0.5 * (*middle + *std::max_element(values.begin(), middle));
}

bool counts(const Tensor& mask, Index i) { return mask.empty() || mask[i] != 0; }

/// Signed errors of the cells that have both heights.
/// wanted  of a cell's index, whether it counts
template <class F>
std::vector<double> errors_where(const Tensor& prediction, const Tensor& truth, const F& wanted) {
  const auto compared = [&](Index i) {
    return wanted(i) && std::isfinite(truth[i]) && std::isfinite(prediction[i]);
  };
  std::size_t number = 0;
  for (Index i = 0; i < truth.count(); ++i) number += compared(i);
  std::vector<double> errors;
  errors.reserve(number);  // growing would take twice as much
  for (Index i = 0; i < truth.count(); ++i)
    if (compared(i))
      errors.push_back(static_cast<double>(prediction[i]) - static_cast<double>(truth[i]));
  return errors;
}
std::vector<double> errors_of(const Tensor& prediction, const Tensor& truth, const Tensor& mask) {
  return errors_where(prediction, truth, [&](Index i) { return counts(mask, i); });
}

/// Heights less an offset that they have in common, which is taken out where they are read: another
/// copy of them would be.
struct Centred {
  Tensor z;
  float offset = 0;

  float at(Index i) const { return z[i] - offset; }
};

/// Half the resolution: mean of the known cells of each 2 x 2 block, NaN where none is known.
Centred halve(const Centred& from) {
  const Tensor& z = from.z;
  const Index H = (z.dim(0) + 1) / 2, W = (z.dim(1) + 1) / 2;
  auto out = Tensor::uninitialised({H, W});
  for (Index i = 0; i < H; ++i)
    for (Index j = 0; j < W; ++j) {
      float sum = 0, n = 0;
      for (Index r = 2 * i; r < std::min(2 * i + 2, z.dim(0)); ++r)
        for (Index c = 2 * j; c < std::min(2 * j + 2, z.dim(1)); ++c)
          if (const float v = from.at(r * z.dim(1) + c); std::isfinite(v)) sum += v, n += 1;
      out[i * W + j] = n > 0 ? sum / n : std::numeric_limits<float>::quiet_NaN();
    }
  return {out};
}

struct Correlation {
  double ncc = -2;
  Index cells = 0;
};

/// Normalised correlation of truth (i + di, j + dj) with prediction (i, j) over the cells both
/// know.
Correlation correlate(const Centred& prediction, const Centred& truth, Index di, Index dj) {
  const Index H = truth.z.dim(0), W = truth.z.dim(1);
  double n = 0, sp = 0, st = 0, spp = 0, stt = 0, spt = 0;
  for (Index i = std::max<Index>(0, -di); i < std::min(H, H - di); ++i)
    for (Index j = std::max<Index>(0, -dj); j < std::min(W, W - dj); ++j) {
      const double p = static_cast<double>(prediction.at(i * W + j));
      const double t = static_cast<double>(truth.at((i + di) * W + j + dj));
      if (!std::isfinite(p) || !std::isfinite(t)) continue;
      n += 1, sp += p, st += t, spp += p * p, stt += t * t, spt += p * t;
    }
  if (n < 2) return {};
  const double vp = spp - sp * sp / n, vt = stt - st * st / n;
  if (vp <= 0 || vt <= 0) return {};
  return {(spt - sp * st / n) / std::sqrt(vp * vt), static_cast<Index>(n)};
}

/// Takes a common offset out, so that the sums of squares above keep their digits.
Centred centred(const Tensor& z) {
  double sum = 0, n = 0;
  for (const float v : z.values())
    if (std::isfinite(v)) sum += static_cast<double>(v), n += 1;
  return {z, static_cast<float>(n > 0 ? sum / n : 0)};
}

/// Whole cells (rows, columns) by which the prediction has to move to agree best with the truth.
/// farthest  that it may move along either, cells
std::array<Index, 2> find_shift(const Tensor& prediction, const Tensor& truth, Index farthest) {
  constexpr Index kRadius = 5, kSide = 2 * kRadius + 1, kSmall = 100;
  std::vector<std::array<Centred, 2>> levels{{centred(prediction), centred(truth)}};
  while (std::min(levels.back()[0].z.dim(0), levels.back()[0].z.dim(1)) >= kSmall)
    levels.push_back({halve(levels.back()[0]), halve(levels.back()[1])});

  std::array<Index, 2> best{0, 0};
  for (auto level = levels.rbegin(); level != levels.rend(); ++level) {
    const auto& [p, t] = *level;
    const Index cell = Index{1} << (levels.rend() - level - 1);  // in cells of the finest level
    const Index most_cells = (farthest + cell - 1) / cell;
    const auto near = [&](Index shift) { return std::clamp(shift, -most_cells, most_cells); };
    const std::array<Index, 2> around{near(2 * best[0]), near(2 * best[1])};
    std::vector<Correlation> found(kSide * kSide);
    for_each_index(kSide * kSide, [&](Index k) {
      const Index di = around[0] + k / kSide - kRadius, dj = around[1] + k % kSide - kRadius;
      if (near(di) == di && near(dj) == dj)
        found[static_cast<std::size_t>(k)] = correlate(p, t, di, dj);
    });
    Index most = 0;
    for (const Correlation& c : found) most = std::max(most, c.cells);
    const Index centre = kSide * kSide / 2;  // wins ties, so that equal surfaces do not move
    Index winner = centre;
    for (Index k = 0; k < kSide * kSide; ++k) {
      const Correlation& c = found[static_cast<std::size_t>(k)];
      // a few cells that happen to agree are no evidence
      if (2 * c.cells >= most && c.ncc > found[static_cast<std::size_t>(winner)].ncc) winner = k;
    }
    best = {around[0] + winner / kSide - kRadius, around[1] + winner % kSide - kRadius};
  }
  return best;
}

/// Mean distance of a prediction's errors from their median, m, where another prediction is known
/// too: what is left of them when one offset is taken out. NaN where there are none.
double left_without_offset(const Tensor& prediction, const Tensor& other, const Tensor& truth) {
  std::vector<double> errors =
      errors_where(prediction, truth, [&](Index i) { return std::isfinite(other[i]); });
  const double median = median_of(errors);
  double sum = 0;
  for (const double e : errors) sum += std::abs(e - median);
  return sum / static_cast<double>(errors.size());
}

}  // namespace

double psnr(const Tensor& image, const Tensor& reference, const Tensor& mask) {
  Dims dim("psnr");
  dim.match("image", image, "C H W").match("reference", reference, "C H W");
  if (!mask.empty()) dim.match("mask", mask, "H W");
  const Index P = dim["H"] * dim["W"];
  double sum = 0, n = 0;
  for (Index i = 0; i < image.count(); ++i) {
    if (!counts(mask, i % P)) continue;
    const double d =
        static_cast<double>(std::clamp(image[i], 0.f, 1.f) - std::clamp(reference[i], 0.f, 1.f));
    sum += d * d, n += 1;
  }
  return n > 0 ? -10 * std::log10(sum / n) : kNan;
}

Tensor fit_colours(const Tensor& image, const Tensor& reference, const Tensor& mask) {
  Dims dim("fit_colours");
  dim.match("image", image, "C H W").match("reference", reference, "C H W");
  if (!mask.empty()) dim.match("mask", mask, "H W");
  const Index C = dim["C"], P = dim["H"] * dim["W"];

  // normal equations of [colours, 1] M = reference
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(C + 1, C + 1), B = Eigen::MatrixXd::Zero(C + 1, C);
  Eigen::VectorXd x = Eigen::VectorXd::Ones(C + 1), y(C);
  for (Index i = 0; i < P; ++i) {
    if (!counts(mask, i)) continue;
    for (Index c = 0; c < C; ++c)
      x[c] = static_cast<double>(image[c * P + i]),
      y[c] = static_cast<double>(reference[c * P + i]);
    A.noalias() += x * x.transpose();
    B.noalias() += x * y.transpose();
  }
  if (A(C, C) == 0) return image;
  const Eigen::MatrixXd M = A.completeOrthogonalDecomposition().solve(B);  // grey has rank 2

  auto out = Tensor::uninitialised(image.shape());
  for (Index i = 0; i < P; ++i) {
    for (Index c = 0; c < C; ++c) x[c] = static_cast<double>(image[c * P + i]);
    y.noalias() = M.transpose() * x;
    for (Index c = 0; c < C; ++c) out[c * P + i] = static_cast<float>(y[c]);
  }
  return out;
}

HeightScores score_heights(const Tensor& prediction, const Tensor& truth, const Tensor& mask) {
  Dims dim("score_heights");
  dim.match("prediction", prediction, "H W").match("truth", truth, "H W");
  if (!mask.empty()) dim.match("mask", mask, "H W");

  HeightScores s;
  for (Index i = 0; i < truth.count(); ++i) s.truth += counts(mask, i) && std::isfinite(truth[i]);
  std::vector<double> errors = errors_of(prediction, truth, mask);
  s.compared = static_cast<Index>(errors.size());

  double absolute = 0, squared = 0;
  std::array<double, 3> below{0, 0, 0};
  constexpr std::array<double, 3> kThresholds{1, 2.5, 7.5};  // m, those of the field's tables
  for (const double e : errors) {
    absolute += std::abs(e), squared += e * e;
    for (std::size_t t = 0; t < 3; ++t) below[t] += std::abs(e) < kThresholds[t];
  }
  const double n = s.compared > 0 ? static_cast<double>(s.compared) : kNan;
  const double all = s.truth > 0 ? static_cast<double>(s.truth) : kNan;
  s.completeness = static_cast<double>(s.compared) / all;
  s.mae = absolute / n, s.rmse = std::sqrt(squared / n);
  s.pag1 = below[0] / all, s.pag2_5 = below[1] / all, s.pag7_5 = below[2] / all;
  s.pag1_compared = below[0] / n, s.pag2_5_compared = below[1] / n,
  s.pag7_5_compared = below[2] / n;
  s.median = median_of(errors);
  for (double& e : errors) e = std::abs(e - s.median);
  s.nmad = 1.4826 * median_of(errors);  // the factor makes it sigma for normal errors
  return s;
}

Tensor resample(const scene::HeightField& field, const scene::HeightField& grid) {
  Dims dim("resample");
  dim.match("field", field.z, "H W").match("grid", grid.z, "h w");
  const Index H = dim["H"], W = dim["W"], h = dim["h"], w = dim["w"];
  auto out = Tensor::uninitialised({h, w});
  const float* z = field.z.data();
  for_range(h, 64, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i)
      for (Index j = 0; j < w; ++j) {
        const double u =
            (grid.x0 + (static_cast<double>(j) + 0.5) * grid.step - field.x0) / field.step - 0.5;
        const double v =
            (field.y0 - grid.y0 + (static_cast<double>(i) + 0.5) * grid.step) / field.step - 0.5;
        float value = std::numeric_limits<float>::quiet_NaN();
        // compared in double: a grid far away must not overflow an index
        if (u > -0.5 && v > -0.5 && u < static_cast<double>(W) - 0.5 &&
            v < static_cast<double>(H) - 0.5) {
          const auto c = static_cast<Index>(std::floor(u)), r = static_cast<Index>(std::floor(v));
          if (c >= 0 && r >= 0 && c + 1 < W && r + 1 < H) {
            const auto a = static_cast<float>(u - std::floor(u)),
                       b = static_cast<float>(v - std::floor(v));
            const float* q = z + r * W + c;
            value = (1 - b) * ((1 - a) * q[0] + a * q[1]) + b * ((1 - a) * q[W] + a * q[W + 1]);
          }
          if (!std::isfinite(value)) {
            const auto near_c = std::clamp<Index>(std::llround(u), 0, W - 1);
            const auto near_r = std::clamp<Index>(std::llround(v), 0, H - 1);
            value = z[near_r * W + near_c];
          }
        }
        out[i * w + j] = value;
      }
  });
  return out;
}

bool like_geoid(double offset, const std::optional<double>& geoid_height) {
  // m: geoids differ by 1 m or so, and surfaces have biases; what hardly any other fault comes to
  constexpr double kAlike = 4, kLarge = 15;
  if (!geoid_height) return std::abs(offset) >= kLarge;
  return std::abs(std::abs(offset) - std::abs(*geoid_height)) <= kAlike;
}

DsmComparison compare_dsm(const scene::HeightField& prediction, const scene::HeightField& truth,
                          Registration registration, const Tensor& mask, bool must_meet) {
  Tensor expected = truth.z;
  if (!mask.empty()) {
    Dims("compare_dsm").match("truth", truth.z, "H W").match("mask", mask, "H W");
    expected = truth.z.clone();
    for (Index i = 0; i < expected.count(); ++i)
      if (mask[i] == 0) expected[i] = std::numeric_limits<float>::quiet_NaN();
  }

  DsmComparison out;
  Tensor z = resample(prediction, truth);
  out.raw = score_heights(z, expected);
  if (registration == Registration::xyz) {
    const auto farthest =
        static_cast<Index>(std::max(1.0, std::floor(kFarthestShift / truth.step)));
    const auto [di, dj] = find_shift(z, expected, farthest);
    const std::array<double, 2> shift{static_cast<double>(dj) * truth.step,
                                      -static_cast<double>(di) * truth.step};
    if (di != 0 || dj != 0) {
      scene::HeightField moved = prediction;
      moved.x0 += shift[0], moved.y0 += shift[1];
      Tensor there = resample(moved, truth);
      // A shift that moves bad cells off the truth correlates better and helps nobody.
      if (left_without_offset(z, there, expected) <= left_without_offset(there, z, expected))
        out.refused_shift = shift;
      else
        z = std::move(there), out.shift = {shift[0], shift[1], 0};
    }
  }
  {
    std::vector<double> errors = errors_of(z, expected, {});
    if (errors.empty() && must_meet)
      throw Error(
          "compare_dsm: no cell with both a predicted and a true height, expected overlapping "
          "surfaces");
    if (registration != Registration::none && !errors.empty()) {
      out.shift[2] = -median_of(errors);
      for (float& v : z.values()) v += static_cast<float>(out.shift[2]);
    }
  }
  out.registered = score_heights(z, expected);
  out.surface = z;
  out.error = z.clone();
  for (Index i = 0; i < z.count(); ++i) out.error[i] -= expected[i];
  return out;
}

}  // namespace satsurf::evaluate
