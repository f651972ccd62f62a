// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/nn/input.h"
#include "satsurf/nn/mono.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/reduce.h"

#include <cmath>

#include "tests/gradcheck.h"

using namespace satsurf;
using namespace satsurf::test;

namespace {

/// All three outputs as one number.
BasicVar<double> objective(const nn::MonoOutput<double>& out) {
  return mean(out.height * out.height) + mean(out.features_half * out.features_half) +
         affine(mean(out.features_full), 3.0, 0.0);
}

}  // namespace

TEST_CASE("the monocular network has the promised shapes, for any base") {
  const NoGrad no_grad;
  for (const Index base : {1, 3, 5, 12}) {
    CAPTURE(base);
    const nn::Mono mono({.base = base}, 1);
    CHECK(mono.net().full_channels() == base);
    CHECK(mono.net().half_channels() == 2 * base);
    const auto out = mono(Var(normal({2, 3, 64, 32}, 4).cast<float>()));
    CHECK(out.height.shape() == Shape{2, 64, 32});
    CHECK(out.features_half.shape() == Shape{2, 2 * base, 32, 16});
    CHECK(out.features_full.shape() == Shape{2, base, 64, 32});
    for (const float v : out.height.value().values()) REQUIRE(std::isfinite(v));
    for (const float v : out.features_full.value().values()) REQUIRE(v >= 0);  // behind the ReLU
    for (const float v : out.features_half.value().values()) REQUIRE(v >= 0);
  }
}

TEST_CASE("the docstring of the monocular network tells its size") {
  const nn::Mono mono({}, 1);
  CHECK(mono.parameters().count() == 833149);
  double multiply_adds = 0;  // of an image of 256 x 256: those of a layer per output pixel
  for (const auto& e : mono.parameters().entries()) {
    if (!e.name.ends_with(".weight")) continue;
    const auto digit = e.name.find_first_of("0123456789");
    double stride = e.name.starts_with("stem") || e.name.starts_with("height")
                        ? 1
                        : std::stod(e.name.substr(digit));
    if (e.name.ends_with("reduce.weight")) stride *= 2;  // before the resampling
    multiply_adds += static_cast<double>(e.var.count()) * (256 / stride) * (256 / stride);
  }
  CHECK(multiply_adds == doctest::Approx(0.777e9).epsilon(1e-3));
}

TEST_CASE("monocular gradients in double") {
  nn::BasicMono<double> mono({.base = 3}, 3);
  // an image with detail at every scale: white noise alone cancels out in the coarse levels
  auto image = normal({2, 3, 32, 32}, 4);
  for (Index i = 0; i < image.count(); ++i)
    image[i] += std::sin(0.2 * static_cast<double>(i % 32)) +
                std::cos(0.3 * static_cast<double>(i / 32 % 32));
  const auto value = [&] {
    const NoGrad no_grad;
    return objective(mono(BasicVar<double>(image))).value().item();
  };
  const BasicVar<double> input(image, true);
  objective(mono(input)).backward();
  // the derivative along a random direction, of every parameter for itself and of the image
  const auto check = [&](const std::string& name, BasicTensor<double>& at,
                         const BasicTensor<double>& gradient, std::uint64_t seed) {
    CAPTURE(name);
    REQUIRE(!gradient.empty());
    const auto direction = normal(at.shape(), seed);
    double analytic = 0, size = 0;
    for (Index i = 0; i < at.count(); ++i) {
      analytic += direction[i] * gradient[i];
      size += std::abs(direction[i] * gradient[i]);
    }
    const double h = 1e-7;
    const auto along = [&](double step) {
      for (Index i = 0; i < at.count(); ++i) at[i] += step * direction[i];
    };
    along(h);
    const double up = value();
    along(-2 * h);
    const double low = value();
    along(h);
    CHECK(size > 0);
    CHECK(std::abs((up - low) / (2 * h) - analytic) <= 1e-5 * size + 1e-8);
  };
  std::uint64_t seed = 100;
  for (const auto& e : mono.parameters().entries()) {
    BasicVar<double> v = e.var;
    check(e.name, v.mutable_value(), v.grad(), ++seed);
  }
  check("image", image, input.grad(), ++seed);
}

TEST_CASE("the monocular network gives the same bits for any number of threads") {
  std::vector<float> bits[2];
  for (const int n : {1, 2}) {
    set_threads(n);
    nn::Mono mono({.base = 5}, 3);
    const auto out = mono(Var(normal({2, 3, 64, 96}, 4).cast<float>()));
    (mean(out.height * out.height) + mean(out.features_half)).backward();
    for (const auto& e : mono.parameters().entries())
      if (!e.var.grad().empty())
        bits[n - 1].insert(bits[n - 1].end(), e.var.grad().values().begin(),
                           e.var.grad().values().end());
  }
  set_threads(0);
  CHECK(!bits[0].empty());
  CHECK(bits[0] == bits[1]);
}

TEST_CASE("relative heights do not depend on the exposure of the image") {
  const NoGrad no_grad;
  nn::PosedImage view{Tensor({3, 32, 64}), Tensor({32, 64}, 1.f), {}, {}}, other = view;
  const auto noise = normal({3, 32, 64}, 8);
  for (Index i = 0; i < noise.count(); ++i) {
    view.rgb[i] = static_cast<float>(0.5 + 0.1 * noise[i]);
    other.rgb[i] = static_cast<float>(0.3 + 0.05 * noise[i]);
  }
  const nn::Mono mono({.base = 3}, 1);
  const auto a = mono(Var(nn::standardised<float>(view))).height,
             b = mono(Var(nn::standardised<float>(other))).height;
  double most = 0, size = 0;
  for (Index i = 0; i < a.count(); ++i) {
    most = std::max(most, static_cast<double>(std::abs(a.value()[i] - b.value()[i])));
    size = std::max(size, static_cast<double>(std::abs(a.value()[i])));
  }
  CHECK(most < 0.05 * size);
}

TEST_CASE("the monocular network refuses what it cannot take") {
  const nn::Mono mono({.base = 1}, 1);
  CHECK_THROWS_WITH_AS(
      mono(Var(Tensor({1, 3, 32, 48}))),
      "mono: image has shape [1,3,32,48], expected multiples of 32 rows and columns", ShapeError);
  CHECK_THROWS_WITH_AS(mono(Var(Tensor({1, 1, 32, 32}))),
                       "mono: image has shape [1,1,32,32], expected [N 3 H W]", ShapeError);
}
