// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/simulate/scene.h"

#include <array>
#include <cstdio>
#include <fstream>

#include <nlohmann/json.hpp>

namespace satsurf::scene {
namespace {

namespace fs = std::filesystem;

std::string image_name(const std::string& scene, std::size_t view) {
  std::array<char, 32> number{};  // the longest number takes 26
  std::snprintf(number.data(), number.size(), "_%03zu_RGB", view + 1);
  return scene + number.data();
}

}  // namespace

void write_scene(const SimulatedScene& scene, const fs::path& out_dir, const std::string& name) {
  const fs::path images = out_dir / "Track3-RGB", truth = out_dir / "Track3-Truth",
                 meta = out_dir / "Track3-Metadata";
  for (const fs::path& folder : {images, truth, meta}) fs::create_directories(folder);

  nlohmann::ordered_json record;
  record["scene"] = name;
  record["kind"] = enum_name(scene.kind);
  record["gsd"] = scene.gsd;
  record["epsg"] = scene.frame.zone.epsg();
  record["min_alt"] = scene.h_min;
  record["max_alt"] = scene.h_max;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    const SimulatedView& view = scene.views[v];
    const std::string file = image_name(name, v);
    Tensor pixels = view.rgb.clone();
    for (float& p : pixels.values()) p *= 255.0f;
    rpc::write_rpc_geotiff(images / (file + ".tif"), pixels, rpc::PixelType::uint8, view.rpc,
                           {{"SUN_ELEVATION", std::to_string(view.sun_elevation_deg)},
                            {"SUN_AZIMUTH", std::to_string(view.sun_azimuth_deg)},
                            {"ACQUISITION_DATE", view.date}});
    record["views"].push_back({{"img", file + ".tif"},
                               {"width", view.rgb.dim(2)},
                               {"height", view.rgb.dim(1)},
                               {"sun_elevation", view.sun_elevation_deg},
                               {"sun_azimuth", view.sun_azimuth_deg},
                               {"acquisition_date", view.date},
                               {"off_nadir", view.off_nadir_deg},
                               {"azimuth", view.azimuth_deg}});
  }

  Tensor heights = scene.dsm.z.clone();
  for (float& z : heights.values()) z += static_cast<float>(scene.frame.h0);
  const rpc::GeoGrid grid{.epsg = scene.frame.zone.epsg(),
                          .x0 = scene.frame.easting0 + scene.dsm.x0,
                          .y0 = scene.frame.northing0 + scene.dsm.y0,
                          .step = scene.dsm.step};
  rpc::write_geo_raster(truth / (name + "_DSM.tif"), heights, grid,
                        rpc::ellipsoidal_height("simulated surface"));
  rpc::GeoTags labels;
  labels.unit.clear(), labels.means = false;
  labels.description = "2 ground, 5 trees, 6 building, 9 water";
  rpc::write_geo_raster(truth / (name + "_CLS.tif"), scene.classes, grid, labels);
  rpc::write_dfc_grid(truth / (name + "_DSM.txt"), grid, scene.dsm.z.dim(0));

  std::ofstream out(meta / (name + ".json"));
  out << record.dump(2) << '\n';
  out.close();
  if (!out) throw IoError((meta / (name + ".json")).string() + ": cannot be written");
}

}  // namespace satsurf::scene
