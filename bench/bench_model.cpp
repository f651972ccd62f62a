// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/adamw.h"
#include "satsurf/nn/model.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/loss.h"
#include "satsurf/ops/reduce.h"

#include "tests/affine_scene.h"
#include <benchmark/benchmark.h>

namespace satsurf {
namespace {

nn::SceneInput bench_scene(Index side) {
  return test::affine_scene(
      side, {{0.8, 0.1}, {-0.7, 0.3}, {0.1, -0.8}}, -25, 25,
      [](double x, double y) { return 4 * std::cos(0.1 * x) * std::cos(0.08 * y); });
}

void cascade_infer(benchmark::State& state) {
  const nn::Model model(nn::model_preset("base8"), 1);
  const auto scene = bench_scene(state.range(1));
  const NoGrad no_grad;
  reset_peak_tensor_bytes();
  for (auto _ : state) benchmark::DoNotOptimize(model.forward(scene)[2].height.value().data());
  state.counters["peak_MB"] = static_cast<double>(peak_tensor_bytes()) * 1e-6;
}
BENCHMARK(cascade_infer)
    ->ArgNames({"views", "side"})
    ->Args({3, 256})
    ->Args({3, 512})
    ->Args({3, 1024})
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);

/// Forward, losses at all stages, a rendered view, backward, update.
void train_step(benchmark::State& state) {
  nn::Model model(nn::model_preset("base8"), 1);
  nn::AdamW adam(model.parameters(), {});
  const Index side = state.range(1);
  const auto scene = bench_scene(side);
  reset_peak_tensor_bytes();
  for (auto _ : state) {
    model.parameters().clear_grads();
    Var total;
    for (const auto& s : model.forward(scene)) {
      const auto render =
          nn::render_view(s.surfels, scene.sources[0].pixel_from_local, side, side, s.stride);
      const Var term = smooth_l1(s.height, Tensor(s.height.shape(), 0.f), {}, 1.f) +
                       mse(render.colour, Tensor(render.colour.shape(), 0.5f), {});
      total = total.empty() ? term : total + term;
    }
    total.backward();
    nn::clip_gradient_norm(model.parameters(), 0.5);
    adam.step(1e-4);
  }
  state.counters["peak_MB"] = static_cast<double>(peak_tensor_bytes()) * 1e-6;
}
BENCHMARK(train_step)
    ->ArgNames({"views", "side"})
    ->Args({3, 128})
    ->Args({3, 256})
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace satsurf
