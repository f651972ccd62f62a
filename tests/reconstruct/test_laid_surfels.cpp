// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/reconstruct/cell_slopes.h"
#include "satsurf/reconstruct/laid_surfels.h"
#include "satsurf/scene/raycast.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <numbers>
#include <utility>
#include <vector>

#include <Eigen/Dense>
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;
using Eigen::Vector3d;

namespace {

constexpr double kStep = 0.5, kSlope = 0.6, kDisc = 0.3;  // m, m per m, m
constexpr Index kCells = 48;
constexpr double kDegree = std::numbers::pi / 180;

/// Level ground of 0 m and, from -6 to 6 m, a roof that rises towards the east from 10 m on.
scene::HeightField tilted_roof() {
  scene::HeightField out{Tensor({kCells, kCells}), -12, 12, kStep};
  for (Index i = 12; i < 36; ++i)
    for (Index j = 12; j < 36; ++j)
      out.z[i * kCells + j] = static_cast<float>(10 + kSlope * kStep * static_cast<double>(j - 12));
  return out;
}

/// Discs at some places that face a camera towards which a ray moves so far per metre of height.
splat::Surfels facing_discs(const std::vector<float>& places, double east, double north) {
  const Index n = std::ssize(places) / 3;
  const Eigen::Quaterniond q =
      Eigen::Quaterniond::FromTwoVectors(Vector3d(0, 0, 1), Vector3d(east, north, 1));
  splat::Surfels out;
  out.means = Var(Tensor::from({n, 3}, places));
  std::vector<float> quats;
  for (Index k = 0; k < n; ++k)
    for (const double v : {q.w(), q.x(), q.y(), q.z()}) quats.push_back(static_cast<float>(v));
  out.quats = Var(Tensor::from({n, 4}, quats));
  out.scales = Var(Tensor({n, 2}, static_cast<float>(kDisc)));
  out.opacity = Var(Tensor({n}, 0.32f));
  out.colours = Var(Tensor({n, 3}));
  out.aux = Var(Tensor({n, 1}));
  return out;
}

/// Tangents and normal of a surfel.
Eigen::Matrix3d axes(const splat::Surfels& surfels, Index k) {
  const float* q = surfels.quats.value().data() + 4 * k;
  return Eigen::Quaterniond(static_cast<double>(q[0]), static_cast<double>(q[1]),
                            static_cast<double>(q[2]), static_cast<double>(q[3]))
      .normalized()
      .toRotationMatrix();
}

/// Degrees between a surfel's normal, either way, and a direction.
double off(const splat::Surfels& surfels, Index k, const Vector3d& direction) {
  const double cosine = std::abs(axes(surfels, k).col(2).dot(direction.normalized()));
  return std::acos(std::min(1.0, cosine)) / kDegree;
}

/// What a camera sees of a disc along a direction across its ray, one standard deviation, m.
double seen_size(const splat::Surfels& surfels, Index k, const Vector3d& across) {
  const Eigen::Matrix3d a = axes(surfels, k);
  const double u = static_cast<double>(surfels.scales.value()[2 * k]) * a.col(0).dot(across),
               v = static_cast<double>(surfels.scales.value()[2 * k + 1]) * a.col(1).dot(across);
  return std::hypot(u, v);
}

}  // namespace

TEST_CASE("a roof, the ground and both sides of a rim slope each as they do, not as their mean") {
  scene::HeightField surface = tilted_roof();
  surface.z[20 * kCells + 20] += 0.1f;          // noise
  surface.z[40 * kCells + 40] = std::nanf("");  // a hole
  const Tensor slopes = cell_slopes(surface);
  REQUIRE(slopes.shape() == Shape{kCells, kCells, 2});
  for (Index i = 0; i < kCells; ++i)
    for (Index j = 0; j < kCells; ++j) {
      CAPTURE(i);
      CAPTURE(j);
      const bool roof = i >= 12 && i < 36 && j >= 12 && j < 36;
      const bool noisy = std::abs(i - 20) <= 1 && std::abs(j - 20) <= 1;
      const float* s = slopes.data() + 2 * (i * kCells + j);
      CHECK(std::abs(static_cast<double>(s[0]) - (roof ? kSlope : 0)) < (noisy ? 0.07 : 1e-5));
      CHECK(std::abs(static_cast<double>(s[1])) < (noisy ? 0.07 : 1e-5));
    }
}

TEST_CASE("discs lie in roof and ground, level with the plane of their cell") {
  const scene::HeightField surface = tilted_roof();
  // a cell of the roof, west of its middle; its rims; the ground before them and elsewhere
  const float x = 0.1f, top = surface.z[24 * kCells + 24], west = surface.z[24 * kCells + 12],
              east = surface.z[24 * kCells + 35];
  const splat::Surfels laid =
      laid_in(facing_discs({x, -0.2f, top, -5.9f, -0.2f, west, 5.9f, -0.2f, east,  //
                            -6.1f, -0.2f, 0, 6.1f, -0.2f, 0, 9, 9, 0},
                           0.2, -0.3),
              surface);
  const Vector3d of_roof(-kSlope, 0, 1), up(0, 0, 1);
  for (Index k = 0; k < 3; ++k) CHECK(off(laid, k, of_roof) < 0.1);
  for (Index k = 3; k < 6; ++k) CHECK(off(laid, k, up) < 0.1);
  const Tensor& p = laid.means.value();
  CHECK(p[0] == x);
  CHECK(p[2] == doctest::Approx(static_cast<double>(top) + kSlope * (0.1 - 0.25)).epsilon(1e-6));
  CHECK(p[17] == 0);
  for (Index k = 0; k < 6; ++k) CHECK(laid.opacity.value()[k] == 0.3f);
}

TEST_CASE("a disc that faces up under a camera straight above stays as it is") {
  const splat::Surfels facing = facing_discs({9, 9, 0}, 0, 0),
                       laid = laid_in(facing, tilted_roof());
  for (Index a = 0; a < 4; ++a) CHECK(laid.quats.value()[a] == facing.quats.value()[a]);
  for (Index a = 0; a < 2; ++a) CHECK(laid.scales.value()[a] == facing.scales.value()[a]);
}

TEST_CASE("discs cast onto a wall face as it does and cover what they covered") {
  const scene::HeightField surface = tilted_roof();
  // seen from the west: the roof's west wall at x = -6 and its foot; a step of the slope at x = 0
  // is no wall, and one seen from the east would face away
  const double lean = -0.6;
  const splat::Surfels laid = laid_in(facing_discs({-6, 0.2f, 5, -6, 0.2f, 9}, lean, 0), surface);
  const Vector3d ray = Vector3d(lean, 0, 1).normalized(), wall(-1, 0, 0);
  const double steep = std::acos(ray.dot(wall)) / kDegree;
  REQUIRE(steep < 65);
  const Vector3d across(0, 1, 0), along = ray.cross(across);
  for (Index k = 0; k < 2; ++k) {
    CHECK(off(laid, k, wall) < 0.1);
    CHECK(seen_size(laid, k, across) == doctest::Approx(kDisc).epsilon(1e-5));
    CHECK(seen_size(laid, k, along) == doctest::Approx(kDisc).epsilon(1e-5));
  }
  CHECK(laid.means.value()[2] == 5);

  // under a camera that looks nearly straight down the wall is turned towards it
  const splat::Surfels grazing = laid_in(facing_discs({-6, 0.2f, 5}, -0.1, 0), surface);
  CHECK(off(grazing, 0, Vector3d(-0.1, 0, 1)) == doctest::Approx(65).epsilon(1e-4));
  CHECK(off(grazing, 0, wall) < 25);
}

TEST_CASE("a step of a slope is no wall, and its disc grows by 18 % at most") {
  const scene::HeightField surface = tilted_roof();
  const float low = surface.z[24 * kCells + 23], high = surface.z[24 * kCells + 24];
  const splat::Surfels laid =
      laid_in(facing_discs({0, -0.2f, 0.5f * (low + high)}, -0.3, 0.8), surface);
  CHECK(off(laid, 0, Vector3d(-kSlope, 0, 1)) < 0.1);
  const float* s = laid.scales.value().data();
  CHECK(s[0] == static_cast<float>(kDisc));
  CHECK(static_cast<double>(s[1]) == doctest::Approx(1.1785 * kDisc).epsilon(1e-3));
}

TEST_CASE("the corner of a wall that runs aslant faces aslant, not as its cells") {
  scene::HeightField surface{Tensor({kCells, kCells}), -12, 12, kStep};
  for (Index i = 0; i < kCells; ++i)
    for (Index j = 0; j < kCells; ++j) surface.z[i * kCells + j] = j > i ? 10.f : 0.f;
  // the ground is south-west of it; a ray from the west ends on the west side of a cell
  const Index i = 20;
  const float x = static_cast<float>(-12 + kStep * static_cast<double>(i + 1)),
              y = static_cast<float>(12 - kStep * (static_cast<double>(i) + 0.5));
  const splat::Surfels laid = laid_in(facing_discs({x, y, 5}, -0.6, -0.2), surface);
  CHECK(off(laid, 0, Vector3d(-1, -1, 0)) < 5);
}

TEST_CASE("discs are laid the same on any number of threads") {
  std::vector<float> places;
  const scene::HeightField surface = tilted_roof();
  for (int k = 0; k < 9000; ++k) {
    const float x = 0.0026f * static_cast<float>(k) - 11.7f,
                y = 0.3f * static_cast<float>(k % 70) - 10;
    places.insert(places.end(), {x, y, 3});
  }
  const splat::Surfels discs = facing_discs(places, 0.3, 0.1);
  set_threads(1);
  const splat::Surfels alone = laid_in(discs, surface);
  set_threads(0);
  const splat::Surfels together = laid_in(discs, surface);
  for (const auto part :
       {&splat::Surfels::means, &splat::Surfels::quats, &splat::Surfels::scales}) {
    const Tensor &a = (alone.*part).value(), &b = (together.*part).value();
    CHECK(std::memcmp(a.data(), b.data(), sizeof(float) * static_cast<std::size_t>(a.count())) ==
          0);
  }
}

TEST_CASE("only the discs of a refined surface are laid in it") {
  Reconstruction made;
  made.dsm = tilted_roof();
  made.surfels = facing_discs({9, 9, 0}, 0.4, 0);
  CHECK(off(delivered_surfels(made), 0, Vector3d(0.4, 0, 1)) < 0.1);
  made.sigma = Tensor({kCells, kCells});
  CHECK(off(delivered_surfels(made), 0, Vector3d(0, 0, 1)) < 0.1);
}
