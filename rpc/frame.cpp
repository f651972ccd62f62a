// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/frame.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <numbers>

namespace satsurf::rpc {
namespace {

// WGS84
constexpr double kA = 6378137.0;          // semi-major axis, m
constexpr double kF = 1 / 298.257223563;  // flattening
constexpr double kB = kA * (1 - kF);      // semi-minor axis, m
constexpr double kE2 = kF * (2 - kF);     // first eccentricity squared
constexpr double kEp2 = kE2 / (1 - kE2);  // second eccentricity squared
constexpr double kN = kF / (2 - kF);      // third flattening

// UTM
constexpr double kK0 = 0.9996, kFalseEasting = 500000, kFalseNorthing = 10000000;

constexpr double kRadian = std::numbers::pi / 180;

double central_meridian(const UtmZone& zone) { return 6.0 * zone.number - 183.0; }

/// c[0] n^first + c[1] n^(first + 1) + ...
template <std::size_t Size>
constexpr double series(int first, const double (&c)[Size]) {
  double sum = 0;
  for (std::size_t i = Size; i-- > 0;) sum = sum * kN + c[i];
  for (int i = 0; i < first; ++i) sum *= kN;
  return sum;
}

// Coefficients of the series between conformal and rectifying (transverse Mercator) coordinates.
// Source: Karney 2011, Transverse Mercator with an accuracy of a few nanometers, eqs. 35 and 36.
constexpr std::array<double, 6> kAlpha{
    series(1, {1. / 2, -2. / 3, 5. / 16, 41. / 180, -127. / 288, 7891. / 37800}),
    series(2, {13. / 48, -3. / 5, 557. / 1440, 281. / 630, -1983433. / 1935360}),
    series(3, {61. / 240, -103. / 140, 15061. / 26880, 167603. / 181440}),
    series(4, {49561. / 161280, -179. / 168, 6601661. / 7257600}),
    series(5, {34729. / 80640, -3418889. / 1995840}),
    series(6, {212378941. / 319334400})};
constexpr std::array<double, 6> kBeta{
    series(1, {1. / 2, -2. / 3, 37. / 96, -1. / 360, -81. / 512, 96199. / 604800}),
    series(2, {1. / 48, 1. / 15, -437. / 1440, 46. / 105, -1118711. / 3870720}),
    series(3, {17. / 480, -37. / 840, -209. / 4480, 5569. / 90720}),
    series(4, {4397. / 161280, -11. / 504, -830251. / 7257600}),
    series(5, {4583. / 161280, -108847. / 3991680}),
    series(6, {20648693. / 638668800})};
/// Radius of the circle with the meridian's length (eq. 14).
constexpr double kRectifying =
    kA / (1 + kN) * (1 + kN * kN / 4 + kN * kN * kN * kN / 64 + kN * kN * kN * kN * kN * kN / 256);

/// tan of the conformal latitude from tan of the geodetic latitude (eqs. 7 to 9).
double conformal_tan(double tau) {
  const double e = std::sqrt(kE2), root = std::hypot(1.0, tau);
  const double sigma = std::sinh(e * std::atanh(e * tau / root));
  return tau * std::hypot(1.0, sigma) - sigma * root;
}

/// Inverse of conformal_tan by Newton's method (eqs. 19 to 21), which converges quadratically from
/// here: three steps reach rounding on the whole ellipsoid.
double geodetic_tan(double tau_conformal) {
  double tau = tau_conformal / (1 - kE2);
  for (int step = 0; step < 3; ++step) {
    const double at = conformal_tan(tau);
    tau += (tau_conformal - at) / std::hypot(1.0, at) * (1 + (1 - kE2) * tau * tau) /
           ((1 - kE2) * std::hypot(1.0, tau));
  }
  return tau;
}

}  // namespace

std::optional<UtmZone> zone_of_epsg(int epsg) {
  const int number = epsg % 100;
  const bool north = epsg / 100 == 326, south = epsg / 100 == 327;
  if ((!north && !south) || number < 1 || number > 60) return std::nullopt;
  return UtmZone{number, north};
}

std::optional<UtmZone> zone_near_epsg(int epsg) {
  const int system = epsg / 100;
  return zone_of_epsg(system == 258 || system == 269 ? 32600 + epsg % 100 : epsg);
}

UtmZone utm_zone_of(double lon, double lat) {
  const int number = static_cast<int>(std::floor((degrees_wrapped(lon) + 180.0) / 6.0)) + 1;
  return {std::clamp(number, 1, 60), lat >= 0};
}

std::array<double, 2> utm_from_geodetic(const UtmZone& zone, double lon, double lat) {
  const double lambda = degrees_wrapped(lon - central_meridian(zone)) * kRadian;
  const double tau = conformal_tan(std::tan(lat * kRadian));
  // Gauss-Schreiber coordinates (eq. 10), then the series (eq. 11).
  const double xi0 = std::atan2(tau, std::cos(lambda));
  const double eta0 = std::asinh(std::sin(lambda) / std::hypot(tau, std::cos(lambda)));
  double xi = xi0, eta = eta0;
  for (std::size_t j = 0; j < kAlpha.size(); ++j) {
    const double k = 2.0 * static_cast<double>(j + 1);
    xi += kAlpha[j] * std::sin(k * xi0) * std::cosh(k * eta0);
    eta += kAlpha[j] * std::cos(k * xi0) * std::sinh(k * eta0);
  }
  return {kFalseEasting + kK0 * kRectifying * eta,
          (zone.north ? 0.0 : kFalseNorthing) + kK0 * kRectifying * xi};
}

std::array<double, 2> geodetic_from_utm(const UtmZone& zone, double easting, double northing) {
  const double xi = (northing - (zone.north ? 0.0 : kFalseNorthing)) / (kK0 * kRectifying);
  const double eta = (easting - kFalseEasting) / (kK0 * kRectifying);
  double xi0 = xi, eta0 = eta;
  for (std::size_t j = 0; j < kBeta.size(); ++j) {
    const double k = 2.0 * static_cast<double>(j + 1);
    xi0 -= kBeta[j] * std::sin(k * xi) * std::cosh(k * eta);
    eta0 -= kBeta[j] * std::cos(k * xi) * std::sinh(k * eta);
  }
  const double tau = std::sin(xi0) / std::hypot(std::sinh(eta0), std::cos(xi0));
  const double lambda = std::atan2(std::sinh(eta0), std::cos(xi0));
  return {degrees_wrapped(central_meridian(zone) + lambda / kRadian),
          std::atan(geodetic_tan(tau)) / kRadian};
}

std::array<std::array<double, 2>, 2> geodetic_from_utm_jacobian(const UtmZone& zone, double easting,
                                                                double northing) {
  // Every step but the last is conformal: analytic in zeta = xi + i eta, and so is its derivative.
  using Complex = std::complex<double>;
  const Complex zeta((northing - (zone.north ? 0.0 : kFalseNorthing)) / (kK0 * kRectifying),
                     (easting - kFalseEasting) / (kK0 * kRectifying));
  Complex zeta0 = zeta, slope = 1;
  for (std::size_t j = 0; j < kBeta.size(); ++j) {
    const double k = 2.0 * static_cast<double>(j + 1);
    zeta0 -= kBeta[j] * std::sin(k * zeta);
    slope -= kBeta[j] * k * std::cos(k * zeta);
  }
  // psi + i lambda, isometric latitude and longitude, by zeta0: their inverse Gauss-Schreiber map
  // is zeta0 = gd(psi + i lambda), with the derivative 1 / cosh = cos zeta0.
  slope /= std::cos(zeta0) * kK0 * kRectifying * kRadian;
  const double lat = geodetic_from_utm(zone, easting, northing)[1] * kRadian,
               sin_lat = std::sin(lat);
  // d(lat)/d(psi)
  const double stretch = (1 - kE2 * sin_lat * sin_lat) * std::cos(lat) / (1 - kE2);
  return {{{slope.real(), slope.imag()}, {-stretch * slope.imag(), stretch * slope.real()}}};
}

std::array<double, 3> ecef_from_geodetic(const Geodetic& p) {
  const double sin_lat = std::sin(p.lat * kRadian), cos_lat = std::cos(p.lat * kRadian);
  const double normal = kA / std::sqrt(1 - kE2 * sin_lat * sin_lat);
  const double axis_distance = (normal + p.h) * cos_lat;
  return {axis_distance * std::cos(p.lon * kRadian), axis_distance * std::sin(p.lon * kRadian),
          (normal * (1 - kE2) + p.h) * sin_lat};
}

Geodetic geodetic_from_ecef(const std::array<double, 3>& p) {
  // Source: Bowring 1976; the reduced latitude is refined until double precision is spent, for any
  // height from the sea floor to a satellite.
  const double r = std::hypot(p[0], p[1]);
  double s = p[2] / kB, c = r / kA;  // of the reduced latitude, up to a common factor
  double lat = 0;
  for (int step = 0; step < 4; ++step) {
    const double length = std::hypot(s, c), sin_b = s / length, cos_b = c / length;
    lat =
        std::atan2(p[2] + kEp2 * kB * sin_b * sin_b * sin_b, r - kE2 * kA * cos_b * cos_b * cos_b);
    s = (1 - kF) * std::sin(lat);
    c = std::cos(lat);
  }
  const double sin_lat = std::sin(lat), cos_lat = std::cos(lat);
  const double h = r * cos_lat + p[2] * sin_lat - kA * std::sqrt(1 - kE2 * sin_lat * sin_lat);
  return {std::atan2(p[1], p[0]) / kRadian, lat / kRadian, h};
}

std::array<double, 3> LocalFrame::local_from_geodetic(const Geodetic& p) const {
  const auto [easting, northing] = utm_from_geodetic(zone, p.lon, p.lat);
  return {easting - easting0, northing - northing0, p.h - h0};
}

Geodetic LocalFrame::geodetic_from_local(const std::array<double, 3>& p_in_local) const {
  const auto [lon, lat] =
      geodetic_from_utm(zone, p_in_local[0] + easting0, p_in_local[1] + northing0);
  return {lon, lat, p_in_local[2] + h0};
}

HeightRange LocalFrame::z_from_heights(const HeightRange& height_range) const {
  return {height_range.low - h0, height_range.high - h0};
}

HeightRange LocalFrame::heights_from_z(const HeightRange& z_range) const {
  return {z_range.low + h0, z_range.high + h0};
}

double grid_convergence_deg(const LocalFrame& frame, const Geodetic& at) {
  const auto a = frame.local_from_geodetic(at);
  const auto b = frame.local_from_geodetic({.lon = at.lon, .lat = at.lat + 1e-4, .h = at.h});
  return -std::atan2(b[0] - a[0], b[1] - a[1]) / kRadian;
}

PixelJacobian pixel_jacobian(const Rpc& camera, const LocalFrame& frame,
                             const std::array<double, 3>& p_in_local) {
  const PixelJacobian by_geodetic = camera.jacobian(frame.geodetic_from_local(p_in_local));
  const auto geodetic = geodetic_from_utm_jacobian(frame.zone, p_in_local[0] + frame.easting0,
                                                   p_in_local[1] + frame.northing0);
  PixelJacobian out{};
  for (std::size_t k = 0; k < 2; ++k) {
    const auto& [by_lon, by_lat, by_h] = by_geodetic[k];
    out[k] = {by_lon * geodetic[0][0] + by_lat * geodetic[1][0],
              by_lon * geodetic[0][1] + by_lat * geodetic[1][1], by_h};
  }
  return out;
}

}  // namespace satsurf::rpc
