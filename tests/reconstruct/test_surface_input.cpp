// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/core/rng.h"
#include "satsurf/reconstruct/cast.h"
#include "satsurf/reconstruct/cell_mode.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/reconstruct/surface_input.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>
#include <vector>

#include "tests/affine_scene.h"
#include "tests/reconstruct/simulated.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;
using nn::SurfaceCandidate;
using nn::SurfacePlane;

namespace {

constexpr Index S = 64;

/// Surfels on level ground and on a roof in its middle, as three views of flat ground find them.
struct MadeUp {
  MadeUp()
      : input(test::affine_scene(S, {{0, 0}, {1, 0}, {-1, 0}}, -5, 10,
                                 [](double, double) { return 0.0; })) {
    for (double x = -12; x < 12; x += 0.25)
      for (double y = -12; y < 12; y += 0.25) {
        if (std::abs(x - 9) < 1.5 && std::abs(y) < 1.5) continue;  // a hole
        add(x, y, std::abs(x) < 3 && std::abs(y) < 3 ? 6 : 0, 0.8f);
      }
  }
  void add(double x, double y, double z, float sure) {
    for (const double v : {x, y, z}) places.push_back(static_cast<float>(v));
    confidences.push_back(sure);
  }
  nn::SurfaceInput made() const {
    const Index n = std::ssize(confidences);
    return surface_input(Tensor::from({n, 3}, places), Tensor::from({n}, confidences),
                         {Tensor::from({n}, confidences), Tensor({n, 2})}, grid, input.sources);
  }
  Index cell(double x, double y) const {
    return static_cast<Index>((grid.north - y) / grid.step) * grid.width +
           static_cast<Index>((x - grid.east) / grid.step);
  }
  float height(const nn::SurfaceInput& in, SurfaceCandidate c, double x, double y) const {
    return in.candidates[static_cast<Index>(c) * grid.height * grid.width + cell(x, y)];
  }
  float plane(const nn::SurfaceInput& in, Index p, double x, double y) const {
    return in.planes[p * grid.height * grid.width + cell(x, y)];
  }

  nn::NetworkInput input;
  std::vector<float> places, confidences;
  FusionGrid grid{.east = -12,
                  .north = 12,
                  .step = 0.5,
                  .height = 48,
                  .width = 48,
                  .footprint = 0.5,
                  .interval = 0.75};
};

Index at(SurfacePlane p) { return static_cast<Index>(p); }

}  // namespace

TEST_CASE("the candidates of roof, ground and hole") {
  MadeUp made;
  for (double y = -1; y < 1; y += 0.25) made.add(6.1, y, 4, 0.3f);  // a few that are wrong
  const nn::SurfaceInput in = made.made();
  CHECK(made.height(in, SurfaceCandidate::mode, 0.1, 0.1) == doctest::Approx(6));
  CHECK(made.height(in, SurfaceCandidate::ground, 0.1, 0.1) == doctest::Approx(0));
  CHECK(std::isnan(made.height(in, SurfaceCandidate::second, 0.1, 0.1)));
  CHECK(made.height(in, SurfaceCandidate::around, 0.1, 0.1) == doctest::Approx(6));
  CHECK(made.plane(in, at(SurfacePlane::mode_share), 0.1, 0.1) == doctest::Approx(1));
  CHECK(made.plane(in, at(SurfacePlane::confidence), 0.1, 0.1) == doctest::Approx(0.8));

  CHECK(made.height(in, SurfaceCandidate::mode, 6.1, 0.1) == doctest::Approx(0));
  CHECK(made.height(in, SurfaceCandidate::second, 6.1, 0.1) == doctest::Approx(4));
  const float share = made.plane(in, at(SurfacePlane::second_share), 6.1, 0.1);
  CHECK(share > 0.02f);
  CHECK(share < 0.3f);
  CHECK(made.plane(in, at(SurfacePlane::mode_share), 6.1, 0.1) == doctest::Approx(1 - share));

  CHECK(std::isnan(made.height(in, SurfaceCandidate::mode, 9.1, 0.1)));
  CHECK(made.height(in, SurfaceCandidate::around, 9.1, 0.1) == doctest::Approx(0));
  CHECK(made.height(in, SurfaceCandidate::ground, 9.1, 0.1) == doctest::Approx(0));
  CHECK(made.plane(in, at(SurfacePlane::weight), 9.1, 0.1) == 0);
}

TEST_CASE("the images agree at the true height and not elsewhere") {
  const MadeUp made;
  const nn::SurfaceInput in = made.made();
  const Index first = at(SurfacePlane::disagreement), best = at(SurfacePlane::best_pair);
  double right = 0, wrong = 0, n = 0;
  for (double x = -2; x < 2; x += 0.5)
    for (double y = -2; y < 2; y += 0.5, ++n) {
      // the images are of level ground: of the roof only the candidate `ground` is where they agree
      wrong += static_cast<double>(
          made.plane(in, first + static_cast<Index>(SurfaceCandidate::mode), x, y));
      right += static_cast<double>(
          made.plane(in, first + static_cast<Index>(SurfaceCandidate::ground), x, y));
      for (Index k = 0; k < nn::kSurfaceCandidates; ++k)
        CHECK(made.plane(in, best + k, x, y) <= 2 * made.plane(in, first + k, x, y) + 1e-6f);
    }
  CHECK(right / n < 0.1);
  CHECK(wrong / n > 0.4);
}

TEST_CASE("what the roof hides from an image is not seen in it") {
  const MadeUp made;
  const nn::SurfaceInput in = made.made();
  // the satellite of the first stands above, that of the second in the west, of the third in the east;
  // 6 m of roof hide 3 m of ground
  const auto of_mode = [&](SurfacePlane p, double x, double y) {
    return made.plane(in, at(p) + static_cast<Index>(SurfaceCandidate::mode), x, y);
  };
  CHECK(of_mode(SurfacePlane::seen, 0.1, 8.1) == 0.75F);  // quarters
  CHECK(of_mode(SurfacePlane::seen, 0.1, 0.1) == 0.75F);
  CHECK(of_mode(SurfacePlane::seen, 4.1, 0.1) == 0.5F);
  CHECK(of_mode(SurfacePlane::seen, -4.1, 0.1) == 0.5F);
  CHECK(of_mode(SurfacePlane::seen, 6.6, 0.1) == 0.75F);
  const auto ground = static_cast<Index>(SurfaceCandidate::ground);
  CHECK(made.plane(in, at(SurfacePlane::seen) + ground, 0.1, 0.1) == 0.25F);  // from above
  CHECK(made.plane(in, at(SurfacePlane::seen_disagreement) + ground, 0.1, 0.1) == 1);
  CHECK(of_mode(SurfacePlane::seen_disagreement, 0.1, 8.1) ==
        of_mode(SurfacePlane::disagreement, 0.1, 8.1));
  // the middles of these cells are the middles of pixels of all images
  const auto local = [&](std::size_t view, Index row, Index column) {
    return nn::locally_normalised<float>(made.input.sources[view])[row * S + column];
  };
  CHECK(of_mode(SurfacePlane::brightness, 0.1, 8.1) ==
        doctest::Approx((local(0, 15, 32) + local(1, 15, 32) + local(2, 15, 32)) / 3));
  CHECK(of_mode(SurfacePlane::brightness, 4.1, 0.1) ==
        doctest::Approx((local(0, 31, 40) + local(2, 31, 40)) / 2));
}

TEST_CASE("of many images those count that show the place") {
  MadeUp made;
  const nn::SurfaceInput three = made.made();
  for (int i = 0; i < 20; ++i) {  // of a place far away
    nn::PosedImage elsewhere = made.input.sources[0];
    elsewhere.pixel_from_local.coeff[0][0] += 1e4;
    made.input.sources.insert(made.input.sources.begin(), elsewhere);
  }
  const nn::SurfaceInput many = made.made();
  CHECK(std::memcmp(many.planes.data(), three.planes.data(),
                    sizeof(float) * static_cast<std::size_t>(many.planes.count())) == 0);
  CHECK(made.plane(many, at(SurfacePlane::views), 0.1, 0.1) == 0.75f);  // quarters
  for (int i = 0; i < 20; ++i) made.input.sources.push_back(made.input.sources.back());
  CHECK(made.plane(made.made(), at(SurfacePlane::views), 0.1, 0.1) == 4);  // of 16 at most
}

TEST_CASE("a cell's summary is what its definition says") {
  Rng rng(4);
  for (int trial = 0; trial < 200; ++trial) {
    std::vector<CellCandidate> candidates;
    for (int k = 0; k < 1 + trial % 30; ++k)
      candidates.push_back({rng.uniform(0, 9), rng.uniform(0.01, 1), rng.uniform(0, 1)});
    std::vector<CellCandidate> again = candidates, rest;
    const CellMode mode = densest_mode(again, 0.8);
    double weight = 0, sure = 0, low = 0, high = 0;
    for (const auto& c : candidates) weight += c.weight, sure += c.weight * c.confidence;
    const CellSummary s = summary_of(again = candidates, 0.8);
    CHECK(s.mode.height == doctest::Approx(mode.height));
    CHECK(s.mode.confidence == doctest::Approx(mode.confidence));
    CHECK(s.weight == doctest::Approx(weight));
    CHECK(s.confidence == doctest::Approx(sure / weight));
    for (const auto& c : candidates) {
      low += c.z < s.low ? c.weight : 0;
      high += c.z > s.high ? c.weight : 0;
    }
    CHECK(low < 0.1 * weight);
    CHECK(high < 0.1 * weight);
    CHECK(s.mode_share + s.second_share <= 1 + 1e-9);
    CHECK(std::isnan(s.second) == (s.second_share == 0));
  }
  std::vector<CellCandidate> none;
  CHECK(std::isnan(summary_of(none, 1).mode.height));
}

TEST_CASE("a refined surface has a height and an expected error in every cell with surfels near") {
  const scene::SimulatedScene made = test::village(96, 3);
  const test::HeldImages held(made);
  const nn::Model model(nn::model_preset("tiny"), 3);
  const nn::SurfaceModel network({.base = 3}, 5);
  const scene::UserScene user = scene::scene_from_images(held.images(), test::range_of(made));
  ReconstructOptions how;
  how.network = &network;
  const Reconstruction refined = reconstruct::reconstruct(model, user.scene, how);
  how.surface = Surface::plain;
  const Reconstruction plain = reconstruct::reconstruct(model, user.scene, how);
  REQUIRE(refined.sigma.shape() == refined.dsm.z.shape());
  CHECK(plain.sigma.empty());
  Index more = 0, known = 0, both = 0;
  for (Index i = 0; i < refined.sigma.count(); ++i) {
    CHECK(std::isfinite(refined.sigma[i]) == std::isfinite(refined.dsm.z[i]));
    CHECK(std::isfinite(refined.confidence[i]) == std::isfinite(refined.dsm.z[i]));
    known += std::isfinite(plain.dsm.z[i]);
    both += std::isfinite(plain.dsm.z[i]) && std::isfinite(refined.dsm.z[i]);
    more += std::isfinite(refined.dsm.z[i]) && !std::isfinite(plain.dsm.z[i]);
  }
  CHECK(more > 0);
  // The rest lies along the rim, where the middle of a cell is seen by one image alone.
  CHECK(static_cast<double>(both) > 0.95 * static_cast<double>(known));
  set_threads(1);
  how.surface = Surface::automatic;
  const Reconstruction alone = reconstruct::reconstruct(model, user.scene, how);
  set_threads(0);
  CHECK(std::memcmp(alone.dsm.z.data(), refined.dsm.z.data(),
                    sizeof(float) * static_cast<std::size_t>(refined.dsm.z.count())) == 0);
  how.surface = Surface::refined, how.network = nullptr;
  CHECK_THROWS_WITH_AS(reconstruct::reconstruct(model, user.scene, how),
                       "surface is refined, expected weights with a surface network", ConfigError);
}

TEST_CASE("surfels are cast along their rays onto the surface they first meet") {
  // A wall from 0 to 4 m at x = 0; rays from the east lean by half a metre per metre of height.
  scene::HeightField surface{Tensor({8, 16}), -8, 4, 1};
  for (Index i = 0; i < 8; ++i)
    for (Index j = 0; j < 8; ++j) surface.z[16 * i + j] = 4;
  surface.z[16 * 3 + 12] = std::nanf("");  // x 4 to 5, y 0 to 1
  const auto cast = [&](std::vector<float> places, std::vector<float> rays) {
    const Index n = std::ssize(places) / 3;
    splat::Surfels surfels;
    surfels.means = Var(Tensor::from({n, 3}, places));
    surfels.quats = Var(Tensor({n, 4}, 1.f));
    surfels.scales = Var(Tensor({n, 2}, 1.f));
    surfels.opacity = Var(Tensor({n}, 1.f));
    surfels.colours = Var(Tensor({n, 3}));
    for (Index k = 0; k < n; ++k) surfels.colours.mutable_value()[3 * k] = static_cast<float>(k);
    surfels.aux = Var(Tensor({n, 1}));
    return cast_on(surfels, Tensor::from({n, 2}, rays), surface);
  };
  const splat::Surfels out =
      cast({2, 0.5, 3, -4, 0.5, 9, 4.5, 0.5, 2, 1, -2.5, 0}, {0.5, 0, 0, 0, 0, 0, 0.5, 0});
  const Tensor &p = out.means.value(), &c = out.colours.value();
  REQUIRE(p.shape() == Shape{3, 3});  // the third looks at what nobody knows
  CHECK(c[0] == 0);
  CHECK(c[3] == 1);
  CHECK(c[6] == 3);
  CHECK(p[0] == doctest::Approx(0.5));  // down to the ground: x = 2 - 3 / 2
  CHECK(p[2] == doctest::Approx(0));
  CHECK(p[3] == doctest::Approx(-4));  // straight down onto the roof
  CHECK(p[5] == doctest::Approx(4));
  CHECK(p[6] == doctest::Approx(1));  // it lay on the surface before
  CHECK(p[8] == doctest::Approx(0));
  // A ray that passes behind the wall's edge ends on the wall.
  const splat::Surfels wall = cast({-1, 0.5, 0}, {0.5, 0});
  CHECK(wall.means.value()[0] == doctest::Approx(0).epsilon(1e-6));
  CHECK(wall.means.value()[2] == doctest::Approx(2));
}
