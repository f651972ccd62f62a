// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/orbit.h"

#include "satsurf/core/error.h"
#include "satsurf/rpc/frame.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>

#include <Eigen/Dense>

namespace satsurf::scene::simulate {
namespace {

using Vec = std::array<double, 3>;

constexpr double kRadians = std::numbers::pi / 180;
constexpr double kEarthRate = 7.2921150e-5;      // rad/s, WGS84
constexpr double kEarthGm = 3.986004418e14;      // m^3/s^2, WGS84
constexpr double kLowestSun = 15, kLowSun = 32;  // degrees: below the first nobody orders images
constexpr double kInclination = 98 * kRadians;   // sun-synchronous at these altitudes

Vec operator+(const Vec& a, const Vec& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
Vec operator-(const Vec& a, const Vec& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Vec operator*(double s, const Vec& a) { return {s * a[0], s * a[1], s * a[2]}; }
double dot(const Vec& a, const Vec& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vec cross(const Vec& a, const Vec& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
Vec normalised(const Vec& a) { return (1 / std::sqrt(dot(a, a))) * a; }

struct Horizon {
  Vec east, north, up;
  Horizon(double lon, double lat) {
    const double sl = std::sin(lon), cl = std::cos(lon), sp = std::sin(lat), cp = std::cos(lat);
    east = {-sl, cl, 0};
    north = {-sp * cl, -sp * sl, cp};
    up = {cp * cl, cp * sl, sp};
  }
  Vec towards(double azimuth) const { return std::sin(azimuth) * east + std::cos(azimuth) * north; }
};

}  // namespace

PushBroom::PushBroom(const Acquisition& a) : acquisition_(a) {
  const Horizon ground(a.target.lon * kRadians, a.target.lat * kRadians);
  target_ = rpc::ecef_from_geodetic(a.target);
  const double reach = std::sqrt(dot(target_, target_));
  radius_ = reach - a.target.h + a.altitude_m;
  // Angle at the ground point from the one at the satellite: law of sines.
  const double zenith =
      std::asin(std::min(1.0, radius_ / reach * std::sin(a.off_nadir_deg * kRadians)));
  const Vec to_satellite =
      std::sin(zenith) * ground.towards(a.azimuth_deg * kRadians) + std::cos(zenith) * ground.up;
  const double b = dot(target_, to_satellite), c = reach * reach - radius_ * radius_;
  const double range = -b + std::sqrt(b * b - c);
  const Vec start = target_ + range * to_satellite;

  // The descending arc through that place; inertial and Earth-fixed axes coincide at t = 0.
  radial_ = normalised(start);
  const double lon = std::atan2(start[1], start[0]), lat = std::asin(radial_[2]);
  const double heading = std::numbers::pi - std::asin(std::cos(kInclination) / std::cos(lat));
  along_ = Horizon(lon, lat).towards(heading);
  rate_ = std::sqrt(kEarthGm / (radius_ * radius_ * radius_));

  const Vec scan = ground.towards(a.scan_azimuth_deg * kRadians);
  across_ = cross(ground.up, scan);
  scan_velocity_ = a.gsd_m * a.line_rate_hz * scan;
  // Ground shift, in the plane of the horizon, for a unit of tangent along the detector.
  const Frame f = at(0);
  const Vec shift =
      range * (f.right - (dot(f.right, ground.up) / dot(f.ahead, ground.up)) * f.ahead);
  ifov_ = a.gsd_m / std::sqrt(dot(shift, shift));
}

PushBroom::Frame PushBroom::at(double t) const {
  const double angle = rate_ * t, turn = -kEarthRate * t;
  const Vec inertial = radius_ * (std::cos(angle) * radial_ + std::sin(angle) * along_);
  const double c = std::cos(turn), s = std::sin(turn);
  Frame f;
  f.position = {c * inertial[0] - s * inertial[1], s * inertial[0] + c * inertial[1], inertial[2]};
  f.ahead = normalised(target_ + t * scan_velocity_ - f.position);
  f.forward = normalised(
      cross(f.ahead, across_));  // yaw steering: lines lie square to the scan on the ground
  f.right = cross(f.forward, f.ahead);
  return f;
}

rpc::Pixel PushBroom::project(const rpc::Geodetic& p) const {
  const Vec ground = rpc::ecef_from_geodetic(p);
  const auto miss = [&](double t) {
    const Frame f = at(t);
    const Vec d = ground - f.position;
    return dot(f.forward, d) / dot(f.ahead, d);
  };
  // Secant steps: the miss is almost linear in time. A step below 1e-5 lines leaves less than 1e-9,
  // and shorter ones would divide rounding errors.
  double t0 = 0, m0 = miss(t0), t1 = 1.0 / acquisition_.line_rate_hz, m1 = miss(t1);
  for (int k = 0; k < 6 && m1 != m0; ++k) {
    const double t = t1 - m1 * (t1 - t0) / (m1 - m0);
    t0 = t1;
    m0 = m1;
    t1 = t;
    m1 = miss(t);
    if (std::abs(t1 - t0) * acquisition_.line_rate_hz < 1e-5) break;
  }
  const Frame f = at(t1);
  const Vec d = ground - f.position;
  return {dot(f.right, d) / dot(f.ahead, d) / ifov_ + 0.5 * (acquisition_.width_px - 1),
          t1 * acquisition_.line_rate_hz + 0.5 * (acquisition_.height_px - 1)};
}

RpcFit fit_rpc(const PushBroom& camera, double low, double high, double margin_px) {
  if (!(high > low))
    throw Error("fit_rpc: heights " + std::to_string(low) + " to " + std::to_string(high) +
                ", expected low < high");
  const Acquisition& a = camera.acquisition();
  // Ground seen by the image, from the pixel size, with room for the parallax of the height range.
  const double half_m =
      a.gsd_m * (0.75 * std::max(a.width_px, a.height_px) + margin_px) + 0.4 * (high - low);
  RpcFit fit;
  rpc::Rpc& r = fit.rpc;
  r.lat_off = a.target.lat;
  r.lon_off = a.target.lon;
  r.height_off = 0.5 * (low + high);
  r.lat_scale = half_m / 111.1e3;
  r.lon_scale = half_m / (111.3e3 * std::cos(a.target.lat * kRadians));
  r.height_scale = 0.5 * (high - low);
  r.samp_off = 0.5 * (a.width_px - 1);
  r.line_off = 0.5 * (a.height_px - 1);

  constexpr int kPlan = 11, kHeights = 7, kPoints = kPlan * kPlan * kHeights, kFree = 39;
  struct Sample {
    std::array<double, 20> m;
    rpc::Pixel pixel;
  };
  std::vector<Sample> samples;
  samples.reserve(kPoints);
  r.samp_scale = r.line_scale = 0;
  for (int k = 0; k < kHeights; ++k) {
    for (int i = 0; i < kPlan; ++i) {
      for (int j = 0; j < kPlan; ++j) {
        const double P = 2.0 * i / (kPlan - 1) - 1, L = 2.0 * j / (kPlan - 1) - 1,
                     H = 2.0 * k / (kHeights - 1) - 1;
        const rpc::Pixel pixel = camera.project({.lon = r.lon_off + L * r.lon_scale,
                                                 .lat = r.lat_off + P * r.lat_scale,
                                                 .h = r.height_off + H * r.height_scale});
        r.samp_scale = std::max(r.samp_scale, std::abs(pixel.x - r.samp_off));
        r.line_scale = std::max(r.line_scale, std::abs(pixel.y - r.line_off));
        samples.push_back({rpc::rpc_monomials(P, L, H), pixel});
      }
    }
  }

  // num . m - q den . m = 0 for the normalised image coordinate q, divided by the last denominator.
  // Damping of the denominators: where numerator and denominator could share a factor it leaves the
  // denominator at 1. Their true coefficients are near 1e-3, so the fit loses nothing that matters.
  constexpr double kDamping = 1e-6;
  const auto solve = [&](const auto& normalised_pixel, std::array<double, 20>& num,
                         std::array<double, 20>& den) {
    den = {1};
    Eigen::MatrixXd A(kPoints + kFree, kFree);
    Eigen::VectorXd y(kPoints + kFree);
    for (int pass = 0; pass < 2; ++pass) {
      A.setZero();
      y.setZero();
      for (int n = 0; n < kPoints; ++n) {
        const Sample& s = samples[static_cast<std::size_t>(n)];
        const double q = normalised_pixel(s.pixel);
        double d = 0;
        for (std::size_t k = 0; k < 20; ++k) d += den[k] * s.m[k];
        for (int k = 0; k < 20; ++k) A(n, k) = s.m[static_cast<std::size_t>(k)] / d;
        for (int k = 1; k < 20; ++k) A(n, 19 + k) = -q * s.m[static_cast<std::size_t>(k)] / d;
        y(n) = q / d;
      }
      for (int k = 20; k < kFree; ++k)
        A(kPoints + k, k) = kDamping * std::sqrt(static_cast<double>(kPoints));
      const Eigen::VectorXd x = A.householderQr().solve(y);
      for (int k = 0; k < 20; ++k) num[static_cast<std::size_t>(k)] = x(k);
      for (int k = 1; k < 20; ++k) den[static_cast<std::size_t>(k)] = x(19 + k);
    }
  };
  solve([&](const rpc::Pixel& p) { return (p.x - r.samp_off) / r.samp_scale; }, r.samp_num,
        r.samp_den);
  solve([&](const rpc::Pixel& p) { return (p.y - r.line_off) / r.line_scale; }, r.line_num,
        r.line_den);

  double sum = 0;
  int count = 0;
  for (int k = 0; k < 4; ++k) {
    for (int i = 0; i < 8; ++i) {
      for (int j = 0; j < 8; ++j) {
        const rpc::Geodetic p{.lon = r.lon_off + (2 * (j + 0.5) / 8 - 1) * r.lon_scale,
                              .lat = r.lat_off + (2 * (i + 0.5) / 8 - 1) * r.lat_scale,
                              .h = r.height_off + (2 * (k + 0.5) / 4 - 1) * r.height_scale};
        const rpc::Pixel want = camera.project(p), got = r.project(p);
        const double e2 = (got.x - want.x) * (got.x - want.x) + (got.y - want.y) * (got.y - want.y);
        sum += e2;
        ++count;
        fit.max_px = std::max(fit.max_px, std::sqrt(e2));
      }
    }
  }
  fit.rms_px = std::sqrt(sum / count);
  return fit;
}

Sun sun_at(double lat_deg, int day_of_year, double solar_hour) {
  const double declination =
      -23.44 * kRadians * std::cos(2 * std::numbers::pi * (day_of_year + 10) / 365.25);
  const double hour = 15 * kRadians * (solar_hour - 12), lat = lat_deg * kRadians;
  const double sine = std::sin(lat) * std::sin(declination) +
                      std::cos(lat) * std::cos(declination) * std::cos(hour);
  const double azimuth = std::atan2(-std::cos(declination) * std::sin(hour),
                                    std::sin(declination) * std::cos(lat) -
                                        std::cos(declination) * std::cos(hour) * std::sin(lat));
  return {std::asin(sine) / kRadians, std::fmod(azimuth / kRadians + 360, 360)};
}

std::string date_string(int year, int day_of_year, double solar_hour, double lon_deg) {
  double hour = solar_hour - lon_deg / 15;
  int day = day_of_year;
  if (hour < 0) hour += 24, --day;
  if (hour >= 24) hour -= 24, ++day;
  const bool leap = (year % 4 == 0 && year % 100 != 0) || year % 400 == 0;
  day = std::clamp(day, 1, leap ? 366 : 365);
  const std::array<int, 12> lengths{31, leap ? 29 : 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31};
  int month = 0;
  while (day > lengths[static_cast<std::size_t>(month)])
    day -= lengths[static_cast<std::size_t>(month++)];
  const int seconds = std::min(86399, static_cast<int>(hour * 3600));
  std::array<char, 64> text{};
  std::snprintf(text.data(), text.size(), "%04d%02d%02d%02d%02d%02d", year, month + 1, day,
                seconds / 3600, seconds / 60 % 60, seconds % 60);
  return text.data();
}

std::vector<ViewPlan> plan_views(const ViewRules& rules, Rng& rng) {
  const double most = std::tan(rules.most_off_nadir_deg * kRadians),
               least = std::tan(rules.least_off_nadir_deg * kRadians);
  const auto direction = [](const std::array<double, 2>& d, ViewPlan& v) {
    v.azimuth_deg = std::fmod(std::atan2(d[0], d[1]) / kRadians + 360, 360);
    v.off_nadir_deg = std::atan(std::hypot(d[0], d[1])) / kRadians;
  };
  const auto allowed = [&](const std::array<double, 2>& d) {
    const double t = std::hypot(d[0], d[1]);
    return t >= least && t <= most;
  };
  // Smallest violation of the parallax rules over a set of view directions, tangents of the
  // off-nadir angle.
  const auto violation = [&](const std::vector<std::array<double, 2>>& set) {
    double worst = 0;
    for (std::size_t i = 0; i < set.size(); ++i) {
      if (!allowed(set[i])) worst += 10;
      for (std::size_t j = 0; j < i; ++j) {
        const double p = std::hypot(set[i][0] - set[j][0], set[i][1] - set[j][1]) / rules.gsd_m;
        worst += std::max({0.0, rules.least_parallax - p, p - rules.most_parallax});
      }
    }
    return worst;
  };
  const auto n = static_cast<std::size_t>(rules.views);
  std::vector<std::array<double, 2>> best;
  double best_violation = 1e300;
  for (int attempt = 0; attempt < 200 && best_violation > 0; ++attempt) {
    std::vector<std::array<double, 2>> set(n);
    if (rules.same_pass) {
      // Along the track at even steps, square to it the same small or large roll.
      const double track = 10 * kRadians, roll = rng.uniform(-0.8, 0.8) * most;
      const double base =
          rng.uniform(rules.least_parallax,
                      rules.most_parallax / std::max(1.0, static_cast<double>(n) - 1)) *
          rules.gsd_m;
      for (std::size_t k = 0; k < n; ++k) {
        const double forward =
            base * (static_cast<double>(k) - 0.5 * (static_cast<double>(n) - 1)) +
            rng.uniform(-0.02, 0.02);
        const double side = roll + rng.uniform(-0.02, 0.02);
        set[k] = {forward * std::sin(track) + side * std::cos(track),
                  forward * std::cos(track) - side * std::sin(track)};
      }
    } else {
      for (auto& d : set) {
        const double t = std::sqrt(rng.uniform(least * least, most * most)),
                     a = rng.uniform(0, 2 * std::numbers::pi);
        d = {t * std::sin(a), t * std::cos(a)};
      }
    }
    const double v = violation(set);
    if (v < best_violation) best_violation = v, best = set;
  }

  const int year = 2012 + static_cast<int>(rng.below(10));
  std::vector<ViewPlan> views(n);
  ViewPlan shared{};
  for (std::size_t k = 0; k < n; ++k) {
    ViewPlan v{};
    if (k == 0 || !rules.same_pass) {
      v.year = year + static_cast<int>(rng.below(2));
      v.date = static_cast<int>(k);
      // High enough a sun; near the summer solstice there always is one within 60 degrees of the
      // equator. Every third date has a low one, where the latitude has any.
      const bool low = rng.chance(0.33);
      for (int attempt = 0; attempt < 64; ++attempt) {
        v.day_of_year = 1 + static_cast<int>(rng.below(365));
        v.solar_hour = 10.6 + rng.uniform(-0.5, 0.6);
        const double e = sun_at(rules.lat_deg, v.day_of_year, v.solar_hour).elevation_deg;
        if (e > kLowestSun && (!low || attempt >= 24 || e < kLowSun)) break;
      }
      shared = v;
    } else {
      v = shared;
      v.solar_hour += static_cast<double>(k) * 0.5 / 60;  // half a minute between looks of one pass
    }
    direction(best[k], v);
    views[k] = v;
  }
  return views;
}

}  // namespace satsurf::scene::simulate
