// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/tiled_files.h"
#include "satsurf/core/error.h"
#include "satsurf/rpc/raster.h"

#include <cmath>
#include <filesystem>
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

/// Puts two tiles down and makes rasters of them in `folder`.
TiledSurface made_of(const TempFolder& folder, const reconstruct::TileSurface& west,
                     const reconstruct::TileSurface& east) {
  const reconstruct::Tiling tiling = two_tiles();
  TileStore store(folder / "run", false, true);
  store.save(tiling.tiles[0], done(), west);
  store.save(tiling.tiles[1], done(), east);
  scene::Scene scene;
  scene.frame.easting0 = 500000, scene.frame.northing0 = 5e6, scene.frame.h0 = 30;
  return write_tiled_surface(folder.path(), tiling, {done(), done()}, store, scene, false,
                             rpc::HeightDatum::ellipsoid, {}, [](double) {});
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
