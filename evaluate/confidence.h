// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <array>
#include <cstddef>
#include <string>
#include <vector>

namespace satsurf::evaluate {

/// Errors of the pixels whose confidence lies in [low, high), or up to 1 with it. Means over nothing
/// are NaN.
struct ConfidenceBin {
  double low = 0, high = 0;
  double confidence = 0;  ///< mean
  Index pixels = 0;
  double mae = 0, rmse = 0;                 ///< m
  double pag1 = 0, pag2_5 = 0, pag7_5 = 0;  ///< share of the pixels with |error| < 1, 2.5, 7.5 m
};

/// How the error depends on the confidence, gathered pixel by pixel in little memory: what is kept
/// are sums over slices of the confidence of 1e-5.
class ConfidenceErrors {
 public:
  ConfidenceErrors();

  /// Adds the pixels that have both numbers.
  /// confidence  [H W] in [0, 1]; beyond it counts as its end
  /// error       [H W] m, NaN where unknown
  /// throws      ShapeError
  void add(const Tensor& confidence, const Tensor& error);

  Index pixels() const;
  /// Bins of equal width over [0, 1].
  std::vector<ConfidenceBin> equal_width() const;
  /// Bins of equally many pixels, least confident first. Pixels of one slice stay together, so
  /// counts differ by up to a slice's, and there are fewer bins where a slice has more than a bin.
  std::vector<ConfidenceBin> equal_count() const;
  /// Whether each bin of `equal_count` has a smaller mean |error| than the one before; false for
  /// fewer than kFewest, which are no trend.
  bool monotone() const;

  static constexpr Index kBins = 10;
  static constexpr std::size_t kFewest = 3;  ///< two bins fall by chance every other time

 private:
  struct Slice {
    Index pixels = 0;
    double confidence = 0, absolute = 0, squared = 0;
    std::array<Index, 3> below{0, 0, 0};
  };
  ConfidenceBin joined(std::size_t begin, std::size_t end) const;
  std::vector<Slice> slices_;
};

/// Errors with the name that tables call them by, e.g. `mvs_source`, and a title for people.
struct NamedConfidence {
  std::string name, title;
  const ConfidenceErrors* errors;
};
/// The same as CSV, one row per bin: of (the name), bins (equal_width or equal_count), low, high,
/// confidence, pixels, share (of all pixels), mae, rmse, pag1, pag2.5, pag7.5. Cells of numbers that
/// do not exist are empty.
std::string confidence_csv(const std::vector<NamedConfidence>& all);

}  // namespace satsurf::evaluate
