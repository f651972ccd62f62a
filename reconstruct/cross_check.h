// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/input.h"

#include <cstddef>

namespace satsurf::reconstruct {

/// Looks up what the views of a window say of one another's points.
class CrossCheck {
 public:
  /// Keeps references to both, which must outlive this object.
  /// input    the window of N views, H x W px
  /// heights  [N H W] height of every pixel, local m
  CrossCheck(const nn::NetworkInput& input, const Tensor& heights);
  CrossCheck(const nn::NetworkInput& input, Tensor&& heights) = delete;

  /// Pixel of view j on which the point at height z of pixel p in view i falls; -1 where that is
  /// outside or not valid.
  Index landing(std::size_t i, std::size_t j, Index p, double z) const;
  /// The height that view j found in its pixel p, local m.
  double height(std::size_t j, Index p) const {
    return static_cast<double>(heights_[static_cast<Index>(j) * H_ * W_ + p]);
  }

 private:
  const nn::NetworkInput& input_;
  const Tensor& heights_;
  Index H_, W_;
};

}  // namespace satsurf::reconstruct
