// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/rng.h"
#include "satsurf/rpc/model.h"

#include <array>
#include <string>
#include <vector>

namespace satsurf::scene::simulate {

/// One acquisition of an agile push-broom satellite on a circular orbit.
struct Acquisition {
  rpc::Geodetic target;           ///< ground point at the centre of the image
  double azimuth_deg = 0;         ///< from the target to the satellite, clockwise from north
  double off_nadir_deg = 10;      ///< at the satellite
  double altitude_m = 617e3;      ///< 617 km: WorldView-3; 694 km: Pleiades
  double gsd_m = 0.3;             ///< ground size of a pixel at the target, both ways
  double scan_azimuth_deg = 180;  ///< direction in which the lines follow one another
  double line_rate_hz = 20000;
  double width_px = 512, height_px = 512;
};

/// The camera of an acquisition in Earth-fixed coordinates: two-body motion, the Earth's rotation,
/// an attitude that moves the line of sight evenly over the ground, one perspective line at a time.
class PushBroom {
 public:
  explicit PushBroom(const Acquisition& acquisition);
  /// Where a ground point falls in the image, px; to about 1e-9 px.
  rpc::Pixel project(const rpc::Geodetic& p) const;
  const Acquisition& acquisition() const { return acquisition_; }

 private:
  using Vec = std::array<double, 3>;
  struct Frame {
    // `right` along the detector, `forward` normal to the detector plane, `ahead` line of sight
    Vec position, right, forward, ahead;
  };
  Frame at(double t) const;

  Acquisition acquisition_;
  Vec target_, across_, scan_velocity_, radial_, along_;
  double radius_ = 0, rate_ = 0, ifov_ = 0;
};

/// An RPC and how well it stands for the camera it was fitted to.
struct RpcFit {
  rpc::Rpc rpc;
  double rms_px = 0, max_px = 0;  ///< on check points between those of the fit, within the image
};

/// Fits all 78 free coefficients: linear least squares, weighted with the denominators of the
/// solution before, damped because so small a part of the Earth does not determine them all.
/// low, high  heights above the ellipsoid, m
/// margin_px  how far beyond the image the ground reaches that is fitted
/// throws     Error unless low < high
/// Source: Tao and Hu 2001, iterative least squares with regularisation.
RpcFit fit_rpc(const PushBroom& camera, double low, double high, double margin_px = 8000);

/// Position of the sun, degrees, azimuth clockwise from north.
struct Sun {
  double elevation_deg = 45, azimuth_deg = 150;
};
/// Where the sun stands, to about a degree, which is enough for shadows.
/// day_of_year  from 1
/// solar_hour   local solar time
Sun sun_at(double lat_deg, int day_of_year, double solar_hour);

/// YYYYMMDDHHMMSS, UTC, of a local solar time.
std::string date_string(int year, int day_of_year, double solar_hour, double lon_deg);

/// Which way each view looks and when.
struct ViewPlan {
  double azimuth_deg, off_nadir_deg;
  int year, day_of_year;
  double solar_hour;
  int date;  ///< views of one pass share it
};
/// What the views of one scene have to obey.
struct ViewRules {
  int views = 5;
  double least_off_nadir_deg = 5, most_off_nadir_deg = 32;
  double gsd_m = 0.5;
  /// Pixel shift between any two views per m of height.
  double least_parallax = 0.3, most_parallax = 2.0;
  double lat_deg = 0;
  bool same_pass = false;  ///< all views from one orbit within minutes, else each on its own date
};
/// Draws the views of one scene.
std::vector<ViewPlan> plan_views(const ViewRules& rules, Rng& rng);

}  // namespace satsurf::scene::simulate
