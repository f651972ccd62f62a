// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/rng.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/rpc/read.h"

#include <array>
#include <cmath>
#include <numbers>

#include "tests/ref/rpc_data.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::rpc;

namespace {

LocalFrame frame_at(const Rpc& r, const Pixel& pixel, double h) {
  const Geodetic p = r.localize(pixel, h);
  LocalFrame f;
  f.zone = utm_zone_of(p.lon, p.lat);
  const auto utm = utm_from_geodetic(f.zone, p.lon, p.lat);
  f.easting0 = std::round(utm[0]);
  f.northing0 = std::round(utm[1]);
  f.h0 = std::round(h);
  return f;
}

Window window_around(const Pixel& centre, double size) {
  return {std::round(centre.x - size / 2), std::round(centre.y - size / 2), size, size};
}

/// The largest error of the three maps at random pixels and heights of the window, against the
/// cameras themselves.
struct Worst {
  double transfer = 0, localisation = 0, projection = 0;
};

Worst worst_errors(const Rpc& a, const Rpc& b, const Pixel& centre, double size, double h,
                   double half, std::uint64_t seed, std::array<Quadratic, 3>* maps = nullptr) {
  const LocalFrame frame = frame_at(a, centre, h);
  const Window window = window_around(centre, size);
  const HeightRange range{h - half, h + half};  // m above the ellipsoid
  const HeightRange z_range = frame.z_from_heights(range);
  const Quadratic transfer = fit_transfer(a, b, frame, window, z_range);
  const Quadratic localisation = fit_localisation(a, frame, window, z_range);
  const Quadratic projection = fit_projection(a, frame, window, z_range);
  if (maps) *maps = {transfer, localisation, projection};
  Worst w;
  Rng rng(seed);
  for (int i = 0; i < 100; ++i) {
    const Pixel p{window.x0 - 0.5 + size * rng.uniform(), window.y0 - 0.5 + size * rng.uniform()};
    const Geodetic g = a.localize(p, rng.uniform(range.low, range.high));
    const auto local = frame.local_from_geodetic(g);
    const Pixel seen = b.project(g);
    const auto t = transfer(p.x, p.y, local[2]), l = localisation(p.x, p.y, local[2]),
               q = projection(local[0], local[1], local[2]);
    w.transfer = std::max(w.transfer, std::hypot(t[0] - seen.x, t[1] - seen.y));
    w.localisation = std::max(w.localisation, std::hypot(l[0] - local[0], l[1] - local[1]));
    w.projection = std::max(w.projection, std::hypot(q[0] - p.x, q[1] - p.y));
  }
  return w;
}

/// The derivatives by central differences.
PixelJacobian jacobian_by_differences(const Rpc& r, const LocalFrame& frame,
                                      const std::array<double, 3>& p) {
  PixelJacobian j{};
  for (std::size_t k = 0; k < 3; ++k) {
    auto up = p, down = p;
    up[k] += 1;
    down[k] -= 1;
    const Pixel a = r.project(frame.geodetic_from_local(up)),
                b = r.project(frame.geodetic_from_local(down));
    j[0][k] = (a.x - b.x) / 2;
    j[1][k] = (a.y - b.y) / 2;
  }
  return j;
}

/// Columns of the rotation of a unit quaternion.
std::array<std::array<double, 3>, 3> columns(const std::array<double, 4>& q) {
  const auto [w, x, y, z] = q;
  return {{{1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)},
           {2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)},
           {2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)}}};
}

}  // namespace

TEST_CASE("fits that are not finite are refused") {
  const Rpc a = test::synthetic_rpc();
  Rpc broken = test::synthetic_rpc();
  broken.samp_den = {};
  const Pixel centre{7000, 12000};
  const LocalFrame frame = frame_at(a, centre, 90);
  CHECK_THROWS_WITH_AS(fit_transfer(a, broken, frame, window_around(centre, 64), {-50, 50}),
                       doctest::Contains("fit_transfer: the camera has no finite value"), Error);
  CHECK_THROWS_WITH_AS(fit_localisation(a, frame, window_around(centre, 64), {-50, INFINITY}),
                       doctest::Contains("fit_localisation: height range"), Error);
}

TEST_CASE("quadratic fits of synthetic cameras and their stored residuals") {
  const Rpc a = test::synthetic_rpc(12.3, 45.1, 0.3, -0.2),
            b = test::synthetic_rpc(12.301, 45.1, -0.25, 0.1);
  for (const double size : {256.0, 1024.0}) {
    CAPTURE(size);
    std::array<Quadratic, 3> maps;
    const Worst w = worst_errors(a, b, {7000, 12000}, size, 90, 50, 5, &maps);
    CHECK(w.transfer < 1e-4);
    CHECK(w.localisation < 1e-4);
    CHECK(w.projection < 1e-4);
    // A random point is never much worse than the largest stored residual, and that is no bare
    // bound.
    const std::array<double, 3> seen{w.transfer, w.localisation, w.projection};
    for (std::size_t i = 0; i < 3; ++i) {
      CHECK(seen[i] < 1.3 * maps[i].max + 1e-8);
      CHECK(maps[i].max < 4 * seen[i] + 1e-7);
      CHECK(maps[i].rms > 0);
      CHECK(maps[i].rms < maps[i].max);
    }
  }
}

TEST_CASE("the local frame's height is the third input") {
  const Rpc a = test::synthetic_rpc(), b = test::synthetic_rpc(12.301, 45.1, -0.25, 0.1);
  LocalFrame frame = frame_at(a, {500, 600}, 100);
  const Window window{400, 500, 201, 99};
  const HeightRange heights{80, 140};
  const Quadratic before = fit_transfer(a, b, frame, window, frame.z_from_heights(heights));
  frame.h0 += 30;
  const Quadratic after = fit_transfer(a, b, frame, window, frame.z_from_heights(heights));
  const auto p = before(450, 520, 20), q = after(450, 520, -10);
  CHECK(std::abs(p[0] - q[0]) < 1e-9);
  CHECK(std::abs(p[1] - q[1]) < 1e-9);
}

TEST_CASE("fits reach the outer edges of the window, and a single height will do") {
  const Rpc a = test::synthetic_rpc();
  const LocalFrame frame = frame_at(a, {500, 600}, 100);
  const Quadratic map =
      fit_localisation(a, frame, {400, 500, 200, 100}, {100 - frame.h0, 100 - frame.h0});
  CHECK(map.offset[0] == doctest::Approx(499.5));
  CHECK(map.scale[0] == doctest::Approx(100));
  CHECK(map.offset[1] == doctest::Approx(549.5));
  CHECK(map.scale[1] == doctest::Approx(50));
  const auto exact = frame.local_from_geodetic(a.localize({599.5, 599.5}, 100));
  const auto at = map(599.5, 599.5, exact[2]);
  CHECK(std::hypot(at[0] - exact[0], at[1] - exact[1]) < 1e-5);
}

TEST_CASE("a scene across the antimeridian is fitted like any other") {
  const Rpc a = test::synthetic_rpc(179.999, -16.5),
            b = test::synthetic_rpc(-179.999, -16.5, -0.2, 0.2);
  const Worst w = worst_errors(a, b, {10000, 10000}, 512, 20, 50, 9);
  CHECK(w.transfer < 1e-4);
  CHECK(w.localisation < 1e-4);
  CHECK(w.projection < 1e-4);
}

TEST_CASE("fits refuse empty windows and reversed ranges") {
  const Rpc a = test::synthetic_rpc();
  const LocalFrame frame = frame_at(a, {500, 600}, 100);
  CHECK_THROWS_WITH_AS(fit_projection(a, frame, {0, 0, 0, 5}, {0, 1}),
                       "fit_projection: window of 0 x 5 px, expected a positive size", Error);
  CHECK_THROWS_WITH_AS(fit_transfer(a, a, frame, {0, 0, 4, 5}, frame.z_from_heights({2, 1})),
                       "fit_transfer: height range 2 to 1 m, expected finite ones, low <= high",
                       Error);
}

TEST_CASE("view geometry of an affine camera") {
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    CAPTURE(seed);
    Rng rng(seed);
    // x right is east, y down is south, turned about the vertical, sheared and tilted.
    const double turn = rng.uniform(-3.1, 3.1), gsd = rng.uniform(0.3, 2),
                 shear = rng.uniform(-0.2, 0.2);
    const double tx = rng.uniform(-0.6, 0.6), ty = rng.uniform(-0.6, 0.6), c = std::cos(turn),
                 s = std::sin(turn);
    std::array<std::array<double, 3>, 2> A{{{c, s, 0}, {s + shear * c, -c + shear * s, 0}}};
    for (auto& row : A) {
      row[2] = -(row[0] * tx + row[1] * ty);  // A (tx, ty, 1) = 0
      for (double& v : row) v /= gsd;
    }
    const ViewGeometry g = view_geometry(A);
    CHECK(g.direction[0] == doctest::Approx(tx));
    CHECK(g.direction[1] == doctest::Approx(ty));
    CHECK(g.direction[2] == 1);
    const auto r = columns(g.quat);
    double norm = 0;
    for (const double v : g.quat) norm += v * v;
    CHECK(norm == doctest::Approx(1));
    // A = K2 [r1; r2] with K2 lower triangular and positive; r3 along the ray, downwards.
    const auto dot = [](const auto& u, const auto& v) {
      return u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
    };
    CHECK(dot(A[0], r[0]) > 0);
    CHECK(dot(A[1], r[1]) > 0);
    CHECK(std::abs(dot(A[0], r[1])) < 1e-12);
    CHECK(std::abs(dot(A[0], r[2])) < 1e-12);
    CHECK(std::abs(dot(A[1], r[2])) < 1e-12);
    const double length = std::sqrt(tx * tx + ty * ty + 1);
    CHECK(r[2][0] == doctest::Approx(-tx / length));
    CHECK(r[2][2] == doctest::Approx(-1 / length));
    const double det = dot(A[0], r[0]) * dot(A[1], r[1]);
    CHECK(g.footprint == doctest::Approx(1 / std::sqrt(det)));
  }
  // Straight down, north up: x right, y down, z into the ground is a half turn about x.
  const ViewGeometry nadir = view_geometry({{{2, 0, 0}, {0, -2, 0}}});
  CHECK(nadir.footprint == doctest::Approx(0.5));
  CHECK(std::abs(nadir.quat[1]) == doctest::Approx(1));
  CHECK(nadir.direction == std::array<double, 3>{0, 0, 1});
}

TEST_CASE("the camera's derivatives in a local frame") {
  const Rpc r = test::synthetic_rpc();
  const LocalFrame own = frame_at(r, {500, 600}, 100);
  LocalFrame neighbour = own;  // far from the central meridian, where north is turned most
  neighbour.zone.number -= 1;
  Rng rng(3);
  for (const LocalFrame& frame : {own, neighbour})
    for (int i = 0; i < 20; ++i) {
      const Geodetic g =
          r.localize({rng.uniform(0, 9000), rng.uniform(0, 9000)}, rng.uniform(0, 200));
      const auto p = frame.local_from_geodetic(g);
      const PixelJacobian found = pixel_jacobian(r, frame, p),
                          expected = jacobian_by_differences(r, frame, p);
      for (std::size_t k = 0; k < 2; ++k)
        for (std::size_t a = 0; a < 3; ++a) CHECK(std::abs(found[k][a] - expected[k][a]) < 1e-7);
    }
}

TEST_CASE("the inverse UTM map's derivatives") {
  Rng rng(4);
  for (int i = 0; i < 50; ++i) {
    const UtmZone zone{1 + static_cast<int>(rng.below(60)), rng.uniform() < 0.5};
    const double east = 500000 + rng.uniform(-4e5, 4e5), north = rng.uniform(1e6, 8e6);
    const auto j = geodetic_from_utm_jacobian(zone, east, north);
    constexpr double kStep = 10;  // m
    for (std::size_t k = 0; k < 2; ++k) {
      const double de = k == 0 ? kStep : 0, dn = k == 0 ? 0 : kStep;
      const auto up = geodetic_from_utm(zone, east + de, north + dn),
                 down = geodetic_from_utm(zone, east - de, north - dn);
      CHECK(j[0][k] == doctest::Approx((up[0] - down[0]) / (2 * kStep)).epsilon(1e-7));
      CHECK(j[1][k] == doctest::Approx((up[1] - down[1]) / (2 * kStep)).epsilon(1e-7));
    }
  }
}

TEST_CASE("inside an image is on one of its pixels") {
  CHECK(inside_image({-0.5, -0.5}, 4, 3));
  CHECK(inside_image({3.49, 2.49}, 4, 3));
  CHECK_FALSE(inside_image({-0.51, 1}, 4, 3));
  CHECK_FALSE(inside_image({1, -0.51}, 4, 3));
  CHECK_FALSE(inside_image({3.5, 1}, 4, 3));
  CHECK_FALSE(inside_image({1, 2.5}, 4, 3));
  CHECK_FALSE(inside_image({std::nan(""), 1}, 4, 3));
}

TEST_CASE("view geometry refuses a mirrored image") {
  CHECK_THROWS_WITH_AS(view_geometry({{{2, 0, 0}, {0, 2, 0}}}),
                       "view_geometry: the viewing direction has an upward component 1, expected a "
                       "negative one; the "
                       "image is mirrored or degenerate",
                       Error);
  CHECK_THROWS_AS(view_geometry({{{2, 0, 0}, {4, 0, 0}}}), Error);
}

TEST_CASE("real cameras: residuals of the quadratic maps") {
  const auto data = test::data_folder();
  if (data.empty()) return;
  struct Row {
    double size;
    Worst worst;
  };
  std::array<Row, 3> rows{Row{256, {}}, Row{1024, {}}, Row{2048, {}}};
  double steepest = 0, flattest = 90, smallest = 1e9, largest = 0;
  const auto measure = [&](const Rpc& a, const Rpc& b, const Pixel& centre, double h) {
    for (Row& row : rows) {
      const Worst w = worst_errors(a, b, centre, row.size, h, 50, 1);
      row.worst.transfer = std::max(row.worst.transfer, w.transfer);
      row.worst.localisation = std::max(row.worst.localisation, w.localisation);
      row.worst.projection = std::max(row.worst.projection, w.projection);
    }
    const LocalFrame frame = frame_at(a, centre, h);
    const auto p = frame.local_from_geodetic(a.localize(centre, h));
    const ViewGeometry g = view_geometry(jacobian_by_differences(a, frame, p));
    const double off_nadir =
        std::atan(std::hypot(g.direction[0], g.direction[1])) * 180 / std::numbers::pi;
    steepest = std::max(steepest, off_nadir);
    flattest = std::min(flattest, off_nadir);
    smallest = std::min(smallest, g.footprint);
    largest = std::max(largest, g.footprint);
    // The direction is the ray's own: what localisation says one metre higher.
    const auto up = frame.local_from_geodetic(a.localize(centre, h + 1));
    CHECK(std::hypot(up[0] - p[0] - g.direction[0], up[1] - p[1] - g.direction[1]) < 1e-4);
  };
  int used = 0;
  for (const char* prefix : {"WV3_OMA_042", "WV3_OMA_281"}) {
    std::vector<test::NamedRpc> views;
    for (auto& v : test::library(data, prefix))
      if (v.name.ends_with("corrected")) views.push_back(v);
    REQUIRE(views.size() >= 8);
    for (std::size_t i = 0; i + 4 < views.size(); i += 4, ++used)
      measure(views[i].rpc, views[i + 4].rpc, {1024, 1024}, 300);
  }
  MESSAGE(used, " WorldView-3 pairs, +-50 m, off nadir ", flattest, " to ", steepest,
          " deg, footprint ", smallest, " to ", largest, " m");
  for (const Row& row : rows) {
    MESSAGE(row.size, " px: transfer ", row.worst.transfer, " px, localisation ",
            row.worst.localisation, " m, projection ", row.worst.projection, " px");
  }
  // Third-order terms of the cameras: errors grow with the cube of the window.
  CHECK(rows[0].worst.transfer < 3e-5);
  CHECK(rows[1].worst.transfer < 1.5e-3);
  CHECK(rows[2].worst.transfer < 1e-2);
  CHECK(rows[1].worst.projection < 1e-3);
  CHECK(rows[2].worst.projection < 7e-3);
  CHECK(rows[1].worst.localisation < 3e-4);
  CHECK(flattest > 0);
  CHECK(steepest < 45);
  CHECK(smallest > 0.28);
  CHECK(largest < 0.6);

  // Pleiades: same-scene pairs of the library, full scenes, at the image centre.
  for (Row& row : rows) row.worst = {};
  const auto pleiades = test::library(data, "PLEIADES");
  int pairs = 0;
  for (std::size_t i = 0; i + 1 < pleiades.size(); ++i) {
    const auto scene = [](const std::string& name) { return name.substr(0, name.rfind('/')); };
    if (scene(pleiades[i].name) != scene(pleiades[i + 1].name)) continue;
    const Rpc& a = pleiades[i].rpc;
    measure(a, pleiades[i + 1].rpc, {a.samp_off, a.line_off}, a.height_off);
    ++pairs;
  }
  MESSAGE(pairs, " Pleiades pairs, +-50 m");
  for (const Row& row : rows)
    MESSAGE(row.size, " px: transfer ", row.worst.transfer, " px, localisation ",
            row.worst.localisation, " m, projection ", row.worst.projection, " px");
  CHECK(pairs >= 5);
  CHECK(rows[0].worst.transfer < 1e-4);
  CHECK(rows[1].worst.transfer < 6e-3);
  CHECK(rows[2].worst.transfer < 5e-2);
  CHECK(rows[1].worst.projection < 1e-3);
  CHECK(rows[2].worst.projection < 8e-3);
}

TEST_CASE(
    "real cameras: the Pleiades images at hand are fitted to 1e-4 px at 1024 and 1e-3 px at 2048") {
  const auto data = test::data_folder();
  if (data.empty()) return;
  for (const char* set : {"pleiades_triplet", "pleiades_pair"}) {
    CAPTURE(set);
    const Rpc a = *read_info(data / set / "img_01.tif").rpc,
              b = *read_info(data / set / "img_02.tif").rpc;
    for (const double size : {1024.0, 2048.0}) {
      const double limit = size < 2000 ? 1e-4 : 1e-3;
      std::array<Quadratic, 3> maps;
      worst_errors(a, b, {512, 512}, size, a.height_off, 50, 4, &maps);
      for (const Quadratic& map : maps) CHECK(map.rms < limit);
      CHECK(maps[2].max < limit);  // projection
      CHECK(maps[1].max < 4e-4);   // localisation, m
      MESSAGE(set, " ", size, " px: transfer ", maps[0].rms, " / ", maps[0].max,
              " px, localisation ", maps[1].rms, " / ", maps[1].max, " m, projection ", maps[2].rms,
              " / ", maps[2].max, " px (rms / max)");
    }
  }
}
