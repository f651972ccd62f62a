// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/scene/simulate/noise.h"
#include "satsurf/scene/simulate/render.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace satsurf::scene::simulate {
namespace {

// Separable Gaussian, edges repeated.
Tensor blurred(const Tensor& image, float sigma) {
  if (sigma <= 0) return image.clone();
  const Index C = image.dim(0), H = image.dim(1), W = image.dim(2);
  const auto reach = static_cast<Index>(std::ceil(3 * sigma));
  std::vector<float> kernel;
  float total = 0;
  for (Index k = -reach; k <= reach; ++k) {
    const float t = static_cast<float>(k) / sigma;
    kernel.push_back(std::exp(-0.5f * t * t));
    total += kernel.back();
  }
  for (float& w : kernel) w /= total;
  auto rows = Tensor::uninitialised(image.shape()), out = Tensor::uninitialised(image.shape());
  for_range(C * H, 32, [&](Index begin, Index end) {
    for (Index r = begin; r < end; ++r) {
      for (Index j = 0; j < W; ++j) {
        float sum = 0;
        for (Index k = -reach; k <= reach; ++k) {
          sum += kernel[static_cast<std::size_t>(k + reach)] *
                 image[r * W + std::clamp(j + k, Index{0}, W - 1)];
        }
        rows[r * W + j] = sum;
      }
    }
  });
  for_range(C * H, 32, [&](Index begin, Index end) {
    for (Index r = begin; r < end; ++r) {
      const Index c = r / H, i = r % H;
      float* o = out.data() + r * W;
      std::fill(o, o + W, 0.0f);
      for (Index k = -reach; k <= reach; ++k) {
        const float* in = rows.data() + (c * H + std::clamp(i + k, Index{0}, H - 1)) * W;
        const float w = kernel[static_cast<std::size_t>(k + reach)];
        for (Index j = 0; j < W; ++j) o[j] += w * in[j];
      }
    }
  });
  return out;
}

}  // namespace

Tensor develop(const Tensor& radiance, const Development& how) {
  Dims dim("develop");
  dim.match("radiance", radiance, "3 H W");
  const Index H = dim["H"], W = dim["W"], P = H * W;
  const Tensor seen = blurred(radiance, how.psf_sigma);

  // One stretch for all bands, so that colours stay as they are, by quantiles of the brightness.
  std::vector<float> grey(static_cast<std::size_t>(P));
  for (Index k = 0; k < P; ++k) {
    grey[static_cast<std::size_t>(k)] =
        0.34f * seen[k] + 0.36f * seen[P + k] + 0.30f * seen[2 * P + k] + how.haze;
  }
  std::vector<float> sorted = grey;
  const auto quantile = [&](double q) {
    const auto at = sorted.begin() + static_cast<std::ptrdiff_t>(q * static_cast<double>(P - 1));
    std::nth_element(sorted.begin(), at, sorted.end());
    return *at;
  };
  const float low = quantile(0.01), high = std::max(quantile(0.99), low + 1e-4f);
  const float dark = std::pow(how.dark, how.gamma), bright = std::pow(how.bright, how.gamma);
  const float gain = (bright - dark) / (high - low), offset = dark - gain * low;

  auto out = Tensor::uninitialised({3, H, W});
  for_range(H, 16, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      for (Index j = 0; j < W; ++j) {
        const Index k = i * W + j;
        for (Index b = 0; b < (how.panchromatic ? 1 : 3); ++b) {
          const float raw = how.panchromatic ? grey[static_cast<std::size_t>(k)]
                                             : (seen[b * P + k] + how.haze) *
                                                   how.tint[static_cast<std::size_t>(b)];
          float value = std::max(0.0f, gain * raw + offset);
          // Shot noise grows with the root of the signal; the floor is what the detector adds
          // itself.
          const std::uint32_t h = hash(static_cast<std::int32_t>(i), static_cast<std::int32_t>(j),
                                       how.seed + static_cast<std::uint32_t>(b));
          value += how.noise * std::sqrt(0.15f + value) * bell(h);
          value = std::pow(std::clamp(value, 0.0f, 1.0f), 1.0f / how.gamma);
          out[b * P + k] = std::round(255.0f * value) * (1.0f / 255.0f);
        }
        if (how.panchromatic) out[P + k] = out[2 * P + k] = out[k];
      }
    }
  });
  return out;
}

}  // namespace satsurf::scene::simulate
