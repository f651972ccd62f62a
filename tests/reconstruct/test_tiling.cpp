// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/parallel.h"
#include "satsurf/reconstruct/feather.h"
#include "satsurf/reconstruct/tile.h"
#include "satsurf/reconstruct/tiling.h"
#include "satsurf/rpc/raster.h"

#include <array>
#include <cmath>
#include <cstring>
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

/// What is asked for where the program may have so much memory.
ReconstructOptions within(double bytes) {
  ReconstructOptions options;
  options.max_memory = bytes;
  return options;
}

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
      const auto at = [&](Index part) { return static_cast<double>(part * core); };
      out.tiles.push_back(out.tile(r, c, {at(c), at(r)}, {at(c + 1), at(r + 1)}));
    }
  return out;
}

/// A straight camera as a given one is in the middle of its image, turned about that on the ground.
/// degrees  clockwise
rpc::Rpc straight_and_turned(const rpc::Rpc& camera, double side, double height, double degrees) {
  const rpc::Geodetic middle = camera.localize({side / 2, side / 2}, height);
  const rpc::PixelJacobian j = camera.jacobian(middle);
  const TileAxes axes = TileAxes::turned(degrees);
  rpc::Rpc out;
  out.lon_off = middle.lon, out.lat_off = middle.lat, out.height_off = middle.h;
  out.lon_scale = out.lat_scale = 0.01, out.height_scale = 500;
  out.samp_off = out.line_off = side / 2;
  out.samp_den[0] = out.line_den[0] = 1;
  const std::array<double, 3> scale{out.lon_scale, out.lat_scale, out.height_scale};
  for (std::size_t k = 0; k < 3; ++k) {
    const auto at = axes.along(j[0][k] * scale[k], j[1][k] * scale[k]);
    out.samp_num[1 + k] = at[0], out.line_num[1 + k] = at[1];
  }
  return out;
}

/// How many tiles answer for each cell.
std::vector<int> owners_of(const Tiling& tiling) {
  const Index W = tiling.grid.width;
  std::vector<int> out(static_cast<std::size_t>(tiling.grid.height * W), 0);
  for (const Tile& tile : tiling.tiles)
    for (Index y = tile.core.y0; y < tile.core.y1; ++y)
      for (Index x = tile.core.x0; x < tile.core.x1; ++x)
        out[static_cast<std::size_t>(y * W + x)] += tiling.owns(tile, x, y) ? 1 : 0;
  return out;
}

/// Turned tiles by hand, of which the grid has the middle.
Tiling turned_by_hand(double degrees) {
  Tiling out;
  out.grid = {-20, 35, 1, 60, 50};
  out.axes = TileAxes::turned(degrees);
  out.overlap = 4, out.rows = 6, out.columns = 6;
  for (Index r = 0; r < 6; ++r)
    for (Index c = 0; c < 6; ++c) {
      const double u = -60 + 30 * static_cast<double>(c), v = -60 + 30 * static_cast<double>(r);
      const Tile tile = out.tile(r, c, {u, v}, {u + 30, v + 30});
      if (tile.all.width() > 0 && tile.all.height() > 0) out.tiles.push_back(tile);
    }
  return out;
}

/// Blends what `value` says of the cells of each tile.
template <class F>
Tensor blended(const Tiling& tiling, const F& value) {
  FeatheredRows rows(tiling);
  Tensor out({tiling.grid.height, tiling.grid.width});
  Index y0 = 0;
  const auto take = [&](Index end) {
    const Tensor done = rows.finished(end);
    REQUIRE(done.dim(0) == end - y0);
    std::copy_n(done.data(), done.count(), out.data() + y0 * tiling.grid.width);
    y0 = end;
  };
  for (const std::size_t k : assembly_order(tiling)) {
    const Tile& tile = tiling.tiles[k];
    if (tile.all.y0 > y0) take(tile.all.y0);
    Tensor part({tile.all.height(), tile.all.width()});
    for (Index i = 0; i < part.count(); ++i)
      part[i] = value(tile, tile.all.y0 + i / tile.all.width(), tile.all.x0 + i % tile.all.width());
    rows.add(tile, part);
  }
  take(tiling.grid.height);
  return out;
}

}  // namespace

TEST_CASE("the weights of two neighbours add up to one, and the rim of the grid keeps its own") {
  const Tiling tiling = by_hand(20, 40, 20, 4);
  const Tile &a = tiling.tiles[0], &b = tiling.tiles[1];
  CHECK(a.all == CellRect{0, 0, 24, 20});
  CHECK(b.all == CellRect{16, 0, 40, 20});
  for (Index x = 0; x < 40; ++x) {
    CAPTURE(x);
    const double west = tiling.weight(a, x, 7), east = tiling.weight(b, x, 7);
    CHECK(west + east == doctest::Approx(1));
    CHECK(west >= 0);
    if (x > 0) CHECK(west <= tiling.weight(a, x - 1, 7));
    CHECK((west > 0) == (x < 24));
    CHECK((west == 1) == (x < 16));
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

TEST_CASE("turned tiles answer for every cell once, and blend into one surface") {
  for (const double degrees : {-44.0, -17.5, 3.0, 45.0}) {
    CAPTURE(degrees);
    const Tiling tiling = turned_by_hand(degrees);
    CHECK(tiling.axes.degrees() == doctest::Approx(degrees));
    REQUIRE(tiling.tiles.size() >= 4);
    for (const int n : owners_of(tiling)) REQUIRE(n == 1);
    const auto surface = [](Index y, Index x) {
      return 0.3f * static_cast<float>(x) + std::sin(0.2f * static_cast<float>(y));
    };
    const Tensor same =
        blended(tiling, [&](const Tile&, Index y, Index x) { return surface(y, x); });
    for (Index i = 0; i < same.count(); ++i)
      REQUIRE(same[i] == doctest::Approx(surface(i / 50, i % 50)).epsilon(1e-5));
    for (Index y = 0; y < 60; ++y)
      for (Index x = 0; x < 50; ++x) {
        double sum = 0;
        for (const Tile& tile : tiling.tiles)
          if (x >= tile.all.x0 && x < tile.all.x1 && y >= tile.all.y0 && y < tile.all.y1)
            sum += tiling.weight(tile, x, y);
        REQUIRE(sum == doctest::Approx(1));
      }
  }
}

TEST_CASE("what tiles own alone comes from the tile that owns it, rows that are given back once") {
  for (const double degrees : {0.0, -17.5}) {
    CAPTURE(degrees);
    const Tiling tiling = turned_by_hand(degrees);
    OwnedRows rows(tiling, 2);
    Tensor out({2, 60, 50});
    Index y0 = 0;
    const auto take = [&](Index end) {
      const Tensor done = rows.finished(end);
      REQUIRE(done.shape() == Shape{2, end - y0, 50});
      for (Index c = 0; c < 2; ++c)
        std::copy_n(done.data() + c * (end - y0) * 50, (end - y0) * 50,
                    out.data() + (c * 60 + y0) * 50);
      y0 = end;
    };
    for (const std::size_t k : assembly_order(tiling)) {
      const Tile& tile = tiling.tiles[k];
      if (tile.all.y0 > y0) take(tile.all.y0);
      if (k == 1) continue;  // was not made
      Tensor part({2, tile.all.height(), tile.all.width()}, static_cast<float>(k));
      for (Index i = part.count() / 2; i < part.count(); ++i) part[i] += 100;
      rows.add(tile, part);
    }
    take(60);
    for (Index i = 0; i < 3000; ++i) {
      std::size_t owner = 0;
      for (std::size_t k = 0; k < tiling.tiles.size(); ++k)
        if (tiling.owns(tiling.tiles[k], i % 50, i / 50)) owner = k;
      if (owner == 1) {
        REQUIRE(std::isnan(out[i]));
        continue;
      }
      REQUIRE(out[i] == static_cast<float>(owner));
      REQUIRE(out[3000 + i] == static_cast<float>(owner + 100));
    }
    CHECK_THROWS_AS(rows.add(tiling.tiles[0], Tensor({2, 3, 3})), ShapeError);
  }
}

TEST_CASE("what a tile does not know of its own cells its neighbour says, as in blended rasters") {
  const Tiling tiling = by_hand(20, 40, 20, 4);
  const auto value = [](const Tile& tile, Index, Index x) {
    return tile.column == 0 && x >= 14 ? kNan : static_cast<float>(tile.column + 3);
  };
  OwnedRows rows(tiling, 2);
  for (const std::size_t k : assembly_order(tiling)) {
    const Tile& tile = tiling.tiles[k];
    const Index h = tile.all.height(), w = tile.all.width();
    Tensor part({2, h, w}, kNan);
    for (Index i = 0; i < h * w; ++i) {
      part[i] = value(tile, tile.all.y0 + i / w, tile.all.x0 + i % w);
      // the second is unknown where the first is 3
      if (part[i] > 3) part[h * w + i] = part[i] + 10;
    }
    rows.add(tile, part);
  }
  const Index H = tiling.grid.height, W = tiling.grid.width;
  const Tensor owned = rows.finished(H), heights = blended(tiling, value);
  for (Index i = 0; i < H * W; ++i) {
    CAPTURE(i);
    REQUIRE(std::isfinite(owned[i]) == std::isfinite(heights[i]));
    if (!std::isfinite(owned[i])) continue;
    const Index x = i % W;
    CHECK(owned[i] == (x < 14 ? 3 : 4));
    if (x < 14)
      CHECK(std::isnan(owned[H * W + i]));
    else
      CHECK(owned[H * W + i] == 14);
  }
  CHECK(std::isfinite(heights[17]));
  CHECK(std::isnan(heights[14]));
}

TEST_CASE("tiles lie as the images do where that saves pixels") {
  const Files files(700);
  const nn::ModelConfig model = nn::model_preset("tiny");
  double bytes = 1e9;
  for (; window_for_memory(model, {3, 700}, Surface::splat, bytes) > 320;) bytes *= 0.98;
  const scene::Survey survey = files.survey();
  const auto planned = [&](double degrees) {
    scene::Survey turned = survey;
    const scene::Scene& scene = survey.user.scene;
    const double height = scene.frame.h0 + scene.z_range.middle();
    for (std::size_t i = 0; i < turned.views.size(); ++i)
      turned.user.scene.views[i].rpc = turned.views[i].rpc =
          straight_and_turned(survey.views[i].rpc, 700, height, degrees);
    return plan_tiles(model, turned, within(bytes), {});
  };
  const Tiling plain = planned(0);
  for (const double degrees : {-25.0, 18.0}) {
    const Tiling askew = planned(degrees);
    CAPTURE(plain.axes.degrees());
    CAPTURE(askew.axes.degrees());
    CHECK(std::abs(askew.axes.degrees() - plain.axes.degrees() - degrees) <= 6);
    CHECK(askew.megapixels < 1.15 * plain.megapixels);
  }
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
  Tiling tiling = plan_tiles(model, survey, within(least), {});
  REQUIRE(tiling.window <= kWholeImage);
  // small windows, whatever the memory of the tiny network
  while (tiling.tiles.size() < 4 && tiling.window > 256) {
    const Index fewer = tiling.window - 64;
    double bytes = least;
    for (; bytes > 1e6 && window_for_memory(model, {3, 700}, Surface::splat, bytes) > fewer;)
      bytes *= 0.98;
    tiling = plan_tiles(model, survey, within(bytes), {});
    CHECK(tiling.memory_bytes < 1.5 * bytes + 4e8);
  }
  REQUIRE(tiling.tiles.size() >= 4);
  CHECK(static_cast<Index>(tiling.tiles.size()) <= tiling.rows * tiling.columns);
  const rpc::HeightRange& z = survey.user.scene.z_range;
  for (const Tile& tile : tiling.tiles)
    for (const scene::SurveyedView& view : survey.views) {
      const auto window =
          scene::window_of(view, survey.user.scene.frame, tiling.ground_of(tile), z);
      REQUIRE(window);
      CHECK(window->width <= tiling.window + 16);
      CHECK(window->height <= tiling.window + 16);
    }
  const scene::Polygon seen = common_outline(survey.user.scene);
  const std::vector<int> owners = owners_of(tiling);
  for (Index i = 0; i < tiling.grid.height * tiling.grid.width; ++i) {
    const double column = static_cast<double>(i % tiling.grid.width) + 0.5,
                 row = static_cast<double>(i / tiling.grid.width) + 0.5;
    const int n = owners[static_cast<std::size_t>(i)];
    REQUIRE(n <= 1);
    if (scene::contains(seen, tiling.grid.east + column * tiling.grid.step,
                        tiling.grid.north - row * tiling.grid.step))
      REQUIRE(n == 1);
  }
}

TEST_CASE("tiles are as long and wide as takes the fewest pixels") {
  const Files files(900);
  scene::Survey survey = files.survey();
  survey.user.scene.z_range.high = survey.user.scene.z_range.low + 20;
  const nn::ModelConfig model = nn::model_preset("tiny");
  double bytes = 1e9;
  for (; window_for_memory(model, {3, 900}, Surface::splat, bytes) > 420;) bytes *= 0.98;
  const Tiling tiling = plan_tiles(model, survey, within(bytes), {});
  REQUIRE(tiling.tiles.size() >= 4);
  std::array<double, 2> begin{INFINITY, INFINITY}, end{-INFINITY, -INFINITY};
  for (const Tile& tile : tiling.tiles)
    for (std::size_t k = 0; k < 2; ++k)
      begin[k] = std::min(begin[k], tile.begin[k]), end[k] = std::max(end[k], tile.end[k]);
  // The windows of a tile in the middle, for so many columns and rows.
  const rpc::HeightRange z = survey.user.scene.z_range;
  const auto cost = [&](Index columns, Index rows) {
    std::array<double, 2> from{}, to{};
    for (std::size_t k = 0; k < 2; ++k) {
      const auto parts = static_cast<double>(k == 0 ? columns : rows);
      const double margin = parts > 1 ? static_cast<double>(tiling.overlap) : 0,
                   half = (end[k] - begin[k]) / parts / 2 + margin,
                   middle = (begin[k] + end[k]) / 2;
      from[k] = middle - half, to[k] = middle + half;
    }
    scene::Polygon ground;
    for (const auto& [u, v] :
         {std::array{from[0], to[1]}, {to[0], to[1]}, {to[0], from[1]}, from}) {
      const auto [x, y] = tiling.axes.place(u, v);
      ground.push_back(
          {tiling.grid.east + x * tiling.grid.step, tiling.grid.north - y * tiling.grid.step});
    }
    Index side = 0;
    for (scene::SurveyedView view : survey.views) {
      view.width = view.height = 100000;  // as if there were more image around
      view.rpc.samp_off += 50000, view.rpc.line_off += 50000;
      const auto w = scene::window_of(view, survey.user.scene.frame, ground, z);
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
    plan_tiles(nn::model_preset("tiny"), survey, options, {});
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

TEST_CASE("the threads have no say in the size of windows") {
  const nn::ModelConfig model = nn::model_preset("wide8");
  const auto windows = [&](int threads) {
    set_threads(threads);
    std::vector<Index> sides;
    for (double bytes = 1.9e9; bytes < 2.1e9; bytes += 5e5)
      sides.push_back(window_for_memory(model, {2, 12000}, Surface::refined, bytes));
    set_threads(0);
    return sides;
  };
  CHECK(windows(1) == windows(0));
}

TEST_CASE("every tile has the best of the images that see it") {
  const Files files(200, 4);
  const scene::Survey all = scene::survey_views(files.images, {}, files.range, {},
                                                {.pointing = {.measure = false}, .most_views = 2});
  REQUIRE(all.views.size() == 4);  // though no tile has more than two
  const Tiling tiling = plan_tiles(nn::model_preset("tiny"), all, {}, {});
  CHECK(tiling.views == 2);
  const scene::Polygon ground = scene::corners_of(tiling.grid.ground());
  const auto chosen = scene::views_of(all, ground, all.user.scene.z_range);
  REQUIRE(chosen.size() == 2);
  CHECK(chosen[0] < chosen[1]);
  const scene::WindowedScene part = scene::read_windows(all, ground, all.user.scene.z_range);
  CHECK(part.views == chosen);
  CHECK(part.scene.views[0].name == all.user.scene.views[chosen[0]].name);
  const scene::Survey survey = files.survey();  // no choice where there are few
  CHECK(scene::views_of(survey, ground, survey.user.scene.z_range).size() == 4);
}

namespace {

/// The one tile of two views that are small enough for it, and a network of weights by chance.
struct OneTile {
  Files files;
  scene::Survey survey;
  nn::Model model{nn::model_preset("tiny"), 3};
  ReconstructOptions options;
  Tiling tiling;
  Tile tile;
  scene::WindowedScene part;

  explicit OneTile(Index pixels) : files(pixels, 2), survey(files.survey()) {
    options.surface = Surface::plain, options.look = false;
    tiling = plan_tiles(model.config(), survey, options, {});
    REQUIRE(tiling.tiles.size() == 1);
    tile = tiling.tiles[0];
    part = scene::read_windows(survey, tiling.ground_of(tile), survey.user.scene.z_range);
  }
  TileSurface made(const std::function<Tensor(const Grid&)>& inside = {}) const {
    return reconstruct_tile(model, part, tiling, tile, {}, options, inside);
  }
};

}  // namespace

TEST_CASE("a tile whose heights take more than a window has several of them") {
  OneTile one(240);
  const auto made_with = [&](Index window) {
    one.tiling.window = window;
    return one.made();
  };
  const TileSurface whole = made_with(1280), parts = made_with(200);
  CHECK(whole.window.height > 200);
  CHECK(parts.window.height <= 200);
  CHECK(parts.window.width <= 200);
  // Both reach from rim to rim, though one view through a window of 200 px does not.
  REQUIRE(whole.expected > 0);
  CHECK(parts.expected > 0.9 * static_cast<double>(whole.expected));
  const auto known = [](const Tensor& heights, Index x0, Index x1) {
    Index n = 0;
    for (Index i = 0; i < heights.count(); ++i) {
      const Index x = i % heights.dim(1);
      n += x >= x0 && x < x1 && std::isfinite(heights[i]);
    }
    return n;
  };
  const Index W = whole.heights.dim(1);
  for (Index k = 0; k < 5; ++k) {
    CAPTURE(k);
    const Index of_whole = known(whole.heights, k * W / 5, (k + 1) * W / 5);
    CHECK(2 * known(parts.heights, k * W / 5, (k + 1) * W / 5) >= of_whole);
  }
}

TEST_CASE("outside of what is asked for a tile has no surfels and no cells that count") {
  const OneTile one(160);
  const Grid core = one.tiling.grid_of(one.tile.core);
  const Index column = core.width / 3;  // from here on nothing is asked for
  const auto inside = [&](const Grid& grid) {
    REQUIRE(grid.width == core.width);
    Tensor out({grid.height, grid.width});
    for (Index i = 0; i < out.count(); ++i) out[i] = i % grid.width < column ? 1 : 0;
    return out;
  };
  const TileSurface whole = one.made(), some = one.made(inside);
  CHECK(some.expected > 0);
  CHECK(some.expected < whole.expected / 2);
  CHECK(some.found <= some.expected);
  // what lies there may hide what is asked for, so it is made
  CHECK(std::memcmp(some.heights.data(), whole.heights.data(),
                    sizeof(float) * static_cast<std::size_t>(whole.heights.count())) == 0);
  const double limit = core.east + static_cast<double>(column) * core.step;
  const auto west = [&](const TileSurface& surface) {
    const Tensor& means = surface.surfels.means.value();
    Index n = 0;
    for (Index i = 0; i < means.dim(0); ++i) n += static_cast<double>(means[3 * i]) < limit;
    return n;
  };
  CHECK(west(some) > 0);
  CHECK(west(some) == west(whole));
  CHECK(west(some) == some.surfels.means.dim(0));
  CHECK(one.made([](const Grid& grid) { return Tensor({grid.height, grid.width}); }).empty);
}

TEST_CASE("what there is to find in a tile is counted without making it") {
  const OneTile one(160);
  const auto to_find = [&](const auto& inside) {
    return static_cast<double>(cells_to_find(one.part, one.tiling, one.tile, one.options, inside));
  };
  const auto west = [](const Grid& grid) {
    Tensor out({grid.height, grid.width});
    for (Index i = 0; i < out.count(); ++i) out[i] = i % grid.width < grid.width / 3 ? 1 : 0;
    return out;
  };
  const std::function<Tensor(const Grid&)> all;
  const auto expected_of_made = [&](const auto& inside) {
    return doctest::Approx(static_cast<double>(one.made(inside).expected)).epsilon(0.1);
  };
  // Of one that is made those with a height count besides, which lie up to a relief farther out.
  CHECK(to_find(all) == expected_of_made(all));
  CHECK(to_find(west) == expected_of_made(west));
  CHECK(to_find(west) < 0.5 * to_find(all));
  OneTile unwanted(160);
  unwanted.options.unwanted = west;
  CHECK(static_cast<double>(cells_to_find(unwanted.part, unwanted.tiling, unwanted.tile,
                                          unwanted.options)) == to_find(all) - to_find(west));
  OneTile alone(160);
  alone.part.scene.views.pop_back();
  CHECK(cells_to_find(alone.part, alone.tiling, alone.tile, alone.options) == 0);
}

TEST_CASE("only the ground that is wanted is made, on the cells of the whole") {
  const Files files(200);
  const scene::Survey survey = files.survey();
  const nn::ModelConfig model = nn::model_preset("tiny");
  const Tiling whole = plan_tiles(model, survey, {}, {});
  const Ground ground = whole.grid.ground();
  const Ground wanted{ground.x0 + 0.3 * ground.width(), ground.y0 + 0.4 * ground.height(),
                      ground.x0 + 0.6 * ground.width(), ground.y0 + 0.6 * ground.height()};
  const Tiling part = plan_tiles(model, survey, {}, wanted);
  CHECK(part.grid.step == whole.grid.step);
  const double columns = (part.grid.east - whole.grid.east) / whole.grid.step;
  CHECK(std::abs(columns - std::round(columns)) < 1e-6);
  CHECK(part.grid.ground().x0 <= wanted.x0);
  CHECK(part.grid.ground().x1 >= wanted.x1);
  CHECK(part.grid.ground().width() < wanted.width() + 2 * whole.grid.step);
  CHECK_THROWS_AS(plan_tiles(model, survey, {}, Ground{1e5, 1e5, 1e5 + 10, 1e5 + 10}), Error);
}
