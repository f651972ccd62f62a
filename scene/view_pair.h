// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/scene.h"

#include <optional>

namespace satsurf::scene {

/// How two views go together.
struct ViewPair {
  double share = 0;     ///< of the smaller footprint that both see
  double parallax = 0;  ///< pixels by which the ground moves per metre of height
  /// Metres on the ground by which their rays part per metre of height: the base-to-height ratio.
  double base = 0;
  std::optional<double> suns_deg{};  ///< between the directions to their suns
  std::optional<double> days{};      ///< between their dates
};
/// h        of the ground, m above the ellipsoid
/// returns  of views without common ground what the sun and the dates say
/// throws   Error
ViewPair view_pair(const View& a, const View& b, double h);

/// Degrees between two directions to the sun; nothing where a view does not say where it stood.
std::optional<double> suns_apart(const View& a, const View& b);
/// Days between two dates that begin with year, month and day, with or without marks between;
/// nothing for others. Months count as 30.4 days.
std::optional<double> days_apart(const View& a, const View& b);

/// Parallax below which two images are seen from one direction and carry no height, pixels per
/// metre: a tenth of a pixel for a tower of 100 m.
inline constexpr double kLeastParallax = 1e-3;

}  // namespace satsurf::scene
