// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/input.h"

#include <cmath>
#include <functional>

namespace satsurf::test {

/// An affine camera: px = x / gsd + slope_x z, py = -y / gsd + slope_y z, about the window's
/// centre.
struct AffineCamera {
  double gsd = 0.5, slope_x = 0, slope_y = 0, centre = 0;

  Quadratic pixel_from_local() const {
    Quadratic q;
    q.coeff[0] = {centre, 1 / gsd, 0, slope_x};
    q.coeff[1] = {centre, 0, -1 / gsd, slope_y};
    return q;
  }
  Quadratic local_from_pixel() const {
    Quadratic q;
    q.coeff[0] = {-centre * gsd, gsd, 0, -slope_x * gsd};
    q.coeff[1] = {centre * gsd, 0, -gsd, slope_y * gsd};
    return q;
  }
  /// Pixels of `other` from pixels of this one.
  Quadratic transfer(const AffineCamera& other) const {
    Quadratic q;  // gsd is shared: only the slopes differ
    q.coeff[0] = {0, 1, 0, other.slope_x - slope_x};
    q.coeff[1] = {0, 0, 1, other.slope_y - slope_y};
    return q;
  }
};

/// Views of a textured surface z(x, y), each pixel coloured by the point it sees (found by
/// fixed-point iteration, so the surface must be gentle).
inline nn::NetworkInput affine_scene(Index size, const std::vector<std::array<double, 2>>& slopes,
                                     double z_low, double z_high,
                                     const std::function<double(double, double)>& surface) {
  const auto texture = [](double x, double y, int c) {
    return 0.5 + 0.2 * std::sin(1.9 * x + 0.7 * y + c) +
           0.15 * std::sin(1.1 * x - 2.3 * y + 2 * c) + 0.1 * std::sin(3.1 * x + 2.9 * y);
  };
  nn::NetworkInput scene;
  scene.z_range = {z_low, z_high};
  std::vector<AffineCamera> cameras;
  for (const auto& s : slopes)
    cameras.push_back({0.5, s[0], s[1], (static_cast<double>(size) - 1) / 2});
  for (const AffineCamera& camera : cameras) {
    nn::PosedImage view{Tensor({3, size, size}), Tensor({size, size}, 1.f),
                        camera.local_from_pixel(), camera.pixel_from_local()};
    for (Index i = 0; i < size * size; ++i) {
      double z = 0.5 * (z_low + z_high);
      std::array<double, 2> p{};
      for (int k = 0; k < 30; ++k) {
        p = view.local_from_pixel(static_cast<double>(i % size), static_cast<double>(i / size), z);
        z = surface(p[0], p[1]);
      }
      for (int c = 0; c < 3; ++c)
        view.rgb[c * size * size + i] = static_cast<float>(texture(p[0], p[1], c));
    }
    scene.sources.push_back(std::move(view));
    auto& row = scene.transfer.emplace_back();
    for (const AffineCamera& other : cameras) row.push_back(camera.transfer(other));
  }
  return scene;
}

}  // namespace satsurf::test
