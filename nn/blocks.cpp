// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/blocks.h"

namespace satsurf::nn {
namespace {

/// Even kernels (4, stride 2) are padded by (k - s) / 2 = 1: output pixels then sit exactly at the
/// centres of 2 x 2 blocks. Odd kernels keep the centre.
Index same_padding(Index kernel, Index stride) {
  return kernel % 2 == 0 ? (kernel - stride) / 2 : kernel / 2;
}

template <class T>
BasicVar<T> ones(ParameterSet<T>& p, const std::string& name, Index n) {
  return p.create(name, {n}, Init::constant(1), false);
}

template <class T>
BasicVar<T> zeros(ParameterSet<T>& p, const std::string& name, Index n) {
  return p.create(name, {n}, Init::constant(0), false);
}

/// GroupNorm of a convolution's result, with the moments the convolution gathered.
template <class T>
Normalised<T> normalised(const BasicVar<T>& x, const BasicVar<T>& gamma, const BasicVar<T>& beta,
                         Activation activation, const ChannelMoments& moments) {
  return group_normalised(x, gamma, beta, norm_groups(gamma.count()), activation, T(1e-5),
                          &moments);
}

}  // namespace

Index norm_groups(Index channels) {
  Index groups = channels >= 32 ? 8 : channels / 4;
  if (groups < 1) groups = 1;
  while (channels % groups != 0) --groups;
  return groups;
}

template <class T>
Conv2d<T>::Conv2d(ParameterSet<T>& p, const std::string& name, Index in, Index out, Index kernel,
                  Index stride)
    : weight(p.create(name + ".weight", {out, in, kernel, kernel},
                      Init::kaiming(in * kernel * kernel), true)),
      bias(zeros(p, name + ".bias", out)),
      options{{stride, stride}, {same_padding(kernel, stride), same_padding(kernel, stride)}} {}

template <class T>
ConvNorm2d<T>::ConvNorm2d(ParameterSet<T>& p, const std::string& name, Index in, Index out,
                          Index kernel, Index stride, Activation act)
    : weight(p.create(name + ".weight", {out, in, kernel, kernel},
                      Init::kaiming(in * kernel * kernel), true)),
      gamma(ones(p, name + ".gamma", out)),
      beta(zeros(p, name + ".beta", out)),
      options{{stride, stride}, {same_padding(kernel, stride), same_padding(kernel, stride)}},
      activation(act) {}

template <class T>
Normalised<T> ConvNorm2d<T>::apply(const Normalised<T>& x, const BasicVar<T>& weights) const {
  ChannelMoments moments;
  const auto y = conv2d(x, weights, {}, options, &moments);
  return normalised(y, gamma, beta, activation, moments);
}

template <class T>
ConvNorm3d<T>::ConvNorm3d(ParameterSet<T>& p, const std::string& name, Index in, Index out,
                          Index stride)
    : weight(p.create(name + ".weight", {out, in, 3, 3, 3}, Init::kaiming(in * 27), true)),
      gamma(ones(p, name + ".gamma", out)),
      beta(zeros(p, name + ".beta", out)),
      options{{stride, stride, stride}, {1, 1, 1}} {}

template <class T>
Normalised<T> ConvNorm3d<T>::apply(const Normalised<T>& x, const BasicVar<T>& weights) const {
  ChannelMoments moments;
  const auto y = conv3d(x, weights, {}, options, &moments);
  return finished(y, moments);
}

template <class T>
Normalised<T> ConvNorm3d<T>::finished(const BasicVar<T>& y, const ChannelMoments& moments) const {
  return normalised(y, gamma, beta, Activation::relu, moments);
}

template <class T>
UpNorm3d<T>::UpNorm3d(ParameterSet<T>& p, const std::string& name, Index in, Index out)
    // Each output sees 27 / 8 taps per input channel on average.
    : weight(
          p.create(name + ".weight", {in, out, 3, 3, 3}, Init::kaiming((in * 27 + 7) / 8), true)),
      gamma(ones(p, name + ".gamma", out)),
      beta(zeros(p, name + ".beta", out)) {}

template <class T>
Normalised<T> UpNorm3d<T>::operator()(const Normalised<T>& x) const {
  const ConvTranspose3dOptions doubling{{2, 2, 2}, {1, 1, 1}, {1, 1, 1}};
  ChannelMoments moments;
  const auto y = conv_transpose3d(x, weight, {}, doubling, &moments);
  return normalised(y, gamma, beta, Activation::relu, moments);
}

template struct Conv2d<float>;
template struct Conv2d<double>;
template struct ConvNorm2d<float>;
template struct ConvNorm2d<double>;
template struct ConvNorm3d<float>;
template struct ConvNorm3d<double>;
template struct UpNorm3d<float>;
template struct UpNorm3d<double>;

}  // namespace satsurf::nn
