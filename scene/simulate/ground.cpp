// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/scene/simulate/draw.h"
#include "satsurf/scene/simulate/layout.h"
#include "satsurf/scene/simulate/noise.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

namespace satsurf::scene::simulate {
namespace {

std::uint32_t seed_of(const Rng& rng, std::uint64_t key) {
  return static_cast<std::uint32_t>(rng.fork(key).next_u64());
}

float smooth_step(float t) {
  const float c = std::clamp(t, 0.0f, 1.0f);
  return c * c * (3.0f - 2.0f * c);
}

// Distance in m from the set where `noise` equals `level`: the value over the length of its
// gradient.
Tensor distance_from_level(const Tensor& noise, float level, float step) {
  const Index N = noise.dim(0);
  auto out = Tensor::uninitialised({N, N});
  for_range(N, 32, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const Index up = std::max(i - 1, Index{0}), down = std::min(i + 1, N - 1);
      for (Index j = 0; j < N; ++j) {
        const Index left = std::max(j - 1, Index{0}), right = std::min(j + 1, N - 1);
        const float gx = (noise[i * N + right] - noise[i * N + left]) / (2 * step);
        const float gy = (noise[down * N + j] - noise[up * N + j]) / (2 * step);
        // The floor keeps flat summits of the noise from counting as near.
        out[i * N + j] = (noise[i * N + j] - level) / std::max(std::sqrt(gx * gx + gy * gy), 2e-3f);
      }
    }
  });
  return out;
}

// Rock that stands out of the ground, or gullies that are cut into it, each with a face all around:
// their shadows fall on slopes that go on beside them, where in a town a shadow lies on the ground
// at the foot of what throws it.
void raise_crags(Tensor& terrain, const CityPlan& plan, const Rng& rng) {
  struct Crags {
    double period, share;                 // of the noise that places them, m; of the ground
    float height, face, uneven, upwards;  // m; m from foot to top; share of the height; +-1
  };
  const Index N = plan.size;
  const auto step = static_cast<float>(plan.step), A = static_cast<float>(plan.relief);
  Rng r = rng.fork(1);
  std::vector<Crags> all(static_cast<std::size_t>(1 + r.below(3)));
  float used = 0;
  for (Crags& c : all) {
    c.period = log_uniform(r, 25, 130);
    c.share = log_uniform(r, 0.04, 0.35);
    c.height = std::min(static_cast<float>(log_uniform(r, 4, 35)), 0.25f * A);
    c.face = static_cast<float>(log_uniform(r, 0.8, 9));
    c.uneven = static_cast<float>(r.uniform(0.1, 0.8));
    c.upwards = r.chance(0.75) ? 1.0f : -1.0f;
    used += c.height;
  }
  for (float& z : terrain.values()) z *= 1 - used / A;  // the ground stays within +-A
  std::uint64_t key = 2;
  for (const Crags& c : all) {
    const Tensor places = fractal_noise(
        N, N, plan.step,
        {.period = c.period, .octaves = 4, .gain = 0.45f, .seed = seed_of(rng, key++)});
    const Tensor tops = fractal_noise(
        N, N, plan.step, {.period = 0.4 * c.period, .octaves = 3, .seed = seed_of(rng, key++)});
    // So much of the ground, whatever the noise is like in this part of it.
    std::vector<float> some;
    for (Index k = 0; k < N * N; k += 17) some.push_back(places[k]);
    const auto edge = some.begin() + static_cast<std::ptrdiff_t>(
                                         (1 - c.share) * static_cast<double>(some.size() - 1));
    std::nth_element(some.begin(), edge, some.end());
    const Tensor inside = distance_from_level(places, *edge, step);
    for_range(N * N, 4096, [&](Index begin, Index end) {
      for (Index k = begin; k < end; ++k) {
        const float rise = smooth_step(inside[k] / c.face);
        terrain[k] +=
            c.upwards * c.height * rise * (1 - c.uneven * std::clamp(0.5f - tops[k], 0.0f, 1.0f));
      }
    });
  }
}

struct Benches {
  float height = 0, riser = 0.2f;  // of one bench, m; share of it that is the steep face
  float lowest = -1;               // of the mask noise: benches where it is above
};

}  // namespace

float Layout::at(const Tensor& grid, float x, float y) const {
  const auto N = static_cast<float>(plan.size - 1);
  const auto step = static_cast<float>(plan.step);
  const float j = std::clamp((x + half_side()) / step, 0.0f, N),
              i = std::clamp((half_side() - y) / step, 0.0f, N);
  return grid[static_cast<Index>(i) * plan.size + static_cast<Index>(j)];
}

void shape_ground(Layout& layout, const Rng& rng) {
  const CityPlan& plan = layout.plan;
  const Index N = plan.size;
  const auto step = static_cast<float>(plan.step), A = static_cast<float>(plan.relief);
  Rng draw = rng.fork(1);
  const bool rough = plan.kind == SceneKind::rough, open = rough || plan.kind == SceneKind::rural;

  const double period = open ? draw.uniform(90, 260) : draw.uniform(180, 420);
  const Tensor hills = fractal_noise(N, N, plan.step,
                                     {.period = period,
                                      .octaves = open ? 5 : 3,
                                      .gain = open ? 0.42f : 0.35f,
                                      .seed = seed_of(rng, 2)});
  const Tensor mask =
      fractal_noise(N, N, plan.step, {.period = 150, .octaves = 2, .seed = seed_of(rng, 3)});
  // A quarry is a steep side cut into many benches; those of an open pit are as tall as houses, and
  // their faces hide their own feet.
  Rng of_pit = rng.fork(8);
  const bool pit = plan.crags && of_pit.chance(0.4);
  const bool quarry = (rough && draw.chance(0.35)) || pit;
  float tilt = static_cast<float>(quarry ? draw.uniform(0.6, 1.0) : draw.uniform(0, 0.6));
  if (plan.crags) tilt = 0.3f + 0.7f * tilt;
  const float turn = static_cast<float>(draw.uniform(0, 6.2832));
  const float tx = tilt * std::cos(turn) / layout.half_side(),
              ty = tilt * std::sin(turn) / layout.half_side();
  Benches benches;
  if (quarry) {
    benches.height = static_cast<float>(draw.uniform(3, 9));
    benches.riser = static_cast<float>(draw.uniform(0.08, 0.3));
    benches.lowest = static_cast<float>(draw.uniform(-1.5, -0.2));
    if (pit) benches.height = std::min(static_cast<float>(log_uniform(of_pit, 5, 20)), 0.5f * A);
  } else if (open && draw.chance(rough ? 0.5 : 0.3)) {
    benches.height = static_cast<float>(draw.uniform(0.12, 0.35)) * A;
    benches.riser = static_cast<float>(draw.uniform(0.08, 0.35));
    benches.lowest = static_cast<float>(draw.uniform(-0.6, 0.3));
  }

  // Hummocks and gullies, too small to be part of the hills.
  const float hummock = static_cast<float>(rough ? draw.uniform(0.1, 1.2) : 0.0);
  const Tensor small = fractal_noise(
      N, N, plan.step,
      {.period = draw.uniform(9, 22), .octaves = rough ? 3 : 0, .seed = seed_of(rng, 6)});

  layout.terrain = Tensor::uninitialised({N, N});
  for_range(N, 32, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const float y = layout.half_side() - (static_cast<float>(i) + 0.5f) * step;
      for (Index j = 0; j < N; ++j) {
        const float x = (static_cast<float>(j) + 0.5f) * step - layout.half_side();
        float z = A * ((quarry ? 0.3f : 0.6f) * hills[i * N + j] + tx * x + ty * y);
        if (benches.height > 0) {
          const float k = std::floor(z / benches.height), f = z / benches.height - k;
          const float stepped =
              benches.height * (k + smooth_step((f - 1 + benches.riser) / benches.riser));
          z += (stepped - z) * smooth_step((mask[i * N + j] - benches.lowest) * 5.0f);
        }
        layout.terrain[i * N + j] = std::clamp(z + hummock * small[i * N + j], -A, A);
      }
    }
  });

  if (plan.crags && !pit) raise_crags(layout.terrain, plan, rng.fork(7));

  if (plan.water) {
    const Tensor noise = fractal_noise(
        N, N, plan.step,
        {.period = draw.uniform(250, 500), .octaves = 3, .gain = 0.3f, .seed = seed_of(rng, 4)});
    layout.shore = distance_from_level(noise, static_cast<float>(draw.uniform(-0.6, -0.25)), step);
    layout.water_height = -A - 1.0f;
    const float beach = static_cast<float>(draw.uniform(1, 25));
    for (Index k = 0; k < N * N; ++k) {
      float& z = layout.terrain[k];
      const float d = layout.shore[k];
      z = d < 0 ? layout.water_height
                : layout.water_height +
                      (z - layout.water_height) * (0.25f + 0.75f * smooth_step(d / beach));
    }
  }
  if (open || plan.kind == SceneKind::village) {
    const Tensor noise = fractal_noise(
        N, N, plan.step,
        {.period = draw.uniform(120, 260), .octaves = 2, .gain = 0.25f, .seed = seed_of(rng, 5)});
    layout.lane = distance_from_level(noise, static_cast<float>(draw.uniform(-0.2, 0.2)), step);
    layout.lane_half_width = static_cast<float>(draw.uniform(1.8, 4.5));
  }
}

}  // namespace satsurf::scene::simulate
