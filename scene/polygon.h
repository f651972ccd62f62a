// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/ground.h"

#include <array>
#include <vector>

namespace satsurf::scene {

/// A convex polygon on the ground, m, counter-clockwise.
using Polygon = std::vector<std::array<double, 2>>;

/// m2.
double polygon_area(const Polygon& polygon);
/// throws  Error for a polygon without area
std::array<double, 2> polygon_centroid(const Polygon& polygon);
/// The part of `a` inside `b`; empty if they do not meet.
/// Source: Sutherland and Hodgman 1974.
Polygon intersect(const Polygon& a, const Polygon& b);
/// The same polygon with its corners in that order, whichever way round they came.
Polygon counter_clockwise(Polygon corners);
/// The smallest one around some points; empty where they lie on a line.
/// Source: Andrew 1979, "Another efficient algorithm for convex hulls in two dimensions".
Polygon convex_hull(std::vector<std::array<double, 2>> points);
/// A rectangle as a polygon.
Polygon corners_of(const Ground& ground);
/// The smallest rectangle around a polygon.
Ground bounds_of(const Polygon& polygon);
/// Whether a point lies in it or on its rim.
bool contains(const Polygon& polygon, double x, double y);

}  // namespace satsurf::scene
