// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/cost_net.h"

#include <cmath>

#include "tests/gradcheck.h"

using namespace satsurf;
using namespace satsurf::nn;
using test::normal;

namespace {

/// Pixel (x, y) at height z is seen at (x + shift z, y).
Quadratic shifted(double shift) {
  Quadratic q;
  q.coeff[0][1] = 1, q.coeff[0][3] = shift;
  q.coeff[1][2] = 1;
  return q;
}

/// The largest difference of the logits of a volume that is whole and of one that comes in bands, in
/// units of the largest logit.
double difference(Index C, Index D, Index H, Index W) {
  ParameterSet<float> parameters(3);
  CostNet<float> net(parameters, "cost",
                     {.channels = C, .more = kPairChannels, .base = 2, .levels = 2});
  for (const auto& entry : parameters.entries())  // of which the further channels begin at nothing
    if (entry.name == "cost.first.more") {
      Var more = entry.var;
      more.mutable_value() = normal(more.shape(), 5).cast<float>();
    }
  const Tensor features = normal({2, C, H, W}, 1).cast<float>();
  Tensor heights({D, H, W});
  for (Index i = 0; i < heights.count(); ++i) heights[i] = static_cast<float>(i / (H * W)) * 0.7f;
  const std::vector<Quadratic> maps{shifted(0), shifted(0.6)};
  const SweepOptions options{.best_pair = true};
  const NoGrad no_grad;
  const Tensor whole =
                   net(plane_sweep_variance(Var(features), 0, maps, heights, {}, options)).value(),
               bands = net(PlaneSweep<float>(features, 0, maps, heights, {}, options)).value();
  REQUIRE(bands.shape() == whole.shape());
  float worst = 0, largest = 0;
  for (Index i = 0; i < whole.count(); ++i) {
    worst = std::fmax(worst, std::abs(bands[i] - whole[i]));
    largest = std::fmax(largest, std::abs(whole[i]));
  }
  REQUIRE(largest > 0);
  return static_cast<double>(worst / largest);
}

}  // namespace

TEST_CASE("a volume that is never whole has the same logits") {
  REQUIRE(band_rows(12 * 8 * 48) > 24);  // one band
  CHECK(difference(7, 8, 24, 48) < 1e-5);
  REQUIRE(band_rows(21 * 64 * 512) == 16);  // three, of which the last is shorter
  CHECK(difference(16, 64, 36, 512) < 1e-5);
}
