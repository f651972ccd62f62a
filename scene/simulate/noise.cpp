// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/noise.h"

#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace satsurf::scene::simulate {
namespace {

// Quintic fade: the first two derivatives vanish at the lattice, so slopes show no lattice lines.
float fade(float t) { return t * t * t * (t * (t * 6.0f - 15.0f) + 10.0f); }

// One octave along a row: which lattice interval a column is in, and how far.
struct Octave {
  double cells;  // lattice period in grid cells
  float amplitude;
  std::uint32_t seed;
  std::vector<std::int32_t> lattice;
  std::vector<float> weight;

  Octave(double cells_, float amplitude_, std::uint32_t seed_, Index W)
      : cells(cells_), amplitude(amplitude_), seed(seed_) {
    lattice.resize(static_cast<std::size_t>(W));
    weight.resize(static_cast<std::size_t>(W));
    for (Index j = 0; j < W; ++j) {
      const double x = static_cast<double>(j) / cells, k = std::floor(x);
      lattice[static_cast<std::size_t>(j)] = static_cast<std::int32_t>(k);
      weight[static_cast<std::size_t>(j)] = fade(static_cast<float>(x - k));
    }
  }

  void add_row(Index i, float* out, Index W, std::vector<float>& values) const {
    const double y = static_cast<double>(i) / cells, k = std::floor(y);
    const float f = fade(static_cast<float>(y - k));
    const auto row = static_cast<std::int32_t>(k);
    const auto n = static_cast<std::size_t>(lattice[static_cast<std::size_t>(W - 1)]) + 2;
    values.resize(n);
    for (std::size_t c = 0; c < n; ++c) {
      const auto col = static_cast<std::int32_t>(c);
      const float a = unit(hash(col, row, seed)), b = unit(hash(col, row + 1, seed));
      values[c] = amplitude * (2.0f * (a + f * (b - a)) - 1.0f);
    }
    for (Index j = 0; j < W; ++j) {
      const auto c = static_cast<std::size_t>(lattice[static_cast<std::size_t>(j)]);
      out[j] += values[c] + weight[static_cast<std::size_t>(j)] * (values[c + 1] - values[c]);
    }
  }
};

}  // namespace

Tensor fractal_noise(Index H, Index W, double step, const Fractal& fractal) {
  Tensor out({H, W});
  std::vector<Octave> octaves;
  double period = fractal.period;
  float amplitude = 1.0f, power = 0.0f;
  for (int k = 0; k < fractal.octaves && period >= 2 * step; ++k) {
    octaves.emplace_back(period / step, amplitude, hash(k, 0x5eed, fractal.seed), W);
    power += amplitude * amplitude;
    amplitude *= fractal.gain;
    period *= 0.5;
  }
  if (octaves.empty()) return out;
  // One octave stays within [-1, 1]; the sum of independent ones spreads with the root of its
  // power.
  for (Octave& o : octaves) o.amplitude /= std::sqrt(power);
  for_range(H, 32, [&](Index begin, Index end) {
    std::vector<float> values;
    for (Index i = begin; i < end; ++i) {
      for (const Octave& o : octaves) o.add_row(i, out.data() + i * W, W, values);
    }
  });
  return out;
}

Tensor box_mean(const Tensor& grid, Index radius) {
  const Index H = grid.dim(0), W = grid.dim(1);
  auto rows = Tensor::uninitialised({H, W}), out = Tensor::uninitialised({H, W});
  for_range(H, 32, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const float* g = grid.data() + i * W;
      double sum = 0;
      Index count = std::min(radius, W);
      for (Index j = 0; j < count; ++j) sum += static_cast<double>(g[j]);
      for (Index j = 0; j < W; ++j) {
        if (j + radius < W) sum += static_cast<double>(g[j + radius]), ++count;
        if (j > radius) sum -= static_cast<double>(g[j - radius - 1]), --count;
        rows[i * W + j] = static_cast<float>(sum / static_cast<double>(count));
      }
    }
  });
  for_range(W, 128, [&](Index begin, Index end) {
    std::vector<double> sum(static_cast<std::size_t>(end - begin), 0.0);
    Index count = std::min(radius, H);
    const auto add = [&](Index i, double sign) {
      for (Index j = begin; j < end; ++j) {
        sum[static_cast<std::size_t>(j - begin)] += sign * static_cast<double>(rows[i * W + j]);
      }
    };
    for (Index i = 0; i < count; ++i) add(i, 1.0);
    for (Index i = 0; i < H; ++i) {
      if (i + radius < H) add(i + radius, 1.0), ++count;
      if (i > radius) add(i - radius - 1, -1.0), --count;
      for (Index j = begin; j < end; ++j) {
        out[i * W + j] = static_cast<float>(sum[static_cast<std::size_t>(j - begin)] /
                                            static_cast<double>(count));
      }
    }
  });
  return out;
}

}  // namespace satsurf::scene::simulate
