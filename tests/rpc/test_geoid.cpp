// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/rpc/geoid.h"

#include <cmath>

#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::rpc;

TEST_CASE("the geoid of 1996 lies where published calculators say") {
  // Jacksonville, a low south of India, a high in New Guinea; m, of the 15' grid, to its rounding
  const auto above =
      geoid_heights(HeightDatum::egm96, {{-81.66, 30.32}, {78.7, 4.7}, {142.0, -5.0}});
  CHECK(above[0] == doctest::Approx(-29.0).epsilon(0.05));
  CHECK(above[1] < -100);
  CHECK(above[2] > 65);
}

TEST_CASE("heights above the geoid") {
  const UtmZone zone{17, true};
  const auto middle = utm_from_geodetic(zone, -81.66, 30.32);
  const GeoGrid grid{zone.epsg(), std::round(middle[0]), std::round(middle[1]), 20};
  Tensor heights({130, 70}, 5.0F);  // the last row and column of knots lie outside
  heights[3] = std::nanf("");
  refer_to_geoid(heights, grid, HeightDatum::egm96);
  CHECK(std::isnan(heights[3]));
  for (const auto& [i, j] : {std::array<Index, 2>{0, 0}, {129, 69}, {64, 64}, {100, 13}}) {
    const auto at = geodetic_from_utm(zone, grid.x0 + (static_cast<double>(j) + 0.5) * grid.step,
                                      grid.y0 - (static_cast<double>(i) + 0.5) * grid.step);
    const double expected = 5 - geoid_heights(HeightDatum::egm96, {at})[0];
    CHECK(static_cast<double>(heights[i * 70 + j]) == doctest::Approx(expected).epsilon(1e-4));
  }
}

TEST_CASE("a datum that is no geoid is refused") {
  CHECK_THROWS_AS(geoid_heights(HeightDatum::ellipsoid, {{0, 0}}), Error);
  Tensor heights({2, 2}, 0.0F);
  CHECK_THROWS_AS(refer_to_geoid(heights, {32631, 500000, 0, 1}, HeightDatum::none), Error);
  CHECK_THROWS_WITH_AS(
      refer_to_geoid(heights, {2154, 500000, 0, 1}, HeightDatum::egm96),
      "refer_to_geoid: a grid in EPSG:2154, expected a zone of UTM (EPSG:326xx or 327xx)", Error);
}
