// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/scene/simulate/develop.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

namespace satsurf::scene::simulate {
namespace {

constexpr Index kBlock = 8;    // side of a JPEG block
constexpr Index kQuarter = 4;  // pixels of the luminance in one of the colours

// A Gaussian, integrated over a box of the given length, sampled at whole pixels.
std::vector<float> kernel_of(float sigma, float box) {
  const auto reach = static_cast<Index>(std::ceil(3 * sigma + 0.5f * box));
  std::vector<float> kernel;
  float total = 0;
  constexpr int kSteps = 9;  // samples of the box
  for (Index k = -reach; k <= reach; ++k) {
    float sum = 0;
    for (int n = 0; n < kSteps; ++n) {
      const float offset = box * ((static_cast<float>(n) + 0.5f) / kSteps - 0.5f);
      const float t = (static_cast<float>(k) - offset) / std::max(sigma, 0.25f);
      sum += std::exp(-0.5f * t * t);
    }
    kernel.push_back(sum);
    total += sum;
  }
  for (float& w : kernel) w /= total;
  return kernel;
}

// Mean of every 4 x 4 pixels.
Tensor quartered(const Tensor& image) {
  const Index C = image.dim(0), H = image.dim(1), W = image.dim(2);
  const Index h = (H + kQuarter - 1) / kQuarter, w = (W + kQuarter - 1) / kQuarter;
  auto out = Tensor::uninitialised({C, h, w});
  for_range(C * h, 16, [&](Index begin, Index end) {
    for (Index r = begin; r < end; ++r) {
      const Index c = r / h, i0 = r % h * kQuarter, i1 = std::min(H, i0 + kQuarter);
      for (Index j = 0; j < w; ++j) {
        const Index j0 = j * kQuarter, j1 = std::min(W, j0 + kQuarter);
        float sum = 0;
        for (Index y = i0; y < i1; ++y) {
          for (Index x = j0; x < j1; ++x) sum += image[(c * H + y) * W + x];
        }
        out[r * w + j] = sum / static_cast<float>((i1 - i0) * (j1 - j0));
      }
    }
  });
  return out;
}

// Where the pixels of a full row or column fall in the quarter.
struct Taps {
  std::vector<Index> first;
  std::vector<float> weight;  // of the one after `first`
  Taps(Index full, Index quarter, float shift) {
    for (Index k = 0; k < full; ++k) {
      const float at = std::clamp((static_cast<float>(k) + 0.5f + shift) / kQuarter - 0.5f, 0.0f,
                                  static_cast<float>(quarter - 1));
      const Index n = std::min(static_cast<Index>(at), std::max(quarter - 2, Index{0}));
      first.push_back(n);
      weight.push_back(quarter > 1 ? at - static_cast<float>(n) : 0.0f);
    }
  }
};

using Blocks = std::array<std::array<float, kBlock>, kBlock>;

// Annex K, tables K.1 and K.2.
constexpr std::array<std::array<int, 64>, 2> kTables{
    {{16, 11, 10, 16, 24,  40,  51,  61,  12, 12, 14, 19, 26,  58,  60,  55,
      14, 13, 16, 24, 40,  57,  69,  56,  14, 17, 22, 29, 51,  87,  80,  62,
      18, 22, 37, 56, 68,  109, 103, 77,  24, 35, 55, 64, 81,  104, 113, 92,
      49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99},
     {17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99, 24, 26, 56, 99, 99, 99,
      99, 99, 47, 66, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
      99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99}}};

Blocks cosines() {
  Blocks c{};
  for (std::size_t u = 0; u < kBlock; ++u) {
    for (std::size_t x = 0; x < kBlock; ++x) {
      c[u][x] = static_cast<float>(
          (u == 0 ? std::sqrt(0.125) : 0.5) *
          std::cos(static_cast<double>((2 * x + 1) * u) * std::numbers::pi / (2 * kBlock)));
    }
  }
  return c;
}

void quantise_block(Blocks& block, const Blocks& c, const std::array<float, 64>& steps) {
  Blocks rows{}, coefficients{};
  for (std::size_t y = 0; y < kBlock; ++y) {
    for (std::size_t u = 0; u < kBlock; ++u) {
      for (std::size_t x = 0; x < kBlock; ++x) rows[y][u] += c[u][x] * block[y][x];
    }
  }
  for (std::size_t v = 0; v < kBlock; ++v) {
    for (std::size_t y = 0; y < kBlock; ++y) {
      for (std::size_t u = 0; u < kBlock; ++u) coefficients[v][u] += c[v][y] * rows[y][u];
    }
    for (std::size_t u = 0; u < kBlock; ++u) {
      const float step = steps[v * kBlock + u];
      coefficients[v][u] = step * std::round(coefficients[v][u] / step);
    }
  }
  rows = {};
  block = {};
  for (std::size_t v = 0; v < kBlock; ++v) {
    for (std::size_t u = 0; u < kBlock; ++u) {
      for (std::size_t x = 0; x < kBlock; ++x) rows[v][x] += c[u][x] * coefficients[v][u];
    }
  }
  for (std::size_t y = 0; y < kBlock; ++y) {
    for (std::size_t v = 0; v < kBlock; ++v) {
      for (std::size_t x = 0; x < kBlock; ++x) block[y][x] += c[v][y] * rows[v][x];
    }
  }
}

}  // namespace

Tensor blurred(const Tensor& image, float sigma, float box) {
  if (sigma <= 0 && box <= 0) return image.clone();
  const Index C = image.dim(0), H = image.dim(1), W = image.dim(2);
  const std::vector<float> across = kernel_of(sigma, 0), along = kernel_of(sigma, box);
  auto rows = Tensor::uninitialised(image.shape()), out = Tensor::uninitialised(image.shape());
  for_range(C * H, 32, [&](Index begin, Index end) {
    const auto reach = static_cast<Index>(across.size()) / 2;
    for (Index r = begin; r < end; ++r) {
      const float* in = image.data() + r * W;
      float* o = rows.data() + r * W;
      std::fill(o, o + W, 0.0f);
      for (Index k = -reach; k <= reach; ++k) {
        const float w = across[static_cast<std::size_t>(k + reach)];
        const Index j0 = std::clamp(-k, Index{0}, W), j1 = std::clamp(W - k, j0, W);
        for (Index j = 0; j < j0; ++j) o[j] += w * in[0];
        for (Index j = j0; j < j1; ++j) o[j] += w * in[j + k];
        for (Index j = j1; j < W; ++j) o[j] += w * in[W - 1];
      }
    }
  });
  for_range(C * H, 32, [&](Index begin, Index end) {
    const auto reach = static_cast<Index>(along.size()) / 2;
    for (Index r = begin; r < end; ++r) {
      const Index c = r / H, i = r % H;
      float* o = out.data() + r * W;
      std::fill(o, o + W, 0.0f);
      for (Index k = -reach; k <= reach; ++k) {
        const float* in = rows.data() + (c * H + std::clamp(i + k, Index{0}, H - 1)) * W;
        const float w = along[static_cast<std::size_t>(k + reach)];
        for (Index j = 0; j < W; ++j) o[j] += w * in[j];
      }
    }
  });
  return out;
}

Tensor pan_sharpened(const Tensor& bands, const Tensor& luminance, std::array<float, 2> shift) {
  Dims dim("pan_sharpened");
  dim.match("bands", bands, "3 H W").match("luminance", luminance, "1 H W");
  const Index H = dim["H"], W = dim["W"], P = H * W;
  const Tensor colours = quartered(bands), grey = quartered(luminance);
  const Index h = grey.dim(1), w = grey.dim(2);
  const Taps cols(W, w, shift[0]), rows(H, h, shift[1]), own_cols(W, w, 0), own_rows(H, h, 0);
  auto out = Tensor::uninitialised({3, H, W});
  for_range(H, 16, [&](Index begin, Index end) {
    const auto sample = [w](const float* image, const Taps& r, const Taps& c, Index i, Index j) {
      const auto y = static_cast<std::size_t>(i), x = static_cast<std::size_t>(j);
      const float* p = image + r.first[y] * w + c.first[x];
      const Index right = c.weight[x] > 0 ? 1 : 0, down = r.weight[y] > 0 ? w : 0;
      const float top = p[0] + c.weight[x] * (p[right] - p[0]),
                  bottom = p[down] + c.weight[x] * (p[down + right] - p[down]);
      return top + r.weight[y] * (bottom - top);
    };
    for (Index i = begin; i < end; ++i) {
      for (Index j = 0; j < W; ++j) {
        const Index k = i * W + j;
        // The floor keeps noise in the dark from making colours.
        constexpr float kFloor = 0.02f;
        const float low = std::max(sample(grey.data(), own_rows, own_cols, i, j), 0.0f) + kFloor;
        const float ratio = (std::max(luminance[k], 0.0f) + kFloor) / low;
        for (Index b = 0; b < 3; ++b)
          out[b * P + k] = ratio * sample(colours.data() + b * h * w, rows, cols, i, j);
      }
    }
  });
  return out;
}

void quantise_blocks(Tensor& levels, int quality) {
  const Index C = levels.dim(0), H = levels.dim(1), W = levels.dim(2), P = H * W;
  const int q = std::clamp(quality, 1, 100), scale = q < 50 ? 5000 / q : 200 - 2 * q;
  std::array<std::array<float, 64>, 2> steps{};
  for (std::size_t t = 0; t < 2; ++t) {
    for (std::size_t k = 0; k < 64; ++k)
      steps[t][k] = static_cast<float>(std::clamp((kTables[t][k] * scale + 50) / 100, 1, 255));
  }
  const Blocks c = cosines();
  float* data = levels.data();
  for_range((H + kBlock - 1) / kBlock, 2, [&](Index begin, Index end) {
    std::array<Blocks, 3> block{};
    for (Index n = begin; n < end; ++n) {
      for (Index j0 = 0; j0 < W; j0 += kBlock) {
        const auto each = [&](const auto& body) {
          for (Index y = 0; y < kBlock; ++y) {
            for (Index x = 0; x < kBlock; ++x) {
              const Index i = n * kBlock + y, j = j0 + x;
              body(static_cast<std::size_t>(y), static_cast<std::size_t>(x),
                   std::min(i, H - 1) * W + std::min(j, W - 1), i < H && j < W);
            }
          }
        };
        // BT.601, as JFIF wants it.
        each([&](std::size_t y, std::size_t x, Index k, bool) {
          const float r = data[k], g = data[C > 1 ? P + k : k], b = data[C > 1 ? 2 * P + k : k];
          block[0][y][x] = 0.299f * r + 0.587f * g + 0.114f * b - 128.0f;
          block[1][y][x] = -0.168736f * r - 0.331264f * g + 0.5f * b;
          block[2][y][x] = 0.5f * r - 0.418688f * g - 0.081312f * b;
        });
        for (std::size_t b = 0; b < static_cast<std::size_t>(C); ++b)
          quantise_block(block[b], c, steps[b > 0 ? 1 : 0]);
        each([&](std::size_t y, std::size_t x, Index k, bool inside) {
          if (!inside) return;
          const float l = block[0][y][x] + 128.0f;
          if (C == 1) {
            data[k] = l;
            return;
          }
          const float u = block[1][y][x], v = block[2][y][x];
          data[k] = l + 1.402f * v;
          data[P + k] = l - 0.344136f * u - 0.714136f * v;
          data[2 * P + k] = l + 1.772f * u;
        });
      }
    }
  });
  // In this order of the arguments no negative zero is left.
  for (float& v : levels.values()) v = std::min(255.0f, std::max(0.0f, std::round(v)));
}

}  // namespace satsurf::scene::simulate
