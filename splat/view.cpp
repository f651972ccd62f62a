// SPDX-License-Identifier: Apache-2.0
#include "satsurf/splat/view.h"

#include <algorithm>
#include <cmath>

namespace satsurf::splat {

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
  for (Index i = 0; i < z.count(); ++i) {
    const float alpha = render.alpha.value()[i];
    if (!(alpha > 0.5f)) z[i] = alpha > kSeen ? render.height.value()[i] : std::nanf("");
  }
  return z;
}

Tensor surface_colours(const Render& render) {
  Tensor out = render.colour.value().clone();
  const Tensor& alpha = render.alpha.value();
  for (Index c = 0; c < out.dim(0); ++c)
    for (Index i = 0; i < alpha.count(); ++i)
      out[c * alpha.count() + i] /= std::max(alpha[i], 0.5f);
  return out;
}

template BasicRender<float> render_view(const BasicSurfels<float>&, const Quadratic&, Index, Index,
                                        Index);
template BasicRender<double> render_view(const BasicSurfels<double>&, const Quadratic&, Index,
                                         Index, Index);

}  // namespace satsurf::splat
