// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/lpips.h"

#include <optional>
#include <string>

namespace satsurf::evaluate {

/// How much one picture is like another. Values are clipped to [0, 1] first; a number that does not
/// exist is NaN.
struct ImageScores {
  double psnr = 0;              ///< dB, see `psnr` of evaluate/metrics.h; infinite for equal images
  double psnr_fitted = 0;       ///< the same after `fit_colours`
  double ssim = 0;              ///< SsimKind::skimage; NaN for images of less than 11 px
  double ssim_conv = 0;         ///< SsimKind::conv
  std::optional<double> lpips;  ///< none without a network; NaN where no pixel counts
  std::string lpips_backbone;   ///< its name; empty without a network
};

/// Scores in double but for LPIPS.
/// image, reference  [C H W]; LPIPS takes one channel for grey, else wants three
/// mask              [H W], zero where a pixel does not count; empty for all. SSIM and LPIPS see
///                   such pixels as black in both pictures
/// lpips             the network, or nullptr
/// throws            ShapeError
ImageScores score_images(const Tensor& image, const Tensor& reference, const Tensor& mask = {},
                         const nn::Lpips* lpips = nullptr);

}  // namespace satsurf::evaluate
