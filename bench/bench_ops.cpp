// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/rng.h"
#include "satsurf/ops/cost_volume.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/matmul.h"
#include "satsurf/ops/norm.h"
#include "satsurf/ops/resize.h"
#include "satsurf/ops/softmax.h"

#include <vector>

#include <benchmark/benchmark.h>

namespace {

using namespace satsurf;

Var normal(const Shape& shape, bool wants_grad) {
  Rng rng(1);
  return Var(normal_tensor<float>(shape, rng), wants_grad);
}

/// Times `op(x)`, with its backward pass if asked; items are input elements.
template <class Op>
void run(benchmark::State& state, const Var& x, bool with_backward, const Op& op) {
  Tensor seed;
  {
    const NoGrad no_grad;
    seed = Tensor(op(x).shape(), 1.0f);
  }
  for (auto _ : state) {
    if (with_backward) {
      op(x).backward(seed);
    } else {
      const NoGrad no_grad;
      benchmark::DoNotOptimize(op(x).value().data());
    }
  }
  state.SetItemsProcessed(state.iterations() * x.count());
}

template <Activation kActivation, bool kBackward>
void group_norm_3d(benchmark::State& s) {
  const Index C = s.range(0);
  const Var x = normal({1, C, s.range(1), s.range(2), s.range(2)}, true);
  const Var gamma(Tensor({C}, 1.1f), true), beta(Tensor({C}, 0.1f), true);
  run(s, x, kBackward,
      [&](const Var& v) { return group_norm(v, gamma, beta, C / 4, kActivation); });
}

template <bool kBackward>
void softmax(benchmark::State& s) {
  const Var x = normal({3, s.range(0), s.range(1), s.range(1)}, true);
  run(s, x, kBackward, [](const Var& v) { return softmax_hypotheses(v); });
}

template <bool kBackward>
void gelu_map(benchmark::State& s) {
  const Var x = normal({3, s.range(0), s.range(1), s.range(1)}, true);
  run(s, x, kBackward, [](const Var& v) { return gelu(v); });
}

template <bool kBackward>
void relu_map(benchmark::State& s) {
  const Var x = normal({3, s.range(0), s.range(1), s.range(1)}, true);
  run(s, x, kBackward, [](const Var& v) { return relu(v); });
}

template <bool kBackward>
void add_maps(benchmark::State& s) {
  const Var x = normal({3, s.range(0), s.range(1), s.range(1)}, true);
  run(s, x, kBackward, [&](const Var& v) { return add(v, x); });
}

template <bool kBackward>
void resize_nearest_x2(benchmark::State& s) {
  const Index side = s.range(1);
  const Var x = normal({3, s.range(0), side, side}, true);
  run(s, x, kBackward, [=](const Var& v) { return resize_nearest(v, 2 * side, 2 * side); });
}

template <bool kBackward>
void resize_bilinear_x2(benchmark::State& s) {
  const Index side = s.range(1);
  const Var x = normal({3, s.range(0), side, side}, true);
  run(s, x, kBackward, [=](const Var& v) { return resize_bilinear(v, 2 * side, 2 * side); });
}

template <bool kBackward>
void matmul_pixels(benchmark::State& s) {
  const Var x = normal({s.range(0), s.range(1)}, true), w = normal({s.range(1), s.range(1)}, true);
  run(s, x, kBackward, [&](const Var& v) { return matmul(v, w, false, true); });
}

/// Two source views with some parallax, as the model sees them at each stage.
template <bool kBackward>
void plane_sweep(benchmark::State& s) {
  const Index C = s.range(0), D = s.range(1), side = s.range(2);
  const double half = static_cast<double>(side) / 2;
  std::vector<Quadratic> maps(3);
  for (std::size_t j = 0; j < maps.size(); ++j) {
    maps[j].offset = {half, half, 0};
    maps[j].scale = {half, half, 1};
    const double parallax = 0.25 * static_cast<double>(D) * (j == 1 ? 1 : -0.7);
    maps[j].coeff[0] = {half + 0.3, half, 0.02, 0.3 * parallax, 0, 0, 0, 0, 0, 0};
    maps[j].coeff[1] = {half - 0.2, -0.03, half, parallax, 0, 0, 0, 0, 0, 0};
  }
  Tensor heights({D, side, side});
  for (Index i = 0; i < heights.count(); ++i)
    heights[i] = 2 * static_cast<float>(i / (side * side)) / static_cast<float>(D) - 1;
  const Var x = normal({3, C, side, side}, true);
  run(s, x, kBackward,
      [&](const Var& v) { return plane_sweep_variance(v, 0, maps, heights, Tensor{}); });
  s.SetItemsProcessed(s.iterations() * C * heights.count());
}

void norm_shapes(benchmark::internal::Benchmark* b) {
  b->ArgNames({"C", "D", "side"})->Args({8, 64, 64})->Args({8, 8, 256})->UseRealTime();
}
void map_shapes(benchmark::internal::Benchmark* b) {
  b->ArgNames({"C", "side"})->Args({32, 256})->UseRealTime();
}
void half_maps(benchmark::internal::Benchmark* b) {
  b->ArgNames({"C", "side"})->Args({16, 128})->UseRealTime();
}
void sweep_shapes(benchmark::internal::Benchmark* b) {
  b->ArgNames({"C", "D", "side"})
      ->Args({32, 64, 64})
      ->Args({16, 32, 128})
      ->Args({8, 8, 256})
      ->UseRealTime()
      ->Unit(benchmark::kMillisecond);
}

BENCHMARK(group_norm_3d<Activation::relu, false>)->Name("group_norm_relu_fwd")->Apply(norm_shapes);
BENCHMARK(group_norm_3d<Activation::relu, true>)
    ->Name("group_norm_relu_fwd_bwd")
    ->Apply(norm_shapes);
BENCHMARK(group_norm_3d<Activation::gelu, false>)->Name("group_norm_gelu_fwd")->Apply(norm_shapes);
BENCHMARK(group_norm_3d<Activation::gelu, true>)
    ->Name("group_norm_gelu_fwd_bwd")
    ->Apply(norm_shapes);
BENCHMARK(softmax<false>)
    ->Name("softmax_hypotheses_fwd")
    ->ArgNames({"D", "side"})
    ->Args({64, 64})
    ->UseRealTime();
BENCHMARK(softmax<true>)
    ->Name("softmax_hypotheses_fwd_bwd")
    ->ArgNames({"D", "side"})
    ->Args({64, 64})
    ->UseRealTime();
BENCHMARK(plane_sweep<false>)->Name("plane_sweep_variance_fwd")->Apply(sweep_shapes);
BENCHMARK(plane_sweep<true>)->Name("plane_sweep_variance_fwd_bwd")->Apply(sweep_shapes);
BENCHMARK(gelu_map<false>)->Name("gelu_fwd")->Apply(map_shapes);
BENCHMARK(gelu_map<true>)->Name("gelu_fwd_bwd")->Apply(map_shapes);
BENCHMARK(relu_map<false>)->Name("relu_fwd")->Apply(map_shapes);
BENCHMARK(relu_map<true>)->Name("relu_fwd_bwd")->Apply(map_shapes);
BENCHMARK(add_maps<false>)->Name("add_fwd")->Apply(map_shapes);
BENCHMARK(add_maps<true>)->Name("add_fwd_bwd")->Apply(map_shapes);
BENCHMARK(resize_nearest_x2<false>)->Name("resize_nearest_x2_fwd")->Apply(half_maps);
BENCHMARK(resize_nearest_x2<true>)->Name("resize_nearest_x2_fwd_bwd")->Apply(half_maps);
BENCHMARK(resize_bilinear_x2<false>)->Name("resize_bilinear_x2_fwd")->Apply(half_maps);
BENCHMARK(resize_bilinear_x2<true>)->Name("resize_bilinear_x2_fwd_bwd")->Apply(half_maps);
BENCHMARK(matmul_pixels<false>)
    ->Name("matmul_fwd")
    ->ArgNames({"rows", "C"})
    ->Args({16384, 64})
    ->UseRealTime();
BENCHMARK(matmul_pixels<true>)
    ->Name("matmul_fwd_bwd")
    ->ArgNames({"rows", "C"})
    ->Args({16384, 64})
    ->UseRealTime();

}  // namespace
