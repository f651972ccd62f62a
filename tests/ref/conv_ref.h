// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"
#include "satsurf/ops/conv/engine.h"

/// The convolutions as seven nested loops over their definition, in double.
namespace satsurf::test {

/// Calls body(x_index, w_index, y_index) for every product that the correlation `g` sums.
template <class Body>
void for_each_product(const conv::Geometry& g, const Body& body) {
  const auto inside = [&](std::size_t a, Index n, Index t, Index& u) {
    u = n * g.stride[a] + t - g.padding[a];
    return u >= 0 && u < g.x_size[a];
  };
  for (Index b = 0; b < g.B; ++b)
    for (Index o = 0; o < g.O; ++o)
      for (Index z = 0; z < g.y_size[0]; ++z)
        for (Index y = 0; y < g.y_size[1]; ++y)
          for (Index x = 0; x < g.y_size[2]; ++x)
            for (Index c = 0; c < g.C; ++c)
              for (Index i = 0; i < g.kernel[0]; ++i)
                for (Index j = 0; j < g.kernel[1]; ++j)
                  for (Index k = 0; k < g.kernel[2]; ++k) {
                    Index u = 0, v = 0, w = 0;
                    if (!inside(0, z, i, u) || !inside(1, y, j, v) || !inside(2, x, k, w)) continue;
                    body((((b * g.C + c) * g.x_size[0] + u) * g.x_size[1] + v) * g.x_size[2] + w,
                         (((o * g.C + c) * g.kernel[0] + i) * g.kernel[1] + j) * g.kernel[2] + k,
                         (((b * g.O + o) * g.y_size[0] + z) * g.y_size[1] + y) * g.y_size[2] + x);
                  }
}

using Doubles = BasicTensor<double>;

inline Doubles correlate_ref(const conv::Geometry& g, const Doubles& x, const Doubles& w) {
  Doubles y({g.B * g.O * g.y_count()});
  for_each_product(g, [&](Index xi, Index wi, Index yi) { y[yi] += x[xi] * w[wi]; });
  return y;
}

inline Doubles correlate_adjoint_ref(const conv::Geometry& g, const Doubles& y, const Doubles& w) {
  Doubles x({g.B * g.C * g.x_count()});
  for_each_product(g, [&](Index xi, Index wi, Index yi) { x[xi] += y[yi] * w[wi]; });
  return x;
}

inline Doubles weight_gradient_ref(const conv::Geometry& g, const Doubles& x, const Doubles& dy) {
  Doubles dw({g.O * g.C * g.taps()});
  for_each_product(g, [&](Index xi, Index wi, Index yi) { dw[wi] += x[xi] * dy[yi]; });
  return dw;
}

}  // namespace satsurf::test
