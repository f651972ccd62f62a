// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/reconstruct/feather.h"
#include "satsurf/reconstruct/tile.h"
#include "satsurf/reconstruct/tiling.h"
#include "satsurf/rpc/raster.h"

#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include "tests/reconstruct/simulated.h"
#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;

namespace {

const float kNan = std::numeric_limits<float>::quiet_NaN();

/// A village in files.
struct Files {
  test::TempFolder folder{"tiling"};
  std::vector<std::filesystem::path> images;
  rpc::HeightRange range;

  explicit Files(Index pixels, Index views = 3) {
    const scene::SimulatedScene made = test::village(pixels, views);
    range = test::range_of(made);
    for (std::size_t i = 0; i < made.views.size(); ++i) {
      images.push_back(folder / ("view_" + std::to_string(i) + ".tif"));
      Tensor values = made.views[i].rgb.clone();
      for (float& v : values.values()) v *= 255;
      rpc::write_rpc_geotiff(images.back(), values, rpc::PixelType::uint8, made.views[i].rpc);
    }
  }
  scene::Survey survey() const {
    return scene::survey_views(images, {}, range, {}, {.pointing = {.measure = false}});
  }
};

/// A tiling by hand: cores of `core` cells a side.
Tiling by_hand(Index height, Index width, Index core, Index overlap) {
  Tiling out;
  out.grid = {0, 0, 1, height, width};
  out.overlap = overlap;
  out.rows = height / core, out.columns = width / core;
  for (Index r = 0; r < out.rows; ++r)
    for (Index c = 0; c < out.columns; ++c) {
      const CellRect k{c * core, r * core, (c + 1) * core, (r + 1) * core};
      out.tiles.push_back({r,
                           c,
                           k,
                           {std::max<Index>(0, k.x0 - overlap), std::max<Index>(0, k.y0 - overlap),
                            std::min(width, k.x1 + overlap), std::min(height, k.y1 + overlap)}});
    }
  return out;
}

/// Blends what `value` says of the cells of each tile.
template <class F>
Tensor blended(const Tiling& tiling, const F& value) {
  FeatheredRows rows(tiling);
  Tensor out({tiling.grid.height, tiling.grid.width});
  Index y0 = 0;
  for (Index r = 0; r < tiling.rows; ++r) {
    for (Index c = 0; c < tiling.columns; ++c) {
      const Tile& tile = tiling.tiles[static_cast<std::size_t>(r * tiling.columns + c)];
      Tensor part({tile.all.height(), tile.all.width()});
      for (Index i = 0; i < part.count(); ++i)
        part[i] =
            value(tile, tile.all.y0 + i / tile.all.width(), tile.all.x0 + i % tile.all.width());
      rows.add(tile, part);
    }
    const Tensor done = rows.finished(r);
    std::copy_n(done.data(), done.count(), out.data() + y0 * tiling.grid.width);
    y0 += done.dim(0);
  }
  CHECK(y0 == tiling.grid.height);
  return out;
}

}  // namespace

TEST_CASE("the weights of two neighbours add up to one, and the rim of the grid keeps its own") {
  for (Index cell = 0; cell < 40; ++cell) {
    CAPTURE(cell);
    const double west = cell < 24 ? feather(cell, 0, 20, 40, 4) : 0,
                 east = cell >= 16 ? feather(cell, 20, 40, 40, 4) : 0;
    CHECK(west + east == doctest::Approx(1));
    CHECK(west >= 0);
    if (cell > 0 && cell < 24) CHECK(west <= feather(cell - 1, 0, 20, 40, 4));
  }
}

TEST_CASE("blending tiles of one surface gives that surface, of two the way between them") {
  const Tiling tiling = by_hand(60, 40, 20, 4);
  const auto surface = [](Index y, Index x) {
    return 0.3f * static_cast<float>(x) + std::sin(0.2f * static_cast<float>(y));
  };
  const Tensor same = blended(tiling, [&](const Tile&, Index y, Index x) { return surface(y, x); });
  for (Index i = 0; i < same.count(); ++i)
    CHECK(same[i] == doctest::Approx(surface(i / 40, i % 40)).epsilon(1e-5));
  const Tensor step =
      blended(tiling, [](const Tile& tile, Index, Index) { return tile.column == 0 ? 0.f : 1.f; });
  CHECK(step[30 * 40 + 15] == 0);
  CHECK(step[30 * 40 + 24] == 1);
  for (Index x = 16; x < 24; ++x)
    CHECK(step[30 * 40 + x] == doctest::Approx((static_cast<double>(x - 16) + 0.5) / 8));
}

TEST_CASE(
    "a cell that one tile does not know is the other's, and one that none knows stays unknown") {
  const Tiling tiling = by_hand(20, 40, 20, 4);
  const Tensor out = blended(tiling, [](const Tile& tile, Index y, Index x) {
    return x == 18 && (tile.column == 0 || y == 7) ? kNan : static_cast<float>(tile.column + 3);
  });
  CHECK(out[18] == 4);
  CHECK(std::isnan(out[7 * 40 + 18]));
  FeatheredRows rows(tiling);
  CHECK_THROWS_AS(rows.add(tiling.tiles[0], Tensor({3, 3})), ShapeError);
}

TEST_CASE("tiles cover the ground once, and every window holds what its tile needs") {
  const Files files(700);
  const scene::Survey survey = files.survey();
  const nn::ModelConfig model = nn::model_preset("tiny");
  const double least = 1e9;  // of windows far below 1280 px
  Tiling tiling = plan_tiles(model, survey, {}, {}, least);
  REQUIRE(tiling.window <= kWholeImage);
  // small windows, whatever the memory of the tiny network
  while (tiling.tiles.size() < 4 && tiling.window > 256) {
    const Index fewer = tiling.window - 64;
    double bytes = least;
    for (; bytes > 1e6 && window_for_memory(model, {3, 700}, Surface::splat, bytes) > fewer;)
      bytes *= 0.98;
    tiling = plan_tiles(model, survey, {}, {}, bytes);
    CHECK(tiling.memory_bytes < 1.5 * bytes + 4e8);
  }
  REQUIRE(tiling.tiles.size() >= 4);
  CHECK(static_cast<Index>(tiling.tiles.size()) == tiling.rows * tiling.columns);
  std::vector<int> covered(static_cast<std::size_t>(tiling.grid.width * tiling.grid.height), 0);
  const rpc::HeightRange& z = survey.user.scene.z_range;
  for (const Tile& tile : tiling.tiles) {
    for (Index y = tile.core.y0; y < tile.core.y1; ++y)
      for (Index x = tile.core.x0; x < tile.core.x1; ++x)
        ++covered[static_cast<std::size_t>(y * tiling.grid.width + x)];
    CHECK(tile.all.x0 == std::max<Index>(0, tile.core.x0 - tiling.overlap));
    CHECK(tile.all.y1 == std::min(tiling.grid.height, tile.core.y1 + tiling.overlap));
    for (const scene::SurveyedView& view : survey.views) {
      const auto window =
          scene::window_of(view, survey.user.scene.frame, tiling.grid_of(tile.all).ground(), z);
      REQUIRE(window);
      CHECK(window->width <= tiling.window + 16);
      CHECK(window->height <= tiling.window + 16);
    }
  }
  for (const int n : covered) REQUIRE(n == 1);
}

TEST_CASE("tiles are as long and wide as takes the fewest pixels") {
  const Files files(900);
  scene::Survey survey = files.survey();
  survey.user.scene.z_range.high = survey.user.scene.z_range.low + 60;
  const nn::ModelConfig model = nn::model_preset("tiny");
  double bytes = 1e9;
  for (; window_for_memory(model, {3, 900}, Surface::splat, bytes) > 420;) bytes *= 0.98;
  const Tiling tiling = plan_tiles(model, survey, {}, {}, bytes);
  REQUIRE(tiling.tiles.size() >= 4);
  // The square windows of a tile in the middle, for so many columns and rows.
  const rpc::HeightRange z = survey.user.scene.z_range;
  const auto cost = [&](Index columns, Index rows) {
    const auto part = [&](Index cells, Index parts) {
      const Index margin = parts > 1 ? tiling.overlap : 0, length = cells / parts;
      return std::array<Index, 2>{(cells - length) / 2 - margin, (cells + length) / 2 + margin};
    };
    const auto x = part(tiling.grid.width, columns), y = part(tiling.grid.height, rows);
    Index side = 0;
    for (scene::SurveyedView view : survey.views) {
      view.width = view.height = 100000;  // as if there were more image around
      view.rpc.samp_off += 50000, view.rpc.line_off += 50000;
      const auto w = scene::window_of(view, survey.user.scene.frame,
                                      tiling.grid_of({x[0], y[0], x[1], y[1]}).ground(), z);
      side = std::max({side, w->width, w->height});
    }
    return static_cast<double>(side <= tiling.window ? columns * rows * side * side : 1 << 30);
  };
  double least = INFINITY;
  for (Index columns = 1; columns < 9; ++columns)
    for (Index rows = 1; rows < 9; ++rows) least = std::min(least, cost(columns, rows));
  CAPTURE(tiling.columns);
  CAPTURE(tiling.rows);
  CHECK(least < 1 << 30);
  CHECK(cost(tiling.columns, tiling.rows) < 1.15 * least);
}

TEST_CASE("a million tiles are refused before any is made") {
  const Files files(96);
  scene::Survey survey = files.survey();
  for (scene::SurveyedView& view : survey.views)  // cameras that see a hair
    view.rpc.samp_scale *= 1e5, view.rpc.line_scale *= 1e5;
  ReconstructOptions options;
  options.resolution = 2e-4;  // m
  std::string message;
  try {
    plan_tiles(nn::model_preset("tiny"), survey, options, {}, 0);
  } catch (const Error& e) {
    message = e.what();
  }
  INFO(message);
  CHECK(message.find("tiles, expected at most a million; wrong cameras?") != std::string::npos);
}

TEST_CASE("more memory never means smaller windows, and too little is refused") {
  const nn::ModelConfig model = nn::model_preset("wide8");
  Index before = 0;
  for (const double gigabytes : {1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0}) {
    const Index window = window_for_memory(model, {3, 12000}, Surface::refined, 1e9 * gigabytes);
    CHECK(window >= before);
    CHECK(window % nn::size_multiple(model) == 0);
    before = window;
  }
  CHECK(before > 1800);
  CHECK(window_for_memory(model, {3, 12000}, Surface::refined, 1e12) == kLargestWindow);
  CHECK(window_for_memory(model, {3, 12000}, Surface::refined, 0) == kWholeImage);
  CHECK_THROWS_AS(window_for_memory(model, {3, 12000}, Surface::refined, 1e8), ConfigError);
}

TEST_CASE("every tile has the best of the images that see it") {
  const Files files(200, 4);
  const scene::Survey all = scene::survey_views(files.images, {}, files.range, {},
                                                {.pointing = {.measure = false}, .most_views = 2});
  REQUIRE(all.views.size() == 4);  // though no tile has more than two
  const Tiling tiling = plan_tiles(nn::model_preset("tiny"), all, {}, {}, 0);
  CHECK(tiling.views == 2);
  const Ground ground = tiling.grid.ground();
  const auto chosen = scene::views_of(all, ground, all.user.scene.z_range);
  REQUIRE(chosen.size() == 2);
  CHECK(chosen[0] < chosen[1]);
  const scene::WindowedScene part = scene::read_windows(all, ground, all.user.scene.z_range);
  CHECK(part.views == chosen);
  CHECK(part.scene.views[0].name == all.user.scene.views[chosen[0]].name);
  const scene::Survey survey = files.survey();  // no choice where there are few
  CHECK(scene::views_of(survey, ground, survey.user.scene.z_range).size() == 4);
}

TEST_CASE("only the ground that is wanted is made, on the cells of the whole") {
  const Files files(200);
  const scene::Survey survey = files.survey();
  const nn::ModelConfig model = nn::model_preset("tiny");
  const Tiling whole = plan_tiles(model, survey, {}, {}, 0);
  const Ground ground = whole.grid.ground();
  const Ground wanted{ground.x0 + 0.3 * ground.width(), ground.y0 + 0.4 * ground.height(),
                      ground.x0 + 0.6 * ground.width(), ground.y0 + 0.6 * ground.height()};
  const Tiling part = plan_tiles(model, survey, {}, wanted, 0);
  CHECK(part.grid.step == whole.grid.step);
  const double columns = (part.grid.east - whole.grid.east) / whole.grid.step;
  CHECK(std::abs(columns - std::round(columns)) < 1e-6);
  CHECK(part.grid.ground().x0 <= wanted.x0);
  CHECK(part.grid.ground().x1 >= wanted.x1);
  CHECK(part.grid.ground().width() < wanted.width() + 2 * whole.grid.step);
  CHECK_THROWS_AS(plan_tiles(model, survey, {}, Ground{1e5, 1e5, 1e5 + 10, 1e5 + 10}, 0), Error);
}
