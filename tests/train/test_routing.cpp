// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/train/routing.h"

#include <limits>

#include "tests/gradcheck.h"

using namespace satsurf;
using namespace satsurf::train;

TEST_CASE("losses are routed by confidence") {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const auto confidence = Tensor::from({2, 4}, {0.1f, 0.2f, 0.21f, 0.9f, 0.9f, nan, 1, 0});
  const auto valid = Tensor::from({2, 4}, {1, 1, 1, 1, 0, 1, 1, 0});
  const auto check = [&](const RoutingOptions& options, std::initializer_list<float> geometry,
                         std::initializer_list<float> appearance) {
    const auto masks = route_losses(confidence, valid, options);
    CHECK(masks.geometry.shape() == confidence.shape());
    const auto g = Tensor::from({2, 4}, geometry), a = Tensor::from({2, 4}, appearance);
    for (Index i = 0; i < 8; ++i) {
      CAPTURE(i);
      CHECK(masks.geometry[i] == g[i]);
      CHECK(masks.appearance[i] == a[i]);
    }
  };
  RoutingOptions options;
  check(options, {1, 1, 0, 0, 0, 1, 0, 0}, {0, 0, 1, 1, 0, 0, 1, 0});  // 0.2 is on it
  options.warmup = true;
  check(options, {1, 1, 0, 0, 0, 1, 0, 0}, {1, 1, 1, 1, 0, 1, 1, 0});
  options.warmup = false;
  options.routing = Routing::none;
  check(options, {1, 1, 1, 1, 0, 1, 1, 0}, {1, 1, 1, 1, 0, 1, 1, 0});
}

TEST_CASE("the two masks partition the valid pixels for any number of threads") {
  Rng rng(1);
  const auto confidence = uniform_tensor<float>({3, 151, 133}, rng, 0.0, 1.0);
  auto valid = uniform_tensor<float>(confidence.shape(), rng, 0.0, 1.0);
  for (float& v : valid.values()) v = v < 0.7f ? 1.f : 0.f;
  for (const double threshold : {0.0, 0.2, static_cast<double>(confidence[5]), 1.0}) {
    RoutingOptions options;
    options.threshold = threshold;
    set_threads(1);
    const auto one = route_losses(confidence, valid, options);
    set_threads(2);
    const auto two = route_losses(confidence, valid, options);
    set_threads(0);
    for (Index i = 0; i < confidence.count(); ++i) {
      REQUIRE(one.geometry[i] + one.appearance[i] == valid[i]);
      REQUIRE(one.geometry[i] * one.appearance[i] == 0);
      REQUIRE(one.geometry[i] == two.geometry[i]);
      REQUIRE(one.appearance[i] == two.appearance[i]);
    }
  }
  const auto all = route_losses(confidence, {}, {});
  for (Index i = 0; i < confidence.count(); ++i) REQUIRE(all.geometry[i] + all.appearance[i] == 1);
}

TEST_CASE("routing refuses") {
  const Tensor confidence({2, 4, 5});
  CHECK_THROWS_WITH_AS(route_losses(confidence, Tensor({4, 5}), {}),
                       "route_losses: valid has shape [4,5], expected [2,4,5] from confidence",
                       ShapeError);
  RoutingOptions options;
  options.threshold = -0.1;
  CHECK_THROWS_WITH_AS(route_losses(confidence, {}, options),
                       "route_losses: threshold is -0.100000, expected 0 to 1", ConfigError);
}
