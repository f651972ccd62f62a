// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/nn/config.h"
#include "satsurf/nn/hypotheses.h"
#include "satsurf/reconstruct/plan.h"
#include "satsurf/scene/crop.h"
#include "satsurf/scene/view_geometry.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "tests/reconstruct/simulated.h"
#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;

namespace {

scene::Scene small_scene(Index views = 3) {
  const scene::SimulatedScene made = test::village(96, views);
  return scene::scene_from_images(test::HeldImages(made).images(), test::range_of(made)).scene;
}

double area(const Ground& g) { return g.width() * g.height(); }

}  // namespace

TEST_CASE("the grid starts at whole multiples of its step and covers the ground") {
  const scene::Scene scene = small_scene();
  const nn::ModelConfig model = nn::model_preset("tiny");
  for (const double step : {0.0, 0.5, 0.7, 3.0}) {
    CAPTURE(step);
    ReconstructOptions options;
    options.resolution = step;
    const ReconstructPlan plan = plan_reconstruction(model, scene, options);
    CHECK(plan.grid.step == doctest::Approx(step > 0 ? step : 0.5).epsilon(0.11));
    const double columns = (plan.grid.east + scene.frame.easting0) / plan.grid.step,
                 rows = (plan.grid.north + scene.frame.northing0) / plan.grid.step;
    CHECK(std::abs(columns - std::round(columns)) < 1e-6);
    CHECK(std::abs(rows - std::round(rows)) < 1e-6);
    // around the height, of three in the range, at which two views share most
    const double away = std::min(15.0, scene.z_range.span() / 4), low = scene.z_range.low + away,
                 high = scene.z_range.high - away;
    Ground most;
    for (const double z : {low, scene.z_range.middle(), high}) {
      const Ground shared = scene::bounds_of(outline_of_two(scene, std::array{z}));
      if (area(shared) > area(most)) most = shared;
    }
    const Ground cells = plan.grid.ground();
    CHECK(cells.x0 <= most.x0);
    CHECK(cells.y0 <= most.y0);
    CHECK(cells.x1 >= most.x1);
    CHECK(cells.y1 >= most.y1);
    // no satellite looks further than 45 degrees aside
    const double beyond = away + plan.grid.step;
    CHECK(cells.x0 > most.x0 - beyond);
    CHECK(cells.y0 > most.y0 - beyond);
    CHECK(cells.x1 < most.x1 + beyond);
    CHECK(cells.y1 < most.y1 + beyond);
    CHECK(area(cells) > 1.05 * area(most));
  }
}

TEST_CASE("windows are multiples of the network's, and small images are one window") {
  const scene::Scene scene = small_scene();
  const nn::ModelConfig model = nn::model_preset("tiny");
  const Index multiple = nn::size_multiple(model);
  REQUIRE(multiple > 1);
  ReconstructPlan plan = plan_reconstruction(model, scene, {});
  CHECK(plan.whole_images);
  CHECK(plan.tiles.size() == 1);
  for (const Index side : {plan.window.height, plan.window.width}) {
    CHECK(side % multiple == 0);
    CHECK(side >= 96);
    CHECK(side < 96 + multiple);
  }
  for (const Index asked : {Index{33}, Index{64}, Index{70}}) {
    ReconstructOptions options;
    options.tile = asked;
    plan = plan_reconstruction(model, scene, options);
    CHECK_FALSE(plan.whole_images);
    CHECK(plan.window.height % multiple == 0);
    CHECK(plan.window.height >= asked);
    CHECK(plan.window.height < asked + multiple);
    CHECK(plan.window.width == plan.window.height);
  }
}

TEST_CASE("tiles cover the ground once, and every window holds its tile") {
  const scene::Scene scene = small_scene();
  ReconstructOptions options;
  options.tile = 64;
  const ReconstructPlan plan = plan_reconstruction(nn::model_preset("tiny"), scene, options);
  REQUIRE(plan.tiles.size() > 1);
  double covered = 0;
  for (const Ground& t : plan.tiles) covered += area(t);
  CHECK(covered == doctest::Approx(area(plan.ground)));
  for (int i = 0; i < 20; ++i)
    for (int j = 0; j < 20; ++j) {
      const double x = plan.ground.x0 + (j + 0.5) / 20 * plan.ground.width(),
                   y = plan.ground.y0 + (i + 0.5) / 20 * plan.ground.height();
      int in = 0;
      for (const Ground& t : plan.tiles) in += t.contains(x, y);
      CHECK(in == 1);
    }
  const double half = static_cast<double>(plan.window.height) / 2;
  for (const Ground& t : plan.tiles)
    for (const scene::View& v : scene.views) {
      const double z_middle = scene.z_range.middle();
      const rpc::Pixel centre = v.rpc.project(
          scene.frame.geodetic_from_local({0.5 * (t.x0 + t.x1), 0.5 * (t.y0 + t.y1), z_middle}));
      for (const double x : {t.x0, t.x1})
        for (const double y : {t.y0, t.y1})
          for (const double z : {scene.z_range.low, scene.z_range.high}) {
            const rpc::Pixel p = v.rpc.project(scene.frame.geodetic_from_local({x, y, z}));
            CHECK(std::abs(p.x - centre.x) < half + 1);  // windows start at whole pixels
            CHECK(std::abs(p.y - centre.y) < half + 1);
          }
    }
}

TEST_CASE("memory grows with the images and the surface") {
  const nn::ModelConfig model = nn::model_preset("tiny");
  const ReconstructPlan two = plan_reconstruction(model, small_scene(2), {}),
                        four = plan_reconstruction(model, small_scene(4), {});
  CHECK(four.memory_bytes > two.memory_bytes);
  REQUIRE(four.memory.size() == two.memory.size());
  CHECK(four.memory.back().part == "surface");
  for (std::size_t i = 0; i < two.memory.size(); ++i)
    CHECK(four.memory[i].bytes >= two.memory[i].bytes);
  ReconstructOptions fine;
  fine.resolution = 0.1;
  CHECK(plan_reconstruction(model, small_scene(2), fine).memory_bytes > two.memory_bytes);
  ReconstructOptions mesh;
  mesh.mesh = 0.05;
  const ReconstructPlan meshed = plan_reconstruction(model, small_scene(2), mesh);
  CHECK(meshed.voxel == 0.05);
  CHECK(meshed.memory_bytes > two.memory_bytes);
  CHECK(meshed.memory_bytes == meshed.mesh_bytes);
  CHECK(two.voxel == 0);
  CHECK(two.mesh_bytes == 0);
}

TEST_CASE("memory grows with the heights to search, where they get more hypotheses") {
  const nn::ModelConfig model = nn::model_preset("wide8");
  const auto volumes = [&](double parallax, Surface surface) {
    const WorkMemory work = work_memory(
        model,
        {.views = 3, .window = {512, 512}, .pixels = 3e5, .cells = 1e5, .parallax = parallax},
        surface);
    const auto part = std::ranges::find(work.parts, "volumes 1", &nn::PartMemory::part);
    REQUIRE(part != work.parts.end());
    return part->bytes;
  };
  const double least = volumes(0, Surface::refined);
  CHECK(volumes(88, Surface::refined) == least);
  CHECK(volumes(177, Surface::refined) > 1.2 * least);
  CHECK(volumes(177, Surface::splat) == volumes(0, Surface::splat));
}

TEST_CASE("the parallax of cameras is that of their images, however they are turned") {
  const scene::Scene scene = small_scene();
  const scene::Crop crop = scene::make_crop(scene, {.sources = {0, 1, 2},
                                                    .centre = {0, 0, scene.z_range.middle()},
                                                    .size = {96, 96},
                                                    .z_range = scene.z_range});
  std::vector<rpc::PixelJacobian> cameras =
      scene::cameras_at(scene.views, scene.frame, {0, 0, scene.z_range.middle()});
  const double upright = mean_parallax(cameras);
  CHECK(upright == doctest::Approx(nn::mean_parallax(crop.input)).epsilon(0.01));
  CHECK(span_of_hypotheses(nn::model_preset("wide8"), cameras) ==
        doctest::Approx(0.35 * 4 * 64 / upright));
  for (rpc::PixelJacobian::value_type& axis : cameras[1])  // by 180 degrees
    for (double& v : axis) v = -v;
  CHECK(mean_parallax(cameras) == doctest::Approx(upright));
}

TEST_CASE("a mesh that does not fit into the memory does not stop the surface") {
  const scene::Scene scene = small_scene(2);
  ReconstructOptions mesh;
  mesh.mesh = 1e-5;
  const ReconstructPlan plan = plan_reconstruction(nn::model_preset("tiny"), scene, mesh);
  CHECK(plan.mesh_bytes > 1e15);
  CHECK(plan.surface_bytes < 1e10);
  CHECK(plan.memory_bytes == plan.mesh_bytes);
  CHECK_NOTHROW(check_memory(plan, scene));
  mesh.max_memory = 1e10;
  const ReconstructPlan limited = plan_reconstruction(nn::model_preset("tiny"), scene, mesh);
  CHECK(limited.mesh_bytes == plan.mesh_bytes);
  CHECK(limited.memory_bytes == plan.surface_bytes);
}

TEST_CASE("views of different places are refused") {
  scene::Scene scene = small_scene(2);
  scene.views[1].rpc.lon_off += 0.01;  // a kilometre
  CHECK_THROWS_WITH_AS(plan_reconstruction(nn::model_preset("tiny"), scene, {}),
                       "no two images see the same ground, expected overlapping views", Error);
}

TEST_CASE("without a resolution cells are as large as pixels on the ground") {
  const scene::Scene scene = small_scene();
  const auto footprint_at = [&](const std::array<double, 3>& place) {
    return mean_footprint(scene::cameras_at(scene.views, scene.frame, place));
  };
  const double footprint = footprint_at({0, 0, scene.z_range.middle()});
  CHECK(footprint == doctest::Approx(0.5).epsilon(0.1));
  CHECK(footprint_at({20, -20, scene.z_range.low}) == doctest::Approx(footprint).epsilon(0.01));
  CHECK(plan_reconstruction(nn::model_preset("tiny"), scene, {}).grid.step ==
        natural_step(footprint));
}

TEST_CASE("cells lie whole cells away from a corner") {
  const rpc::LocalFrame frame{{.number = 31, .north = true}, 500003.1, 4000000.7, 0};
  const Ground ground{-10.2, -7.3, 20.4, 15};
  for (const std::array<double, 2>& corner :
       {std::array{0.0, 0.0}, std::array{500000.2, 4000100.1}, std::array{510000.0, 3999999.9}}) {
    const Grid grid = grid_of(ground, frame, 0.3, corner);
    CAPTURE(corner[0]);
    const double columns = (grid.east + frame.easting0 - corner[0]) / 0.3,
                 rows = (grid.north + frame.northing0 - corner[1]) / 0.3;
    CHECK(std::abs(columns - std::round(columns)) < 1e-6);
    CHECK(std::abs(rows - std::round(rows)) < 1e-6);
    CHECK(grid.east <= ground.x0);
    CHECK(grid.east > ground.x0 - 0.3);
    CHECK(grid.north >= ground.y1);
    CHECK(grid.north < ground.y1 + 0.3);
    CHECK(grid.ground().x1 >= ground.x1 - 1e-9);
    CHECK(grid.ground().y0 <= ground.y0 + 1e-9);
  }
}

TEST_CASE("a surface of more cells than there can be is refused, whatever made it so large") {
  const rpc::LocalFrame frame;
  CHECK(grid_of({0, 0, 10, 10}, frame, 0.5).width == 20);
  for (const double step : {0.0, -1.0, 1e-9, std::nan("")})
    CHECK_THROWS_AS(grid_of({0, 0, 10, 10}, frame, step), Error);
  for (const double far : {1e300, double{INFINITY}, std::nan("")})
    CHECK_THROWS_AS(grid_of({0, 0, far, 10}, frame, 0.5), Error);
  CHECK(test::error_of<Error>([&] {
          grid_of({0, 0, 4e9, 10}, frame, 0.5);
        }) ==
        "a surface of 4e+09 x 10 m in cells of 0.5 m, expected fewer than 2^31 cells a side; wrong "
        "cameras?");
  // pixels of a centimetre round to cells of nothing
  CHECK(natural_step(0.01) == 0.05);
  CHECK(natural_step(0.52) == doctest::Approx(0.5));
}
