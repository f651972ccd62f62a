// SPDX-License-Identifier: Apache-2.0
// What the made-up places and images look like: shares, sizes, and what a date changes.
#include "satsurf/scene/simulate/city.h"
#include "satsurf/scene/simulate/conditions.h"
#include "satsurf/scene/simulate/develop.h"
#include "satsurf/scene/simulate/layout.h"
#include "satsurf/scene/simulate/natural.h"
#include "satsurf/scene/simulate/orbit.h"
#include "satsurf/scene/simulate/render.h"
#include "satsurf/scene/simulate/scene.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::scene;
using namespace satsurf::scene::simulate;

namespace {

double mean_of(const Tensor& t) {
  double sum = 0;
  for (const float v : t.values()) sum += static_cast<double>(v);
  return sum / static_cast<double>(t.count());
}

// No noise, no blur, no tone curve.
Development plain() {
  Development how;
  how.haze = {0, 0, 0};
  how.psf_sigma = how.noise = 0;
  how.gamma = 1;
  return how;
}

// Straight down on a city of the given side, one pixel a cell.
Quadratic from_above(const City& city) {
  Quadratic q;
  q.coeff[0][0] = city.field.x0 + 0.5 * city.field.step;
  q.coeff[0][1] = city.field.step;
  q.coeff[1][0] = city.field.y0 - 0.5 * city.field.step;
  q.coeff[1][2] = -city.field.step;
  return q;
}

// Grey ground with one deciduous crown of 8 m all over its middle.
City grove(Index N) {
  City city;
  city.field = {.z = Tensor({N, N}), .x0 = 0, .y0 = 0.5 * static_cast<double>(N), .step = 0.5};
  const auto cells = static_cast<std::size_t>(N * N);
  city.cells.resize(cells);
  for (SurfaceCell& c : city.cells) c.albedo = {30000, 30000, 30000};
  city.fine.assign(cells, 0);
  city.patch.assign(cells, 0);
  city.floor = city.cells;
  city.floor_z = city.field.z.clone();
  for (Index i = N / 4; i < 3 * N / 4; ++i) {
    for (Index j = N / 4; j < 3 * N / 4; ++j) {
      const Index k = i * N + j;
      city.field.z[k] = 8;
      SurfaceCell& c = city.cells[static_cast<std::size_t>(k)];
      c.material = Material::tree;
      c.plant = 128;
      c.albedo = {2000, 3000, 1500};
    }
  }
  return city;
}

/// A square of 400 x 400 cells, rough or rural by turns.
CityPlan open_country(std::uint64_t seed, double relief) {
  return {.kind = seed % 2 == 0 ? SceneKind::rough : SceneKind::rural,
          .relief = relief,
          .tallest = 24,
          .x0 = -100,
          .y0 = 100,
          .step = 0.5,
          .size = 400};
}

}  // namespace

TEST_CASE("the stretch saturates the share it is asked for, unless nothing is bright") {
  const Index H = 60, W = 80, P = H * W;
  Tensor radiance({3, H, W});
  for (Index k = 0; k < 3 * P; ++k) radiance[k] = 0.1f + 0.3f * static_cast<float>(k % P) / P;
  const auto white = [](const Tensor& image) {
    return static_cast<double>(std::count(image.values().begin(), image.values().end(), 1.0f)) /
           static_cast<double>(image.count());
  };
  Development how = plain();
  for (const double share : {0.002, 0.02, 0.1}) {
    how.saturated = static_cast<float>(share);
    const double got = white(develop(radiance, how));
    CHECK(got > 0.8 * share);
    CHECK(got < share + 0.004);  // half a level below white counts as white
  }
  how.least_bright = 0.8f;
  const Tensor dim = develop(radiance, how);
  CHECK(white(dim) == 0);
  CHECK(mean_of(dim) < 0.4);
}

TEST_CASE("light beyond white spills one or two pixels") {
  const Index N = 40;
  Tensor radiance({3, N, N}, 0.2f);
  for (Index b = 0; b < 3; ++b) {
    for (Index i = 0; i < N; ++i) {
      for (Index j = 0; j < N / 2; ++j) radiance[(b * N + i) * N + j] = 2.0f;
    }
  }
  Development how = plain();
  how.dark = 0;
  how.bright = 2;
  const Tensor sharp = develop(radiance, how);
  how.bloom = 0.5f;
  const Tensor blooming = develop(radiance, how);
  const Index row = N / 2 * N, edge = N / 2;
  CHECK(blooming[row + edge] > sharp[row + edge] + 0.05f);
  CHECK(blooming[row + edge + 5] == sharp[row + edge + 5]);
}

TEST_CASE("sharpening overshoots on both sides of an edge") {
  const Index N = 32;
  Tensor radiance({3, N, N}, 0.3f);
  for (Index k = 0; k < 3 * N * N; ++k) radiance[k] = k % N < N / 2 ? 0.3f : 0.6f;
  Development how = plain();
  how.dark = 0.3f;
  how.bright = 0.6f;
  how.halo = 0.8f;
  const Tensor image = develop(radiance, how);
  const Index row = N / 2 * N;
  CHECK(image[row + N / 2 - 1] < image[row + 4] - 0.05f);
  CHECK(image[row + N / 2] > image[row + N - 5] + 0.05f);
}

TEST_CASE("blurred keeps the mean and smears along the columns alone") {
  const Index N = 41, c = N / 2;
  Tensor spot({1, N, N});
  spot[c * N + c] = 1;
  const auto spread = [&](const Tensor& t, bool rows) {
    double sum = 0, square = 0;
    for (Index i = 0; i < N; ++i) {
      for (Index j = 0; j < N; ++j) {
        const auto d = static_cast<double>(rows ? i - c : j - c),
                   w = static_cast<double>(t[i * N + j]);
        sum += w;
        square += w * d * d;
      }
    }
    CHECK(sum == doctest::Approx(1).epsilon(1e-5));
    return square;
  };
  const Tensor round = blurred(spot, 1.5f), smeared = blurred(spot, 1.5f, 6);
  CHECK(spread(round, true) == doctest::Approx(2.25).epsilon(0.02));
  CHECK(spread(smeared, false) == doctest::Approx(spread(round, false)).epsilon(1e-4));
  // a box of length L has variance L^2 / 12
  CHECK(spread(smeared, true) == doctest::Approx(2.25 + 3).epsilon(0.03));
}

TEST_CASE("pan-sharpening keeps the luminance and gives colours at a quarter") {
  const Index H = 22, W = 30, P = H * W;
  Rng rng(4);
  const Tensor luminance = uniform_tensor<float>({1, H, W}, rng, 0.2, 0.9);
  Tensor bands({3, H, W});
  const std::array<float, 3> tint{1.2f, 1.0f, 0.7f};
  for (Index k = 0; k < 3 * P; ++k)
    bands[k] = tint[static_cast<std::size_t>(k / P)] * luminance[k % P];
  // One colour everywhere: the bands come back, but for the floor under the ratio.
  const Tensor same = pan_sharpened(bands, luminance, {0, 0});
  for (Index k = 0; k < 3 * P; ++k) CHECK(same[k] == doctest::Approx(bands[k]).epsilon(0.12));

  // A red and a green half: next to their border the colours mix, farther off they do not.
  for (Index k = 0; k < P; ++k) {
    const bool left = k % W < 15;
    bands[k] = left ? 0.6f : 0.1f;
    bands[P + k] = left ? 0.1f : 0.6f;
    bands[2 * P + k] = 0.1f;
  }
  const Tensor flat({1, H, W}, 0.4f), mixed = pan_sharpened(bands, flat, {0, 0});
  const Index row = 10 * W;
  CHECK(mixed[row + 2] == doctest::Approx(0.6).epsilon(1e-4));
  CHECK(mixed[row + 14] < 0.5f);
  CHECK(mixed[row + 14] > mixed[row + 16]);
}

TEST_CASE("blocks are quantised the more the lower the quality") {
  const Index H = 21, W = 34;
  Tensor constant({3, H, W}, 77.0f);
  quantise_blocks(constant, 90);
  for (const float v : constant.values()) CHECK(std::abs(v - 77) <= 1);

  Rng rng(6);
  for (const Index C : {Index{1}, Index{3}}) {
    const Tensor image = uniform_tensor<float>({C, H, W}, rng, 60, 200);
    double before = 0;
    for (const int quality : {98, 90, 70}) {
      Tensor coded = image.clone();
      quantise_blocks(coded, quality);
      double error = 0;
      for (Index k = 0; k < image.count(); ++k) {
        CHECK_UNARY(coded[k] == std::round(coded[k]) && coded[k] >= 0 && coded[k] <= 255);
        error += std::abs(static_cast<double>(coded[k] - image[k]));
      }
      error /= static_cast<double>(image.count());
      CHECK(error > before);
      CHECK(error < 30);
      before = error;
    }
  }
}

TEST_CASE("a bare crown is seen through, and its shadow is light") {
  const City city = grove(40);
  const Quadratic above = from_above(city);
  const Index N = 40, middle = N / 2 * N + N / 2;
  Daylight light{.sun = {.elevation_deg = 45, .azimuth_deg = 180}};
  const LitCity leafy = light_city(city, light);
  light.leaves = 0;
  const LitCity bare = light_city(city, light);
  CHECK(leafy.sparse_shade.empty());
  REQUIRE_FALSE(bare.sparse_shade.empty());
  // What is true does not depend on the season.
  CHECK(leafy.field.z[middle] == 8);
  CHECK(bare.field.z[middle] == 8);
  const Tensor summer = render_view(city, leafy, above, N, N),
               winter = render_view(city, bare, above, N, N);
  CHECK(winter[middle] > 3 * summer[middle]);
  // 8 m to the north of the crown's edge, in its shadow; and far from it.
  const Index shaded = (N / 4 - 8) * N + N / 2, open = (N - 3) * N + N / 2;
  CHECK(summer[shaded] < 0.5f * summer[open]);
  CHECK(winter[shaded] > 1.2f * summer[shaded]);
  CHECK(winter[shaded] < 0.95f * winter[open]);
  CHECK(winter[open] == summer[open]);
}

TEST_CASE("visitors stand on the ground of their date, and throw shadows") {
  City city = grove(40);
  city.visitors.push_back({.x = -7, .y = -7, .cos = 1, .sin = 0, .length = 4});
  Daylight light{.sun = {.elevation_deg = 30, .azimuth_deg = 180}};
  light.visitors = 0;
  const LitCity empty = light_city(city, light);
  light.visitors = 1;
  const LitCity parked = light_city(city, light);
  const auto column = [](double x, double y) {
    return static_cast<Index>((10 - y) / 0.5) * 40 + static_cast<Index>((x + 10) / 0.5);
  };
  const Index car = column(-7, -7), behind = column(-7, -5.5);
  CHECK(empty.field.z[car] == 0);
  CHECK(parked.field.z[car] == doctest::Approx(1.45));
  CHECK(city.field.z[car] == 0);
  CHECK(empty.shade[behind] < 0);
  CHECK(parked.shade[behind] > 0.3f);
}

TEST_CASE("the sun is low on some dates and never too low where it rises high enough") {
  int low = 0, all = 0;
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    Rng rng(seed);
    for (const ViewPlan& v : plan_views({.views = 5, .gsd_m = 0.4, .lat_deg = 42}, rng)) {
      const double e = sun_at(42, v.day_of_year, v.solar_hour).elevation_deg;
      CHECK(e > 15);
      low += e < 32;
      ++all;
    }
  }
  CHECK(low > all / 4);
  CHECK(low < 3 * all / 4);
}

TEST_CASE("seasons: bare in winter, green in summer, never white in the tropics") {
  const Sun sun{.elevation_deg = 30, .azimuth_deg = 170};
  int snow = 0;
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    Rng a(seed), b(seed), c(seed), d(seed);
    const Daylight january = draw_daylight(sun, 48, 15, a), july = draw_daylight(sun, 48, 190, b),
                   south = draw_daylight(sun, -48, 15, c), equator = draw_daylight(sun, 3, 15, d);
    CHECK(january.leaves < 0.3f);
    CHECK(july.leaves == 1);
    CHECK(july.snow == 0);
    CHECK(south.leaves == 1);
    CHECK(equator.leaves > 0.15f);
    CHECK(equator.snow == 0);
    snow += january.snow > 0;
  }
  CHECK(snow > 5);
  CHECK(snow < 30);
}

TEST_CASE("towns hold wide flat roofs and, some of them, towers, none above the cap") {
  int wide = 0, canopies = 0, roads = 0;
  for (std::uint64_t seed = 0; seed < 16; ++seed) {
    const City city = make_city({.kind = SceneKind::industrial,
                                 .relief = 1,
                                 .tallest = 30,
                                 .x0 = -125,
                                 .y0 = 125,
                                 .step = 0.5,
                                 .size = 500},
                                Rng(seed));
    for (const Part& p : city.parts) {
      const float narrow = 2 * std::min(p.a, p.b);
      wide += narrow > 45 && p.roof == Roof::flat && p.texture < 0.6f;
      (std::max(p.a, p.b) > 120 ? roads : canopies) += p.open;
      CHECK(p.eave + (p.roof == Roof::flat ? p.rise : 0) <= 1 + 30 + 0.01f);
    }
  }
  CHECK(wide >= 16);
  CHECK(canopies >= 1);
  CHECK(roads >= 1);
  CHECK(roads <= 6);

  SimulateConfig config;
  config.kinds = {SceneKind::city};
  config.pixels = 32, config.views = 2, config.heights = false, config.gsd = 0.6;
  config.water = 0;
  double tallest = 0;
  for (Index k = 0; k < 24; ++k) {
    const SimulatedScene scene = simulate_scene(config, 2, k);
    tallest = std::max(tallest, scene.h_max - scene.h_min);
  }
  CHECK(tallest > 60);
  config.tallest_max = 24;
  for (Index k = 0; k < 12; ++k) {
    const SimulatedScene scene = simulate_scene(config, 2, k);
    CHECK(scene.h_max - scene.h_min < 24 + 2 * 8);
  }
}

TEST_CASE("dark ground changes the colour of soil, rock and plants and nothing else") {
  const auto natural = [](Material m) {
    return m == Material::soil || m == Material::rock || m == Material::grass ||
           m == Material::field;
  };
  int darkened = 0, layered = 0;
  for (std::uint64_t seed = 0; seed < 6; ++seed) {
    CityPlan plan = open_country(seed, 20);
    const City bright = make_city(plan, Rng(seed));
    plan.dark = true;
    const City dark = make_city(plan, Rng(seed));
    CHECK(std::ranges::equal(bright.field.z.values(), dark.field.z.values()));
    double before = 0, after = 0;
    Index much = 0, cells = 0;
    for (std::size_t k = 0; k < dark.cells.size(); ++k) {
      const SurfaceCell &b = bright.cells[k], &d = dark.cells[k];
      REQUIRE(b.material == d.material);
      if (!natural(b.material)) {
        if (b.albedo != d.albedo) FAIL("a cell that is not natural has changed");
        continue;
      }
      before += b.albedo[1];
      after += d.albedo[1];
      much += 2 * d.albedo[1] < b.albedo[1];
      ++cells;
    }
    CAPTURE(seed);
    CHECK(after < before);
    darkened += 5 * much > cells;

    // Without stains and folds the layers of rock depend on nothing but the height.
    const DarkGround ground(plan, Rng(seed));
    CHECK(ground.factor(0, 3, 0, Material::asphalt) == 1);
    CHECK(ground.factor(0, 3, 0, Material::roof) == 1);
    float least = 2, most = 0;
    for (float z = -20; z < 20; z += 0.25f) {
      const float f = ground.factor(0, z, 2, Material::rock);
      least = std::min(least, f);
      most = std::max(most, f);
    }
    CHECK(least > 0.0);
    CHECK(most < 1.3);
    layered += most > 1.1f * least;
  }
  CHECK(darkened >= 2);
  CHECK(layered >= 1);
  CHECK(layered <= 5);
}

TEST_CASE("rock stands out of open ground where it is asked for, and stays within the relief") {
  int steeper = 0;
  for (std::uint64_t seed = 0; seed < 6; ++seed) {
    CityPlan plan = open_country(seed, 40);
    // cells that differ from the one beside them by their size or more
    const auto faces = [&] {
      Layout layout;
      layout.plan = plan;
      shape_ground(layout, Rng(seed));
      Index steep = 0;
      for (Index k = 0; k < layout.terrain.count(); ++k) {
        REQUIRE(std::abs(layout.terrain[k]) <= 40.001f);
        steep += k % 400 > 0 && std::abs(layout.terrain[k] - layout.terrain[k - 1]) > 0.5f;
      }
      return steep;
    };
    const Index before = faces();
    plan.crags = true;
    const Index after = faces();
    CAPTURE(seed);
    CHECK(after > 400);  // of 160,000
    steeper += after > before + 400;
  }
  CHECK(steeper >= 4);
  SimulateConfig config;
  config.pixels = 64;
  config.views = 1;
  config.kinds = {SceneKind::city};
  const SimulatedScene town = simulate_scene(config, 4, 0);
  config.crags = 1;
  CHECK(std::ranges::equal(simulate_scene(config, 4, 0).views[0].rgb.values(),
                           town.views[0].rgb.values()));
}

TEST_CASE("two of five grounds with rock are open pits: level benches that climb as a whole") {
  const auto benched = [](std::uint64_t seed, bool crags) {
    Layout layout;
    layout.plan = open_country(seed, 80);
    layout.plan.crags = crags;
    shape_ground(layout, Rng(seed));
    const Index N = layout.plan.size;
    const Tensor& z = layout.terrain;
    const float slope = 0.15f * static_cast<float>(layout.plan.step);
    Index level = 0;
    for (Index i = 1; i < N; ++i)
      for (Index j = 1; j < N; ++j)
        level +=
            std::hypot(z[i * N + j] - z[i * N + j - 1], z[i * N + j] - z[(i - 1) * N + j]) < slope;
    std::array<float, 4> sides{};  // west, east, north, south
    for (Index i = 0; i < N; ++i) {
      const std::array ends{z[i * N], z[i * N + N - 1], z[i], z[(N - 1) * N + i]};
      for (std::size_t k = 0; k < 4; ++k) sides[k] += ends[k] / static_cast<float>(N);
    }
    const float climb = std::hypot(sides[1] - sides[0], sides[3] - sides[2]);
    return 2 * level > N * N && climb > 90;
  };
  int without = 0, with = 0;
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    without += benched(seed, false);
    with += benched(seed, true);
  }
  CHECK(with >= 12);
  CHECK(with >= 2 * without);
}

TEST_CASE("kinds are drawn by their weights") {
  SimulateConfig config;
  config.pixels = 16, config.views = 1, config.heights = false, config.gsd = 0.6;
  config.kinds = {SceneKind::city, SceneKind::rural, SceneKind::suburb};
  config.kind_weights = {0, 3, 1};
  check_config(config);
  int rural = 0, suburb = 0;
  for (Index k = 0; k < 40; ++k) {
    const SceneKind kind = simulate_scene(config, 7, k).kind;
    rural += kind == SceneKind::rural;
    suburb += kind == SceneKind::suburb;
  }
  CHECK(rural + suburb == 40);
  CHECK(rural > 22);
  CHECK(suburb > 3);

  config.kind_weights = {1, 2};
  CHECK_THROWS_WITH_AS(check_config(config),
                       "simulate: kind_weights has 2 numbers, expected the 3 of kinds, or none",
                       ConfigError);
  config.kind_weights = {0, 0, 0};
  CHECK_THROWS_WITH_AS(check_config(config),
                       "simulate: kind_weights are all 0, expected one above 0, or none",
                       ConfigError);
  config.kind_weights = {1, -1, 1};
  CHECK_THROWS_AS(check_config(config), ConfigError);
}

namespace {

// Even ground with a house of 20 by 12 m and a rough clump beside it; 64 m a side.
GivenSurface little_town(bool classified) {
  const Index N = 128;
  GivenSurface s{.z = Tensor({N, N}, 31.5f),
                 .classes = {},
                 .grid = {.epsg = 32633, .x0 = 500000, .y0 = 5400064, .step = 0.5},
                 .zone = {.number = 33, .north = true}};
  Tensor classes({N, N}, 2.0f);
  Rng rng(8);
  for (Index i = 30; i < 54; ++i) {
    for (Index j = 20; j < 60; ++j) {
      s.z[i * N + j] = 40;
      classes[i * N + j] = 6;
    }
    for (Index j = 80; j < 110; ++j) {
      s.z[i * N + j] = 36 + static_cast<float>(rng.uniform(0, 4));
      classes[i * N + j] = 5;
    }
  }
  for (Index j = 0; j < N; ++j) s.z[100 * N + j] = std::nanf("");
  if (classified) s.classes = classes;
  return s;
}

}  // namespace

TEST_CASE("a given surface keeps its heights and its place under made-up light") {
  SimulateConfig config;
  config.pixels = 64, config.views = 3, config.gsd = 0.5, config.panchromatic = 0;
  for (const bool classified : {true, false}) {
    CAPTURE(classified);
    const GivenSurface town = little_town(classified);
    const SimulatedScene scene = simulate_on_surface(town, config, 3, 0);
    CHECK(scene.frame.zone == town.zone);
    CHECK(scene.views.size() == 3);
    const Index N = scene.dsm.z.dim(0), M = town.z.dim(0);
    Index inside = 0, wrong = 0, houses = 0, trees = 0;
    for (Index i = 0; i < N; ++i) {
      for (Index j = 0; j < N; ++j) {
        const double e = scene.frame.easting0 + scene.dsm.x0 +
                         (static_cast<double>(j) + 0.5) * scene.dsm.step,
                     n = scene.frame.northing0 + scene.dsm.y0 -
                         (static_cast<double>(i) + 0.5) * scene.dsm.step;
        const auto r = static_cast<Index>(std::floor((town.grid.y0 - n) / town.grid.step)),
                   c = static_cast<Index>(std::floor((e - town.grid.x0) / town.grid.step));
        const float z = scene.dsm.z[i * N + j];
        CHECK_UNARY(std::isfinite(z));
        if (r < 0 || c < 0 || r >= M || c >= M) continue;
        const auto want = static_cast<double>(town.z[r * M + c]);
        if (std::isnan(want)) continue;
        ++inside;
        wrong += std::abs(static_cast<double>(z) + scene.frame.h0 - want) > 1e-3;
        const bool house = r >= 32 && r < 52 && c >= 22 && c < 58,
                   tree = r >= 32 && r < 52 && c >= 82 && c < 108;
        const float label = scene.classes[i * N + j];
        if (house) houses += label == 6 ? 1 : -1;
        if (tree) trees += label == 5 ? 1 : -1;
      }
    }
    CHECK(inside > M * M / 3);
    CHECK(wrong == 0);
    CHECK(houses > 400);
    CHECK(trees > 200);
    for (const SimulatedView& v : scene.views) {
      for (const float z : v.height.values()) CHECK_UNARY(std::isfinite(z));
      CHECK(v.rpc.project(scene.frame.geodetic_from_local({0, 0, 0})).x ==
            doctest::Approx(31.5).epsilon(0.8));
    }
  }
  CHECK_FALSE(simulate_on_surface(little_town(true), config, 3, 1).frame ==
              simulate_on_surface(little_town(true), config, 3, 0).frame);

  GivenSurface other = little_town(true);
  other.classes = Tensor({5, 128});
  CHECK_THROWS_AS(simulate_on_surface(other, config, 3, 0), ShapeError);
}

TEST_CASE("surfaces are read as they were written, and wrong ones are refused") {
  const test::TempFolder folder("surface");
  const GivenSurface town = little_town(true);
  const auto dsm = folder.path() / "dsm.tif", classes = folder.path() / "classes.tif";
  rpc::write_geo_raster(dsm, town.z, town.grid);
  rpc::write_geo_raster(classes, town.classes, town.grid);
  const GivenSurface back = read_surface(dsm, classes);
  CHECK(back.zone == town.zone);
  CHECK(back.grid == town.grid);
  CHECK(back.z[77] == town.z[77]);
  CHECK(std::isnan(back.z[100 * 128]));
  CHECK(back.classes[40 * 128 + 30] == 6);
  CHECK(read_surface(dsm, {}).classes.empty());

  rpc::GeoGrid moved = town.grid;
  moved.x0 += 1;
  rpc::write_geo_raster(classes, town.classes, moved);
  CHECK_THROWS_WITH_AS(
      read_surface(dsm, classes),
      (classes.string() + ": another grid, expected that of " + dsm.string()).c_str(), IoError);
  moved.epsg = 3857;
  rpc::write_geo_raster(dsm, town.z, moved);
  CHECK_THROWS_WITH_AS(read_surface(dsm, {}),
                       (dsm.string() + ": EPSG:3857, expected a zone of UTM or no system").c_str(),
                       IoError);
}
