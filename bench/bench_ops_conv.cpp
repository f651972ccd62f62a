// SPDX-License-Identifier: Apache-2.0
#include "satsurf/bench/bench.h"
#include "satsurf/ops/conv/conv.h"

/// Convolutions at the network's shapes.
namespace satsurf::bench {
namespace {

/// The forward pass, and the forward pass with both gradients: the data gradient reads the output's
/// gradient and writes the input's, the weight gradient reads the input again.
OpCase conv_case(std::vector<Var> inputs, std::function<Var(const std::vector<Var>&)> op,
                 Index multiply_adds, Index outputs) {
  const double flop = 2 * number(multiply_adds), x = number(inputs[0].count()), y = number(outputs),
               w = number(inputs[1].count());
  return {std::move(inputs),
          std::move(op),
          {flop, bytes_of(x + y + w)},
          {3 * flop, bytes_of(3 * x + 2 * y + 3 * w)}};
}

/// Arguments: images, input channels, output channels, side, kernel, stride.
OpCase conv2d_case(const benchmark::State& s) {
  const Index B = s.range(0), C = s.range(1), O = s.range(2), S = s.range(3), K = s.range(4),
              stride = s.range(5), P = (K - 1) / 2, side = (S + 2 * P - K) / stride + 1,
              outputs = B * O * side * side;
  return conv_case(
      {normal({B, C, S, S}), normal({O, C, K, K}, 2), normal({O}, 3)},
      [=](const std::vector<Var>& v) {
        return conv2d(v[0], v[1], v[2], {.stride = {stride, stride}, .padding = {P, P}});
      },
      outputs * C * K * K, outputs);
}

/// Arguments: images, input channels, output channels, depth, side, stride.
OpCase conv3d_case(const benchmark::State& s) {
  const Index B = s.range(0), C = s.range(1), O = s.range(2), D = s.range(3), S = s.range(4),
              stride = s.range(5), outputs = B * O * (D / stride) * (S / stride) * (S / stride);
  return conv_case(
      {normal({B, C, D, S, S}), normal({O, C, 3, 3, 3}, 2)},
      [=](const std::vector<Var>& v) {
        return conv3d(v[0], v[1], Var(),
                      {.stride = {stride, stride, stride}, .padding = {1, 1, 1}});
      },
      outputs * C * 27, outputs);
}

/// Arguments: images, input channels, output channels, depth, side; doubles every axis.
OpCase conv_transpose3d_case(const benchmark::State& s) {
  const Index B = s.range(0), C = s.range(1), O = s.range(2), D = s.range(3), S = s.range(4);
  return conv_case(
      {normal({B, C, D, S, S}), normal({C, O, 3, 3, 3}, 2)},
      [](const std::vector<Var>& v) {
        return conv_transpose3d(
            v[0], v[1], Var(),
            {.stride = {2, 2, 2}, .padding = {1, 1, 1}, .output_padding = {1, 1, 1}});
      },
      B * C * O * 27 * D * S * S, B * O * 8 * D * S * S);
}

}  // namespace

void add_conv_rows() {
  add_op("conv3d", {"B", "C", "O", "D", "side", "s"},
         {{1, 8, 8, 48, 64, 1},   {1, 8, 8, 32, 128, 1},  {1, 8, 8, 8, 256, 1},
          {1, 32, 8, 48, 64, 1},  {1, 32, 8, 64, 64, 1},  {1, 16, 8, 32, 128, 1},
          {1, 37, 8, 80, 132, 1}, {1, 21, 8, 32, 264, 1}, {1, 13, 8, 8, 528, 1},
          {1, 8, 1, 48, 64, 1},   {1, 8, 1, 64, 64, 1},   {1, 16, 16, 24, 32, 1},
          {1, 32, 32, 12, 16, 1}, {1, 64, 64, 6, 8, 1},   {1, 8, 16, 48, 64, 2},
          {1, 8, 16, 32, 128, 2}, {1, 8, 16, 32, 264, 2}, {1, 8, 16, 8, 256, 2},
          {1, 16, 32, 24, 32, 2}, {1, 32, 64, 12, 16, 2}},
         conv3d_case);
  add_op("conv_transpose3d", {"B", "C", "O", "D", "side"},
         {{1, 64, 32, 6, 8},
          {1, 32, 16, 12, 16},
          {1, 16, 8, 24, 32},
          {1, 16, 8, 16, 64},
          {1, 16, 8, 4, 128}},
         conv_transpose3d_case);
  add_op("conv2d", {"B", "C", "O", "side", "k", "s"},
         {{3, 8, 8, 1024, 3, 1},  {3, 16, 16, 512, 3, 1}, {3, 32, 32, 256, 3, 1},
          {3, 3, 8, 256, 3, 1},   {3, 8, 8, 256, 3, 1},   {3, 16, 16, 128, 3, 1},
          {3, 32, 32, 64, 3, 1},  {3, 8, 16, 256, 4, 2},  {3, 16, 32, 128, 4, 2},
          {3, 64, 64, 128, 1, 1}, {3, 32, 32, 64, 1, 1},  {3, 8, 32, 256, 1, 1},
          {3, 32, 16, 128, 3, 1}, {3, 32, 8, 256, 3, 1},  {3, 100, 64, 64, 3, 1},
          {3, 64, 64, 64, 3, 1},  {3, 52, 48, 128, 3, 1}, {3, 48, 48, 128, 3, 1},
          {3, 20, 32, 256, 3, 1}, {3, 32, 10, 256, 1, 1}},
         conv2d_case);
}

}  // namespace satsurf::bench
