// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"
#include "satsurf/scene/simulate/city.h"

#include <cstdint>

namespace satsurf::scene::simulate {

/// What atmosphere, instrument and ground segment do to radiance.
struct Development {
  Colour haze{0.02f, 0.02f, 0.02f};  ///< airlight of each band, radiance
  Colour tint{1, 1, 1};              ///< gain of each band
  float psf_sigma = 0.5f;            ///< px
  float smear = 0;                   ///< how far a line moves while it is exposed, px
  float noise = 0.008f;              ///< deviation at full scale, as a share of it
  float dark = 0.05f;                ///< where the 1 % quantile of the brightness is put
  float bright = 1.0f;               ///< where the quantile of `saturated` is put
  float saturated = 0.01f;           ///< share of the pixels brighter than `bright`
  /// Radiances within which the stretch never stays: a crop where all is dark, or all bright, keeps
  /// the tones it has in its strip.
  float most_dark = 1e9f, least_bright = 0;
  float bloom = 0;  ///< share of the light beyond white that spills, over 1 to 2 px
  float gamma = 1.8f;
  /// Luminance in full, colour at a quarter of the resolution, set apart by `colour_shift` px.
  bool pan_sharpened = false;
  std::array<float, 2> colour_shift{};
  float halo = 0;             ///< strength of the sharpening, 0 for none
  int block_quality = 0;      ///< of a JPEG-like quantisation of 8 x 8 blocks, 1 to 100; 0 for none
  bool panchromatic = false;  ///< luminance in all three channels
  std::uint32_t seed = 0;
};
/// Radiance to an image of 256 levels.
/// radiance  [3 H W], linear
/// returns   [3 H W] in [0, 1]
Tensor develop(const Tensor& radiance, const Development& how);

/// Separable blur, edges repeated: a Gaussian, and along the columns a box as well.
/// image    [C H W]
/// sigma    of the Gaussian, px; 0 for none
/// box      its length along the columns, px; 0 for none
/// returns  [C H W]
Tensor blurred(const Tensor& image, float sigma, float box = 0);

/// Colours at a quarter of the resolution under a luminance in full: every band times the ratio of
/// the luminance to its own quarter.
/// Source: Gillespie et al. 1987, the Brovey transform.
/// bands      [3 H W]
/// luminance  [1 H W]
/// shift      of the colours against the luminance, px, columns and rows
/// returns    [3 H W]
Tensor pan_sharpened(const Tensor& bands, const Tensor& luminance, std::array<float, 2> shift);

/// Rounds the cosine coefficients of blocks of 8 x 8 pixels as JPEG does, without subsampling.
/// Source: ITU-T T.81, Annex K; scaling of its tables by quality as the Independent JPEG Group's.
/// levels   [C H W] in [0, 255], C = 1 or 3
/// quality  1 to 100
void quantise_blocks(Tensor& levels, int quality);

}  // namespace satsurf::scene::simulate
