// SPDX-License-Identifier: Apache-2.0
#include "satsurf/splat/view.h"

#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>

namespace satsurf::splat {
namespace {

constexpr Index kGrain = 1 << 15;  // pixels of one piece of work

}  // namespace

template <class T>
BasicRender<T> render_view(const BasicSurfels<T>& surfels, const Quadratic& pixel_from_local,
                           Index height, Index width, Index stride) {
  const auto projection = project(surfels.means.value(),
                                  rescale_pixels(pixel_from_local, 1, static_cast<double>(stride)));
  return rasterize(surfels, projection, {.height = height / stride, .width = width / stride});
}

Quadratic nadir_camera(double x0, double y0, double step) {
  Quadratic q;  // column = (x - x0) / step - 0.5, row = (y0 - y) / step - 0.5
  q.coeff[0] = {-x0 / step - 0.5, 1 / step};
  q.coeff[1] = {y0 / step - 0.5, 0, -1 / step};
  return q;
}

Tensor surface_heights(const Render& render) {
  constexpr float kSeen = 0.05f;
  Tensor z = render.median_height.clone();
  const Tensor &alphas = render.alpha.value(), &means = render.height.value();
  for_range(z.count(), kGrain, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i)
      // Just above a half, rounding may leave the transmittance there: then there is no median.
      if (const float alpha = alphas[i]; !(alpha > 0.5f) || std::isnan(z[i]))
        z[i] = alpha > kSeen ? means[i] : std::nanf("");
  });
  return z;
}

Tensor surface_colours(const Render& render) {
  Tensor out = render.colour.value().clone();
  const Tensor& alpha = render.alpha.value();
  const Index C = out.dim(0), P = alpha.count();
  for_range(P, kGrain, [&](Index begin, Index end) {
    for (Index c = 0; c < C; ++c)
      for (Index i = begin; i < end; ++i) out[c * P + i] /= std::max(alpha[i], 0.5f);
  });
  return out;
}

template BasicRender<float> render_view(const BasicSurfels<float>&, const Quadratic&, Index, Index,
                                        Index);
template BasicRender<double> render_view(const BasicSurfels<double>&, const Quadratic&, Index,
                                         Index, Index);

}  // namespace satsurf::splat
