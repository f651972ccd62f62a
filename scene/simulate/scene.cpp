// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/scene.h"

#include "satsurf/core/parallel.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/scene/simulate/city.h"
#include "satsurf/scene/simulate/orbit.h"
#include "satsurf/scene/simulate/render.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <sstream>

namespace satsurf::scene {
namespace {

using namespace simulate;

constexpr double kRadians = std::numbers::pi / 180;
constexpr double kFinestGsd = 0.3;  // m, where none is given

double log_uniform(Rng& rng, double low, double high) {
  return low * std::pow(high / low, rng.uniform());
}

CityPlan draw_plan(const SimulateConfig& config, Rng& rng) {
  CityPlan plan;
  if (config.kinds.empty()) throw ConfigError("simulate: kinds is empty, expected at least one");
  plan.kind =
      config.kinds[static_cast<std::size_t>(rng.below(static_cast<Index>(config.kinds.size())))];
  const auto range = [&](double relief_low, double relief_high, double tall_low, double tall_high) {
    plan.relief = std::min(log_uniform(rng, relief_low, relief_high), config.relief_max);
    plan.tallest = std::min(rng.uniform(tall_low, tall_high), config.tallest_max);
  };
  switch (plan.kind) {
    case SceneKind::city:
      range(0.5, 8, 24, 60);
      break;
    case SceneKind::suburb:
      range(0.5, 14, 24, 26);
      break;
    case SceneKind::industrial:
      range(0.5, 6, 24, 40);
      break;
    case SceneKind::village:
      range(1, 25, 24, 26);
      break;
    case SceneKind::rural:
      range(2, 35, 24, 25);
      break;
    case SceneKind::rough:
      range(8, 60, 24, 25);
      break;
  }
  plan.water = rng.chance(config.water);
  return plan;
}

// A day's light: a high sun is white and strong against the sky, a low one yellow and weak.
Daylight draw_daylight(const Sun& sun, Rng& rng) {
  Daylight d;
  d.sun = sun;
  const double height = std::sin(sun.elevation_deg * kRadians);
  const auto warm = static_cast<float>(0.10 * (1 - height));
  const auto sky = static_cast<float>(rng.uniform(0.12, 0.28));
  d.sun_colour = {1.0f + warm, 0.98f, 0.93f - warm};
  d.sky_colour = {0.80f * sky, 1.0f * sky, 1.35f * sky};
  const auto season = static_cast<float>(rng.uniform(-1, 1)),
             lush = static_cast<float>(rng.uniform(0.75, 1.35));
  d.vegetation = {lush * (1.0f + 0.3f * season), lush, lush * (1.0f - 0.1f * season)};
  // glint makes water bright on some dates
  const auto w = static_cast<float>(log_uniform(rng, 0.3, 6));
  const auto green = static_cast<float>(rng.uniform(0.7, 1.4));
  d.water = {0.028f * w, 0.04f * w * green, 0.045f * w};
  d.ripples = static_cast<float>(rng.uniform(0.02, 0.25));
  d.wetness = static_cast<float>(rng.chance(0.15) ? rng.uniform(0.55, 0.9) : rng.uniform(0.9, 1.1));
  d.visitors = rng.uniform(0.15, 0.8);
  d.seed = static_cast<std::uint32_t>(rng.next_u64());
  return d;
}

Development draw_development(bool panchromatic, Rng& rng) {
  Development how;
  how.haze = static_cast<float>(rng.uniform(0.0, 0.03));
  how.psf_sigma = static_cast<float>(rng.uniform(0.4, 0.7));
  how.noise = static_cast<float>(log_uniform(rng, 0.003, 0.02));
  how.dark = static_cast<float>(rng.uniform(0.06, 0.22));
  how.bright = static_cast<float>(rng.uniform(0.75, 1.02));
  how.gamma = static_cast<float>(rng.uniform(1.2, 2.2));
  for (float& t : how.tint) t = static_cast<float>(rng.uniform(0.94, 1.06));
  how.panchromatic = panchromatic;
  how.seed = static_cast<std::uint32_t>(rng.next_u64());
  return how;
}

rpc::Geodetic draw_place(Rng& rng) {
  const double lat = rng.uniform(-58, 58), lon = rng.uniform(-179, 179);
  return {.lon = lon,
          .lat = lat,
          .h = rng.chance(0.5) ? rng.uniform(-40, 150) : rng.uniform(-40, 1500)};
}

struct Bounds {
  double x_low = 1e300, x_high = -1e300, y_low = 1e300, y_high = -1e300;
  void include(const std::array<double, 3>& p) {
    x_low = std::min(x_low, p[0]);
    x_high = std::max(x_high, p[0]);
    y_low = std::min(y_low, p[1]);
    y_high = std::max(y_high, p[1]);
  }
};

}  // namespace

void check_config(const SimulateConfig& c) {
  check_fields(c, "simulate");
  const auto ordered = [](const char* low_name, double low, const char* high_name, double high) {
    if (low <= high) return;
    std::ostringstream text;
    text << "simulate: " << low_name << " is " << low << ", expected at most the " << high << " of "
         << high_name;
    throw ConfigError(text.str());
  };
  ordered("off_nadir_min_deg", c.off_nadir_min_deg, "off_nadir_max_deg", c.off_nadir_max_deg);
  ordered("parallax_min", c.parallax_min, "parallax_max", c.parallax_max);
  // Two views on opposite sides, as far from nadir as allowed, in the finest pixels.
  const double widest =
      2 * std::tan(c.off_nadir_max_deg * kRadians) / (c.gsd > 0 ? c.gsd : kFinestGsd);
  if (c.views > 1 && c.parallax_min > widest) {
    std::ostringstream text;
    text << "simulate: parallax_min is " << c.parallax_min << " px/m, expected at most the "
         << widest << " that off_nadir_max_deg = " << c.off_nadir_max_deg << " allows";
    throw ConfigError(text.str());
  }
}

SimulatedScene simulate_scene(const SimulateConfig& config, std::uint64_t seed, Index index) {
  const Rng root = Rng(seed, 0x51D).fork(static_cast<std::uint64_t>(index));
  Rng rng = root.fork(1);
  SimulatedScene scene;
  CityPlan plan = draw_plan(config, rng);
  scene.kind = plan.kind;
  scene.gsd = config.gsd > 0 ? config.gsd : rng.uniform(kFinestGsd, 0.6);
  const bool panchromatic = rng.chance(config.panchromatic),
             same_pass = rng.chance(config.same_pass);
  const rpc::Geodetic place = draw_place(rng);
  scene.frame.zone = rpc::utm_zone_of(place.lon, place.lat);
  const auto utm = rpc::utm_from_geodetic(scene.frame.zone, place.lon, place.lat);
  scene.frame.easting0 = std::round(utm[0]);
  scene.frame.northing0 = std::round(utm[1]);
  scene.frame.h0 = std::round(place.h);
  const double z_low = -plan.relief - 2, z_high = plan.relief + plan.tallest + 2;

  const std::vector<ViewPlan> looks = plan_views({.views = static_cast<int>(config.views),
                                                  .least_off_nadir_deg = config.off_nadir_min_deg,
                                                  .most_off_nadir_deg = config.off_nadir_max_deg,
                                                  .gsd_m = scene.gsd,
                                                  .least_parallax = config.parallax_min,
                                                  .most_parallax = config.parallax_max,
                                                  .lat_deg = place.lat,
                                                  .same_pass = same_pass},
                                                 rng);
  const double altitude = panchromatic ? 694e3 : 617e3;
  const double scan =
      rng.chance(0.1) ? rng.uniform(0, 360) : 180 + 8 * std::clamp(rng.normal(), -2.0, 2.0);
  const auto side = static_cast<double>(config.pixels);
  scene.views.resize(looks.size());
  std::vector<RpcFit> cameras(looks.size());
  for_each_index(static_cast<Index>(looks.size()), [&](Index v) {
    const auto n = static_cast<std::size_t>(v);
    Rng r = root.fork(100 + static_cast<std::uint64_t>(v));
    const ViewPlan& look = looks[n];
    rpc::Geodetic target = place;
    target.h += 0.3 * z_high;
    target.lon += r.uniform(-5, 5) / (111.3e3 * std::cos(place.lat * kRadians));
    target.lat += r.uniform(-5, 5) / 111.1e3;
    const PushBroom camera(
        {.target = target,
         .azimuth_deg = look.azimuth_deg,
         .off_nadir_deg = look.off_nadir_deg,
         .altitude_m = altitude,
         .gsd_m = scene.gsd * r.uniform(0.97, 1.05),
         .scan_azimuth_deg = scan + (same_pass ? r.uniform(-1, 1) : r.uniform(-5, 5)),
         .line_rate_hz = panchromatic ? 14000.0 : 20000.0,
         .width_px = side,
         .height_px = side});
    cameras[n] = fit_rpc(camera, place.h + z_low - 300, place.h + z_high + 300);
    SimulatedView& view = scene.views[n];
    view.rpc = cameras[n].rpc;
    view.rpc_rms_px = cameras[n].rms_px;
    view.rpc_max_px = cameras[n].max_px;
    view.off_nadir_deg = look.off_nadir_deg;
    view.azimuth_deg = look.azimuth_deg;
    const Sun sun = sun_at(place.lat, look.day_of_year, look.solar_hour);
    view.sun_elevation_deg = sun.elevation_deg;
    view.sun_azimuth_deg = sun.azimuth_deg;
    view.date = date_string(look.year, look.day_of_year, look.solar_hour, place.lon);
  });

  Bounds bounds;
  for (const SimulatedView& view : scene.views) {
    for (const double x : {-1.0, side}) {
      for (const double y : {-1.0, side}) {
        for (const double z : {z_low, z_high}) {
          bounds.include(
              scene.frame.local_from_geodetic(view.rpc.localize({x, y}, scene.frame.h0 + z)));
        }
      }
    }
  }
  constexpr double kMargin = 3;  // m
  plan.step = scene.gsd < 0.4 ? 0.25 : 0.3;
  const double extent =
      std::max(bounds.x_high - bounds.x_low, bounds.y_high - bounds.y_low) + 2 * kMargin;
  plan.size = static_cast<Index>(std::ceil(extent / plan.step));
  plan.x0 = std::floor(0.5 * (bounds.x_low + bounds.x_high - extent));
  plan.y0 = std::ceil(0.5 * (bounds.y_low + bounds.y_high + extent));

  const City city = make_city(plan, root.fork(2));
  const ColumnField columns(city.field);
  scene.h_min = scene.frame.h0 + columns.low();
  scene.h_max = scene.frame.h0 + columns.high();

  const double turn = rpc::grid_convergence_deg(scene.frame, place);
  LitCity lit;
  int date = -1;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    SimulatedView& view = scene.views[v];
    if (looks[v].date != date) {
      date = looks[v].date;
      Rng r = root.fork(200 + static_cast<std::uint64_t>(date));
      lit =
          light_city(city, draw_daylight({view.sun_elevation_deg, view.sun_azimuth_deg - turn}, r));
    }
    const rpc::Window window{0, 0, side, side};
    const Quadratic localisation = rpc::fit_localisation(view.rpc, scene.frame, window,
                                                         {columns.low() - 1, columns.high() + 1});
    Rng r = root.fork(300 + static_cast<std::uint64_t>(v));
    const auto waves = static_cast<std::uint32_t>(r.next_u64());
    view.rgb =
        develop(render_view(city, columns, lit, localisation, config.pixels, config.pixels, waves),
                draw_development(panchromatic, r));
    if (config.heights)
      view.height = heights_in_view(city.field, localisation, config.pixels, config.pixels);
    view.rpc.samp_off += r.uniform(-config.bias_px, config.bias_px);
    view.rpc.line_off += r.uniform(-config.bias_px, config.bias_px);
  }
  scene.classes = classes_of(city);
  scene.dsm = city.field;
  return scene;
}

}  // namespace satsurf::scene
