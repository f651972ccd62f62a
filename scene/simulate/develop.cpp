// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/develop.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/scene/simulate/noise.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace satsurf::scene::simulate {
namespace {

constexpr Colour kLuminance{0.34f, 0.36f, 0.30f};  // of the panchromatic band
constexpr float kWhite = 1.0f;

// The tone curve as a table: 2^16 steps leave less than two of 256 levels between the first two.
class Curve {
 public:
  explicit Curve(float gamma) : levels_(kSteps + 1) {
    for (std::size_t k = 0; k <= kSteps; ++k) {
      levels_[k] = std::round(
          255.0f * std::pow(static_cast<float>(k) / static_cast<float>(kSteps), 1.0f / gamma));
    }
  }
  float operator()(float value) const {
    const float v = std::clamp(value, 0.0f, 1.0f) * static_cast<float>(kSteps);
    return levels_[static_cast<std::size_t>(v + 0.5f)];
  }

 private:
  static constexpr std::size_t kSteps = 65535;
  std::vector<float> levels_;
};

// Light beyond white spills into the pixels around.
void spill(Tensor& value, float share) {
  const Index C = value.dim(0), H = value.dim(1), W = value.dim(2), P = H * W;
  Tensor beyond({1, H, W});
  for (Index k = 0; k < P; ++k) {
    float sum = 0;
    for (Index b = 0; b < C; ++b) sum += std::max(0.0f, value[b * P + k] - kWhite);
    // What is far beyond white, a glint, fills the well and no more.
    beyond[k] = std::min(sum / static_cast<float>(C), 1.5f);
  }
  const Tensor spilt = blurred(beyond, 1.2f);
  for (Index b = 0; b < C; ++b) {
    for (Index k = 0; k < P; ++k) value[b * P + k] += share * spilt[k];
  }
}

void sharpen(Tensor& value, float strength) {
  const Tensor smooth = blurred(value, 1.1f);
  // The filter of a ground segment works on pixels that have saturated already.
  for (Index k = 0; k < value.count(); ++k) {
    const float v = std::clamp(value[k], 0.0f, kWhite);
    value[k] = v + strength * (v - std::clamp(smooth[k], 0.0f, kWhite));
  }
}

}  // namespace

Tensor develop(const Tensor& radiance, const Development& how) {
  Dims dim("develop");
  dim.match("radiance", radiance, "3 H W");
  const Index H = dim["H"], W = dim["W"], P = H * W;
  const Tensor seen = blurred(radiance, how.psf_sigma, how.smear);

  // One stretch for all bands, so that colours stay as they are, by quantiles of the brightness.
  auto grey = Tensor::uninitialised({1, H, W});
  const auto band = [&](std::size_t b, Index k) {
    return (seen[static_cast<Index>(b) * P + k] + how.haze[b]) * how.tint[b];
  };
  for (Index k = 0; k < P; ++k)
    grey[k] = kLuminance[0] * band(0, k) + kLuminance[1] * band(1, k) + kLuminance[2] * band(2, k);
  std::vector<float> sorted(grey.data(), grey.data() + P);
  const auto quantile = [&](double q) {
    const auto at = sorted.begin() + static_cast<std::ptrdiff_t>(q * static_cast<double>(P - 1));
    std::nth_element(sorted.begin(), at, sorted.end());
    return *at;
  };
  const float low = std::min(quantile(0.01), how.most_dark),
              high = std::max({quantile(1.0 - static_cast<double>(how.saturated)), how.least_bright,
                               low + 1e-4f});
  const float dark = std::pow(how.dark, how.gamma), bright = std::pow(how.bright, how.gamma);
  const float gain = (bright - dark) / (high - low), offset = dark - gain * low;

  // Shot noise grows with the root of the signal; the floor is what the detector adds itself.
  const auto detected = [&](float raw, Index k, std::uint32_t channel) {
    const std::uint32_t h = hash(static_cast<std::int32_t>(k / W), static_cast<std::int32_t>(k % W),
                                 how.seed + channel);
    const float value = gain * raw + offset;
    return value + how.noise * std::sqrt(0.15f + std::max(0.0f, value)) * bell(h);
  };
  const bool wants_bands = !how.panchromatic, wants_grey = how.panchromatic || how.pan_sharpened;
  Tensor bands, luminance;
  if (wants_bands) bands = Tensor::uninitialised({3, H, W});
  if (wants_grey) luminance = Tensor::uninitialised({1, H, W});
  for_range(H, 16, [&](Index begin, Index end) {
    for (Index k = begin * W; k < end * W; ++k) {
      for (std::size_t b = 0; wants_bands && b < 3; ++b) {
        bands[static_cast<Index>(b) * P + k] =
            detected(band(b, k), k, static_cast<std::uint32_t>(b));
      }
      if (wants_grey) luminance[k] = detected(grey[k], k, 3);
    }
  });
  for (Tensor* t : {&bands, &luminance}) {
    if (!t->empty() && how.bloom > 0) spill(*t, how.bloom);
  }
  Tensor& sharp = wants_grey ? luminance : bands;
  if (how.halo > 0) sharpen(sharp, how.halo);
  Tensor levels = how.panchromatic    ? luminance
                  : how.pan_sharpened ? pan_sharpened(bands, luminance, how.colour_shift)
                                      : bands;
  const Curve curve(how.gamma);
  for_range(levels.dim(0) * H, 16, [&](Index begin, Index end) {
    for (Index k = begin * W; k < end * W; ++k) levels[k] = curve(levels[k]);
  });
  if (how.block_quality > 0) quantise_blocks(levels, how.block_quality);

  auto out = Tensor::uninitialised({3, H, W});
  for (Index k = 0; k < 3 * P; ++k) out[k] = levels[how.panchromatic ? k % P : k] * (1.0f / 255.0f);
  return out;
}

}  // namespace satsurf::scene::simulate
