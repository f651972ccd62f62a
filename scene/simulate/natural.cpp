// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/natural.h"

#include "satsurf/scene/simulate/draw.h"
#include "satsurf/scene/simulate/noise.h"

#include <algorithm>
#include <cmath>

namespace satsurf::scene::simulate {

DarkGround::DarkGround(const CityPlan& plan, const Rng& rng) {
  const auto noise = [&](double period, int octaves, std::uint64_t key) {
    return fractal_noise(plan.size, plan.size, plan.step,
                         {.period = period,
                          .octaves = octaves,
                          .gain = 0.55f,
                          .seed = static_cast<std::uint32_t>(rng.fork(key).next_u64())});
  };
  Rng r = rng.fork(1);
  if (r.chance(0.6)) rock_ = static_cast<float>(log_uniform(r, 0.12, 0.7));
  if (r.chance(0.4)) soil_ = static_cast<float>(log_uniform(r, 0.2, 0.8));
  if (r.chance(0.6)) face_ = static_cast<float>(log_uniform(r, 0.25, 1.2));
  if (r.chance(0.5)) {
    layer_ = draw(r, 0.1, 0.6);
    layer_height_ = static_cast<float>(log_uniform(r, 1, 12));
    folding_ = draw(r, 0, 1.5) * layer_height_;
  }
  if (r.chance(0.75)) {
    stain_ = static_cast<float>(log_uniform(r, 0.08, 0.5));
    stain_above_ = draw(r, -0.1, 0.5);
    stain_edge_ = static_cast<float>(log_uniform(r, 2, 25));
  }
  const auto period = static_cast<float>(log_uniform(r, 12, 90));  // m
  stains_ = noise(period, 4, 2);
  folds_ = noise(60, 2, 3);
  seed_ = static_cast<std::uint32_t>(r.next_u64());
}

float DarkGround::factor(Index cell, float z, float steepness, Material material) const {
  const bool rock = material == Material::rock;
  if (!(rock || material == Material::soil || material == Material::grass ||
        material == Material::field))
    return 1;
  float f = rock ? rock_ : material == Material::soil ? soil_ : 1.0f;
  const float face = std::clamp(2.5f * (steepness - 0.5f), 0.0f, 1.0f);
  f *= 1 + (face_ - 1) * face;
  if (layer_ > 0 && (rock || face > 0)) {
    const auto n =
        static_cast<std::int32_t>(std::floor((z + folding_ * folds_[cell]) / layer_height_));
    f *= 1 - layer_ * (rock ? 1.0f : face) * unit(hash(n, 0, seed_));
  }
  const float stained = std::clamp(stain_edge_ * (stains_[cell] - stain_above_) + 0.5f, 0.0f, 1.0f);
  return f * (1 + (stain_ - 1) * stained);
}

}  // namespace satsurf::scene::simulate
