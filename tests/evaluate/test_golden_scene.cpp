// SPDX-License-Identifier: Apache-2.0
// The numbers that the shipped weights give for one made-up scene.
#include "satsurf/nn/weights_file.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/scene/dataset.h"
#include "satsurf/scene/simulate/scene.h"

#include <array>
#include <cmath>

#include "tests/paths.h"
#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;

namespace {

/// The height of the cell that holds a point, NaN outside.
double height_at(const scene::HeightField& field, double x, double y) {
  const Index cell = scene::cell_at(field, x, y);
  return cell < 0 ? NAN : static_cast<double>(field.z[cell]);
}

}  // namespace

TEST_CASE("the shipped weights on a made-up scene") {
  const test::TempFolder folder("golden-scene");
  scene::SimulateConfig config;
  config.pixels = 192, config.views = 3, config.gsd = 0.5, config.water = 0;
  config.kinds = {scene::SceneKind::suburb};
  scene::write_scene(scene::simulate_scene(config, 5, 0), folder.path(), "SIM_001");
  const scene::Scene scene = scene::load_scene(folder.path(), "SIM_001");
  REQUIRE(scene.truth);
  const nn::Model model = nn::load_model(test::tests_folder() / "../nn/weights/wide8.safetensors");
  const auto network = nn::load_surface(test::tests_folder() / "../nn/weights/wide8.safetensors");
  REQUIRE(network);
  reconstruct::ReconstructOptions options;
  options.resolution = 0.5;
  options.network = &*network;
  const NoGrad no_grad;
  const auto made = reconstruct::reconstruct(model, scene, options);

  const auto within_a_tenth = [](const reconstruct::Reconstruction& of) {
    const double planned = of.planned_memory.back().bytes;
    REQUIRE(of.memory.back().part == "surface");
    CAPTURE(of.memory.back().bytes);
    CAPTURE(planned);
    CHECK(std::abs(of.memory.back().bytes / planned - 1) < 0.1);
  };
  within_a_tenth(made);
  SUBCASE("the memory of finer cells is foreseen too") {
    reconstruct::ReconstructOptions fine = options;
    fine.resolution = 0.2;
    within_a_tenth(reconstruct::reconstruct(model, scene, fine));
  }

  const Index H = made.dsm.z.dim(0), W = made.dsm.z.dim(1);
  REQUIRE(H == 218);
  REQUIRE(W == 226);
  double error = 0, expected = 0, confidence = 0, cells = 0;
  for (Index i = 0; i < H * W; ++i) {
    const double x = made.dsm.x0 + (static_cast<double>(i % W) + 0.5) * made.dsm.step,
                 y = made.dsm.y0 - (static_cast<double>(i / W) + 0.5) * made.dsm.step,
                 difference = static_cast<double>(made.dsm.z[i]) - height_at(*scene.truth, x, y);
    if (!std::isfinite(difference)) continue;
    error += std::abs(difference);
    expected += static_cast<double>(made.sigma[i]);
    confidence += static_cast<double>(made.confidence[i]);
    ++cells;
  }
  // The instruction sets differ by 1e-6 m in the mean errors and 1e-5 m in single heights; their
  // counts are the same.
  CAPTURE(error / cells);  // these are what to write here for other weights
  CAPTURE(expected / cells);
  CAPTURE(confidence / cells);
  CAPTURE(made.completeness);
  CAPTURE(cells);
  CAPTURE(made.surfels.means.dim(0));
  CHECK(std::abs(error / cells - 0.673377) < 5e-5);
  CHECK(std::abs(expected / cells - 1.187896) < 5e-5);
  CHECK(std::abs(confidence / cells - 0.636099) < 5e-6);
  CHECK(std::abs(made.completeness - 0.964743) < 1e-4);
  CHECK(std::abs(cells - 38500) < 10);
  CHECK(std::abs(static_cast<double>(made.surfels.means.dim(0)) - 98252) < 30);
  // down a column
  const std::array<double, 7> heights{-6.37608, 2.60616,  -0.336318, -6.13569,
                                      2.1417,   0.174231, 2.13097};
  for (std::size_t k = 0; k < heights.size(); ++k) {
    CAPTURE(k);
    const Index row = (static_cast<Index>(k) + 1) * H / 8;
    CAPTURE(made.dsm.z[row * W + W / 3]);
    CHECK(std::abs(static_cast<double>(made.dsm.z[row * W + W / 3]) - heights[k]) < 3e-4);
  }
}
