// SPDX-License-Identifier: Apache-2.0
// Cameras that no satellite has, as a program that embeds the library may hand them over unchecked: through everything that
// asks a camera anything, up to the plan of a reconstruction.
#include "satsurf/nn/config.h"
#include "satsurf/reconstruct/plan.h"
#include "satsurf/reconstruct/tiling.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/scene/crop.h"
#include "satsurf/scene/view_geometry.h"
#include "satsurf/scene/view_pair.h"

#include "tests/fuzz/fuzz.h"
#include "tests/fuzz/hostile_camera.h"
#include "tests/made_view.h"

namespace satsurf::fuzz {

void run(std::string_view bytes) {
  Bytes in(bytes);
  const auto kind = in.take<std::uint8_t>();
  scene::Scene scene;
  scene.views = {test::view_from("a", -0.3), test::view_from("b", 0.3)};
  scene.frame.zone = rpc::utm_zone_of(21, 10);
  const auto origin = rpc::utm_from_geodetic(scene.frame.zone, 21, 10);
  scene.frame.easting0 = origin[0], scene.frame.northing0 = origin[1], scene.frame.h0 = 20;
  scene.z_range = {-10, 30};
  if (kind & 1) scene.z_range = {in.take<double>(), in.take<double>()};
  reconstruct::ReconstructOptions options;
  if (kind & 2) options.tile = 32 * (1 + in.take<std::uint8_t>() % 8);
  if (kind & 4) options.resolution = std::abs(in.take<double>());
  if (kind & 8) options.mesh = 0;
  if (kind & 16)
    for (scene::View& v : scene.views) v.date = in.until(' ');
  std::vector<rpc::Rpc> cameras{scene.views[0].rpc, scene.views[1].rpc};
  spoil(cameras, in);
  for (std::size_t i = 0; i < cameras.size(); ++i) scene.views[i].rpc = cameras[i];

  const rpc::Rpc &a = cameras[0], &b = cameras[1];
  const rpc::Window window{0, 0, 100, 100};
  const nn::ModelConfig model = nn::model_preset("tiny");
  switch (kind >> 5) {  // each of these takes some milliseconds
    case 0:
      only<Error>([&] { a.localize({50, 50}, 20); });
      only<Error>([&] { scene::view_angles(a, 100, 100, 20); });
      only<Error>([&] { scene::footprint(a, 100, 100, scene.frame.zone, 20); });
      only<Error>([&] { scene::common_ground(a, 100, 100, b, 100, 100, 20); });
      only<Error>([&] { scene::parallax(a, b, {21, 10, 20}); });
      only<Error>([&] { scene::view_pair(scene.views[0], scene.views[1], 20); });
      break;
    case 1:
      only<Error>([&] { rpc::fit_localisation(a, scene.frame, window, scene.z_range); });
      break;
    case 2:
      only<Error>([&] { rpc::fit_projection(a, scene.frame, window, scene.z_range); });
      break;
    case 3:
      only<Error>([&] { rpc::fit_transfer(a, b, scene.frame, window, scene.z_range); });
      break;
    case 4:
      only<Error>([&] {
        const scene::Crop crop = scene::make_crop(
            scene,
            {.sources = {0}, .centre = {0, 0, 0}, .size = {32, 32}, .z_range = scene.z_range});
        require(crop.input.sources.size() == 1, "a crop has its views");
      });
      break;
    case 5:
      only<Error>([&] {
        const reconstruct::ReconstructPlan plan =
            reconstruct::plan_reconstruction(model, scene, options);
        require(plan.grid.width > 0 && plan.grid.height > 0 && !plan.tiles.empty() &&
                    plan.memory_bytes > 0,
                "a plan has cells and tiles");
      });
      break;
    default:
      only<Error, ConfigError>([&] {
        scene::Survey survey;
        survey.user.scene = scene;
        for (const scene::View& v : scene.views)
          survey.views.push_back({.source = {}, .width = 100, .height = 100, .rpc = v.rpc});
        const reconstruct::Tiling tiling =
            reconstruct::plan_tiles(model, survey, options, std::nullopt);
        require(tiling.grid.width > 0 && tiling.grid.height > 0 && !tiling.tiles.empty(),
                "a tiling has cells and tiles");
      });
  }
}

}  // namespace satsurf::fuzz
