// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/conv/conv.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/isa.h"
#include "satsurf/ops/conv/engine.h"

#include <string>

namespace satsurf {
namespace {

using conv::Geometry;

template <std::size_t N>
std::string text(const std::array<Index, N>& a) {
  std::string s;
  for (const Index i : a) s += (s.empty() ? "[" : ",") + std::to_string(i);
  return s + "]";
}

template <std::size_t N>
void check_options(const char* where, const std::array<Index, N>& stride,
                   const std::array<Index, N>& padding) {
  for (std::size_t a = 0; a < N; ++a) {
    if (stride[a] < 1)
      throw ShapeError(std::string(where) + ": stride " + text(stride) + ", expected 1 or more");
    if (padding[a] < 0)
      throw ShapeError(std::string(where) + ": padding " + text(padding) + ", expected 0 or more");
  }
}

void check_kernel(const char* where, const Shape& weight) {
  if (weight.count() == 0)
    throw ShapeError(std::string(where) + ": weight has shape " + weight.str() +
                     ", expected no extent of 0");
}

/// Extent of y along each axis of a correlation, floor((x + 2 p - k) / s) + 1.
void set_y_size(const char* where, const Shape& x, const Shape& weight, Geometry& g) {
  for (std::size_t a = 0; a < 3; ++a) {
    const Index room = g.x_size[a] + 2 * g.padding[a] - g.kernel[a];
    if (room < 0)
      throw ShapeError(std::string(where) + ": x has shape " + x.str() + " and weight " +
                       weight.str() + ", expected a kernel no larger than the padded x");
    g.y_size[a] = room / g.stride[a] + 1;
  }
}

template <class T>
const T* data_or_null(const BasicVar<T>& v) {
  return v.empty() ? nullptr : v.value().data();
}

template <class T>
conv::Input<T> input_of(const Normalised<T>& v) {
  return {v.x.value().data(), data_or_null(v.affine), v.activation};
}

/// The same from the tape: inputs 0 and 1 of every convolution.
template <class T>
conv::Input<T> input_of(const Node<T>& n, Activation activation) {
  return {n.in(0), n.inputs[1] ? n.in(1) : nullptr, activation};
}

/// Gradients of x and its affine: `adjoint(target, accumulate)` computes that of the normalised x.
template <class T, class Adjoint>
void input_gradient(Node<T>& n, Activation activation, const Adjoint& adjoint) {
  const bool plain = n.inputs[1] == nullptr && activation == Activation::none;
  if (plain) {
    const GradientTarget<T> dx = n.grad_out(0);
    if (dx) adjoint(dx.data, dx.accumulate);
    return;
  }
  const auto wanted = [&](std::size_t i) { return n.inputs[i] && n.inputs[i]->wants_grad; };
  if (!wanted(0) && !wanted(1)) return;
  auto dz = BasicTensor<T>::uninitialised(n.inputs[0]->value.shape());
  adjoint(dz.data(), false);
  detail::normalised_backward(n, 0, activation, dz.data());
}

/// What conv2d and conv3d share once the shapes are checked.
template <class T>
BasicVar<T> correlation(const char* op, const Geometry& g, const Shape& shape,
                        const Normalised<T>& x, const BasicVar<T>& weight, const BasicVar<T>& bias,
                        ChannelMoments* moments) {
  auto out = BasicTensor<T>::uninitialised(shape);
  conv::correlate(active_kernels<ConvKernels<T>>(), g, input_of(x), weight.value().data(),
                  data_or_null(bias), out.data(), false, moments);

  const Activation activation = x.activation;
  return BasicVar<T>::record(op, out, {x.x, x.affine, weight, bias}, [g, activation](Node<T>& n) {
    const auto& kernels = active_kernels<ConvKernels<T>>();
    const T* dy = n.grad.data();
    input_gradient(n, activation, [&](T* dx, bool accumulate) {
      conv::correlate_adjoint<T>(kernels, g, {dy}, n.in(2), nullptr, dx, accumulate);
    });
    if (T* dw = n.grad_in(2))
      conv::correlate_weight_gradient<T>(kernels, g, input_of(n, activation), {dy}, dw);
    if (T* db = n.grad_in(3)) conv::bias_gradient(kernels, g.B, g.O, g.y_count(), dy, db);
  });
}

/// Of a 3D correlation, whose input and weight it checks.
template <class T>
Geometry volume_geometry(const char* op, Dims& dim, const Normalised<T>& x,
                         const BasicVar<T>& weight, const Conv3dOptions& options) {
  detail::check_normalised(op, x);
  dim.match("x", x.shape(), "B C D H W").match("weight", weight, "O C KD KH KW");
  check_options(op, options.stride, options.padding);
  check_kernel(op, weight.shape());
  Geometry g{.B = dim["B"],
             .C = dim["C"],
             .O = dim["O"],
             .x_size = {dim["D"], dim["H"], dim["W"]},
             .y_size = {},
             .kernel = {dim["KD"], dim["KH"], dim["KW"]},
             .stride = options.stride,
             .padding = options.padding};
  set_y_size(op, x.shape(), weight.shape(), g);
  return g;
}

}  // namespace

template <class T>
BasicVar<T> conv2d(const Normalised<T>& x, const BasicVar<T>& weight, const BasicVar<T>& bias,
                   const Conv2dOptions& options, ChannelMoments* moments) {
  detail::check_normalised("conv2d", x);
  Dims dim("conv2d");
  dim.match("x", x.shape(), "B C H W").match("weight", weight, "O C KH KW");
  if (!bias.empty()) dim.match("bias", bias, "O");
  check_options("conv2d", options.stride, options.padding);
  check_kernel("conv2d", weight.shape());

  Geometry g{.B = dim["B"],
             .C = dim["C"],
             .O = dim["O"],
             .x_size = {1, dim["H"], dim["W"]},
             .y_size = {},
             .kernel = {1, dim["KH"], dim["KW"]},
             .stride = {1, options.stride[0], options.stride[1]},
             .padding = {0, options.padding[0], options.padding[1]}};
  set_y_size("conv2d", x.shape(), weight.shape(), g);
  return correlation("conv2d", g, {g.B, g.O, g.y_size[1], g.y_size[2]}, x, weight, bias, moments);
}

template <class T>
BasicVar<T> conv3d(const Normalised<T>& x, const BasicVar<T>& weight, const BasicVar<T>& bias,
                   const Conv3dOptions& options, ChannelMoments* moments) {
  Dims dim("conv3d");
  const Geometry g = volume_geometry("conv3d", dim, x, weight, options);
  if (!bias.empty()) dim.match("bias", bias, "O");
  return correlation("conv3d", g, {g.B, g.O, g.y_size[0], g.y_size[1], g.y_size[2]}, x, weight,
                     bias, moments);
}

template <class T>
void conv3d_rows(const Normalised<T>& x, const BasicVar<T>& weight,
                 const std::array<Index, 3>& padding, BasicTensor<T>& out, Index first_row,
                 ChannelMoments* moments) {
  Dims dim("conv3d_rows");
  const Geometry g = volume_geometry("conv3d_rows", dim.match("x", x.shape(), "1 C D H W"), x,
                                     weight, {.padding = padding});
  const auto [D, H, W] = g.y_size;
  const Index rows = dim.match("out", out, "1 O OD OH OW")["OH"];
  if (out.shape() != Shape{1, g.O, D, rows, W} || first_row < 0 || first_row + H > rows)
    throw ShapeError("conv3d_rows: rows from " + std::to_string(first_row) +
                     " on in out of shape " + out.shape().str() + ", expected room for " +
                     Shape{1, g.O, D, H, W}.str());
  conv::correlate<T>(active_kernels<ConvKernels<T>>(), g, input_of(x), weight.value().data(),
                     nullptr, out.data() + first_row * W, false, moments, rows * W);
}

template <class T>
BasicVar<T> conv_transpose3d(const Normalised<T>& x, const BasicVar<T>& weight,
                             const BasicVar<T>& bias, const ConvTranspose3dOptions& options,
                             ChannelMoments* moments) {
  detail::check_normalised("conv_transpose3d", x);
  Dims dim("conv_transpose3d");
  dim.match("x", x.shape(), "B C D H W").match("weight", weight, "C O KD KH KW");
  if (!bias.empty()) dim.match("bias", bias, "O");
  check_options("conv_transpose3d", options.stride, options.padding);
  check_kernel("conv_transpose3d", weight.shape());
  for (std::size_t a = 0; a < 3; ++a)
    if (options.output_padding[a] < 0 || options.output_padding[a] >= options.stride[a])
      throw ShapeError("conv_transpose3d: output_padding " + text(options.output_padding) +
                       ", expected 0 or more and less than stride " + text(options.stride));

  // The roles of a correlation are swapped: its y is our input, its x our output.
  Geometry g{.B = dim["B"],
             .C = dim["O"],
             .O = dim["C"],
             .x_size = {},
             .y_size = {dim["D"], dim["H"], dim["W"]},
             .kernel = {dim["KD"], dim["KH"], dim["KW"]},
             .stride = options.stride,
             .padding = options.padding};
  for (std::size_t a = 0; a < 3; ++a) {
    g.x_size[a] = (g.y_size[a] - 1) * g.stride[a] - 2 * g.padding[a] + g.kernel[a] +
                  options.output_padding[a];
    if (g.x_size[a] < 1)
      throw ShapeError("conv_transpose3d: padding " + text(g.padding) + " leaves no output of x " +
                       x.shape().str() + " and weight " + weight.shape().str() +
                       ", expected at least one");
  }

  auto out = BasicTensor<T>::uninitialised({g.B, g.C, g.x_size[0], g.x_size[1], g.x_size[2]});
  conv::correlate_adjoint(active_kernels<ConvKernels<T>>(), g, input_of(x), weight.value().data(),
                          data_or_null(bias), out.data(), false, moments);

  const Activation activation = x.activation;
  return BasicVar<T>::record(
      "conv_transpose3d", out, {x.x, x.affine, weight, bias}, [g, activation](Node<T>& n) {
        const auto& kernels = active_kernels<ConvKernels<T>>();
        const T* dy = n.grad.data();
        input_gradient(n, activation, [&](T* dx, bool accumulate) {
          conv::correlate<T>(kernels, g, {dy}, n.in(2), nullptr, dx, accumulate);
        });
        if (T* dw = n.grad_in(2))
          conv::correlate_weight_gradient<T>(kernels, g, {dy}, input_of(n, activation), dw);
        if (T* db = n.grad_in(3)) conv::bias_gradient(kernels, g.B, g.C, g.x_count(), dy, db);
      });
}

template BasicVar<float> conv2d(const Normalised<float>&, const BasicVar<float>&,
                                const BasicVar<float>&, const Conv2dOptions&, ChannelMoments*);
template BasicVar<double> conv2d(const Normalised<double>&, const BasicVar<double>&,
                                 const BasicVar<double>&, const Conv2dOptions&, ChannelMoments*);
template BasicVar<float> conv3d(const Normalised<float>&, const BasicVar<float>&,
                                const BasicVar<float>&, const Conv3dOptions&, ChannelMoments*);
template BasicVar<double> conv3d(const Normalised<double>&, const BasicVar<double>&,
                                 const BasicVar<double>&, const Conv3dOptions&, ChannelMoments*);
template void conv3d_rows(const Normalised<float>&, const BasicVar<float>&,
                          const std::array<Index, 3>&, Tensor&, Index, ChannelMoments*);
template void conv3d_rows(const Normalised<double>&, const BasicVar<double>&,
                          const std::array<Index, 3>&, BasicTensor<double>&, Index,
                          ChannelMoments*);
template BasicVar<float> conv_transpose3d(const Normalised<float>&, const BasicVar<float>&,
                                          const BasicVar<float>&, const ConvTranspose3dOptions&,
                                          ChannelMoments*);
template BasicVar<double> conv_transpose3d(const Normalised<double>&, const BasicVar<double>&,
                                           const BasicVar<double>&, const ConvTranspose3dOptions&,
                                           ChannelMoments*);

}  // namespace satsurf
