// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/nn/adamw.h"
#include "satsurf/nn/blocks.h"
#include "satsurf/nn/confidence.h"
#include "satsurf/nn/hypotheses.h"
#include "satsurf/nn/running_mean.h"
#include "satsurf/nn/surfel_head.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/reduce.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "tests/affine_scene.h"
#include "tests/gradcheck.h"
#include <Eigen/Geometry>

using namespace satsurf;
using namespace satsurf::test;

TEST_CASE("parameters depend on seed and name alone") {
  nn::ParameterSet<float> a(7), b(7), c(8);
  a.create("first", {3}, nn::Init::kaiming(2), true);
  const Var x = a.create("w", {4, 5}, nn::Init::kaiming(5), true),
            y = b.create("w", {4, 5}, nn::Init::kaiming(5), true),
            z = c.create("w", {4, 5}, nn::Init::kaiming(5), true);
  CHECK(std::equal(x.value().values().begin(), x.value().values().end(), y.value().data()));
  CHECK_FALSE(std::equal(x.value().values().begin(), x.value().values().end(), z.value().data()));
  CHECK(a.count() == 23);
  CHECK_THROWS_WITH_AS(a.create("w", {1}, nn::Init::constant(0), false),
                       "ParameterSet: parameter w exists already", Error);
}

TEST_CASE("parameters are stored and loaded by name, and refused with a list") {
  nn::ParameterSet<float> a(1), b(2), other(3);
  a.create("w", {2, 2}, nn::Init::kaiming(2), true);
  const Var w = b.create("w", {2, 2}, nn::Init::kaiming(2), true);
  other.create("w", {4}, nn::Init::constant(0), true);
  other.create("v", {1}, nn::Init::constant(0), true);
  TensorFile file;
  a.store(file, "model.");
  b.load(file, "model.", "f");
  for (Index i = 0; i < 4; ++i) CHECK(w.value()[i] == a.entries()[0].var.value()[i]);
  file.tensors["model.extra"] = Tensor({1});
  CHECK_THROWS_WITH_AS(other.load(file, "model.", "f"),
                       "f: these parameters do not fit the model; missing v; of another shape w "
                       "([2,2], expected [4]); "
                       "not in the model extra",
                       IoError);
}

TEST_CASE("parameters of a file with fewer parts are taken, the others stay") {
  nn::ParameterSet<float> a(1), b(2), other(3);
  a.create("w", {2, 2}, nn::Init::kaiming(2), true);
  const Var w = b.create("w", {2, 2}, nn::Init::kaiming(2), true),
            v = b.create("v", {1}, nn::Init::constant(7), true);
  TensorFile file;
  a.store(file, "model.");
  CHECK(b.load_present(file, "model.", "f") == std::vector<std::string>{"v"});
  for (Index i = 0; i < 4; ++i) CHECK(w.value()[i] == a.entries()[0].var.value()[i]);
  CHECK(v.value()[0] == 7);
  CHECK(a.load_present(file, "model.", "f").empty());

  other.create("x", {1}, nn::Init::constant(0), true);  // nothing in common
  CHECK_THROWS_WITH_AS(other.load_present(file, "model.", "f"),
                       "f: these parameters do not fit the model; missing x; not in the model w",
                       IoError);
  CHECK_THROWS_AS(other.load_present(TensorFile{}, "model.", "f"), IoError);
  file.tensors["model.w"][3] = std::nanf("");
  CHECK_THROWS_AS(b.load_present(file, "model.", "f"), IoError);
  CHECK(std::isfinite(w.value()[3]));
}

TEST_CASE("the probability near a height") {
  // hypotheses at 10, 12, 14, 16 m, each for the 2 m around it
  const auto hypotheses = Tensor::from({1, 4, 1, 2}, {10, 10, 12, 12, 14, 14, 16, 16});
  const auto probability = Tensor::from({1, 4, 1, 2}, {0.1f, 0, 0.2f, 0, 0.4f, 0, 0.3f, 1});
  const auto height = Tensor::from({1, 1, 2}, {14, 16});
  nn::StageHeights<float> stage{.interval = 2,
                                .hypotheses = hypotheses,
                                .probability = Var(probability),
                                .height = Var(height)};
  const auto near = [&](double reach) { return nn::probability_within(stage, reach); };
  CHECK(near(1)[0] == doctest::Approx(0.4));
  CHECK(near(2)[0] == doctest::Approx(0.4 + 0.5 * (0.2 + 0.3)));  // half of both neighbours
  CHECK(near(3)[0] == doctest::Approx(0.9));
  CHECK(near(100)[0] == doctest::Approx(1));
  CHECK(near(1)[1] == 1);
  stage.height = Var(probability);
  CHECK_THROWS_AS(nn::probability_within(stage, 1), ShapeError);

  // a slow one, over several maps and threads
  Rng rng(3);
  const auto p = uniform_tensor<double>({2, 5, 71, 67}, rng, 0.0, 0.2),
             z = uniform_tensor<double>({2, 71, 67}, rng, -3.0, 3.0);
  BasicTensor<double> h(p.shape());
  for (Index i = 0; i < h.count(); ++i) h[i] = -2.0 + static_cast<double>(i / (71 * 67) % 5);
  for (const int threads : {1, 2}) {
    set_threads(threads);
    const auto out = nn::probability_within<double>({.interval = 1,
                                                     .hypotheses = h,
                                                     .probability = BasicVar<double>(p),
                                                     .height = BasicVar<double>(z)},
                                                    1.25);
    for (Index i = 0; i < z.count(); ++i) {
      double sum = 0;
      for (Index d = 0; d < 5; ++d) {
        const Index at = (i / (71 * 67) * 5 + d) * 71 * 67 + i % (71 * 67);
        // overlap of the hypothesis' interval with z +- 1.25
        const double low = std::max(h[at] - 0.5, z[i] - 1.25),
                     high = std::min(h[at] + 0.5, z[i] + 1.25);
        sum += p[at] * std::max(0.0, high - low);
      }
      REQUIRE(out[i] == doctest::Approx(sum));
    }
  }
  set_threads(0);
}

TEST_CASE("AdamW follows the published recurrence") {
  nn::ParameterSet<float> p(0);
  Var w = p.create("w", {1}, nn::Init::constant(1), true),
      b = p.create("b", {1}, nn::Init::constant(1), false);
  nn::AdamW adam(p, {.weight_decay = 0.1});
  double m = 0, v = 0, x = 1, y = 1;
  for (int t = 1; t <= 4; ++t) {
    const double g = 0.5 * t;
    w.mutable_grad() = Tensor({1}, static_cast<float>(g));
    b.mutable_grad() = Tensor({1}, static_cast<float>(g));
    adam.step(0.01);
    m = 0.9 * m + 0.1 * g;
    v = 0.999 * v + 0.001 * g * g;
    const double update =
        0.01 * (m / (1 - std::pow(0.9, t))) / (std::sqrt(v / (1 - std::pow(0.999, t))) + 1e-8);
    x = x * (1 - 0.01 * 0.1) - update;
    y -= update;
    CHECK(w.value()[0] == doctest::Approx(x).epsilon(1e-6));
    CHECK(b.value()[0] == doctest::Approx(y).epsilon(1e-6));
  }
  CHECK(adam.steps() == 4);
}

TEST_CASE("the running mean follows the published recurrence, and is exchanged") {
  nn::ParameterSet<float> p(0);
  Var w = p.create("w", {1}, nn::Init::constant(1), true);
  nn::RunningMean average(p, 0.3);
  double mean = 1;
  const auto add = [&](float value, double keep) {
    w.mutable_value() = Tensor({1}, value);
    average.add();
    mean = keep * mean + (1 - keep) * static_cast<double>(value);
  };
  add(2, 2.0 / 11);  // (1 + t) / (10 + t)
  add(4, 3.0 / 12);
  add(8, 0.3);  // below 4 / 13
  CHECK(w.value()[0] == 8);
  average.swap();
  CHECK(w.value()[0] == doctest::Approx(mean).epsilon(1e-6));
  average.swap();
  CHECK(w.value()[0] == 8);
}

TEST_CASE("gradients are clipped to a global norm") {
  nn::ParameterSet<float> p(0);
  Var a = p.create("a", {2}, nn::Init::constant(0), true),
      b = p.create("b", {1}, nn::Init::constant(0), true);
  a.mutable_grad() = Tensor::from({2}, {3.f, 0.f});
  b.mutable_grad() = Tensor::from({1}, {4.f});
  CHECK(nn::clip_gradient_norm(p, 10) == doctest::Approx(5));
  CHECK(a.grad()[0] == 3.f);
  CHECK(nn::clip_gradient_norm(p, 1) == doctest::Approx(5));
  CHECK(nn::gradient_norm(p) == doctest::Approx(1));
}

TEST_CASE("one-cycle schedule") {
  CHECK(nn::one_cycle_lr(1, 0.1, 0, 101) == doctest::Approx(0.04));
  CHECK(nn::one_cycle_lr(1, 0.1, 10, 101) == doctest::Approx(1).epsilon(0.01));
  CHECK(nn::one_cycle_lr(1, 0.1, 100, 101) == doctest::Approx(1e-4).epsilon(0.01));
  for (Index s = 11; s < 100; ++s)
    CHECK(nn::one_cycle_lr(1, 0.1, s + 1, 101) < nn::one_cycle_lr(1, 0.1, s, 101));
}

TEST_CASE("blocks keep, halve and double sizes") {
  nn::ParameterSet<double> p(0);
  const BasicVar<double> x(normal({2, 3, 8, 12}, 1)), v(normal({1, 4, 4, 8, 6}, 2));
  CHECK(nn::Conv2d<double>(p, "a", 3, 5, 3)(x).shape() == Shape{2, 5, 8, 12});
  CHECK(nn::ConvNorm2d<double>(p, "b", 3, 4, 4, 2, Activation::relu)(x).shape() ==
        Shape{2, 4, 4, 6});
  CHECK(nn::ConvNorm3d<double>(p, "c", 4, 8, 2)(v).shape() == Shape{1, 8, 2, 4, 3});
  CHECK(nn::UpNorm3d<double>(p, "d", 4, 2)(v).shape() == Shape{1, 2, 8, 16, 12});
  CHECK(nn::norm_groups(64) == 8);
  CHECK(nn::norm_groups(8) == 2);
  CHECK(nn::norm_groups(3) == 1);
}

TEST_CASE("hypotheses") {
  const auto uniform = nn::uniform_hypotheses<double>(
      {.views = 2, .height = 3, .width = 4, .hypotheses = 8}, {-5, 9});
  CHECK(uniform[0] == -5);
  CHECK(uniform[7 * 12] == 9);
  CHECK(uniform[12] - uniform[0] == doctest::Approx(2));
  const auto centre = BasicTensor<double>::from({1, 1, 3}, {0.0, -4.9, 8.9});
  const nn::StageGrid grid{.views = 1, .height = 1, .width = 3, .hypotheses = 4, .interval = 0.5};
  const auto narrow = nn::narrowed_hypotheses(grid, centre, {-5, 9});
  CHECK_THROWS_AS(nn::narrowed_hypotheses(grid, uniform, {-5, 9}), ShapeError);
  for (Index i = 0; i < 3; ++i) {
    for (Index d = 0; d < 3; ++d)
      CHECK(narrow[(d + 1) * 3 + i] - narrow[d * 3 + i] == doctest::Approx(0.5));
    CHECK(narrow[i] >= -5);
    CHECK(narrow[9 + i] <= 9);
  }
  CHECK(narrow[0] == doctest::Approx(-0.75));
  CHECK(narrow[1] == doctest::Approx(-5));  // shifted, not squeezed
}

TEST_CASE("surfels of pixels: gradients and meaning") {
  const auto scene =
      affine_scene(8, {{0.6, 0.2}, {-0.5, 0.3}}, -4, 4, [](double, double) { return 0.0; });
  std::vector<nn::PixelGeometry> geometry;
  for (const auto& v : scene.sources) geometry.push_back(nn::pixel_geometry(v, 0, 4));
  const auto raw = normal({2, 10, 2, 2}, 3, 0.3), height = normal({2, 2, 2}, 4),
             conf = normal({2, 2, 2}, 5);
  const auto image = normal({2, 3, 2, 2}, 6);
  for (const nn::Rotation rotation :
       {nn::Rotation::residual, nn::Rotation::camera, nn::Rotation::gradient}) {
    CAPTURE(static_cast<int>(rotation));
    CHECK(gradcheck(
        [&](const DoubleVars& v) {
          const auto s =
              nn::surfels_from_maps<double>({v[0], v[1], image, v[2]}, geometry, rotation);
          std::vector<BasicVar<double>> all{s.means, s.scales, reshape(s.opacity, Shape{8, 1}),
                                            s.colours, s.aux};
          // surfels along the surface turn with the heights, by design without a gradient
          if (rotation != nn::Rotation::gradient) all.push_back(s.quats);
          return concat(all, 1);
        },
        {raw, height, conf}));
  }
  const BasicVar<double> heights(height, true);
  mean(
      nn::surfels_from_maps<double>({BasicVar<double>(raw), heights, image, BasicVar<double>(conf)},
                                    geometry, nn::Rotation::gradient)
          .quats)
      .backward();
  for (const double g : heights.grad().values()) CHECK(g == 0);
  const auto s = nn::surfels_from_maps<double>(
      {BasicVar<double>(raw), BasicVar<double>(height), image, BasicVar<double>(conf)}, geometry,
      nn::Rotation::residual);
  for (Index i = 0; i < 8; ++i) {  // a surfel's centre projects onto its own pixel
    const double* m = s.means.value().data() + 3 * i;
    const auto p = rescale_pixels(scene.sources[static_cast<std::size_t>(i / 4)].pixel_from_local,
                                  1, 4)(m[0], m[1], m[2]);
    CHECK(p[0] == doctest::Approx(static_cast<double>(i % 2)).epsilon(1e-9));
    CHECK(p[1] == doctest::Approx(static_cast<double>(i / 2 % 2)).epsilon(1e-9));
  }
}

TEST_CASE("surfels of pixels have the attributes that the head's numbers stand for") {
  const auto scene =
      affine_scene(8, {{0.6, 0.2}, {-0.5, 0.3}}, -4, 4, [](double, double) { return 0.0; });
  std::vector<nn::PixelGeometry> geometry;
  for (const auto& v : scene.sources) geometry.push_back(nn::pixel_geometry(v, 0, 4));
  geometry[1].footprint *= 1.5;  // of the same size otherwise
  const auto raw = normal({2, 10, 2, 2}, 3, 0.3), image = normal({2, 3, 2, 2}, 6);
  const BasicVar<double> height(normal({2, 2, 2}, 4)), confidence(normal({2, 2, 2}, 5));
  const auto sigma = [](double x) { return 1 / (1 + std::exp(-x)); };
  for (const nn::Rotation rotation : {nn::Rotation::camera, nn::Rotation::residual}) {
    CAPTURE(static_cast<int>(rotation));
    const auto s = nn::surfels_from_maps<double>({BasicVar<double>(raw), height, image, confidence},
                                                 geometry, rotation);
    for (Index i = 0; i < 8; ++i) {
      CAPTURE(i);
      const nn::PixelGeometry& view = geometry[static_cast<std::size_t>(i / 4)];
      const auto r = [&](Index k) { return raw[(i / 4 * 10 + k) * 4 + i % 4]; };
      for (Index k = 0; k < 2; ++k)
        CHECK(s.scales.value()[2 * i + k] ==
              doctest::Approx(view.footprint * (0.1 + 2.9 * sigma(r(k)))));
      CHECK(s.opacity.value()[i] == doctest::Approx(sigma(r(6))));
      for (Index c = 0; c < 3; ++c)
        CHECK(s.colours.value()[3 * i + c] ==
              doctest::Approx(image[(i / 4 * 3 + c) * 4 + i % 4] + r(7 + c)));
      CHECK(s.aux.value()[i] == confidence.value()[i]);
      std::array<double, 4> quat = view.quat;
      if (rotation == nn::Rotation::residual) {
        // the product of Hamilton by parts: w = qw rw - qv . rv, v = qw rv + rw qv + qv x rv
        const Eigen::Vector3d qv(quat[1], quat[2], quat[3]), rv(r(3), r(4), r(5));
        const double qw = quat[0], rw = 1 + r(2);
        const Eigen::Vector3d v = qw * rv + rw * qv + qv.cross(rv);
        quat = {qw * rw - qv.dot(rv), v[0], v[1], v[2]};
        CHECK(qv.cross(rv).norm() > 1e-3);  // it matters which of them stands first
      }
      for (Index k = 0; k < 4; ++k)
        CHECK(s.quats.value()[4 * i + k] ==
              doctest::Approx(quat[static_cast<std::size_t>(k)]).epsilon(1e-9));
    }
  }
}
