// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/tiled_files.h"
#include "satsurf/core/error.h"
#include "satsurf/rpc/geoid.h"
#include "satsurf/rpc/raster.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <optional>
#include <vector>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::app;
using test::TempFolder;

namespace {

/// Two tiles of 6 x 8 cells side by side, each two cells into the other.
reconstruct::Tiling two_tiles() {
  reconstruct::Tiling out;
  out.grid = {100, 200, 0.5, 8, 12};
  out.columns = 2, out.overlap = 2;
  out.tiles = {out.tile(0, 0, {0, 0}, {6, 8}), out.tile(0, 1, {6, 0}, {12, 8})};
  return out;
}

/// A level surface, without expected errors.
reconstruct::TileSurface level(float z) {
  reconstruct::TileSurface out;
  out.empty = false;
  out.heights = Tensor({8, 8}, z), out.confidence = Tensor({8, 8}, 0.5f);
  out.views = Tensor({8, 8}, 2.f), out.ortho = Tensor({1, 8, 8}, 9.f);
  return out;
}

TileRecord done() {
  TileRecord out;
  out.status = "done";
  return out;
}

/// A scene south of the Himalaya, where the geoid is steep.
scene::Scene somewhere() {
  scene::Scene scene;
  scene.frame = {{45, true}, 500000, 3e6, 30};
  return scene;
}

/// Puts tiles down and makes rasters of them in `folder`.
TiledSurface made_of(const TempFolder& folder, const reconstruct::Tiling& tiling,
                     const std::vector<reconstruct::TileSurface>& surfaces,
                     rpc::HeightDatum datum = rpc::HeightDatum::ellipsoid,
                     const std::optional<rpc::Area>& polygons = {}) {
  TileStore store(folder / "run", false, true);
  for (std::size_t k = 0; k < surfaces.size(); ++k)
    store.save(tiling.tiles[k], done(), surfaces[k]);
  return write_tiled_surface(folder.path(), tiling,
                             std::vector<TileRecord>(surfaces.size(), done()), store, somewhere(),
                             false, datum, polygons, [](double) {});
}
TiledSurface made_of(const TempFolder& folder, const reconstruct::TileSurface& west,
                     const reconstruct::TileSurface& east) {
  return made_of(folder, two_tiles(), {west, east});
}

/// Four tiles of 10 x 12 cells, each two cells into the others: the rows of the whole come in two
/// batches, the second from row 5 on.
reconstruct::Tiling four_tiles(double step) {
  reconstruct::Tiling out;
  out.grid = {100, 200, step, 10, 12};
  out.rows = out.columns = 2, out.overlap = 2;
  out.tiles = {out.tile(0, 0, {0, 0}, {5, 7}), out.tile(0, 1, {5, 0}, {12, 7}),
               out.tile(1, 0, {0, 7}, {5, 10}), out.tile(1, 1, {5, 7}, {12, 10})};
  return out;
}

/// Which cell of the grid a cell is, in whatever tile: ten times its row and its column.
float number_of(Index row, Index column) { return static_cast<float>(10 * row + column); }

/// What a tile has of a surface whose cells tell which they are.
reconstruct::TileSurface numbered(const reconstruct::Tile& tile) {
  const reconstruct::CellRect& all = tile.all;
  const Shape shape{all.height(), all.width()};
  reconstruct::TileSurface out;
  out.empty = false;
  out.heights = Tensor(shape), out.confidence = Tensor(shape), out.sigma = Tensor(shape);
  out.views = Tensor(shape), out.ortho = Tensor({1, all.height(), all.width()});
  for (Index i = 0; i < out.heights.count(); ++i) {
    const float n = number_of(all.y0 + i / all.width(), all.x0 + i % all.width());
    out.heights[i] = n, out.confidence[i] = n / 128, out.sigma[i] = n + 1;
    out.views[i] = n + 2, out.ortho[i] = n + 3;
  }
  return out;
}
std::vector<reconstruct::TileSurface> numbered(const reconstruct::Tiling& tiling) {
  std::vector<reconstruct::TileSurface> out;
  for (const reconstruct::Tile& tile : tiling.tiles) out.push_back(numbered(tile));
  return out;
}

}  // namespace

TEST_CASE("tiles become one raster of every kind, and the way from one to the other is blended") {
  const TempFolder folder("tiled");
  reconstruct::TileSurface west = level(4), east = level(8);
  west.sigma = east.sigma = Tensor({8, 8}, 0.25f);
  const TiledSurface made = made_of(folder, west, east);
  CHECK(made.heights.low == 34);
  CHECK(made.heights.high == 38);
  CHECK(made.mean_confidence == doctest::Approx(0.5));
  const rpc::GeoRaster dsm = rpc::read_geo_raster(folder / "dsm.tif");
  CHECK(dsm.values.shape() == Shape{8, 12});
  CHECK(dsm.grid.x0 == 500100);
  for (Index y = 0; y < 8; ++y) {
    for (Index x = 0; x < 12; ++x) {
      const float z = dsm.values[y * 12 + x];
      CHECK(z >= (x == 0 ? 34 : dsm.values[y * 12 + x - 1]));
      if (x < 4) CHECK(z == 34);
      if (x >= 8) CHECK(z == 38);
    }
    CHECK(dsm.values[y * 12 + 5] > 34);
    CHECK(dsm.values[y * 12 + 6] < 38);
  }
  const rpc::GeoRaster sigma = rpc::read_geo_raster(folder / "height_sigma.tif"),
                       views = rpc::read_geo_raster(folder / "views.tif");
  for (const float s : sigma.values.values()) CHECK(s == 0.25f);
  for (const float n : views.values.values()) CHECK(n == 2);
}

TEST_CASE("a cell with a height has its number of images and its colour, whichever tile knows it") {
  const TempFolder folder("tiled");
  reconstruct::TileSurface west = level(4), east = level(8);
  for (Index y = 0; y < 8; ++y) {
    const Index at = y * 8 + 5;  // the last column that the western tile answers for
    west.heights[at] = west.confidence[at] = west.views[at] = west.ortho[at] = std::nanf("");
  }
  for (Index y = 0; y < 8; ++y) east.views[y * 8 + 1] = 3, east.ortho[y * 8 + 1] = 7;  // the same
  east.ortho[2 * 8 + 6] = std::nanf(""), east.views[2 * 8 + 6] = 0;
  made_of(folder, west, east);
  const Tensor dsm = rpc::read_geo_raster(folder / "dsm.tif").values,
               views = rpc::read_geo_raster(folder / "views.tif").values,
               ortho = rpc::read_geo_raster(folder / "ortho.tif").values;
  for (Index i = 0; i < dsm.count(); ++i) {
    CAPTURE(i);
    const bool own = i % 12 != 5, unseen = i == 2 * 12 + 10;
    CHECK(dsm[i] >= 34);
    CHECK(views[i] == (unseen ? 0 : own ? 2 : 3));
    if (unseen)
      CHECK(std::isnan(ortho[i]));
    else
      CHECK(ortho[i] == (own ? 9 : 7));
  }
}

TEST_CASE("tiles with other rasters than the others are those of another run") {
  const TempFolder folder("tiled");
  reconstruct::TileSurface known = level(4), coloured = level(4);
  known.sigma = Tensor({8, 8}, 0.25f);
  coloured.ortho = Tensor({3, 8, 8}, 9.f);
  const auto error = [&](const reconstruct::TileSurface& west,
                         const reconstruct::TileSurface& east) {
    return test::error_of<IoError>([&] { made_of(folder, west, east); });
  };
  for (const std::string& said :
       {error(known, level(4)), error(level(4), known), error(level(4), coloured)})
    CHECK(said.find(" has other rasters than the others, expected the tiles of one run") !=
          std::string::npos);
  CHECK_FALSE(std::filesystem::exists(folder / "dsm.tif"));
}

TEST_CASE("of two rows of tiles each cell has its own values, and none outside of the polygons") {
  const TempFolder folder("tiled");
  const reconstruct::Tiling tiling = four_tiles(0.5);
  const rpc::Area triangle{{{{500100.6, 3000199.6}, {500105.6, 3000197.8}, {500101.7, 3000195.2}}}};
  const TiledSurface made =
      made_of(folder, tiling, numbered(tiling), rpc::HeightDatum::ellipsoid, triangle);
  const auto read = [&](const char* name) { return rpc::read_geo_raster(folder / name).values; };
  const Tensor dsm = read("dsm.tif"), confidence = read("confidence.tif"),
               sigma = read("height_sigma.tif"), views = read("views.tif"),
               ortho = read("ortho.tif");
  REQUIRE(dsm.shape() == Shape{10, 12});
  Index inside = 0;
  float low = INFINITY, high = -INFINITY;
  for (Index i = 0; i < dsm.count(); ++i) {
    CAPTURE(i);
    if (!triangle.contains(500100 + 0.5 * (static_cast<double>(i % 12) + 0.5),
                           3000200 - 0.5 * (static_cast<double>(i / 12) + 0.5))) {
      for (const Tensor* raster : {&dsm, &confidence, &sigma, &views, &ortho})
        CHECK(std::isnan((*raster)[i]));
      CHECK(std::isnan(made.dsm.z[i]));
      continue;
    }
    const float n = number_of(i / 12, i % 12);
    ++inside, low = std::min(low, n), high = std::max(high, n);
    CHECK(dsm[i] == doctest::Approx(n + 30));
    CHECK(confidence[i] == doctest::Approx(n / 128));
    CHECK(sigma[i] == doctest::Approx(n + 1));
    CHECK(views[i] == n + 2);
    CHECK(ortho[i] == n + 3);
  }
  CHECK(inside > 30);
  CHECK(inside < 60);
  CHECK(made.heights.low == doctest::Approx(low + 30));
  CHECK(made.heights.high == doctest::Approx(high + 30));
}

TEST_CASE("of two rows of tiles each height is above the geoid at its own place") {
  const TempFolder folder("tiled");
  const reconstruct::Tiling tiling = four_tiles(300);
  const TiledSurface made = made_of(folder, tiling, numbered(tiling), rpc::HeightDatum::egm96);
  const Tensor dsm = rpc::read_geo_raster(folder / "dsm.tif").values;
  const rpc::LocalFrame frame = somewhere().frame;
  std::vector<std::array<double, 2>> places;
  for (Index i = 0; i < dsm.count(); ++i) {
    const auto at = frame.geodetic_from_local({100 + 300 * (static_cast<double>(i % 12) + 0.5),
                                               200 - 300 * (static_cast<double>(i / 12) + 0.5), 0});
    places.push_back({at.lon, at.lat});
  }
  const std::vector<double> geoid = rpc::geoid_heights(rpc::HeightDatum::egm96, places);
  REQUIRE(std::abs(geoid[5 * 12] - geoid[0]) > 0.3);  // to be told from that of other rows
  for (Index i = 0; i < dsm.count(); ++i) {
    CAPTURE(i);
    const double expected =
        static_cast<double>(number_of(i / 12, i % 12)) + 30 - geoid[static_cast<std::size_t>(i)];
    CHECK(std::abs(static_cast<double>(dsm[i]) - expected) < 0.05);
  }
  CHECK(made.heights.low == 30);  // these stay above the ellipsoid
}
