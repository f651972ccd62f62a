// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/rng.h"
#include "satsurf/rpc/frame.h"
#include "satsurf/rpc/model.h"

#include <array>
#include <cmath>
#include <memory>
#include <string>

#include "tests/ref/rpc_data.h"
#include <doctest/doctest.h>
#include <ogr_spatialref.h>

using namespace satsurf;
using namespace satsurf::rpc;

namespace {

double distance(const Pixel& a, const Pixel& b) { return std::hypot(a.x - b.x, a.y - b.y); }

/// Where a camera with a correction is to see a point.
Pixel corrected_pixel(const Rpc& r, const Geodetic& p, const Pixel& shift,
                      const ShiftSlope& slope) {
  const Pixel q = r.project(p);
  const double x = q.x - slope.at.x, y = q.y - slope.at.y;
  const auto& s = slope.per_pixel;
  return {q.x + shift.x + s[0][0] * x + s[0][1] * y, q.y + shift.y + s[1][0] * x + s[1][1] * y};
}

/// A point of the camera's validity box shrunk by `part`.
Geodetic random_point(const Rpc& r, Rng& rng, double part = 0.9) {
  return {r.lon_off + std::abs(r.lon_scale) * rng.uniform(-part, part),
          r.lat_off + std::abs(r.lat_scale) * rng.uniform(-part, part),
          r.height_off + r.height_scale * rng.uniform(-part, part)};
}

double worst_jacobian_error(const Rpc& r, const Geodetic& p) {
  const auto analytic = r.jacobian(p);
  const std::array<double, 3> step{3e-5 * r.lon_scale, 3e-5 * r.lat_scale, 3e-5 * r.height_scale};
  double worst = 0;
  for (std::size_t k = 0; k < 3; ++k) {
    const auto moved = [&](double s) {
      Geodetic q = p;
      (k == 0 ? q.lon : k == 1 ? q.lat : q.h) += s * step[k];
      return r.project(q);
    };
    const Pixel up = moved(1), down = moved(-1);
    const std::array<double, 2> numeric{(up.x - down.x) / (2 * step[k]),
                                        (up.y - down.y) / (2 * step[k])};
    for (std::size_t i = 0; i < 2; ++i) {
      // In pixels per unit of the normalised coordinate, against the largest slope of the row.
      const double unit = step[k] / 3e-5, size = std::max(r.samp_scale, r.line_scale);
      worst = std::max(worst, std::abs((numeric[i] - analytic[i][k]) * unit) / size);
    }
  }
  return worst;
}

}  // namespace

TEST_CASE("synthetic camera: the projection written out by hand") {
  Rpc r;  // one term of each polynomial at a time, so that an exchanged monomial shows
  r.samp_off = 100, r.samp_scale = 10, r.line_off = 200, r.line_scale = 20;
  r.lat_off = 40, r.lat_scale = 0.5, r.lon_off = 10, r.lon_scale = 0.25, r.height_off = 50;
  r.height_scale = 100;
  r.samp_den[0] = r.line_den[0] = 1;
  const double P = 0.3, L = -0.7, H = 1.1;
  const Geodetic p{10 + 0.25 * L, 40 + 0.5 * P, 50 + 100 * H};
  const std::array<double, 20> expected{1,         L,         P,         H,         L * P,
                                        L * H,     P * H,     L * L,     P * P,     H * H,
                                        P * L * H, L * L * L, L * P * P, L * H * H, L * L * P,
                                        P * P * P, P * H * H, L * L * H, P * P * H, H * H * H};
  for (std::size_t i = 0; i < 20; ++i) {
    Rpc one = r;
    one.samp_num[i] = 1;
    one.line_num[i] = 1;
    one.line_den[i] += 0.5;
    CAPTURE(i);
    CHECK(one.project(p).x == doctest::Approx(100 + 10 * expected[i]).epsilon(1e-12));
    const double den = 1 + 0.5 * expected[i];
    CHECK(one.project(p).y == doctest::Approx(200 + 20 * expected[i] / den).epsilon(1e-12));
    CHECK(worst_jacobian_error(one, p) < 1e-7);
  }
}

TEST_CASE("synthetic camera: localisation undoes projection") {
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    CAPTURE(seed);
    Rng rng(seed);
    const Rpc r = test::synthetic_rpc(rng.uniform(-170, 170), rng.uniform(-70, 70),
                                      rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6));
    for (int i = 0; i < 10; ++i) {
      const Geodetic p = random_point(r, rng), back = r.localize(r.project(p), p.h);
      CHECK(std::abs(back.lon - p.lon) < 1e-11);
      CHECK(std::abs(back.lat - p.lat) < 1e-11);
      CHECK(back.h == p.h);
      CHECK(worst_jacobian_error(r, p) < 1e-7);
    }
  }
}

TEST_CASE("synthetic camera: the ray's slope keeps the pixel") {
  Rng rng(7);
  const Rpc r = test::synthetic_rpc();
  for (int i = 0; i < 20; ++i) {
    const Geodetic p = random_point(r, rng);
    const auto slope = r.ray_slope(p);
    const Geodetic up = r.localize(r.project(p), p.h + 1), down = r.localize(r.project(p), p.h - 1);
    CHECK(slope[0] == doctest::Approx((up.lon - down.lon) / 2).epsilon(1e-5));
    CHECK(slope[1] == doctest::Approx((up.lat - down.lat) / 2).epsilon(1e-5));
  }
}

TEST_CASE("a scene across the antimeridian is one piece") {
  const Rpc r = test::synthetic_rpc(179.99, -16.5);
  const Rpc inland = test::synthetic_rpc(100.0, -16.5);
  for (const double dlon : {-0.03, 0.0, 0.005, 0.02, 0.04}) {
    CAPTURE(dlon);
    const double wrapped = 179.99 + dlon >= 180 ? 179.99 + dlon - 360 : 179.99 + dlon;
    const Pixel a = r.project({wrapped, -16.51, 30});
    CHECK(distance(a, inland.project({100.0 + dlon, -16.51, 30})) < 1e-6);
    CHECK(distance(a, r.project({wrapped + 360, -16.51, 30})) < 1e-6);
    const Geodetic back = r.localize(a, 30);
    CHECK(back.lon == doctest::Approx(wrapped).epsilon(1e-12));
    CHECK(back.lon >= -180);
    CHECK(back.lon < 180);
    // The metric frame does not tear either.
    const auto [easting, northing] = utm_from_geodetic({60, false}, wrapped, -16.51);
    const auto unwrapped = utm_from_geodetic({60, false}, 179.99 + dlon, -16.51);
    CHECK(std::abs(easting - unwrapped[0]) < 1e-6);
    CHECK(std::abs(northing - unwrapped[1]) < 1e-6);
  }
}

TEST_CASE("a turned image has a turned camera") {
  Rng rng(4);
  const Rpc r = test::synthetic_rpc();
  const Index width = 700, height = 300;
  for (int i = 0; i < 20; ++i) {
    const Geodetic p = random_point(r, rng);
    const Pixel at = r.project(p);
    const double right = static_cast<double>(width) - 1, bottom = static_cast<double>(height) - 1;
    CHECK(distance(r.turned(1, width, height).project(p), {bottom - at.y, at.x}) < 1e-9);
    CHECK(distance(r.turned(2, width, height).project(p), {right - at.x, bottom - at.y}) < 1e-9);
    CHECK(distance(r.turned(3, width, height).project(p), {at.y, right - at.x}) < 1e-9);
    CHECK(distance(r.turned(3, width, height).turned(1, height, width).project(p), at) < 1e-9);
  }
  CHECK(r.turned(0, width, height) == r);
}

TEST_CASE("crop and resize move pixels and nothing else") {
  Rng rng(3);
  const Rpc r = test::synthetic_rpc(), crop = r.cropped(1200, 345), half = r.resized(0.5);
  for (int i = 0; i < 20; ++i) {
    const Geodetic p = random_point(r, rng);
    const Pixel full = r.project(p);
    CHECK(distance(crop.project(p), {full.x - 1200, full.y - 345}) < 1e-9);
    CHECK(distance(half.project(p), {(full.x + 0.5) * 0.5 - 0.5, (full.y + 0.5) * 0.5 - 0.5}) <
          1e-9);
    CHECK(distance(half.resized(2).project(p), full) < 1e-9);
    // Cropping at 4 n, then quartering, is quartering, then cropping at n.
    CHECK(distance(r.cropped(400, 80).resized(0.25).project(p),
                   r.resized(0.25).cropped(100, 20).project(p)) < 1e-9);
  }
  CHECK(r.cropped(0, 0) == r);
  CHECK(r.cropped(7, -9).cropped(-7, 9) == r);
  CHECK(r.cropped(7, 0).line_off == r.line_off);
}

TEST_CASE("a corrected camera sees every point further on") {
  Rng rng(4);
  const Rpc r = test::synthetic_rpc();
  const Pixel shift{2.5, -7};
  CHECK(r.corrected(shift) == r.cropped(-2.5, 7));
  const ShiftSlope slope{{300, 1200}, {{{1.5e-3, -3e-3}, {0.5e-3, 2e-3}}}};
  CHECK_FALSE(slope.empty());
  CHECK(ShiftSlope{{300, 1200}, {}}.empty());
  const Rpc whole = r.corrected(shift, slope),
            crop = r.cropped(1200, 345).corrected(shift, slope.cropped(1200, 345)),
            half = r.resized(0.5).corrected({1.25, -3.5}, slope.resized(0.5));
  for (int i = 0; i < 50; ++i) {
    const Geodetic p = random_point(r, rng, 1);
    const Pixel wanted = corrected_pixel(r, p, shift, slope);
    CHECK(distance(whole.project(p), wanted) < 0.01);
    CHECK(distance(crop.project(p), {wanted.x - 1200, wanted.y - 345}) < 0.01);
    CHECK(distance(half.resized(2).project(p), wanted) < 0.02);
  }
  // what leads right alone needs no other denominator
  const ShiftSlope right{{5, 7}, {{{1.5e-3, 0}, {0, 0}}}};
  const Geodetic p = random_point(r, rng);
  CHECK(distance(r.corrected({}, right).project(p), corrected_pixel(r, p, {}, right)) < 1e-9);
  Rpc broken = r;
  broken.samp_den = {0, 1};  // zero in the middle
  CHECK_THROWS_AS(broken.corrected({}, slope), Error);
  broken.samp_den = {};
  CHECK_THROWS_AS(broken.corrected({}, slope), Error);
}

TEST_CASE("localisation says which pixel and height it cannot serve") {
  Rpc r = test::synthetic_rpc();
  r.samp_num[7] = r.line_num[8] = 40;  // far too curved for Newton's method from the centre
  CHECK_THROWS_WITH_AS(r.localize({12, 34}, 1e6),
                       doctest::Contains("pixel (12, 34) at height 1e+06 m"), Error);
  r = test::synthetic_rpc();
  r.samp_den = {};  // 0 / 0 must not slip through a comparison with NaN
  CHECK_THROWS_AS(r.localize({12, 34}, 0), Error);
  r = test::synthetic_rpc(12, 89.99);  // the polynomials go on beyond the pole
  CHECK(r.localize(r.project({12, 89.98, 120}), 120).lat == doctest::Approx(89.98));
  CHECK_THROWS_WITH_AS(r.localize(r.project({12, 90.02, 120}), 120),
                       doctest::Contains("expected one within 90 degrees"), Error);
}

TEST_CASE("real cameras: GDAL's transformer, differences, localisation") {
  const auto data = test::data_folder();
  if (data.empty()) return;
  const auto cameras = test::library(data);
  CHECK(cameras.size() >= 700);
  double worst_gdal = 0, worst_jacobian = 0, worst_round_trip = 0, worst_correction = 0;
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    CAPTURE(cameras[c].name);
    const Rpc& r = cameras[c].rpc;
    const test::GdalRpc oracle(r);
    Rng rng(c);
    const auto per_pixel = [&] { return rng.uniform(-5, 5) / std::abs(r.samp_scale); };
    const ShiftSlope slope{{r.samp_off, r.line_off},
                           {{{per_pixel(), per_pixel()}, {per_pixel(), per_pixel()}}}};
    const Rpc corrected = r.corrected({1, 2}, slope);
    for (int i = 0; i < 5; ++i) {
      const Geodetic p = random_point(r, rng);
      const Pixel pixel = r.project(p);
      worst_gdal = std::max(worst_gdal, distance(pixel, oracle.project(p)));
      worst_jacobian = std::max(worst_jacobian, worst_jacobian_error(r, p));
      worst_correction = std::max(
          worst_correction, distance(corrected.project(p), corrected_pixel(r, p, {1, 2}, slope)));
      const Geodetic back = r.localize(pixel, p.h);
      worst_round_trip = std::max(worst_round_trip, distance(pixel, r.project(back)));
      CHECK(std::abs(back.lon - p.lon) < 1e-10);
      CHECK(std::abs(back.lat - p.lat) < 1e-10);
    }
  }
  MESSAGE(cameras.size(), " cameras: GDAL ", worst_gdal, " px, Jacobian ", worst_jacobian,
          " of the scale, round trip ", worst_round_trip, " px, slopes of up to 5 px ",
          worst_correction, " px");
  CHECK(worst_correction < 0.01);
  CHECK(worst_gdal < 1e-6);
  CHECK(worst_jacobian < 1e-7);
  CHECK(worst_round_trip < 1e-6);
}

TEST_CASE("zones by their codes, and codes that name none") {
  for (const UtmZone zone : {UtmZone{1, true}, {60, true}, {1, false}, {17, true}, {60, false}})
    CHECK(zone_of_epsg(zone.epsg()) == zone);
  for (const int epsg :
       {0, 17, 2154, 4326, 25832, 26917, 32600, 32661, 32700, 32761, -32617, 326017})
    CHECK_FALSE(zone_of_epsg(epsg).has_value());
  CHECK(zone_near_epsg(32717) == UtmZone{17, false});
  CHECK(zone_near_epsg(25832) == UtmZone{32, true});
  CHECK(zone_near_epsg(26917) == UtmZone{17, true});
  for (const int epsg : {0, 2154, 4326, 25800, 26961})
    CHECK_FALSE(zone_near_epsg(epsg).has_value());
}

TEST_CASE("UTM agrees with PROJ in the zone and its neighbours") {
  for (const UtmZone zone :
       {UtmZone{17, true}, UtmZone{40, false}, UtmZone{1, true}, UtmZone{60, false}}) {
    OGRSpatialReference wgs84, utm;
    REQUIRE(wgs84.importFromEPSG(4326) == OGRERR_NONE);
    REQUIRE(utm.importFromEPSG(zone.epsg()) == OGRERR_NONE);
    wgs84.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
    utm.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
    const std::unique_ptr<OGRCoordinateTransformation> to_utm(
        OGRCreateCoordinateTransformation(&wgs84, &utm));
    REQUIRE(to_utm);
    Rng rng(static_cast<std::uint64_t>(zone.number));
    double worst = 0, worst_back = 0;
    for (int i = 0; i < 300; ++i) {
      const double dlon = rng.uniform(-9, 9), lat = rng.uniform(-84, 84);
      const double lon = std::remainder(6.0 * zone.number - 183 + dlon, 360.0);
      double x = lon, y = lat;
      REQUIRE(to_utm->Transform(1, &x, &y));
      const auto [easting, northing] = utm_from_geodetic(zone, lon, lat);
      worst = std::max(worst, std::hypot(easting - x, northing - y));
      const auto back = geodetic_from_utm(zone, easting, northing);
      const double m_per_degree = 111320;
      worst_back =
          std::max(worst_back,
                   m_per_degree * std::hypot(std::remainder(back[0] - lon, 360.0), back[1] - lat));
    }
    MESSAGE("EPSG:", zone.epsg(), ": ", worst, " m from PROJ, ", worst_back, " m there and back");
    CHECK(worst < 1e-6);
    CHECK(worst_back < 1e-6);
  }
}

TEST_CASE("UTM zones") {
  CHECK(utm_zone_of(-81.66, 30.3) == UtmZone{17, true});
  CHECK(utm_zone_of(55.7, -21.2) == UtmZone{40, false});
  CHECK(utm_zone_of(-180, 0) == UtmZone{1, true});
  CHECK(utm_zone_of(180, 0) == UtmZone{1, true});
  CHECK(utm_zone_of(179.999, -0.1) == UtmZone{60, false});
  CHECK(utm_zone_of(6, 50) == UtmZone{32, true});
  CHECK(UtmZone{17, true}.epsg() == 32617);
  CHECK(UtmZone{40, false}.epsg() == 32740);
}

TEST_CASE("earth-centred coordinates") {
  OGRSpatialReference wgs84, geocentric;
  REQUIRE(wgs84.importFromEPSG(4979) == OGRERR_NONE);
  REQUIRE(geocentric.importFromEPSG(4978) == OGRERR_NONE);
  wgs84.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  const std::unique_ptr<OGRCoordinateTransformation> to_ecef(
      OGRCreateCoordinateTransformation(&wgs84, &geocentric));
  REQUIRE(to_ecef);
  Rng rng(11);
  for (int i = 0; i < 200; ++i) {
    const Geodetic p{rng.uniform(-180, 180), i == 0 ? 90.0 : rng.uniform(-90, 90),
                     i % 2 == 0 ? rng.uniform(-500, 9000) : rng.uniform(4e5, 8e5)};
    const auto ecef = ecef_from_geodetic(p);
    double x = p.lon, y = p.lat, z = p.h;
    REQUIRE(to_ecef->Transform(1, &x, &y, &z));
    CHECK(std::hypot(ecef[0] - x, ecef[1] - y, ecef[2] - z) < 1e-6);
    const Geodetic back = geodetic_from_ecef(ecef);
    const auto again = ecef_from_geodetic(back);
    CHECK(std::hypot(again[0] - ecef[0], again[1] - ecef[1], again[2] - ecef[2]) < 1e-6);
    CHECK(std::abs(back.h - p.h) < 1e-6);
  }
}

TEST_CASE("the local frame is UTM minus its origin") {
  const LocalFrame frame{{17, true}, 435000, 3358000, -20};
  const auto p = frame.local_from_geodetic({-81.66, 30.349, -10});
  const auto utm = utm_from_geodetic({17, true}, -81.66, 30.349);
  CHECK(p[0] == utm[0] - 435000);
  CHECK(p[1] == utm[1] - 3358000);
  CHECK(p[2] == 10);
  const Geodetic back = frame.geodetic_from_local(p);
  CHECK(std::abs(back.lon + 81.66) < 1e-11);
  CHECK(std::abs(back.lat - 30.349) < 1e-11);
  CHECK(back.h == -10);
}
