// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/module.h"
#include "satsurf/ops/conv/conv.h"
#include "satsurf/ops/norm.h"

#include <string>

namespace satsurf::nn {

/// Groups of a GroupNorm over `channels`: groups of about four channels, at most eight of them.
Index norm_groups(Index channels);

// Blocks take and return values whose normalisation is left to the next reader
// (ops/normalised.h): between two convolutions no tensor but the convolution's own is made.

/// 2D convolution with bias, of maps [B C H W]. Padding keeps (stride 1) or divides (stride s) the
/// size.
template <class T>
struct Conv2d {
  BasicVar<T> weight, bias;
  Conv2dOptions options;
  Conv2d(ParameterSet<T>& p, const std::string& name, Index in, Index out, Index kernel,
         Index stride = 1);
  BasicVar<T> operator()(const Normalised<T>& x) const { return conv2d(x, weight, bias, options); }
};

/// 2D convolution, GroupNorm and activation, on maps [B C H W].
template <class T>
struct ConvNorm2d {
  BasicVar<T> weight, gamma, beta;
  Conv2dOptions options;
  Activation activation;
  ConvNorm2d(ParameterSet<T>& p, const std::string& name, Index in, Index out, Index kernel,
             Index stride, Activation act);
  Normalised<T> operator()(const Normalised<T>& x) const { return apply(x, weight); }
  /// With other weights than its own, such as for further channels.
  Normalised<T> apply(const Normalised<T>& x, const BasicVar<T>& weights) const;
};

/// 3D convolution (3 x 3 x 3), GroupNorm and ReLU, on volumes [B C D H W].
template <class T>
struct ConvNorm3d {
  BasicVar<T> weight, gamma, beta;
  Conv3dOptions options;
  ConvNorm3d(ParameterSet<T>& p, const std::string& name, Index in, Index out, Index stride);
  Normalised<T> operator()(const Normalised<T>& x) const { return apply(x, weight); }
  /// With other weights than its own, such as for further channels.
  Normalised<T> apply(const Normalised<T>& x, const BasicVar<T>& weights) const;
  /// What follows the convolution, for who convolves in parts.
  /// y        the convolution's result
  /// moments  of its channels
  Normalised<T> finished(const BasicVar<T>& y, const ChannelMoments& moments) const;
};

/// Transposed 3D convolution that doubles every axis, GroupNorm and ReLU, on volumes [B C D H W].
template <class T>
struct UpNorm3d {
  BasicVar<T> weight, gamma, beta;
  UpNorm3d(ParameterSet<T>& p, const std::string& name, Index in, Index out);
  Normalised<T> operator()(const Normalised<T>& x) const;
};

}  // namespace satsurf::nn
