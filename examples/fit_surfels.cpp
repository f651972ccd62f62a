// SPDX-License-Identifier: Apache-2.0
// The engine without the network: finds the heights of a patch of ground from two pictures of it,
// by gradient descent through the splatter. Needs nothing but satsurf::engine.
#include <cmath>
#include <cstdio>

#include <satsurf/core/rng.h>
#include <satsurf/nn/adamw.h>
#include <satsurf/ops/elementwise.h>
#include <satsurf/ops/loss.h>
#include <satsurf/splat/rasterize.h>

using namespace satsurf;

namespace {

constexpr Index kSide = 12;  // surfels per row, one metre apart
constexpr Index kCount = kSide * kSide;
constexpr Index kPixels = 2 * kSide;      // pixels of half a metre
constexpr double kSlant[] = {-0.6, 0.6};  // pixels a metre of height moves each view's picture by
constexpr double kRoof = 3;               // m, of the box in the middle

/// pixel = (2 x + slant * 2 z, 2 (side - y))
Quadratic camera(double slant) {
  Quadratic q;
  q.coeff[0][1] = 2;
  q.coeff[0][3] = 2 * slant;
  q.coeff[1][0] = 2 * kSide - 1;
  q.coeff[1][2] = -2;
  return q;
}

splat::Surfels patch(const Var& means) {
  Tensor quats({kCount, 4}), colours({kCount, 3});
  Rng rng(5);
  for (Index i = 0; i < kCount; ++i) {
    quats[4 * i] = 1;  // flat
    for (Index c = 0; c < 3; ++c) colours[3 * i + c] = static_cast<float>(rng.uniform());
  }
  return {.means = means,
          .quats = Var(quats),
          .scales = Var(Tensor({kCount, 2}, 0.5F)),
          .opacity = Var(Tensor({kCount}, 0.9F)),
          .colours = Var(colours),
          .aux = {}};
}

Var picture(const Var& means, double slant) {
  const auto view = splat::project(means.value(), camera(slant));
  return splat::rasterize(patch(means), view, {.height = kPixels, .width = kPixels}).colour;
}

double mean_height_error(const Tensor& means, const Tensor& truth) {
  double sum = 0;
  for (Index i = 0; i < kCount; ++i) sum += std::abs(means[3 * i + 2] - truth[3 * i + 2]);
  return sum / static_cast<double>(kCount);
}

}  // namespace

int main() {
  Tensor truth({kCount, 3}), flat({kCount, 3});
  for (Index i = 0; i < kCount; ++i) {
    const Index x = i % kSide, y = i / kSide;
    const bool roof = x >= 4 && x < 8 && y >= 3 && y < 9;
    flat[3 * i] = truth[3 * i] = static_cast<float>(x);
    flat[3 * i + 1] = truth[3 * i + 1] = static_cast<float>(y);
    truth[3 * i + 2] = roof ? kRoof : 0;
    flat[3 * i + 2] = 1;
  }
  const Tensor seen[] = {picture(Var(truth), kSlant[0]).value(),
                         picture(Var(truth), kSlant[1]).value()};

  nn::ParameterSet<float> parameters(0);
  Var means = parameters.create("means", {kCount, 3}, nn::Init::constant(0), false);
  means.mutable_value() = flat;
  nn::AdamW adam(parameters, {.weight_decay = 0});
  const double before = mean_height_error(means.value(), truth);
  constexpr Index kSteps = 300;
  for (Index step = 0; step < kSteps; ++step) {
    const Var loss =
        mse(picture(means, kSlant[0]), seen[0], {}) + mse(picture(means, kSlant[1]), seen[1], {});
    parameters.clear_grads();
    loss.backward();
    adam.step(nn::one_cycle_lr(0.1, 0.1, step, kSteps));
    if (step % 50 == 0)
      std::printf("step %3td  loss %.5f  height error %.3f m\n", step,
                  static_cast<double>(loss.value().item()),
                  mean_height_error(means.value(), truth));
  }
  const double after = mean_height_error(means.value(), truth);
  std::printf("mean height error: %.3f m before, %.3f m after\n", before, after);
  return after < before / 3 ? 0 : 1;
}
