// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/crop.h"
#include "satsurf/scene/dataset.h"
#include "satsurf/scene/simulate/city.h"
#include "satsurf/scene/simulate/noise.h"
#include "satsurf/scene/simulate/orbit.h"
#include "satsurf/scene/simulate/render.h"
#include "satsurf/scene/simulate/scene.h"

#include <cmath>
#include <cstring>
#include <fstream>
#include <numbers>
#include <set>

#include "tests/ref/raycast_ref.h"
#include "tests/temp_folder.h"
#include <doctest/doctest.h>
#include <nlohmann/json.hpp>

using namespace satsurf;
using namespace satsurf::scene;
using namespace satsurf::scene::simulate;

namespace {

// local = origin + pixel * size (y down) + z * slant, with a little curvature.
Quadratic slanted(double x0, double y0, double size, double slant_x, double slant_y) {
  Quadratic q;
  q.coeff[0][0] = x0;
  q.coeff[0][1] = size;
  q.coeff[0][3] = slant_x;
  q.coeff[0][4] = 1e-5;
  q.coeff[1][0] = y0;
  q.coeff[1][2] = -size;
  q.coeff[1][3] = slant_y;
  q.coeff[1][6] = 1e-5;
  return q;
}

bool same_bits(const Tensor& a, const Tensor& b) {
  return a.shape() == b.shape() &&
         std::memcmp(a.data(), b.data(), static_cast<std::size_t>(a.count()) * sizeof(float)) == 0;
}

SimulateConfig small_config(SceneKind kind) {
  SimulateConfig config;
  config.pixels = 64;
  config.views = 3;
  config.gsd = 0.5;
  config.kinds = {kind};
  return config;
}

// Bilinear, no checks.
double sample(const float* image, Index W, double x, double y) {
  const auto i = static_cast<Index>(std::floor(y)), j = static_cast<Index>(std::floor(x));
  const double fy = y - std::floor(y), fx = x - std::floor(x);
  const auto at = [&](Index r, Index c) { return static_cast<double>(image[r * W + c]); };
  return (1 - fy) * ((1 - fx) * at(i, j) + fx * at(i, j + 1)) +
         fy * ((1 - fx) * at(i + 1, j) + fx * at(i + 1, j + 1));
}

// Correlation of view `b`, resampled through heights seen in view `a` plus `lift`, with view `a`.
double agreement(const SimulatedScene& scene, std::size_t a, std::size_t b, double lift) {
  const SimulatedView &va = scene.views[a], &vb = scene.views[b];
  const Index H = va.rgb.dim(1), W = va.rgb.dim(2);
  double n = 0, sa = 0, sb = 0, saa = 0, sbb = 0, sab = 0;
  for (Index i = 1; i + 1 < H; ++i) {
    for (Index j = 1; j + 1 < W; ++j) {
      const double z = static_cast<double>(va.height[i * W + j]);
      const auto ground = va.rpc.localize({static_cast<double>(j), static_cast<double>(i)},
                                          z + scene.frame.h0 + lift);
      const auto p = vb.rpc.project(ground);
      if (p.x < 0 || p.y < 0 || p.x > static_cast<double>(W - 2) ||
          p.y > static_cast<double>(H - 2))
        continue;
      // Only what both views see.
      if (std::abs(static_cast<double>(vb.height[std::lround(p.y) * W + std::lround(p.x)]) - z) >
              0.5 &&
          lift == 0)
        continue;
      const double u = static_cast<double>(va.rgb[i * W + j]),
                   v = sample(vb.rgb.data(), W, p.x, p.y);
      n += 1, sa += u, sb += v, saa += u * u, sbb += v * v, sab += u * v;
    }
  }
  REQUIRE(n > 1000);
  return (sab - sa * sb / n) / std::sqrt((saa - sa * sa / n) * (sbb - sb * sb / n));
}

}  // namespace

TEST_CASE("heights_in_view agrees with marching down every ray") {
  const Index H = 23, W = 19;
  Rng rng(3);
  HeightField field{
      .z = uniform_tensor<float>({H, W}, rng, 0.0, 6.0), .x0 = -3.0, .y0 = 7.0, .step = 0.7};
  for (Index k = 0; k < H * W; ++k) {
    if (rng.chance(0.7)) field.z[k] = 0.5f * std::floor(field.z[k] / 3);  // mostly open ground
  }
  field.z[7 * W + 11] = std::nanf("");
  const std::array<std::array<double, 2>, 5> slants{
      {{0.6, -0.3}, {-0.4, -0.7}, {0.0, 0.53}, {-0.8, 0.0}, {0.0, 0.0}}};
  for (const auto& slant : slants) {
    CAPTURE(slant[0]);
    CAPTURE(slant[1]);
    const Quadratic map = slanted(-4.2, 8.1, 0.41, slant[0], slant[1]);
    const Index rows = 45, cols = 38;
    const Tensor z = heights_in_view(field, map, rows, cols);
    Index unknown = 0, different = 0;
    double worst = 0;
    for (Index i = 0; i < rows; ++i) {
      for (Index j = 0; j < cols; ++j) {
        const double want = ref::height_by_marching(field, map, static_cast<double>(j),
                                                    static_cast<double>(i), 4000);
        const auto got = static_cast<double>(z[i * cols + j]);
        unknown += std::isnan(got);
        if (std::isnan(want) != std::isnan(got) || std::abs(want - got) > 4e-3)
          ++different;
        else if (!std::isnan(got))
          worst = std::max(worst, std::abs(want - got));
      }
    }
    CHECK(unknown > 100);  // beyond the grid, and where the hole is
    CHECK(unknown < rows * cols / 2);
    CHECK(different <= 3);  // rays that graze an edge by less than a marching step
    CHECK(worst <= 2e-3);   // 6 m in 4000 steps
  }
}

TEST_CASE("heights_in_view on simple fields") {
  HeightField field{.z = Tensor({5, 7}, 2.5f), .x0 = 0, .y0 = 5, .step = 1};
  SUBCASE("flat ground is seen at its height, and nothing beyond it") {
    const Tensor z = heights_in_view(field, slanted(-0.5, 5.5, 1, 0, 0), 7, 9);
    for (Index i = 0; i < 7; ++i) {
      for (Index j = 0; j < 9; ++j) {
        const bool inside = i > 0 && i < 6 && j > 0 && j < 8;
        if (inside)
          CHECK(z[i * 9 + j] == 2.5f);
        else
          CHECK(std::isnan(z[i * 9 + j]));
      }
    }
  }
  SUBCASE("a wall is seen between the ground before it and its top") {
    for (Index i = 0; i < 5; ++i) {
      for (Index j = 4; j < 7; ++j) field.z[i * 7 + j] = 6.5f;
    }
    // A ray loses 1 m of height per m towards the east: from (2, 6.5 m) it meets x = 4 at 4.5 m.
    Quadratic map = slanted(0, 4.5, 1, -1, 0);
    map.coeff[0][0] = 2 + 6.5;
    map.coeff[0][4] = map.coeff[1][6] = 0;
    const Tensor z = heights_in_view(field, map, 1, 1);
    CHECK(z[0] == doctest::Approx(4.5));
  }
  SUBCASE("the lowest ground is seen however its height rounds") {
    HeightField wide{.z = Tensor({40, 40}), .x0 = 0, .y0 = 40, .step = 1};
    for (Index k = 0; k < 60; ++k) {
      const float low = -36.1f - 0.37f * static_cast<float>(k);
      wide.z.fill(low);
      wide.z[0] = 52.3f + 0.7f * static_cast<float>(k);
      const Tensor z = heights_in_view(wide, slanted(20, 20, 1, 0.01, 0.02), 3, 3);
      for (const float v : z.values()) CHECK(v == low);
    }
  }
  SUBCASE("nothing is seen where nothing is known") {
    field.z.fill(std::nanf(""));
    const Tensor seen = heights_in_view(field, slanted(0, 5, 1, 0, 0), 3, 4);
    for (const float z : seen.values()) CHECK(std::isnan(z));
  }
  SUBCASE("an unknown cell hides what lies behind it") {
    field.z[2 * 7 + 3] = std::nanf("");
    const Tensor z = heights_in_view(field, slanted(0.5, 4.5, 1, 0, 0), 5, 7);
    CHECK(std::isnan(z[2 * 7 + 3]));
    CHECK(z[2 * 7 + 2] == 2.5f);
  }
}

TEST_CASE("the orbital camera") {
  Acquisition a;
  a.target = {.lon = -81.66, .lat = 30.35, .h = -20};
  a.azimuth_deg = 70;
  a.off_nadir_deg = 20;
  a.width_px = 300;
  a.height_px = 200;
  const PushBroom camera(a);
  const auto centre = camera.project(a.target);
  CHECK(centre.x == doctest::Approx(149.5).epsilon(1e-9));
  CHECK(centre.y == doctest::Approx(99.5).epsilon(1e-9));

  SUBCASE("pixels have the wanted size, x to the east and y to the south") {
    const double metre = 1 / 110.85e3;  // degrees of latitude here
    const auto north = camera.project({a.target.lon, a.target.lat + 30 * metre, a.target.h});
    CHECK(north.y - centre.y == doctest::Approx(-100).epsilon(2e-3));
    CHECK(std::abs(north.x - centre.x) < 0.1);
    const auto east = camera.project({a.target.lon + 30 / 96.1e3, a.target.lat, a.target.h});
    CHECK(east.x - centre.x == doctest::Approx(100).epsilon(2e-3));
  }
  SUBCASE("what is higher is seen displaced away from the satellite") {
    const double zenith =
        std::asin((6371e3 + 617e3) / 6371e3 * std::sin(20 * std::numbers::pi / 180));
    const auto up = camera.project({a.target.lon, a.target.lat, a.target.h + 10});
    const double shift = 10 * std::tan(zenith) / a.gsd_m, azimuth = 70 * std::numbers::pi / 180;
    CHECK(up.x - centre.x == doctest::Approx(-shift * std::sin(azimuth)).epsilon(5e-3));
    CHECK(up.y - centre.y == doctest::Approx(shift * std::cos(azimuth)).epsilon(5e-3));
  }
  SUBCASE("an RPC stands for it to far less than a pixel, everywhere") {
    for (const double lat : {-58.0, 0.0, 45.0}) {
      for (const double off_nadir : {5.0, 32.0}) {
        CAPTURE(lat);
        CAPTURE(off_nadir);
        Acquisition b = a;
        b.target.lat = lat;
        b.off_nadir_deg = off_nadir;
        b.scan_azimuth_deg = 200;
        const RpcFit fit = fit_rpc(PushBroom(b), -100, 200);
        CHECK(fit.max_px < 1e-4);
        CHECK(fit.rms_px > 0);
        CHECK(fit.rms_px <= fit.max_px);
        const auto p = fit.rpc.project(b.target);
        CHECK(p.x == doctest::Approx(149.5).epsilon(1e-6));
      }
    }
  }
  SUBCASE("so do the maps that large images are made with") {
    Acquisition b = a;
    b.off_nadir_deg = 30;
    b.gsd_m = 0.5;
    b.width_px = b.height_px = 12'000;
    const RpcFit fit = fit_rpc(PushBroom(b), -300, 400);
    CHECK(fit.max_px < 1e-3);
    const rpc::LocalFrame frame{rpc::utm_zone_of(-81.66, 30.35), 436'000, 3'358'000, -20};
    const Quadratic map = rpc::fit_localisation(fit.rpc, frame, {0, 0, 12'000, 12'000}, {-10, 160});
    CHECK(map.max < 0.05);  // m
    MESSAGE(fit.max_px << " px, " << map.max << " m");
  }
  SUBCASE("heights that are no range are refused") {
    CHECK_THROWS_WITH_AS(fit_rpc(camera, 5, 5),
                         "fit_rpc: heights 5.000000 to 5.000000, expected low < high", Error);
  }
}

TEST_CASE("sun and date") {
  // Noon at the equinox: 90 degrees less the latitude, in the south; at the equator in the zenith.
  CHECK(sun_at(40, 81, 12).elevation_deg == doctest::Approx(50).epsilon(0.02));
  CHECK(sun_at(40, 81, 12).azimuth_deg == doctest::Approx(180).epsilon(1e-6));
  CHECK(sun_at(-40, 81, 12).azimuth_deg == doctest::Approx(0).epsilon(1e-6));
  CHECK(sun_at(0, 81, 9).azimuth_deg == doctest::Approx(90).epsilon(0.01));
  // Jacksonville, 15 February, 16:12 UTC: the sun runs 14 minutes behind the clock; metadata of a
  // real image say 42.2 and 150.2 degrees.
  const Sun sun = sun_at(30.35, 46, 16.202 - 81.66 / 15 - 14.2 / 60);
  CHECK(sun.elevation_deg == doctest::Approx(42.2).epsilon(0.02));
  CHECK(sun.azimuth_deg == doctest::Approx(150.2).epsilon(0.01));
  CHECK(date_string(2016, 60, 10.5, 0) == "20160229103000");
  CHECK(date_string(2015, 365, 10.5, -165) == "20151231213000");
  CHECK(date_string(2015, 60, 10.5, 165) == "20150228233000");
}

TEST_CASE("views are planned within the rules") {
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    CAPTURE(seed);
    for (const bool same_pass : {false, true}) {
      Rng rng(seed);
      const ViewRules rules{.views = 3, .gsd_m = 0.5, .lat_deg = 50, .same_pass = same_pass};
      const auto views = plan_views(rules, rng);
      REQUIRE(views.size() == 3);
      for (const ViewPlan& v : views) {
        CHECK(v.off_nadir_deg >= 5 - 1e-9);
        CHECK(v.off_nadir_deg <= 32 + 1e-9);
        CHECK((v.date == 0) == (same_pass || &v == &views[0]));
        CHECK(sun_at(50, v.day_of_year, v.solar_hour).elevation_deg > 14);
        for (const ViewPlan& w : views) {
          if (&v == &w) continue;
          const auto ground = [](const ViewPlan& p) {
            const double r = std::numbers::pi / 180, t = std::tan(p.off_nadir_deg * r);
            return std::array{t * std::sin(p.azimuth_deg * r), t * std::cos(p.azimuth_deg * r)};
          };
          const auto a = ground(v), b = ground(w);
          const double parallax = std::hypot(a[0] - b[0], a[1] - b[1]) / 0.5;
          CHECK(parallax >= 0.3 - 1e-9);
          CHECK(parallax <= 2.0 + 1e-9);
        }
      }
    }
  }
}

TEST_CASE("noise") {
  const Tensor n = fractal_noise(70, 90, 0.5, {.period = 12, .octaves = 3, .seed = 5});
  double sum = 0, power = 0;
  for (const float v : n.values()) {
    CHECK(std::abs(v) < 1.8f);
    sum += static_cast<double>(v);
    power += static_cast<double>(v) * static_cast<double>(v);
  }
  CHECK(std::abs(sum / static_cast<double>(n.count())) < 0.2);
  CHECK(power / static_cast<double>(n.count()) > 0.05);
  float step = 0;
  for (Index k = 1; k < 90; ++k) step = std::max(step, std::abs(n[k] - n[k - 1]));
  CHECK(step < 0.5f);  // continuous
  CHECK(step > 0.02f);
}

TEST_CASE("a block throws a shadow of its height over the tangent of the sun's elevation") {
  City city;
  const Index N = 121;
  city.field = {.z = Tensor({N, N}), .x0 = 0, .y0 = 60.5, .step = 0.5};
  city.cells.resize(static_cast<std::size_t>(N * N));
  const Index c = N / 2;
  for (Index i = c - 4; i <= c + 4; ++i) {
    for (Index j = c - 4; j <= c + 4; ++j) city.field.z[i * N + j] = 10;
  }
  for (const double azimuth : {90.0, 180.0, 135.0, 20.0}) {
    CAPTURE(azimuth);
    const LitCity lit = light_city(city, {.sun = {.elevation_deg = 40, .azimuth_deg = azimuth}});
    const double a = azimuth * std::numbers::pi / 180,
                 length = 10 / std::tan(40 * std::numbers::pi / 180);
    // Along the ray through the block's centre away from the sun, from the block's own edge.
    const double edge = 2.25 / std::max(std::abs(std::sin(a)), std::abs(std::cos(a)));
    for (double d = edge + 0.8; d < edge + length + 8; d += 0.5) {
      const auto i = c + std::lround(d * std::cos(a) / 0.5),
                 j = c - std::lround(d * std::sin(a) / 0.5);
      const bool dark = lit.shade[i * N + j] > 0;
      if (std::abs(d - edge - length) > 0.8) CHECK(dark == (d < edge + length));
    }
    // Towards the sun there is none.
    CHECK(lit.shade[(c - std::lround(12 * std::cos(a))) * N + c + std::lround(12 * std::sin(a))] <
          0);
  }
}

TEST_CASE("scenes are the same for any number of threads, and differ by seed and index") {
  const SimulateConfig config = small_config(SceneKind::city);
  set_threads(1);
  const SimulatedScene one = simulate_scene(config, 5, 2);
  set_threads(2);
  const SimulatedScene two = simulate_scene(config, 5, 2);
  set_threads(0);
  CHECK(same_bits(one.dsm.z, two.dsm.z));
  CHECK(same_bits(one.classes, two.classes));
  CHECK(one.frame == two.frame);
  for (std::size_t v = 0; v < one.views.size(); ++v) {
    CHECK(one.views[v].rpc == two.views[v].rpc);
    CHECK(same_bits(one.views[v].rgb, two.views[v].rgb));
    CHECK(same_bits(one.views[v].height, two.views[v].height));
  }
  CHECK_FALSE(simulate_scene(config, 5, 3).frame == one.frame);
  CHECK_FALSE(simulate_scene(config, 6, 2).frame == one.frame);
}

TEST_CASE("every kind of scene is complete and true to itself") {
  for (const SceneKind kind : SimulateConfig().kinds) {
    CAPTURE(enum_name(kind));
    SimulateConfig config = small_config(kind);
    config.water = 1;
    const SimulatedScene scene = simulate_scene(config, 11, 0);
    CHECK(scene.kind == kind);
    REQUIRE(scene.views.size() == 3);

    std::set<float> classes;
    float water = std::nanf("");
    for (Index k = 0; k < scene.classes.count(); ++k) {
      const float c = scene.classes[k], z = scene.dsm.z[k];
      classes.insert(c);
      CHECK_UNARY(std::isfinite(z));
      if (c != 9) continue;
      if (std::isnan(water)) water = z;
      if (z != water) FAIL("water is not flat");
    }
    for (const float c : classes) CHECK((c == 2 || c == 5 || c == 6 || c == 9));

    for (const SimulatedView& view : scene.views) {
      CHECK(view.rpc_max_px < 0.05);
      CHECK(view.date.size() == 14);
      double mean = 0, square = 0;
      for (const float v : view.rgb.values()) {
        CHECK_UNARY(v >= 0 && v <= 1 && std::abs(v * 255 - std::round(v * 255)) < 1e-3f);
        mean += static_cast<double>(v);
        square += static_cast<double>(v) * static_cast<double>(v);
      }
      const auto n = static_cast<double>(view.rgb.count());
      mean /= n;
      CHECK(mean > 0.1);
      CHECK(mean < 0.95);
      CHECK(square / n - mean * mean > 0.03 * 0.03);
      // The pixel's ray at the stated height is over, or at the wall of, a column that reaches it.
      const Index H = view.height.dim(0), W = view.height.dim(1), N = scene.dsm.z.dim(0);
      for (Index i = 0; i < H; i += 7) {
        for (Index j = 0; j < W; j += 5) {
          const auto z = static_cast<double>(view.height[i * W + j]);
          REQUIRE(std::isfinite(z));
          const auto p = scene.frame.local_from_geodetic(view.rpc.localize(
              {static_cast<double>(j), static_cast<double>(i)}, z + scene.frame.h0));
          double nearest = 1e9, tallest = -1e9;
          for (const double dy : {-1e-3, 1e-3}) {
            for (const double dx : {-1e-3, 1e-3}) {
              const auto row = static_cast<Index>((scene.dsm.y0 - p[1] + dy) / scene.dsm.step);
              const auto col = static_cast<Index>((p[0] + dx - scene.dsm.x0) / scene.dsm.step);
              const auto cell = static_cast<double>(scene.dsm.z[row * N + col]);
              nearest = std::min(nearest, std::abs(cell - z));
              tallest = std::max(tallest, cell);
            }
          }
          CHECK_UNARY(nearest < 2e-3 || tallest > z);
        }
      }
    }
  }
}

TEST_CASE("what is seen in one view is found in another at its height and not above it") {
  SimulateConfig config = small_config(SceneKind::suburb);
  config.pixels = 96;
  config.same_pass = 1;
  config.panchromatic = 1;
  config.water = 0;
  const SimulatedScene scene = simulate_scene(config, 3, 1);
  const double here = agreement(scene, 0, 2, 0), above = agreement(scene, 0, 2, 6);
  CHECK(here > 0.8);
  CHECK(above < here - 0.2);

  // The top of a cell is either seen where the camera puts it, or something nearer the satellite
  // is.
  const SimulatedView& view = scene.views[1];
  const Index N = scene.dsm.z.dim(0), W = view.height.dim(1), H = view.height.dim(0);
  Index seen = 0, hidden = 0, wrong = 0;
  for (Index i = 3; i < N; i += 5) {
    for (Index j = 2; j < N; j += 5) {
      const auto z = static_cast<double>(scene.dsm.z[i * N + j]);
      const auto p = view.rpc.project(scene.frame.geodetic_from_local(
          {scene.dsm.x0 + (static_cast<double>(j) + 0.5) * scene.dsm.step,
           scene.dsm.y0 - (static_cast<double>(i) + 0.5) * scene.dsm.step, z}));
      const auto r = std::lround(p.y), c = std::lround(p.x);
      if (r < 0 || c < 0 || r >= H || c >= W) continue;
      const auto there = static_cast<double>(view.height[r * W + c]);
      if (std::abs(there - z) < 0.4)
        ++seen;
      else if (there > z)
        ++hidden;
      else
        ++wrong;  // half a pixel beside the cell, over its edge
    }
  }
  CHECK(seen > 500);
  CHECK(hidden < seen);
  CHECK(wrong < seen / 8);
}

TEST_CASE("a camera's given bias is what was asked for") {
  SimulateConfig config = small_config(SceneKind::rough);
  config.heights = false;
  const SimulatedScene exact = simulate_scene(config, 2, 0);
  CHECK(exact.views[0].height.empty());
  config.bias_px = 0.3;
  const SimulatedScene biased = simulate_scene(config, 2, 0);
  for (std::size_t v = 0; v < exact.views.size(); ++v) {
    CHECK(same_bits(exact.views[v].rgb, biased.views[v].rgb));
    const double dx = biased.views[v].rpc.samp_off - exact.views[v].rpc.samp_off;
    CHECK(dx != 0);
    CHECK(std::abs(dx) <= 0.3);
  }
}

TEST_CASE("a surface has cells of the size asked for, and no more than fit into memory") {
  SimulateConfig config;
  config.pixels = 64;
  config.views = 2;
  config.gsd = 0.5;
  const SimulatedScene fine = simulate_scene(config, 3, 0);
  CHECK(fine.dsm.step == 0.3);
  config.cell = 0.75;
  const SimulatedScene coarse = simulate_scene(config, 3, 0);
  CHECK(coarse.dsm.step == 0.75);
  const auto side = [](const SimulatedScene& s) {
    return s.dsm.step * static_cast<double>(s.dsm.z.dim(0));
  };
  CHECK(std::abs(side(coarse) - side(fine)) < 1);
  CHECK(coarse.views[0].rpc.samp_off == fine.views[0].rpc.samp_off);
  config.pixels = 16384;
  config.cell = 0.02;
  CHECK(test::error_of<Error>([&] {
          simulate_scene(config, 3, 0);
        }).starts_with("simulate: a scene of "));
}

TEST_CASE("a scene without a kind is refused") {
  SimulateConfig none = small_config(SceneKind::city);
  none.kinds.clear();
  CHECK_THROWS_WITH_AS(simulate_scene(none, 1, 0),
                       "simulate: kinds is empty, expected at least one", ConfigError);
}

TEST_CASE("written scenes are read back") {
  const test::TempFolder folder("simulate");
  SimulateConfig config = small_config(SceneKind::village);
  config.panchromatic = 0;
  const SimulatedScene scene = simulate_scene(config, 4, 0);
  write_scene(scene, folder.path(), "SIM_000");
  REQUIRE(list_scenes(folder.path()) == std::vector<std::string>{"SIM_000"});
  const Scene back = load_scene(folder.path(), "SIM_000");
  REQUIRE(back.views.size() == scene.views.size());
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    const SimulatedView& view = scene.views[v];
    CHECK(same_bits(back.views[v].rgb, view.rgb));
    CHECK(back.views[v].date == view.date);
    CHECK(back.views[v].sun_elevation_deg == doctest::Approx(view.sun_elevation_deg).epsilon(1e-6));
    const auto p = view.rpc.localize({10, 50}, scene.h_min),
               q = back.views[v].rpc.localize({10, 50}, scene.h_min);
    CHECK(p.lon == doctest::Approx(q.lon).epsilon(1e-12));
    CHECK(p.lat == doctest::Approx(q.lat).epsilon(1e-12));
  }
  REQUIRE(back.truth.has_value());
  REQUIRE(back.truth->z.shape() == scene.dsm.z.shape());
  CHECK(back.frame.zone == scene.frame.zone);
  CHECK(back.truth->x0 + back.frame.easting0 ==
        doctest::Approx(scene.dsm.x0 + scene.frame.easting0).epsilon(1e-12));
  CHECK(back.truth->y0 + back.frame.northing0 ==
        doctest::Approx(scene.dsm.y0 + scene.frame.northing0).epsilon(1e-12));
  for (Index k = 0; k < scene.dsm.z.count(); k += 13) {
    CHECK(static_cast<double>(back.truth->z[k]) + back.frame.h0 ==
          doctest::Approx(static_cast<double>(scene.dsm.z[k]) + scene.frame.h0).epsilon(1e-6));
  }
  CHECK(same_bits(back.classes, scene.classes));

  std::ifstream file(folder.path() / "Track3-Metadata" / "SIM_000.json");
  const auto record = nlohmann::json::parse(file);
  CHECK(record["views"].size() == 3);
  CHECK(record["epsg"] == scene.frame.zone.epsg());
  CHECK(record["views"][1]["acquisition_date"] == scene.views[1].date);
}
