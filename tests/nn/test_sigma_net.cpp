// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/core/rng.h"
#include "satsurf/nn/sigma_net.h"
#include "satsurf/ops/loss.h"

#include <algorithm>
#include <cmath>

#include <doctest/doctest.h>

namespace satsurf::nn {
namespace {

/// Rough ground with a hole of some cells and one far away.
FoundSurface some_surface(Index H, Index W) {
  Rng rng(5);
  FoundSurface out;
  for (Tensor* map : {&out.heights, &out.log_scale, &out.sure, &out.most, &out.spread})
    *map = normal_tensor<float>({H, W}, rng);
  for (float& v : out.spread.values()) v = std::abs(v);
  for (Index i = 0; i < 3; ++i)
    for (Index j = 4; j < 9; ++j) {
      out.heights[i * W + j] = std::nanf("");
      out.log_scale[i * W + j] = 1e6f;  // must not be read
    }
  out.heights[(H - 1) * W] = std::nanf("");
  return out;
}

TEST_CASE("channels of expected errors: the cell, then what is in each square, holes left out") {
  const Index H = 34, W = 41;
  const FoundSurface found = some_surface(H, W);
  const Tensor channels = sigma_channels(found);
  REQUIRE(channels.shape() == Shape{1, kSigmaChannels, H, W});
  const auto squeezed = [](double z) { return 0.5 * std::asinh(z); };
  const auto spread = [&](Index i) {
    return std::log(static_cast<double>(found.spread[i]) + 0.02);
  };
  for (Index y = 0; y < H; ++y)
    for (Index x = 0; x < W; ++x) {
      const Index cell = y * W + x;
      Index channel = 0;
      const auto next = [&] { return channels[channel++ * H * W + cell]; };
      if (!std::isfinite(found.heights[cell])) {
        while (channel < kSigmaChannels) REQUIRE(next() == 0);
        continue;
      }
      REQUIRE(next() == found.log_scale[cell]);
      REQUIRE(next() == found.sure[cell]);
      REQUIRE(next() == doctest::Approx(spread(cell)));
      REQUIRE(next() == found.most[cell]);
      for (const Index radius : kSigmaRadii) {
        double n = 0, scale = 0, sure = 0, apart = 0, height = 0;
        double scale_most = -INFINITY, scale_least = INFINITY, top = -INFINITY, bottom = INFINITY;
        for (Index v = std::max<Index>(0, y - radius); v <= std::min(H - 1, y + radius); ++v)
          for (Index u = std::max<Index>(0, x - radius); u <= std::min(W - 1, x + radius); ++u) {
            const Index i = v * W + u;
            if (!std::isfinite(found.heights[i])) continue;
            const auto s = static_cast<double>(found.log_scale[i]),
                       z = static_cast<double>(found.heights[i]);
            n += 1, scale += s, sure += static_cast<double>(found.sure[i]), apart += spread(i),
                height += z;
            scale_most = std::max(scale_most, s), scale_least = std::min(scale_least, s);
            top = std::max(top, z), bottom = std::min(bottom, z);
          }
        const auto here = static_cast<double>(found.heights[cell]);
        for (const double expected :
             {scale / n, sure / n, apart / n, scale_most, scale_least, squeezed(top - here),
              squeezed(here - bottom), squeezed(here - height / n)})
          REQUIRE(std::abs(static_cast<double>(next()) - expected) < 2e-5);
      }
      REQUIRE(channel == kSigmaChannels);
    }
  FoundSurface other = found;
  other.most = Tensor({H, W + 1});
  CHECK_THROWS_AS(sigma_channels(other), ShapeError);
}

TEST_CASE("expected errors of a cell do not depend on what is more than 30 cells away") {
  const Index H = 40, W = 90;
  const FoundSurface found = some_surface(H, W);
  FoundSurface other = some_surface(H, W);  // not a copy, which shares its maps
  for (Index y = 0; y < H; ++y) other.heights[y * W + 71] = 500, other.log_scale[y * W + 71] = 4;
  ParameterSet<float> parameters(3);
  const SigmaNet<float> net(parameters, "sigma.", 8);
  const Tensor a = net(sigma_channels(found)).value(), b = net(sigma_channels(other)).value();
  Index changed = 0;
  for (Index y = 0; y < H; ++y)
    for (Index x = 0; x < W; ++x) {
      const float difference = std::abs(a[y * W + x] - b[y * W + x]);
      if (x < 71 - 30)  // running sums round
        CHECK(difference < 1e-4f);
      else
        changed += difference > 1e-3f ? 1 : 0;
    }
  CHECK(changed > H * 20);
}

TEST_CASE("a large surface in strips gets what its cells get by themselves") {
  const Index H = 300, W = 260;  // more than one strip
  Rng rng(4);
  const Tensor channels = normal_tensor<float>({1, kSigmaChannels, H, W}, rng);
  ParameterSet<float> parameters(3);
  const SigmaNet<float> net(parameters, "sigma.", 8);
  const auto run = [&](int threads) {
    set_threads(threads);
    const Tensor out = net(channels).value();
    set_threads(0);
    return out;
  };
  const Tensor all = run(1), again = run(2);
  REQUIRE(all.shape() == Shape{H, W});
  CHECK(std::ranges::equal(all.values(), again.values()));
  for (const Index cell : {Index{0}, 251 * W + 259, 252 * W, H * W - 1}) {
    Tensor one({1, kSigmaChannels, 1, 1});
    for (Index c = 0; c < kSigmaChannels; ++c) one[c] = channels[c * H * W + cell];
    CHECK(net(one).value().item() == doctest::Approx(all[cell]).epsilon(1e-4));
  }
}

}  // namespace
}  // namespace satsurf::nn
