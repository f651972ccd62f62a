// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/rng.h"
#include "satsurf/ops/conv.h"

#include <benchmark/benchmark.h>

/// Convolutions at the network's shapes. FLOP/s counts two per multiply-add of the definition,
/// padding included; fwd_bwd counts the forward pass and both gradients.
namespace {

using namespace satsurf;

Var random_var(const Shape& shape, std::uint64_t seed) {
  Rng rng(seed);
  return Var(normal_tensor<float>(shape, rng), true);
}

void count_flops(benchmark::State& state, Index per_iteration) {
  state.counters["FLOP/s"] = benchmark::Counter(static_cast<double>(per_iteration),
                                                benchmark::Counter::kIsIterationInvariantRate);
}

/// A scalar whose backward pass hands `y` a gradient (of zeros), as the next op of a network would.
Var root_of(const Var& y) {
  return Var::record("root", Tensor::scalar(0.F), {y}, [](Node<float>& n) { n.grad_in(0); });
}

/// The forward pass alone, or followed by the backward pass.
template <class Forward>
void run(benchmark::State& state, bool backward, Index flops, const Forward& forward) {
  if (!backward) {
    const NoGrad no_grad;
    for (auto _ : state) benchmark::DoNotOptimize(forward().value().data());
    return count_flops(state, flops);
  }
  for (auto _ : state) root_of(forward()).backward();
  count_flops(state, 3 * flops);
}

/// Arguments: images, input channels, output channels, side, kernel, stride.
void conv2d_rows(benchmark::State& state, bool backward) {
  const Index B = state.range(0), C = state.range(1), O = state.range(2), S = state.range(3),
              K = state.range(4), s = state.range(5), p = (K - 1) / 2;
  const Var x = random_var({B, C, S, S}, 1), w = random_var({O, C, K, K}, 2),
            b = random_var({O}, 3);
  run(state, backward, 2 * B * C * O * K * K * (S / s) * (S / s), [&] {
    return conv2d(x, w, b, {.stride = {s, s}, .padding = {p, p}});
  });
}

/// Arguments: images, input channels, output channels, depth, side, stride.
void conv3d_rows(benchmark::State& state, bool backward) {
  const Index B = state.range(0), C = state.range(1), O = state.range(2), D = state.range(3),
              S = state.range(4), s = state.range(5);
  const Var x = random_var({B, C, D, S, S}, 1), w = random_var({O, C, 3, 3, 3}, 2);
  run(state, backward, 2 * B * C * O * 27 * (D / s) * (S / s) * (S / s), [&] {
    return conv3d(x, w, Var(), {.stride = {s, s, s}, .padding = {1, 1, 1}});
  });
}

/// Arguments: images, input channels, output channels, depth, side; doubles every axis.
void conv_transpose3d_rows(benchmark::State& state, bool backward) {
  const Index B = state.range(0), C = state.range(1), O = state.range(2), D = state.range(3),
              S = state.range(4);
  const Var x = random_var({B, C, D, S, S}, 1), w = random_var({C, O, 3, 3, 3}, 2);
  run(state, backward, 2 * B * C * O * 27 * D * S * S, [&] {
    return conv_transpose3d(
        x, w, Var(), {.stride = {2, 2, 2}, .padding = {1, 1, 1}, .output_padding = {1, 1, 1}});
  });
}

void conv2d_fwd(benchmark::State& state) { conv2d_rows(state, false); }
void conv2d_fwd_bwd(benchmark::State& state) { conv2d_rows(state, true); }
void conv3d_fwd(benchmark::State& state) { conv3d_rows(state, false); }
void conv3d_fwd_bwd(benchmark::State& state) { conv3d_rows(state, true); }
void conv_transpose3d_fwd(benchmark::State& state) { conv_transpose3d_rows(state, false); }
void conv_transpose3d_fwd_bwd(benchmark::State& state) { conv_transpose3d_rows(state, true); }

void shapes_2d(benchmark::internal::Benchmark* b) {
  b->ArgNames({"B", "C", "O", "side", "k", "s"})->UseRealTime()->Unit(benchmark::kMicrosecond);
  b->Args({3, 3, 8, 256, 3, 1})->Args({3, 8, 8, 256, 3, 1});
  b->Args({3, 16, 16, 128, 3, 1})->Args({3, 32, 32, 64, 3, 1});
  b->Args({3, 8, 16, 256, 4, 2})->Args({3, 16, 32, 128, 4, 2});
  b->Args({3, 32, 32, 64, 1, 1})->Args({3, 8, 32, 256, 1, 1});
  b->Args({1, 99, 64, 64, 3, 1})->Args({1, 64, 64, 64, 3, 1});
  b->Args({1, 51, 48, 128, 3, 1})->Args({1, 48, 48, 128, 3, 1});
  b->Args({1, 19, 32, 256, 3, 1})->Args({1, 32, 32, 256, 3, 1})->Args({1, 32, 10, 256, 3, 1});
}

void shapes_3d(benchmark::internal::Benchmark* b) {
  b->ArgNames({"B", "C", "O", "D", "side", "s"})->UseRealTime()->Unit(benchmark::kMicrosecond);
  b->Args({1, 8, 8, 48, 64, 1})->Args({1, 8, 8, 32, 128, 1})->Args({1, 8, 8, 8, 256, 1});
  b->Args({1, 32, 8, 48, 64, 1})->Args({1, 16, 8, 32, 128, 1})->Args({1, 8, 1, 48, 64, 1});
  b->Args({1, 16, 16, 24, 32, 1})->Args({1, 32, 32, 12, 16, 1})->Args({1, 64, 64, 6, 8, 1});
  b->Args({1, 8, 16, 48, 64, 2})->Args({1, 16, 32, 24, 32, 2})->Args({1, 32, 64, 12, 16, 2});
}

void shapes_up(benchmark::internal::Benchmark* b) {
  b->ArgNames({"B", "C", "O", "D", "side"})->UseRealTime()->Unit(benchmark::kMicrosecond);
  b->Args({1, 64, 32, 6, 8})->Args({1, 32, 16, 12, 16})->Args({1, 16, 8, 24, 32});
  b->Args({1, 16, 8, 4, 128});
}

BENCHMARK(conv2d_fwd)->Apply(shapes_2d);
BENCHMARK(conv2d_fwd_bwd)->Apply(shapes_2d);
BENCHMARK(conv3d_fwd)->Apply(shapes_3d);
BENCHMARK(conv3d_fwd_bwd)->Apply(shapes_3d);
BENCHMARK(conv_transpose3d_fwd)->Apply(shapes_up);
BENCHMARK(conv_transpose3d_fwd_bwd)->Apply(shapes_up);

}  // namespace
