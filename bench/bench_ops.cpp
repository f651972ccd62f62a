// SPDX-License-Identifier: Apache-2.0
#include "satsurf/bench/bench.h"
#include "satsurf/ops/attention.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/cost_volume.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/loss.h"
#include "satsurf/ops/matmul.h"
#include "satsurf/ops/norm.h"
#include "satsurf/ops/reduce.h"
#include "satsurf/ops/resize.h"
#include "satsurf/ops/softmax.h"
#include "satsurf/ops/window_correlation.h"

/// Everything of ops/ but the convolutions, at the network's shapes. Bytes are counted in passes
/// over the input; a pass reads or writes it once.
namespace satsurf::bench {
namespace {

using Vars = std::vector<Var>;

/// An op bound by memory on one tensor `x`, or on several of that shape.
OpCase passes(Vars inputs, std::function<Var(const Vars&)> op, double forward, double both) {
  const double one = bytes_of(number(inputs[0].count()));
  return {std::move(inputs), std::move(op), {0, forward * one}, {0, both * one}};
}

/// B images of C channels, or of logits.
Var batch(const benchmark::State& s) {
  return normal({s.range(0), s.range(1), s.range(2), s.range(2)});
}

/// Three images of C channels.
Var maps(const benchmark::State& s, std::uint64_t seed = 1) {
  return normal({3, s.range(0), s.range(1), s.range(1)}, seed);
}

/// Forward: read x, write y. Backward: read x (or y) and its gradient, write.
template <class Op>
MakeCase unary(Op op) {
  return [=](const benchmark::State& s) {
    return passes(
        {maps(s)}, [=](const Vars& v) { return op(v[0]); }, 2, 5);
  };
}

template <class Op>
MakeCase binary(Op op, double both) {
  return [=](const benchmark::State& s) {
    return passes(
        {maps(s), maps(s, 2)}, [=](const Vars& v) { return op(v[0], v[1]); }, 3, both);
  };
}

void add_pointwise_rows() {
  const std::vector<std::string> names{"C", "side"};
  const Shapes shapes{{32, 256}};
  add_op("relu", names, shapes, unary([](const Var& x) { return relu(x); }));
  add_op("gelu", names, shapes, unary([](const Var& x) { return gelu(x); }));
  add_op("sigmoid", names, shapes, unary([](const Var& x) { return sigmoid(x); }));
  add_op("add", names, shapes, binary([](const Var& a, const Var& b) { return add(a, b); }, 6));
  add_op("sub", names, shapes, binary([](const Var& a, const Var& b) { return sub(a, b); }, 6));
  add_op("mul", names, shapes, binary([](const Var& a, const Var& b) { return mul(a, b); }, 8));
  add_op("affine", names, shapes, [](const benchmark::State& s) {
    return passes(
        {maps(s)}, [](const Vars& v) { return affine(v[0], 0.3F, 0.7F); }, 2, 4);
  });
  add_op("sum", names, shapes, [](const benchmark::State& s) {
    return passes(
        {maps(s)}, [](const Vars& v) { return sum(v[0]); }, 1, 2);
  });
  add_op("mean", names, shapes, [](const benchmark::State& s) {
    return passes(
        {maps(s)}, [](const Vars& v) { return mean(v[0]); }, 1, 2);
  });
  // Distance, target and weight are read twice, the gradient is written.
  add_op("smooth_l1", {"C", "side"}, {{1, 1024}}, [](const benchmark::State& s) {
    const Tensor target = maps(s, 2).value(), weight(target.shape(), 0.5F);
    return passes(
        {maps(s)}, [=](const Vars& v) { return smooth_l1(v[0], target, weight, 1.F); }, 3, 7);
  });
  add_op("mse", names, {{3, 1024}}, [](const benchmark::State& s) {
    const Tensor target = maps(s, 2).value(), weight(target.shape(), 0.5F);
    return passes(
        {maps(s)}, [=](const Vars& v) { return mse(v[0], target, weight); }, 3, 7);
  });
}

void add_layout_rows() {
  const std::vector<std::string> names{"C", "side"};
  add_op("concat", names, {{16, 256}}, [](const benchmark::State& s) {
    return passes(
        {maps(s), maps(s, 2)}, [](const Vars& v) { return concat(v, 1); }, 4, 8);
  });
  add_op("slice", names, {{32, 256}}, [](const benchmark::State& s) {
    const Index half = s.range(0) / 2;
    return passes(
        {maps(s)}, [=](const Vars& v) { return slice(v[0], 1, 0, half); }, 1, 2.5);
  });
  // Forward shares the buffer: there is nothing to touch.
  add_op("reshape", names, {{32, 256}}, [](const benchmark::State& s) {
    return passes(
        {maps(s)}, [](const Vars& v) { return reshape(v[0], {v[0].count()}); }, 0, 2);
  });
  const Shapes doubled{{3, 32, 128}, {1, 32, 256}};
  add_op("resize_nearest_x2", {"B", "C", "side"}, doubled, [=](const benchmark::State& s) {
    const Index side = 2 * s.range(2);
    return passes(
        {batch(s)}, [=](const Vars& v) { return resize_nearest(v[0], side, side); }, 5, 10);
  });
  add_op("resize_bilinear_x2", {"B", "C", "side"}, doubled, [=](const benchmark::State& s) {
    const Index side = 2 * s.range(2);
    return passes(
        {batch(s)}, [=](const Vars& v) { return resize_bilinear(v[0], side, side); }, 5, 10);
  });
  add_op("area_downsample_x4", names, {{3, 1024}}, [](const benchmark::State& s) {
    return passes(
        {maps(s)}, [](const Vars& v) { return area_downsample(v[0], 4); }, 1.0625, 2.125);
  });
}

/// Moments need all of x before the first result: forward reads it twice. Backward reads x and the
/// gradient and writes; that the sums of backward may need a second reading is not counted.
template <Activation kActivation>
OpCase group_norm_case(const benchmark::State& s) {
  const Index C = s.range(0);
  return passes(
      {normal({1, C, s.range(1), s.range(2), s.range(2)}), Var(Tensor({C}, 1.1F), true),
       Var(Tensor({C}, 0.1F), true)},
      [=](const Vars& v) {
        return materialise(group_normalised(v[0], v[1], v[2], C / 4, kActivation));
      },
      3, 6);
}

Tensor hypotheses(Index B, Index D, Index side) {
  Tensor heights({B, D, side, side});
  for (Index i = 0; i < heights.count(); ++i)
    heights[i] = 2 * static_cast<float>(i / (side * side) % D) / static_cast<float>(D) - 1;
  return heights;
}

void add_softmax_rows() {
  const std::vector<std::string> names{"B", "D", "side"};
  const Shapes shapes{{3, 64, 64}, {3, 32, 128}, {3, 8, 256}, {1, 48, 256}, {1, 64, 256}};
  // Reads logits and heights, writes probabilities (the next stage reads them); backward reads
  // probabilities and heights and writes. Height and confidence are 1/D of a pass.
  add_op("softmax_expectation_max", names, shapes, [=](const benchmark::State& s) {
    const Tensor heights = hypotheses(s.range(0), s.range(1), s.range(2));
    return passes(
        {batch(s)},
        [=](const Vars& v) {
          const auto h = height_distribution(v[0], heights);
          return add(h.height, h.confidence);
        },
        3, 6);
  });
}

/// Two source views with some parallax, as the model sees them at each stage. Ten operations per
/// source, channel and hypothesis: four weighted neighbours, sum and sum of squares; backward
/// samples again and scatters.
OpCase sweep_case(const benchmark::State& s, const SweepOptions& options) {
  const Index C = s.range(0), D = s.range(1), side = s.range(2);
  const double half = number(side) / 2;
  std::vector<Quadratic> transfer(3);
  for (std::size_t j = 0; j < transfer.size(); ++j) {
    transfer[j].offset = {half, half, 0};
    transfer[j].scale = {half, half, 1};
    const double parallax = 0.25 * number(D) * (j == 1 ? 1 : -0.7);
    transfer[j].coeff[0] = {half + 0.3, half, 0.02, 0.3 * parallax, 0, 0, 0, 0, 0, 0};
    transfer[j].coeff[1] = {half - 0.2, -0.03, half, parallax, 0, 0, 0, 0, 0, 0};
  }
  const Tensor heights = hypotheses(1, D, side).slice0(0);
  const double P = number(side * side), maps_read = 3 * number(C) * P, d = number(D),
               volume = number(C) * d * P, flop = 2 * 10 * volume;
  return {{normal({3, C, side, side})},
          [=](const Vars& v) {
            return plane_sweep_variance(v[0], 0, transfer, heights, Tensor{}, options);
          },
          {flop, bytes_of(maps_read + d * P + volume)},
          {3 * flop, bytes_of(3 * maps_read + 2 * d * P + 2 * volume)}};
}

OpCase plane_sweep_case(const benchmark::State& s) { return sweep_case(s, {}); }
OpCase paired_sweep_case(const benchmark::State& s) { return sweep_case(s, {.best_pair = true}); }

/// Arguments: rows, inner extent, columns of the product with a transposed weight matrix.
OpCase matmul_case(const benchmark::State& s) {
  const Index M = s.range(0), K = s.range(1), N = s.range(2);
  const double flop = 2 * number(M * K * N), a = number(M * K), b = number(K * N),
               c = number(M * N);
  return {{normal({M, K}), normal({N, K}, 2)},
          [](const Vars& v) { return matmul(v[0], v[1], false, true); },
          {flop, bytes_of(a + b + c)},
          {3 * flop, bytes_of(3 * a + 3 * b + 2 * c)}};
}

/// Arguments: heads, tokens, channels of a head. Backward makes the weights again: 7 products to 2.
OpCase attention_case(const benchmark::State& s) {
  const Index H = s.range(0), N = s.range(1), d = s.range(2);
  const double flop = 4 * number(H * N * N * d), map = number(H * N * d);
  return {{normal({H, N, d}), normal({H, N, d}, 2), normal({H, N, d}, 3)},
          [](const Vars& v) { return attention(v[0], v[1], v[2]); },
          {flop, bytes_of(4 * map)},
          {3.5 * flop, bytes_of(12 * map)}};
}

/// One height of the search for the range. Argument: side of the images. Counted are the two of them,
/// what of them is valid, and the result.
void correlate_windows(benchmark::State& state) {
  const Index side = state.range(0);
  const MaskedGrey a{normal({side, side}).value(), Tensor({side, side}, 1.F)},
      b{normal({side, side}, 2).value(), Tensor({side, side}, 1.F)};
  Quadratic map;
  map.coeff[0] = {3.3, 1, 0.01, 0.1};
  map.coeff[1] = {-2.4, 0, 0.99, 0.2};
  time_row(state, {.bytes = bytes_of(5 * number(side * side))}, [&] {
    benchmark::DoNotOptimize(window_correlation(a, b, map, {0, 0, side, side}, 5).data());
  });
}

}  // namespace

void add_op_rows() {
  const std::vector<std::string> volume_names{"C", "D", "side"};
  const Shapes volumes{{8, 64, 64}, {8, 32, 128}, {8, 8, 256}, {32, 3, 256}};
  add_op("group_norm", volume_names, volumes, group_norm_case<Activation::none>);
  add_op("group_norm_relu", volume_names, volumes, group_norm_case<Activation::relu>);
  add_op("group_norm_gelu", volume_names, volumes, group_norm_case<Activation::gelu>);
  add_pointwise_rows();
  add_layout_rows();
  add_softmax_rows();
  add_op("plane_sweep_variance", volume_names,
         {{32, 64, 64}, {32, 48, 64}, {16, 32, 128}, {8, 8, 256}}, plane_sweep_case);
  add_op("plane_sweep_pairs", volume_names,
         {{32, 64, 64}, {16, 32, 128}, {8, 8, 256}, {8, 8, 1024}}, paired_sweep_case);
  add_op("attention", {"heads", "tokens", "width"}, {{6, 1370, 64}}, attention_case);
  add_op("matmul", {"M", "K", "N"},
         {{1369, 384, 1536}, {1369, 1536, 384}, {1370, 384, 1152}, {16384, 64, 64}}, matmul_case);
  benchmark::RegisterBenchmark("window_correlation", correlate_windows)->ArgName("side")->Arg(256);
}

}  // namespace satsurf::bench
