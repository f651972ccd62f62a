// SPDX-License-Identifier: Apache-2.0
#include "satsurf/evaluate/image_metrics.h"

#include "satsurf/core/dims.h"
#include "satsurf/evaluate/metrics.h"
#include "satsurf/ops/ssim.h"

#include <algorithm>
#include <limits>

namespace satsurf::evaluate {
namespace {

/// Values within 0 and 1; pictures of whole numbers have no others.
Tensor clipped(const Tensor& image) {
  if (std::ranges::all_of(image.values(), [](float v) { return v >= 0 && v <= 1; })) return image;
  Tensor out = image.clone();
  for (float& v : out.values()) v = std::clamp(v, 0.f, 1.f);
  return out;
}

/// Grey as three equal channels.
Tensor colours(const Tensor& image) {
  if (image.dim(0) != 1) return image;
  auto out = Tensor::uninitialised(image.shape().with(0, 3));
  for (Index c = 0; c < 3; ++c)
    std::copy_n(image.data(), image.count(), out.data() + c * image.count());
  return out;
}

/// Whether any pixel counts that is `border` px from the image's borders.
bool any_counts(const Tensor& mask, Index H, Index W, Index border) {
  if (H <= 2 * border || W <= 2 * border) return false;
  if (mask.empty()) return true;
  for (Index i = border; i < H - border; ++i)
    for (Index j = border; j < W - border; ++j)
      if (mask[i * W + j] != 0) return true;
  return false;
}

}  // namespace

ImageScores score_images(const Tensor& image, const Tensor& reference, const Tensor& mask,
                         const nn::Lpips* lpips) {
  Dims dim("score_images");
  dim.match("image", image, "C H W").match("reference", reference, "C H W");
  if (!mask.empty()) dim.match("mask", mask, "H W");
  const Index H = dim["H"], W = dim["W"];
  const Tensor a = clipped(image), b = clipped(reference);

  const NoGrad no_grad;
  ImageScores scores;
  scores.psnr = psnr(a, b, mask);
  scores.psnr_fitted = psnr(fit_colours(a, b, mask), b, mask);
  const auto similarity = [&](SsimKind kind, Index border) {
    return any_counts(mask, H, W, border) ? ssim_score(a, b, kind, mask)
                                          : std::numeric_limits<double>::quiet_NaN();
  };
  constexpr Index kBorder = 5;  // what SsimKind::skimage leaves out
  scores.ssim = similarity(SsimKind::skimage, kBorder);
  scores.ssim_conv = similarity(SsimKind::conv, 0);
  if (lpips != nullptr) {
    // two pictures that are black all over are no evidence
    scores.lpips =
        any_counts(mask, H, W, 0)
            ? static_cast<double>((*lpips)(Var(colours(a)), colours(b), mask).value().item())
            : std::numeric_limits<double>::quiet_NaN();
    scores.lpips_backbone = nn::lpips_backbone_name(lpips->backbone());
  }
  return scores;
}

}  // namespace satsurf::evaluate
