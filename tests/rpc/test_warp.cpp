// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/rpc/warp.h"

#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::rpc;
using test::TempFolder;

namespace {

const UtmZone kZone{31, true};
constexpr Index kHeight = 160, kWidth = 240;

/// Some ground near the eastern end of the zone.
GeoGrid grid() {
  const auto middle = utm_from_geodetic(kZone, 5.8, 50.9);
  return {kZone.epsg(), std::round(middle[0]), std::round(middle[1]), 0.5};
}

/// A slope with a hole.
double height_at(double east, double north) {
  const GeoGrid g = grid();
  return 40 + 0.3 * (east - g.x0) - 0.2 * (north - g.y0);
}
bool hole(Index i, Index j) { return i >= 50 && i < 70 && j >= 100 && j < 140; }
/// Fields of three by two cells.
double field_at(Index row, Index column) { return (column / 3 + row / 2) % 2 != 0 ? 1 : 9; }
Tensor filled(double (*value)(double, double)) {
  const GeoGrid g = grid();
  Tensor out({kHeight, kWidth});
  for (Index i = 0; i < kHeight; ++i)
    for (Index j = 0; j < kWidth; ++j)
      out[i * kWidth + j] =
          hole(i, j) ? std::nanf("")
                     : static_cast<float>(value(g.x0 + (static_cast<double>(j) + 0.5) * g.step,
                                                g.y0 - (static_cast<double>(i) + 0.5) * g.step));
  return out;
}

}  // namespace

TEST_CASE("a surface in another system has the heights of the same ground") {
  const TempFolder folder("warp");
  write_geo_raster(folder / "dsm.tif", filled(height_at), grid(),
                   height_tags("Surface heights", HeightDatum::egm96));
  GeoTags counts;
  counts.unit = "", counts.type = CellType::uint8, counts.nodata = 255, counts.means = false;
  write_geo_raster(folder / "views.tif", filled([](double east, double north) {
                     const GeoGrid g = grid();
                     return field_at(static_cast<Index>((g.y0 - north) / g.step),
                                     static_cast<Index>((east - g.x0) / g.step));
                   }),
                   grid(), counts);
  const ProjectedCrs crs = projected_crs("EPSG:32632");
  const ProjectedGrid to = covering_grid(grid(), kHeight, kWidth, crs);
  CHECK(std::fmod(to.x0, 0.5) == 0);
  warp_raster(folder / "dsm.tif", to, Resampling::bilinear);
  warp_raster(folder / "views.tif", to, Resampling::nearest);
  for (const auto& left : std::filesystem::directory_iterator(folder / ""))
    CHECK(left.path().extension() == ".tif");

  const GeoRaster dsm = read_geo_raster(folder / "dsm.tif"),
                  views = read_geo_raster(folder / "views.tif");
  CHECK(dsm.grid == GeoGrid{32632, to.x0, to.y0, 0.5});
  CHECK(dsm.tags.heights == HeightDatum::egm96);
  CHECK(dsm.tags.unit == "m");
  CHECK(dsm.tags.description == "Surface heights");
  REQUIRE(dsm.values.shape() == Shape{to.height, to.width});
  Index known = 0, between = 0, wrong = 0, compared = 0;
  double worst = 0;
  const UtmZone zone{32, true};
  for (Index i = 0; i < to.height; ++i)
    for (Index j = 0; j < to.width; ++j) {
      const Index k = i * to.width + j;
      CHECK(std::isnan(dsm.values[k]) == std::isnan(views.values[k]));
      if (std::isnan(dsm.values[k])) continue;
      ++known;
      between += views.values[k] != 1 && views.values[k] != 9;
      const auto [lon, lat] =
          geodetic_from_utm(zone, to.x0 + (static_cast<double>(j) + 0.5) * to.step,
                            to.y0 - (static_cast<double>(i) + 0.5) * to.step);
      const auto there = utm_from_geodetic(kZone, lon, lat);
      const GeoGrid g = grid();
      const double x = (there[0] - g.x0) / g.step, y = (g.y0 - there[1]) / g.step;
      const bool beside = x < 1 || y < 1 || x > kWidth - 1 || y > kHeight - 1 ||
                          (x > 99 && x < 141 && y > 49 && y < 71);  // half of the cells is missing
      if (beside) continue;
      worst = std::max(
          worst, std::abs(static_cast<double>(dsm.values[k]) - height_at(there[0], there[1])));
      // places are found to a hundredth of a cell
      if (std::abs(x - std::round(x)) < 0.02 || std::abs(y - std::round(y)) < 0.02) continue;
      ++compared;
      wrong += static_cast<double>(views.values[k]) !=
               field_at(static_cast<Index>(y), static_cast<Index>(x));
    }
  CHECK(worst < 0.005);
  CHECK(between == 0);  // classes and counts have no means
  CHECK(wrong == 0);
  CHECK(compared > known * 4 / 5);
  // as many cells as there is ground, by the scales of the zones: 0.9996 and more beside the middle
  CHECK(static_cast<double>(known) == doctest::Approx(kHeight * kWidth - 20 * 40).epsilon(0.01));
}

TEST_CASE("systems that no grid can be in are refused in words") {
  const auto refuses = [](const std::string& text, const std::string& words) {
    try {
      projected_crs(text);
      FAIL_CHECK(text << " was taken");
    } catch (const ConfigError& e) {
      CHECK_MESSAGE(std::string(e.what()).find(words) != std::string::npos, e.what());
    }
  };
  refuses("EPSG:4326", "counts in degrees");
  refuses("EPSG:2263", "foot");
  refuses("EPSG:7415", "--geoid");
  refuses("EPSG:4978", "no projected system");
  refuses("EPSG:5773", "no projected system");
  refuses("EPSG:99999", "names no reference system");
  refuses("somewhere", "names no reference system");
  refuses("/etc/hostname", "names no reference system");
  CHECK(projected_crs("EPSG:31370").label == "EPSG:31370");
  CHECK(projected_crs("EPSG:31370").epsg == 31370);
  const ProjectedCrs own = projected_crs("+proj=tmerc +lon_0=5.8 +lat_0=50 +datum=WGS84 +units=m");
  CHECK(own.epsg == 0);
  CHECK_FALSE(own.label.empty());
}

TEST_CASE("a system that is made for elsewhere is refused") {
  const ProjectedCrs belgian = projected_crs("EPSG:31370");
  CHECK_NOTHROW(check_area_of_use(belgian, 4.4, 50.8));
  CHECK_NOTHROW(check_area_of_use(belgian, 7.5, 50.8));  // beside it
  CHECK_THROWS_AS(check_area_of_use(belgian, -81.6, 30.3), ConfigError);
  CHECK_THROWS_AS(check_area_of_use(belgian, 4.4, 54), ConfigError);
  const ProjectedCrs fiji = projected_crs("EPSG:3460");  // on both sides of the date line
  CHECK_NOTHROW(check_area_of_use(fiji, 178, -18));
  CHECK_NOTHROW(check_area_of_use(fiji, -179.5, -18));
  CHECK_THROWS_AS(check_area_of_use(fiji, 0, -18), ConfigError);
  const std::string said =
      test::error_of<ConfigError>([&] { check_area_of_use(belgian, 4.4, 54); });
  CHECK(said.find("EPSG:31370 is for Belgium - onshore (lon 2.5 to 6.4, ") != std::string::npos);
  // a name of many countries is told to its end, one of a page is not
  const auto place = [&](const char* code) {
    return test::error_of<ConfigError>([&] { check_area_of_use(projected_crs(code), 4.4, -54); });
  };
  CHECK(place("EPSG:32636").find("Uganda. Ukraine (lon ") != std::string::npos);
  const std::string maine = place("EPSG:3463");
  CHECK(maine.size() < 800);
  CHECK(maine.find(" ... (lon ") != std::string::npos);
  CHECK_NOTHROW(check_area_of_use(projected_crs("EPSG:3857"), 4.4, 50.8));
  CHECK_NOTHROW(check_area_of_use(projected_crs("+proj=tmerc +lon_0=5 +datum=WGS84"), 5, 50));
}

TEST_CASE("rasters are not warped by guesses") {
  // a datum that nobody has tied to any other
  const ProjectedCrs unknown = projected_crs("+proj=tmerc +lon_0=5.8 +lat_0=50 +ellps=airy");
  CHECK_THROWS_AS(covering_grid(grid(), 10, 10, unknown), Error);
}
