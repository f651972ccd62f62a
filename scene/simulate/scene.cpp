// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/scene.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/memory.h"
#include "satsurf/core/parallel.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/scene/simulate/city.h"
#include "satsurf/scene/simulate/conditions.h"
#include "satsurf/scene/simulate/draw.h"
#include "satsurf/scene/simulate/given.h"
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

SceneKind draw_kind(const SimulateConfig& config, Rng& rng) {
  if (config.kinds.empty()) throw ConfigError("simulate: kinds is empty, expected at least one");
  if (config.kind_weights.empty())
    return config
        .kinds[static_cast<std::size_t>(rng.below(static_cast<Index>(config.kinds.size())))];
  double total = 0;
  for (const double w : config.kind_weights) total += w;
  double left = total * rng.uniform();
  std::size_t k = 0;
  // Rounding never leads to a kind without weight: the walk ends at the last that has some.
  for (std::size_t n = 0; n < config.kinds.size(); ++n) {
    if (config.kind_weights[n] <= 0) continue;
    k = n;
    left -= config.kind_weights[n];
    if (left < 0) break;
  }
  return config.kinds[k];
}

CityPlan draw_plan(const SimulateConfig& config, Rng& rng) {
  CityPlan plan;
  plan.kind = draw_kind(config, rng);
  const auto range = [&](double relief_low, double relief_high, double tall_low, double tall_high) {
    plan.relief = std::min(log_uniform(rng, relief_low, relief_high), config.relief_max);
    plan.tallest = std::min(rng.uniform(tall_low, tall_high), config.tallest_max);
  };
  switch (plan.kind) {
    case SceneKind::city:
      // Most of a town is low; some have towers.
      rng.chance(0.65) ? range(0.5, 8, 24, 60) : range(0.5, 8, 60, 150);
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
  // Last, so that nothing else about a scene depends on them.
  plan.dark = rng.fork(1).chance(config.dark);
  Rng r = rng.fork(2);
  plan.crags =
      (plan.kind == SceneKind::rough || plan.kind == SceneKind::rural) && r.chance(config.crags);
  if (plan.crags) plan.relief = std::min(log_uniform(r, 20, 110), config.relief_max);
  return plan;
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
  if (!c.kind_weights.empty()) {
    double total = 0;
    for (const double w : c.kind_weights) total += w;
    std::ostringstream text;
    if (c.kind_weights.size() != c.kinds.size()) {
      text << "simulate: kind_weights has " << c.kind_weights.size() << " numbers, expected the "
           << c.kinds.size() << " of kinds, or none";
      throw ConfigError(text.str());
    }
    if (!(total > 0))
      throw ConfigError("simulate: kind_weights are all 0, expected one above 0, or none");
  }
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

namespace {

// Where on a surface a scene lies, and between which heights. The views reach as little beyond its
// edges as may be.
rpc::Geodetic place_on(const GivenSurface& surface, double reach, Rng& rng, double& z_low,
                       double& z_high) {
  Dims dim("simulate");
  dim.match("surface", surface.z, "H W");
  if (!surface.classes.empty()) dim.match("classes", surface.classes, "H W");
  std::vector<float> known;
  for (const float z : surface.z.values()) {
    if (std::isfinite(z)) known.push_back(z);
  }
  if (known.empty()) throw ConfigError("simulate: the surface is empty, expected known heights");
  std::sort(known.begin(), known.end());
  const auto along = [&](Index cells) {
    const double length = static_cast<double>(cells) * surface.grid.step,
                 margin = std::min(reach, 0.5 * length);
    return rng.uniform(margin, length - margin);
  };
  const double east = surface.grid.x0 + along(dim["W"]), north = surface.grid.y0 - along(dim["H"]);
  const auto position = rpc::geodetic_from_utm(surface.zone, east, north);
  const double ground = static_cast<double>(known[known.size() / 20]);
  z_low = static_cast<double>(known.front()) - ground - 3;
  z_high = static_cast<double>(known.back()) - ground + 3;
  return {.lon = position[0], .lat = position[1], .h = ground};
}

/// throws  Error for a scene that does not fit into memory
void check_size(Index cells, const SimulateConfig& config) {
  // Bytes; they cover the peaks of scenes of 1024 and 2048 px.
  constexpr double kCell = 85, kPixel = 16, kInTheMaking = 48;
  const double pixels = std::pow(static_cast<double>(config.pixels), 2);
  check_memory("simulate: a scene of " + std::to_string(cells) + " cells a side needs",
               kCell * std::pow(static_cast<double>(cells), 2) +
                   (kPixel * static_cast<double>(config.views) + kInTheMaking) * pixels,
               "ask for fewer pixels or a larger --cell");
}

SimulatedScene make_scene(const SimulateConfig& config, std::uint64_t seed, Index index,
                          const GivenSurface* surface) {
  check_config(config);
  const Rng root = Rng(seed, 0x51D).fork(static_cast<std::uint64_t>(index));
  Rng rng = root.fork(1);
  SimulatedScene scene;
  CityPlan plan = draw_plan(config, rng);
  scene.kind = plan.kind;
  scene.gsd = config.gsd > 0 ? config.gsd : rng.uniform(kFinestGsd, 0.6);
  const bool panchromatic = rng.chance(config.panchromatic),
             same_pass = rng.chance(config.same_pass);
  double z_low = -plan.relief - 2, z_high = plan.relief + plan.tallest + 2;
  const double reach = 0.55 * scene.gsd * static_cast<double>(config.pixels);
  const rpc::Geodetic place =
      surface != nullptr ? place_on(*surface, reach, rng, z_low, z_high) : draw_place(rng);
  scene.frame.zone = surface != nullptr ? surface->zone : rpc::utm_zone_of(place.lon, place.lat);
  const auto utm = rpc::utm_from_geodetic(scene.frame.zone, place.lon, place.lat);
  scene.frame.easting0 = std::round(utm[0]);
  scene.frame.northing0 = std::round(utm[1]);
  scene.frame.h0 = std::round(place.h);

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
  if (surface != nullptr) plan.step = std::clamp(surface->grid.step, 0.25, 0.5);
  if (config.cell > 0) plan.step = config.cell;
  const double extent =
      std::max(bounds.x_high - bounds.x_low, bounds.y_high - bounds.y_low) + 2 * kMargin;
  plan.size = static_cast<Index>(std::ceil(extent / plan.step));
  plan.x0 = std::floor(0.5 * (bounds.x_low + bounds.x_high - extent));
  plan.y0 = std::ceil(0.5 * (bounds.y_low + bounds.y_high + extent));

  check_size(plan.size, config);

  const City city = surface != nullptr ? city_on(*surface, scene.frame, plan, root.fork(2))
                                       : make_city(plan, root.fork(2));
  {
    const ColumnField columns(city.field);
    scene.h_min = scene.frame.h0 + columns.low();
    scene.h_max = scene.frame.h0 + columns.high();
  }

  const double turn = rpc::grid_convergence_deg(scene.frame, place);
  Rng product_rng = root.fork(3);
  const Product product = draw_product(panchromatic, product_rng);
  LitCity lit;
  Development development;
  int date = -1;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    SimulatedView& view = scene.views[v];
    if (looks[v].date != date) {
      date = looks[v].date;
      Rng r = root.fork(200 + static_cast<std::uint64_t>(date));
      const Sun sun{view.sun_elevation_deg, view.sun_azimuth_deg - turn};
      lit = light_city(city, draw_daylight(sun, place.lat, looks[v].day_of_year, r));
      development = draw_atmosphere(product, plan.kind, lit.light, r);
    }
    const rpc::Window window{0, 0, side, side};
    const Quadratic localisation = rpc::fit_localisation(
        view.rpc, scene.frame, window, {lit.columns->low() - 1, lit.columns->high() + 1});
    Rng r = root.fork(300 + static_cast<std::uint64_t>(v));
    const auto waves = static_cast<std::uint32_t>(r.next_u64());
    draw_instrument(product, development, r);
    view.rgb = develop(render_view(city, lit, localisation, config.pixels, config.pixels, waves),
                       development);
    if (config.heights)
      view.height = heights_in_view(city.field, localisation, config.pixels, config.pixels);
    view.rpc.samp_off += r.uniform(-config.bias_px, config.bias_px);
    view.rpc.line_off += r.uniform(-config.bias_px, config.bias_px);
  }
  scene.classes = classes_of(city);
  scene.dsm = city.field;
  return scene;
}

}  // namespace

SimulatedScene simulate_scene(const SimulateConfig& config, std::uint64_t seed, Index index) {
  return make_scene(config, seed, index, nullptr);
}

SimulatedScene simulate_on_surface(const GivenSurface& surface, const SimulateConfig& config,
                                   std::uint64_t seed, Index index) {
  return make_scene(config, seed, index, &surface);
}

}  // namespace satsurf::scene
