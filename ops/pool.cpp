// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/pool.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <string>
#include <vector>

namespace satsurf {
namespace {

constexpr Index kGrain = 1 << 14;  // elements of x per piece

/// Number of windows along an axis of n elements; none if that is less than 1.
Index windows(Index n, const PoolOptions& o) {
  const Index ahead = n - o.kernel + (o.ceil_mode ? o.stride - 1 : 0);
  if (n < 1 || ahead < 0) return 0;
  const Index count = ahead / o.stride + 1;
  return (count - 1) * o.stride < n ? count : count - 1;
}

/// Whether v replaces `best`: the first of equal ones stays, and the first NaN.
template <class T>
bool beats(T v, T best) {
  return v > best || (v != v && best == best);
}

}  // namespace

template <class T>
BasicVar<T> max_pool2d(const BasicVar<T>& x, const PoolOptions& options) {
  Dims dim("max_pool2d");
  dim.match("x", x, "B C H W");
  if (options.kernel < 1 || options.stride < 1)
    throw ConfigError("max_pool2d: kernel " + std::to_string(options.kernel) + " and stride " +
                      std::to_string(options.stride) + ", expected positive numbers");
  const Index P = dim["B"] * dim["C"], H = dim["H"], W = dim["W"];
  const Index K = options.kernel, S = options.stride;
  const Index h = windows(H, options), w = windows(W, options);
  if (P < 1 || h < 1 || w < 1)
    throw ShapeError("max_pool2d: x has shape " + x.shape().str() +
                     ", expected room for a window of " + std::to_string(K) + " x " +
                     std::to_string(K));
  auto out = BasicTensor<T>::uninitialised({dim["B"], dim["C"], h, w});
  const Index rows = std::max<Index>(1, kGrain / (K * W));
  for_range(P * h, rows, [&](Index begin, Index end) {
    std::vector<T> column(W);  // the largest of each column's K
    for (Index r = begin; r < end; ++r) {
      const Index top = r % h * S;
      const T* from = x.value().data() + (r / h * H + top) * W;
      std::copy_n(from, W, column.data());
      for (Index k = 1; k < std::min(K, H - top); ++k)
        for (Index j = 0; j < W; ++j) {
          const T v = from[k * W + j], best = column[j];
          column[j] = beats(v, best) ? v : best;
        }
      T* y = out.data() + r * w;
      for (Index j = 0; j < w; ++j) {
        const T* c = column.data() + j * S;
        T best = c[0];
        for (Index k = 1; k < std::min(K, W - j * S); ++k) best = beats(c[k], best) ? c[k] : best;
        y[j] = best;
      }
    }
  });
  return BasicVar<T>::record("max_pool2d", out, {x}, [=](Node<T>& n) {
    T* dx = n.grad_in(0);
    if (dx == nullptr) return;
    // windows overlap, so a plane has one writer
    for_range(P, std::max<Index>(1, kGrain / (H * W)), [&](Index begin, Index end) {
      for (Index p = begin; p < end; ++p)
        for (Index i = 0; i < h; ++i)
          for (Index j = 0; j < w; ++j) {
            const Index first = (p * H + i * S) * W + j * S;
            const Index deep = std::min(K, H - i * S), wide = std::min(K, W - j * S);
            const T* v = n.in(0);
            Index best = first;
            for (Index a = 0; a < deep; ++a)
              for (Index b = 0; b < wide; ++b)
                if (beats(v[first + a * W + b], v[best])) best = first + a * W + b;
            dx[best] += n.grad[(p * h + i) * w + j];
          }
    });
  });
}

template BasicVar<float> max_pool2d(const BasicVar<float>&, const PoolOptions&);
template BasicVar<double> max_pool2d(const BasicVar<double>&, const PoolOptions&);

}  // namespace satsurf
