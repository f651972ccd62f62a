// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/ops/normalised.h"

#include <array>

namespace satsurf {

/// Of a 2D convolution, in rows and columns.
struct Conv2dOptions {
  std::array<Index, 2> stride{1, 1};
  std::array<Index, 2> padding{0, 0};  ///< zeros on either side
};

/// Of a 3D convolution, in hypotheses, rows and columns.
struct Conv3dOptions {
  std::array<Index, 3> stride{1, 1, 1};
  std::array<Index, 3> padding{0, 0, 0};  ///< zeros on either side
};

/// Of a transposed 3D convolution, in hypotheses, rows and columns.
struct ConvTranspose3dOptions {
  std::array<Index, 3> stride{1, 1, 1};
  std::array<Index, 3> padding{0, 0, 0};         ///< cut off the result on either side
  std::array<Index, 3> output_padding{0, 0, 0};  ///< further outputs behind the last
};

/// 2D cross-correlation:
///   out[b,o,y,x] = bias[o] + sum_{c,i,j} weight[o,c,i,j] x[b,c,y*sy+i-py,x*sx+j-px]
/// x        [B C H W]; padding is zero whatever normalisation makes of zeros
/// weight   [O C KH KW]
/// bias     [O], or an empty Var for none
/// moments  takes those of the result's channels, gathered while they are in the cache
/// returns  [B O H' W'] with H' = (H + 2 py - KH) / sy + 1 (floor), likewise W'
/// throws   ShapeError
template <class T>
BasicVar<T> conv2d(const Normalised<T>& x, const BasicVar<T>& weight, const BasicVar<T>& bias,
                   const Conv2dOptions& options = {}, ChannelMoments* moments = nullptr);
template <class T>
BasicVar<T> conv2d(const BasicVar<T>& x, const BasicVar<T>& weight, const BasicVar<T>& bias,
                   const Conv2dOptions& options = {}, ChannelMoments* moments = nullptr) {
  return conv2d(Normalised<T>(x), weight, bias, options, moments);
}

/// 3D cross-correlation, as conv2d with one more axis in front of the rows.
/// x        [B C D H W]
/// weight   [O C KD KH KW]
/// bias     [O], or an empty Var for none
/// returns  [B O D' H' W']
/// throws   ShapeError
template <class T>
BasicVar<T> conv3d(const Normalised<T>& x, const BasicVar<T>& weight, const BasicVar<T>& bias,
                   const Conv3dOptions& options = {}, ChannelMoments* moments = nullptr);
template <class T>
BasicVar<T> conv3d(const BasicVar<T>& x, const BasicVar<T>& weight, const BasicVar<T>& bias,
                   const Conv3dOptions& options = {}, ChannelMoments* moments = nullptr) {
  return conv3d(Normalised<T>(x), weight, bias, options, moments);
}

/// Rows of a conv3d with stride 1, written into a larger tensor; nothing goes on the tape.
/// x        [1 C D H W]
/// weight   [O C KD KH KW]
/// padding  as in Conv3dOptions
/// out      [1 O D' R W'] with D' and W' as in conv3d, whose rows first_row and following are
///          overwritten, as many as the H' of conv3d
/// moments  takes those of the rows' channels
/// throws   ShapeError, also where the rows are not within out
template <class T>
void conv3d_rows(const Normalised<T>& x, const BasicVar<T>& weight,
                 const std::array<Index, 3>& padding, BasicTensor<T>& out, Index first_row,
                 ChannelMoments* moments = nullptr);

/// Transposed 3D convolution: the data gradient of conv3d with the same options, as a forward op.
/// x        [B C D H W]
/// weight   [C O KD KH KW]
/// bias     [O], or an empty Var for none
/// returns  [B O D' H' W'] with D' = (D - 1) s - 2 p + KD + output_padding, likewise H' and W'
/// throws   ShapeError
template <class T>
BasicVar<T> conv_transpose3d(const Normalised<T>& x, const BasicVar<T>& weight,
                             const BasicVar<T>& bias, const ConvTranspose3dOptions& options = {},
                             ChannelMoments* moments = nullptr);
template <class T>
BasicVar<T> conv_transpose3d(const BasicVar<T>& x, const BasicVar<T>& weight,
                             const BasicVar<T>& bias, const ConvTranspose3dOptions& options = {},
                             ChannelMoments* moments = nullptr) {
  return conv_transpose3d(Normalised<T>(x), weight, bias, options, moments);
}

}  // namespace satsurf
