// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/conv_engine.h"

#include "satsurf/core/parallel.h"

#include <vector>

namespace satsurf::conv {
namespace {

/// Calls body(tap, y_offset, x_offset) for every pair of elements of one image that a tap connects.
template <class Body>
void for_each_pair(const Geometry& g, const Body& body) {
  Index tap = 0;
  for (Index i = 0; i < g.kernel[0]; ++i)
    for (Index j = 0; j < g.kernel[1]; ++j)
      for (Index k = 0; k < g.kernel[2]; ++k, ++tap)
        for (Index z = 0; z < g.y_size[0]; ++z)
          for (Index y = 0; y < g.y_size[1]; ++y)
            for (Index x = 0; x < g.y_size[2]; ++x) {
              const Index u = z * g.stride[0] + i - g.padding[0];
              const Index v = y * g.stride[1] + j - g.padding[1];
              const Index w = x * g.stride[2] + k - g.padding[2];
              if (u < 0 || u >= g.x_size[0] || v < 0 || v >= g.x_size[1] || w < 0 ||
                  w >= g.x_size[2])
                continue;
              body(tap, (z * g.y_size[1] + y) * g.y_size[2] + x,
                   (u * g.x_size[1] + v) * g.x_size[2] + w);
            }
}

}  // namespace

template <class T>
void correlate(const ConvKernels<T>&, const Geometry& g, const T* x, const T* weight, const T* bias,
               T* y, bool accumulate) {
  const Index K = g.taps(), N = g.x_count(), M = g.y_count();
  for_each_index(g.B * g.O, [&](Index i) {
    const Index b = i / g.O, o = i % g.O;
    T* yo = y + i * M;
    for (Index m = 0; m < M; ++m)
      yo[m] = (accumulate ? yo[m] : T(0)) + (bias == nullptr ? T(0) : bias[o]);
    for (Index c = 0; c < g.C; ++c) {
      const T* xc = x + (b * g.C + c) * N;
      const T* w = weight + (o * g.C + c) * K;
      for_each_pair(g, [&](Index t, Index m, Index n) { yo[m] += w[t] * xc[n]; });
    }
  });
}

template <class T>
void correlate_adjoint(const ConvKernels<T>&, const Geometry& g, const T* y, const T* weight,
                       const T* bias, T* x, bool accumulate) {
  const Index K = g.taps(), N = g.x_count(), M = g.y_count();
  for_each_index(g.B * g.C, [&](Index i) {
    const Index b = i / g.C, c = i % g.C;
    T* xc = x + i * N;
    for (Index n = 0; n < N; ++n)
      xc[n] = (accumulate ? xc[n] : T(0)) + (bias == nullptr ? T(0) : bias[c]);
    for (Index o = 0; o < g.O; ++o) {
      const T* yo = y + (b * g.O + o) * M;
      const T* w = weight + (o * g.C + c) * K;
      for_each_pair(g, [&](Index t, Index m, Index n) { xc[n] += w[t] * yo[m]; });
    }
  });
}

template <class T>
void correlate_weight_gradient(const ConvKernels<T>&, const Geometry& g, const T* x, const T* dy,
                               T* dw) {
  const Index K = g.taps(), N = g.x_count(), M = g.y_count();
  for_each_index(g.O * g.C, [&](Index i) {
    const Index o = i / g.C, c = i % g.C;
    for (Index b = 0; b < g.B; ++b) {
      const T* xc = x + (b * g.C + c) * N;
      const T* g_o = dy + (b * g.O + o) * M;
      for_each_pair(g, [&](Index t, Index m, Index n) { dw[i * K + t] += g_o[m] * xc[n]; });
    }
  });
}

template <class T>
void bias_gradient(const ConvKernels<T>& kernels, Index B, Index C, Index N, const T* dy, T* db) {
  std::vector<T> sums(static_cast<std::size_t>(B * C));
  for_each_index(B * C,
                 [&](Index i) { sums[static_cast<std::size_t>(i)] = kernels.sum(dy + i * N, N); });
  for (Index b = 0; b < B; ++b)
    for (Index c = 0; c < C; ++c) db[c] += sums[static_cast<std::size_t>(b * C + c)];
}

template void correlate(const ConvKernels<float>&, const Geometry&, const float*, const float*,
                        const float*, float*, bool);
template void correlate(const ConvKernels<double>&, const Geometry&, const double*, const double*,
                        const double*, double*, bool);
template void correlate_adjoint(const ConvKernels<float>&, const Geometry&, const float*,
                                const float*, const float*, float*, bool);
template void correlate_adjoint(const ConvKernels<double>&, const Geometry&, const double*,
                                const double*, const double*, double*, bool);
template void correlate_weight_gradient(const ConvKernels<float>&, const Geometry&, const float*,
                                        const float*, float*);
template void correlate_weight_gradient(const ConvKernels<double>&, const Geometry&, const double*,
                                        const double*, double*);
template void bias_gradient(const ConvKernels<float>&, Index, Index, Index, const float*, float*);
template void bias_gradient(const ConvKernels<double>&, Index, Index, Index, const double*,
                            double*);

}  // namespace satsurf::conv
