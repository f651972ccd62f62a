// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/rpc/geoid.h"
#include "satsurf/rpc/ground_raster.h"

#include <array>
#include <cmath>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>
#include <gdal_priv.h>
#include <ogr_spatialref.h>

using namespace satsurf;
using namespace satsurf::rpc;
using test::TempFolder;
using test::write_bytes;

namespace {

const UtmZone kZone{17, true};
constexpr double kEast = 500000, kNorth = 3350000;  // of the ground, m: its south-western corner

/// A raster of 10 m cells over 200 m x 200 m, in the zone.
void write_raster(const std::filesystem::path& path, float (*value)(Index row, Index column),
                  const GeoTags& tags) {
  Tensor values({20, 20});
  for (Index i = 0; i < 400; ++i) values[i] = value(i / 20, i % 20);
  write_geo_raster(path, values, {kZone.epsg(), kEast, kNorth + 200, 10}, tags);
}

/// Heights from 30 in the west to 49 in the east, with a tower of one cell.
float slope(Index row, Index column) {
  return row == 10 && column == 5 ? 80.0F : 30.0F + static_cast<float>(column);
}

/// The same raster as DFC2019 has them: its place is in a text file beside it.
void write_dfc_raster(const std::filesystem::path& path, float (*value)(Index row, Index column)) {
  GDALAllRegister();
  GDALDriver* driver = GetGDALDriverManager()->GetDriverByName("GTiff");
  const std::unique_ptr<GDALDataset> d(
      driver->Create(path.c_str(), 20, 20, 1, GDT_Float32, nullptr));
  REQUIRE(d);
  std::array<float, 400> values{};
  for (Index i = 0; i < 400; ++i) values[static_cast<std::size_t>(i)] = value(i / 20, i % 20);
  REQUIRE(d->GetRasterBand(1)->RasterIO(GF_Write, 0, 0, 20, 20, values.data(), 20, 20, GDT_Float32,
                                        0, 0, nullptr) == CE_None);
}

constexpr Index kRows = 60, kColumns = 90;
constexpr double kCell = 1e-4;  // degrees

/// West and north of cells in degrees around the middle of the ground.
std::array<double, 2> corner() {
  const auto [lon, lat] = geodetic_from_utm(kZone, kEast + 100, kNorth + 100);
  return {lon - kCell * kColumns / 2, lat + kCell * kRows / 2};
}

/// A raster of cells in degrees, as those of SRTM and Copernicus.
void write_degrees(const std::filesystem::path& path, int epsg,
                   float (*value)(Index row, Index column)) {
  GDALAllRegister();
  GDALDriver* driver = GetGDALDriverManager()->GetDriverByName("GTiff");
  const std::unique_ptr<GDALDataset> d(
      driver->Create(path.c_str(), kColumns, kRows, 1, GDT_Float32, nullptr));
  REQUIRE(d);
  const auto [west, north] = corner();
  std::array<double, 6> place{west, kCell, 0, north, 0, -kCell};
  REQUIRE(d->SetGeoTransform(place.data()) == CE_None);
  OGRSpatialReference crs;
  REQUIRE(crs.importFromEPSG(epsg) == OGRERR_NONE);
  REQUIRE(d->SetSpatialRef(&crs) == CE_None);
  std::vector<float> values;
  for (Index i = 0; i < kRows * kColumns; ++i) values.push_back(value(i / kColumns, i % kColumns));
  REQUIRE(d->GetRasterBand(1)->RasterIO(GF_Write, 0, 0, kColumns, kRows, values.data(), kColumns,
                                        kRows, GDT_Float32, 0, 0, nullptr) == CE_None);
}

/// A slope of 2 m a cell to the east and 0.9 m a cell to the north.
double height_at(double lon, double lat) {
  const auto [west, north] = corner();
  return 100 + (2 * (lon - west) + 0.9 * (lat - north)) / kCell;
}

double geoid() {
  const auto at = geodetic_from_utm(kZone, kEast + 100, kNorth + 100);
  return geoid_heights(HeightDatum::egm96, {at})[0];  // below the ellipsoid here
}

const std::array<double, 4> kGround{kEast + 30, kNorth + 30, kEast + 170, kNorth + 170};

}  // namespace

TEST_CASE("a mask is where its raster is neither zero nor nodata, in any system") {
  const TempFolder folder("mask");
  const GeoTags tags{.unit = "", .type = CellType::uint8, .nodata = 255, .means = false};
  write_raster(
      folder / "water.tif",
      [](Index row, Index column) {
        return row < 5 ? std::nanf("") : column >= 10 ? 9.0F : 0.0F;  // unknown in the north
      },
      tags);
  const GroundMask mask(folder / "water.tif");
  const Tensor here = mask.on({kZone.epsg(), kEast, kNorth + 200, 5}, 40, 40);
  for (Index i = 0; i < here.count(); ++i)
    CHECK(here[i] == (i / 40 >= 10 && i % 40 >= 20 ? 1.0F : 0.0F));
  const Tensor beside = mask.on({kZone.epsg(), kEast + 150, kNorth + 50, 10}, 5, 20);
  for (Index i = 0; i < beside.count(); ++i) CHECK(beside[i] == (i % 20 < 5 ? 1.0F : 0.0F));

  // the same ground in the next zone
  const auto [lon, lat] = geodetic_from_utm(kZone, kEast + 150, kNorth + 50);
  const auto there = utm_from_geodetic({18, true}, lon, lat);
  const Tensor other = mask.on({32618, there[0] - 2.5, there[1] + 2.5, 5}, 1, 1);
  CHECK(other[0] == 1);
  CHECK_THROWS_WITH_AS(
      mask.on({2154, kEast, kNorth + 200, 5}, 40, 40),
      "GroundMask::on: a grid in EPSG:2154, expected a zone of UTM (EPSG:326xx or 327xx)", Error);
}

TEST_CASE("a mask of polygons") {
  const TempFolder folder("mask_polygons");
  write_bytes(folder / "lake.geojson", R"({"type":"FeatureCollection",
"crs":{"type":"name","properties":{"name":"EPSG:32617"}},"features":[{"type":"Feature","properties":{},
"geometry":{"type":"Polygon","coordinates":[[[500050,3350050],[500150,3350050],[500150,3350150],
[500050,3350150],[500050,3350050]]]}}]})");
  const GroundMask mask(folder / "lake.geojson");
  const Tensor here = mask.on({kZone.epsg(), kEast, kNorth + 200, 10}, 20, 20);
  for (Index i = 0; i < here.count(); ++i) {
    const Index y = i / 20, x = i % 20;
    CHECK(here[i] == (y >= 5 && y < 15 && x >= 5 && x < 15 ? 1.0F : 0.0F));
  }
}

TEST_CASE("masks without a place are refused") {
  const TempFolder folder("mask_refused");
  write_bytes(folder / "text.txt", "none");
  CHECK_THROWS_AS(GroundMask(folder / "text.txt"), IoError);
  CHECK_THROWS_AS(GroundMask(folder / "missing.tif"), IoError);
  const GeoTags tags{.unit = ""};
  write_geo_raster(folder / "nowhere.tif", Tensor({4, 4}, 1.0F), {0, 0, 0, 1}, tags);
  CHECK_THROWS_AS(GroundMask(folder / "nowhere.tif"), IoError);
}

TEST_CASE("a terrain's lowest and highest height, by what it says they are above") {
  const TempFolder folder("terrain");
  write_raster(folder / "ellipsoid.tif", slope, ellipsoidal_height("Terrain"));
  write_raster(folder / "geoid.tif", slope, height_tags("Terrain", HeightDatum::egm96));
  write_raster(folder / "silent.tif", slope, height_tags("Terrain", HeightDatum::none));
  const TerrainHeights known = Terrain(folder / "ellipsoid.tif").over(kZone, kGround);
  CHECK(known.covered == 1);
  CHECK_FALSE(known.either);
  CHECK(known.heights.low >= 30);
  CHECK(known.heights.low <= 33);
  CHECK(known.heights.high == 80);  // a tower of one cell counts
  const TerrainHeights raised = Terrain(folder / "geoid.tif").over(kZone, kGround);
  CHECK_FALSE(raised.either);
  CHECK(std::abs(raised.heights.low - (known.heights.low + geoid())) < 0.02);
  CHECK(std::abs(raised.heights.high - (80 + geoid())) < 0.02);
  const TerrainHeights silent = Terrain(folder / "silent.tif").over(kZone, kGround);
  CHECK(silent.either);
  CHECK(silent.heights.low == doctest::Approx(raised.heights.low));
  CHECK(silent.heights.high == 80);
}

TEST_CASE("terrain in degrees, of two axes and of three") {
  const TempFolder folder("terrain_degrees");
  const auto over = [&](int epsg, const std::array<double, 4>& ground) {
    const auto path = folder / (std::to_string(epsg) + ".tif");
    write_degrees(path, epsg, [](Index row, Index column) {
      const auto [west, north] = corner();
      return static_cast<float>(height_at(west + (static_cast<double>(column) + 0.5) * kCell,
                                          north - (static_cast<double>(row) + 0.5) * kCell));
    });
    return Terrain(path).over(kZone, ground);
  };
  // lowest in the south-west, highest in the north-east, two cells beside the ground
  constexpr double kRim = 2 * kCell * 111e3, kHalfCell = 1.46;  // m, the latter of height
  const auto height = [](double east, double north) {
    const auto [lon, lat] = geodetic_from_utm(kZone, east, north);
    return height_at(lon, lat);
  };
  const TerrainHeights known = over(4979, kGround);
  CHECK_FALSE(known.either);
  CHECK(known.covered == 1);
  CHECK(std::abs(known.heights.low - height(kGround[0] - kRim, kGround[1] - kRim)) < kHalfCell);
  CHECK(std::abs(known.heights.high - height(kGround[2] + kRim, kGround[3] + kRim)) < kHalfCell);
  // two axes do not say what the heights are above
  const TerrainHeights silent = over(4326, kGround);
  CHECK(silent.either);
  CHECK(silent.covered == 1);
  CHECK(std::abs(silent.heights.low - (known.heights.low + geoid())) < 0.02);
  CHECK(silent.heights.high == known.heights.high);
  // ground that is half beside it, in the east and in the south
  const auto [west, north] = corner();
  const auto side = utm_from_geodetic(kZone, west + kCell * kColumns, north - kCell * kRows / 2),
             foot = utm_from_geodetic(kZone, west + kCell * kColumns / 2, north - kCell * kRows);
  for (const auto& [x, y] : {side, foot}) {
    const TerrainHeights half = over(4326, {x - 70, y - 70, x + 70, y + 70});
    CHECK(half.covered == doctest::Approx(0.5).epsilon(0.01));
  }
}

TEST_CASE("a mask in degrees has the value of the cell under every middle") {
  const TempFolder folder("mask_degrees");
  const auto value = [](Index row, Index column) {
    return (3 * row + 7 * column) % 5 < 2 ? 4.0F : 0.0F;
  };
  write_degrees(folder / "water.tif", 4326, value);
  const auto [west, north] = corner();
  const auto [x, y] = utm_from_geodetic(kZone, west, north);
  const GeoGrid grid{kZone.epsg(), std::round(x) - 50, std::round(y) + 30, 4};
  constexpr Index H = 50, W = 80;
  const Tensor here = GroundMask(folder / "water.tif").on(grid, H, W);
  Index wrong = 0, masked = 0;
  for (Index i = 0; i < H * W; ++i) {
    const auto [lon, lat] =
        geodetic_from_utm(kZone, grid.x0 + (static_cast<double>(i % W) + 0.5) * grid.step,
                          grid.y0 - (static_cast<double>(i / W) + 0.5) * grid.step);
    const double u = (lon - west) / kCell, v = (north - lat) / kCell;
    // places are found to a hundredth of a cell
    if (std::abs(u - std::round(u)) < 0.02 || std::abs(v - std::round(v)) < 0.02) continue;
    const float wanted =
        u > 0 && v > 0 && value(static_cast<Index>(v), static_cast<Index>(u)) > 0 ? 1.0F : 0.0F;
    wrong += here[i] != wanted;
    masked += wanted > 0;
  }
  CHECK(wrong == 0);
  CHECK(masked > 1000);
}

TEST_CASE("a terrain says of how much ground it knows nothing") {
  const TempFolder folder("terrain_holes");
  write_raster(
      folder / "half.tif", [](Index, Index column) { return column >= 10 ? std::nanf("") : 5.0F; },
      ellipsoidal_height("Terrain"));
  const Terrain terrain(folder / "half.tif");
  const TerrainHeights half = terrain.over(kZone, kGround);
  CHECK(half.covered == doctest::Approx(0.5).epsilon(0.05));
  CHECK(half.heights == HeightRange{5, 5});
  CHECK(terrain.over(kZone, {kEast + 1000, kNorth, kEast + 1100, kNorth + 100}).covered == 0);
  // ground within one cell
  CHECK(terrain.over(kZone, {kEast + 52, kNorth + 52, kEast + 53, kNorth + 53}).covered == 1);
}

TEST_CASE("grids of DFC2019 lie where the text file beside them says, in the zone of the images") {
  const TempFolder folder("terrain_dfc");
  write_dfc_raster(folder / "A_DSM.tif", slope);
  write_dfc_raster(folder / "A_CLS.tif",
                   [](Index, Index column) { return column >= 10 ? 9.0F : 0.0F; });
  CHECK_THROWS_WITH_AS(
      Terrain(folder / "A_DSM.tif"),
      ((folder / "A_DSM.tif").string() + ": no georeference, expected one in the file or in " +
       (folder / "A_DSM.txt").string())
          .c_str(),
      IoError);
  write_dfc_grid(folder / "A_DSM.txt", {kZone.epsg(), kEast, kNorth + 200, 10}, 20);

  const TerrainHeights known = Terrain(folder / "A_DSM.tif").over(kZone, kGround);
  CHECK(known.covered == 1);
  CHECK(known.either);
  CHECK(known.heights.high == 80);
  CHECK(Terrain(folder / "A_DSM.tif").over({18, true}, kGround).covered == 1);  // same numbers

  const GroundMask mask(folder / "A_CLS.tif");
  const Tensor here = mask.on({kZone.epsg(), kEast, kNorth + 200, 5}, 40, 40);
  for (Index i = 0; i < here.count(); ++i) CHECK(here[i] == (i % 40 >= 20 ? 1.0F : 0.0F));
}

TEST_CASE("of a raster of classes the values that are named are the mask") {
  const TempFolder folder("mask_classes");
  const GeoTags tags{.unit = "", .type = CellType::uint8, .nodata = 255, .means = false};
  write_raster(
      folder / "classes.tif",
      [](Index row, Index column) {
        return row < 5 ? std::nanf("") : column < 5 ? 0.0F : column < 10 ? 2.0F : 9.0F;
      },
      tags);
  const GeoGrid grid{kZone.epsg(), kEast, kNorth + 200, 10};
  const auto masked = [&](const std::vector<double>& values) {
    return GroundMask(folder / "classes.tif", values).on(grid, 20, 20);
  };
  const Tensor all = masked({}), water = masked({9, 17}), ground = masked({0, 2, 255});
  for (Index i = 0; i < all.count(); ++i) {
    const bool known = i / 20 >= 5;
    CHECK(all[i] == (known && i % 20 >= 5 ? 1.0F : 0.0F));
    CHECK(water[i] == (known && i % 20 >= 10 ? 1.0F : 0.0F));
    CHECK(ground[i] == (known && i % 20 < 10 ? 1.0F : 0.0F));
  }
  write_bytes(folder / "lake.geojson", R"({"type":"Point","coordinates":[0,0]})");
  CHECK_THROWS_AS(GroundMask(folder / "lake.geojson", {9}), ConfigError);
}

TEST_CASE("terrain and masks that lie nowhere, and heights on no Earth, are refused") {
  const TempFolder folder("nowhere");
  const std::string p = (folder / "x.tif").string();
  const double nan = std::nan("");
  for (const auto& [east, north, cell] : {std::array{nan, kNorth, 10.0},
                                          {1e300, kNorth, 10.0},
                                          {kEast, INFINITY, 10.0},
                                          {kEast, kNorth, 1e-300},
                                          {kEast, kNorth, 1e300}}) {
    write_raster(p, slope, {});
    {
      const std::unique_ptr<GDALDataset> d(
          GDALDataset::Open(p.c_str(), GDAL_OF_RASTER | GDAL_OF_UPDATE));
      REQUIRE(d);
      std::array<double, 6> place{east, cell, 0, north, 0, -cell};
      REQUIRE(d->SetGeoTransform(place.data()) == CE_None);
    }
    CHECK(test::error_of<IoError>([&] { Terrain{p}; }).starts_with(p + ": a grid at ("));
    CHECK(test::error_of<IoError>([&] { GroundMask{p}; }).starts_with(p + ": a grid at ("));
  }
  write_raster(p, [](Index, Index column) { return column == 9 ? 1e38F : 30.0F; }, {});
  CHECK(test::error_of<IoError>([&] { Terrain(p).over(kZone, kGround); }) ==
        p + ": heights from 30 to 1e+38 m, expected at most 1000 km either way");
}

TEST_CASE("terrain in feet is refused") {
  const TempFolder folder("terrain_feet");
  const GeoTags tags{.unit = "ft"};
  write_raster(folder / "feet.tif", slope, tags);
  CHECK_THROWS_WITH_AS(
      Terrain(folder / "feet.tif"),
      ((folder / "feet.tif").string() + ": heights in ft, expected metres").c_str(), IoError);
}
