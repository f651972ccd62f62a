// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/guidance.h"
#include "satsurf/nn/surfel_head.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "tests/affine_scene.h"
#include "tests/gradcheck.h"
#include <Eigen/Geometry>
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::test;

namespace {

using Doubles = BasicTensor<double>;

double median(std::vector<double> v) {
  std::sort(v.begin(), v.end());
  const std::size_t n = v.size();
  return n == 0 ? 0 : n % 2 == 1 ? v[n / 2] : 0.5 * (v[n / 2 - 1] + v[n / 2]);
}

}  // namespace

TEST_CASE("the residual of guidance compares maps as defined") {
  // 2 views; the rendered map is half the size and constant in blocks, so that its bilinear samples
  // in the middle of four equal pixels are known.
  const Index h = 8, w = 12;
  Doubles height = normal({2, h, w}, 1, 2.0), confidence({2, h, w}, 0.25), valid({2, h, w}, 1.0);
  Doubles rendered({2, h / 2, w / 2}, 3.0), alpha({2, h / 2, w / 2}, 1.0);
  for (Index i = 0; i < w / 2; ++i) {  // the second view's last rows are far higher
    rendered[h / 2 * w / 2 + 2 * w / 2 + i] = 9;
    rendered[h / 2 * w / 2 + 3 * w / 2 + i] = 9;
  }
  valid[5] = 0.3;
  alpha[0] = 0.4;
  const nn::GuidedMaps<double> stage{
      .height = height, .confidence = confidence, .validity = valid, .interval = 0.5};
  const auto interval = nn::guidance_residual(stage, {rendered, alpha}, nn::GuidanceNorm::interval);
  REQUIRE(interval.shape() == Shape{2, 3, h, w});
  const auto at = [&](const Doubles& t, Index n, Index c, Index y, Index x) {
    return t[((n * 3 + c) * h + y) * w + x];
  };
  const auto clamped = [](double d) { return std::clamp(d, -10.0, 10.0); };
  CHECK(at(interval, 0, 0, 6, 6) == doctest::Approx(clamped((height[6 * w + 6] - 3) / 0.5)));
  CHECK(at(interval, 0, 1, 6, 6) == std::abs(at(interval, 0, 0, 6, 6)));
  CHECK(at(interval, 0, 2, 6, 6) == 0.25);
  CHECK(at(interval, 1, 0, 7, 3) ==
        doctest::Approx(clamped((height[h * w + 7 * w + 3] - 9) / 0.5)));
  CHECK(at(interval, 0, 0, 0, 5) == 0);  // no data
  CHECK(at(interval, 0, 0, 0, 0) == 0);  // not covered
  CHECK(at(interval, 0, 0, 1, 1) == 0);  // samples a pixel that is not covered

  const auto robust = nn::guidance_residual(stage, {rendered, alpha}, nn::GuidanceNorm::robust);
  for (Index n = 0; n < 2; ++n) {
    std::vector<double> values, deviations;
    for (Index i = 0; i < h * w; ++i)
      if (valid[n * h * w + i] >= 0.5) values.push_back(height[n * h * w + i]);
    const double m = median(values);
    for (const double v : values) deviations.push_back(std::abs(v - m));
    const double mad = median(deviations);
    // view 0 is flat; in view 1 half of the pixels are 3 and half 9: median 6, MAD 3
    const double theirs = n == 0 ? 0 : (9 - 6) / 3.1;
    CHECK(at(robust, n, 0, 7, 6) ==
          doctest::Approx(clamped((height[n * h * w + 7 * w + 6] - m) / (mad + 0.1) - theirs)));
  }
  CHECK_THROWS_AS(
      nn::guidance_residual(stage, {rendered, Doubles({2, 3, 3})}, nn::GuidanceNorm::robust),
      ShapeError);
}

TEST_CASE("surfels that follow the surface face along its normal") {
  // A plane z = 0.3 x: every surfel's normal is (-0.3, 0, 1), down in the camera's convention.
  const auto scene =
      affine_scene(16, {{0, 0}, {0.5, 0}}, -9, 9, [](double x, double) { return 0.3 * x; });
  const nn::PixelGeometry geometry = nn::pixel_geometry(scene.sources[0], 0, 1);
  Doubles height({1, 16, 16});
  for (Index i = 0; i < 256; ++i) height[i] = 0.3 * 0.5 * (static_cast<double>(i % 16) - 7.5);
  const auto s = nn::surfels_from_maps<double>(
      {BasicVar<double>(Doubles({1, 10, 16, 16})), BasicVar<double>(height),
       Doubles({1, 3, 16, 16}), BasicVar<double>(Doubles({1, 16, 16}))},
      {geometry}, nn::Rotation::gradient);
  for (Index i = 0; i < 256; ++i) {
    const double* q = s.quats.value().data() + 4 * i;
    const double n[3] = {2 * (q[1] * q[3] + q[0] * q[2]), 2 * (q[2] * q[3] - q[0] * q[1]),
                         1 - 2 * (q[1] * q[1] + q[2] * q[2])};
    const double length = std::sqrt(1.09);
    CHECK(n[0] == doctest::Approx(0.3 / length).epsilon(1e-9));
    CHECK(std::abs(n[1]) < 1e-9);
    CHECK(n[2] == doctest::Approx(-1 / length).epsilon(1e-9));
  }
}

TEST_CASE("surfels that follow a surface seen at a slant face along its normal, too") {
  // rows and columns of the image lie askew on the ground, which shifts with the height
  nn::PixelGeometry geometry;
  geometry.local_from_pixel = AffineCamera{0.5, 0.5, -0.3, 7.5}.local_from_pixel();
  geometry.local_from_pixel.coeff[0][2] = 0.1;
  geometry.local_from_pixel.coeff[1][1] = -0.15;
  constexpr Index kSide = 16;
  Doubles height({1, kSide, kSide});
  for (Index i = 0; i < height.count(); ++i)
    for (int k = 0; k < 30; ++k) {  // the point seen, by fixed-point iteration
      const auto p = geometry.local_from_pixel(static_cast<double>(i % kSide),
                                               static_cast<double>(i / kSide), height[i]);
      height[i] = 0.3 * p[0] - 0.2 * p[1];
    }
  const auto s = nn::surfels_from_maps<double>(
      {BasicVar<double>(Doubles({1, 10, kSide, kSide})), BasicVar<double>(height),
       Doubles({1, 3, kSide, kSide}), BasicVar<double>(Doubles({1, kSide, kSide}))},
      {geometry}, nn::Rotation::gradient);
  const Eigen::Vector3d normal = Eigen::Vector3d(0.3, -0.2, -1).normalized();
  for (Index i = 0; i < kSide * kSide; ++i) {
    CAPTURE(i);
    const double* q = s.quats.value().data() + 4 * i;
    const Eigen::Matrix3d axes = Eigen::Quaterniond(q[0], q[1], q[2], q[3]).toRotationMatrix();
    CHECK((axes.col(2) - normal).norm() < 1e-9);
    if (i % kSide == kSide - 1) continue;
    const double* m = s.means.value().data() + 3 * i;  // and the first axis to the next pixel
    const Eigen::Vector3d next(m[3] - m[0], m[4] - m[1], m[5] - m[2]);
    CHECK((axes.col(0) - next.normalized()).norm() < 1e-9);
  }
}
