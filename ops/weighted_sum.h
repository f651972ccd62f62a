// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>

namespace satsurf {

/// What a weighted mean is made of; for `ordered_reduce`.
struct WeightedSum {
  double sum = 0, weight = 0;
  WeightedSum& operator+=(const WeightedSum& o) {
    sum += o.sum;
    weight += o.weight;
    return *this;
  }
  /// The weight, never 0: without any the mean is 0, not 0 / 0.
  double total() const { return std::max(weight, 1e-12); }
  double mean() const { return sum / total(); }
};

}  // namespace satsurf
