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
BasicVar<T> ConvNorm2d<T>::operator()(const BasicVar<T>& x) const {
  return group_norm(conv2d(x, weight, {}, options), gamma, beta, norm_groups(gamma.count()),
                    activation);
}

template <class T>
ConvNorm3d<T>::ConvNorm3d(ParameterSet<T>& p, const std::string& name, Index in, Index out,
                          Index stride)
    : weight(p.create(name + ".weight", {out, in, 3, 3, 3}, Init::kaiming(in * 27), true)),
      gamma(ones(p, name + ".gamma", out)),
      beta(zeros(p, name + ".beta", out)),
      options{{stride, stride, stride}, {1, 1, 1}} {}

template <class T>
BasicVar<T> ConvNorm3d<T>::operator()(const BasicVar<T>& x) const {
  return group_norm(conv3d(x, weight, {}, options), gamma, beta, norm_groups(gamma.count()),
                    Activation::relu);
}

template <class T>
UpNorm3d<T>::UpNorm3d(ParameterSet<T>& p, const std::string& name, Index in, Index out)
    // Each output sees 27 / 8 taps per input channel on average.
    : weight(
          p.create(name + ".weight", {in, out, 3, 3, 3}, Init::kaiming((in * 27 + 7) / 8), true)),
      gamma(ones(p, name + ".gamma", out)),
      beta(zeros(p, name + ".beta", out)) {}

template <class T>
BasicVar<T> UpNorm3d<T>::operator()(const BasicVar<T>& x) const {
  const ConvTranspose3dOptions doubling{{2, 2, 2}, {1, 1, 1}, {1, 1, 1}};
  return group_norm(conv_transpose3d(x, weight, {}, doubling), gamma, beta,
                    norm_groups(gamma.count()), Activation::relu);
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
