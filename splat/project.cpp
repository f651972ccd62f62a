// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/splat/rasterize.h"

namespace satsurf::splat {

template <class T>
BasicProjection<T> project(const BasicTensor<T>& means, const Quadratic& pixel_from_local) {
  Dims dim("project");
  dim.match("means", means, "P 3");
  const Index P = dim["P"];
  BasicProjection<T> out{BasicTensor<T>::uninitialised({P, 2}),
                         BasicTensor<T>::uninitialised({P, 2, 3})};
  const T* m = means.data();
  T* pixels = out.pixels.data();
  T* jacobians = out.jacobians.data();
  for_range(P, 4096, [&](Index begin, Index end) {
    for (Index p = begin; p < end; ++p) {
      const double x = m[3 * p], y = m[3 * p + 1], z = m[3 * p + 2];
      const auto pixel = pixel_from_local(x, y, z);
      const auto jacobian = pixel_from_local.jacobian(x, y, z);
      for (std::size_t k = 0; k < 2; ++k) {
        const Index row = 2 * p + k;
        pixels[row] = static_cast<T>(pixel[k]);
        for (std::size_t c = 0; c < 3; ++c) jacobians[3 * row + c] = static_cast<T>(jacobian[k][c]);
      }
    }
  });
  return out;
}

template BasicProjection<float> project(const BasicTensor<float>&, const Quadratic&);
template BasicProjection<double> project(const BasicTensor<double>&, const Quadratic&);

}  // namespace satsurf::splat
