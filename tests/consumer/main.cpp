// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <iostream>

#include <satsurf/satsurf.h>

using namespace satsurf;

namespace {

bool check(bool ok, const char* what) {
  std::cout << (ok ? "ok      " : "FAILED  ") << what << '\n';
  return ok;
}

/// d/dx mean((x * x - 1)^2) at x = 2 and 3.
bool gradient() {
  const Var x(Tensor::from({2}, {2, 3}), true);
  const Var y = affine(x * x, 1.0F, -1.0F);
  mean(y * y).backward();
  return check(x.grad()[0] == 12 && x.grad()[1] == 48, "gradient of a mean of squares");
}

/// A camera whose sample is the longitude and whose line is the latitude, both scaled.
bool projection() {
  rpc::Rpc camera;
  camera.samp_num[1] = camera.line_num[2] = 1;  // monomials 1, L, P, H, ...
  camera.samp_den[0] = camera.line_den[0] = 1;
  camera.samp_off = 100;
  camera.samp_scale = camera.line_scale = 50;
  const rpc::Pixel p = camera.project({.lon = 0.5, .lat = -0.25, .h = 0});
  return check(std::abs(p.x - 125) < 1e-9 && std::abs(p.y + 12.5) < 1e-9, "RPC projection");
}

/// One red disc over black, seen from above, and the gradient of the picture.
bool splat_one() {
  splat::Surfels s;
  s.means = Var(Tensor::from({1, 3}, {4, 3, 2}), true);
  s.quats = Var(Tensor::from({1, 4}, {1, 0, 0, 0}));
  s.scales = Var(Tensor::from({1, 2}, {1.5F, 1.5F}));
  s.opacity = Var(Tensor::from({1}, {0.75F}), true);
  s.colours = Var(Tensor::from({1, 3}, {1, 0, 0}));
  Quadratic camera;  // pixel = (x, 7 - y)
  camera.coeff[0][1] = 1;
  camera.coeff[1][0] = 7;
  camera.coeff[1][2] = -1;
  const auto view = splat::project(s.means.value(), camera);
  const auto image = splat::rasterize(s, view, {.height = 8, .width = 9});
  mean(image.colour).backward();
  const float centre = image.colour.value()[4 * 9 + 4];
  return check(std::abs(centre - 0.75F) < 1e-4F && s.opacity.grad()[0] > 0,
               "splat and its gradient");
}

}  // namespace

int main() {
  std::cout << "kernels: " << isa_name(active_isa()) << ", threads: " << threads() << '\n';
  const bool all[] = {gradient(), projection(), splat_one()};
  return all[0] && all[1] && all[2] ? 0 : 1;
}
