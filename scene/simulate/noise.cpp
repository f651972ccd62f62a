// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/noise.h"

#include "satsurf/core/parallel.h"

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

}  // namespace satsurf::scene::simulate
