// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>

namespace satsurf::rpc {

/// Lowest and highest height, m. Named `height_range` it counts from the ellipsoid; named `z_range`
/// from the origin of a local frame, which converts it (`LocalFrame::z_from_heights`).
struct HeightRange {
  double low = 0, high = 0;

  double span() const { return high - low; }
  double middle() const { return 0.5 * (low + high); }
  /// Neither empty nor a single height.
  bool has_span() const { return low < high; }
  HeightRange widened(double by) const { return {low - by, high + by}; }
  friend bool operator==(const HeightRange&, const HeightRange&) = default;
};

/// The least range that holds both.
inline HeightRange hull(const HeightRange& a, const HeightRange& b) {
  return {std::min(a.low, b.low), std::max(a.high, b.high)};
}

}  // namespace satsurf::rpc
