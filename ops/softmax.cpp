// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/softmax.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/pointwise_kernels.h"

#include <algorithm>
#include <vector>

namespace satsurf {
namespace {

constexpr Index kPixels = 512;  // per piece; each has D hypotheses

/// body(b, first pixel, last pixel + 1) for runs of pixels of one batch element.
template <class Body>
void each_run(Index B, Index P, const Body& body) {
  const Index runs = (P + kPixels - 1) / kPixels;
  for_each_index(B * runs, [&](Index r) {
    const Index b = r / runs, begin = r % runs * kPixels;
    body(b, begin, std::min(P, begin + kPixels));
  });
}

}  // namespace

template <class T>
BasicVar<T> softmax_hypotheses(const BasicVar<T>& logits) {
  Dims dim("softmax_hypotheses");
  dim.match("logits", logits, "B D H W");
  const Index B = dim["B"], D = dim["D"], P = dim["H"] * dim["W"];

  auto out = BasicTensor<T>::uninitialised(logits.shape());
  if (out.count() == 0) return BasicVar<T>(out);
  const auto forward = SATSURF_DISPATCH(softmax<T>);
  each_run(B, P, [&](Index b, Index begin, Index end) {
    std::vector<T> tile(static_cast<std::size_t>(D * kSoftmaxTile));
    for (Index i = begin; i < end; i += kSoftmaxTile)
      forward(D, P, std::min(kSoftmaxTile, end - i), logits.value().data() + b * D * P + i,
              out.data() + b * D * P + i, tile.data());
  });
  return BasicVar<T>::record("softmax_hypotheses", out, {logits}, [=](Node<T>& n) {
    T* dx = n.grad_in(0);
    if (dx == nullptr) return;
    const auto backward = SATSURF_DISPATCH(softmax_backward<T>);
    each_run(B, P, [&](Index b, Index begin, Index end) {  // dL/dx_d = p_d (g_d - sum_k p_k g_k)
      std::vector<T> tile(static_cast<std::size_t>(kSoftmaxTile));
      for (Index i = begin; i < end; i += kSoftmaxTile) {
        const Index at = b * D * P + i;
        backward(D, P, std::min(kSoftmaxTile, end - i), n.value.data() + at, n.grad.data() + at,
                 dx + at, tile.data());
      }
    });
  });
}

template <class T>
BasicVar<T> expected_height(const BasicVar<T>& probability, const BasicTensor<T>& heights) {
  Dims dim("expected_height");
  dim.match("probability", probability, "B D H W").match("heights", heights, "B D H W");
  const Index B = dim["B"], D = dim["D"], H = dim["H"], W = dim["W"], P = H * W;

  BasicTensor<T> out({B, H, W});
  each_run(B, P, [&](Index b, Index begin, Index end) {
    const T *p = probability.value().data() + b * D * P, *z = heights.data() + b * D * P;
    T* y = out.data() + b * P;
    for (Index d = 0; d < D; ++d)
      for (Index i = begin; i < end; ++i) y[i] += p[d * P + i] * z[d * P + i];
  });
  return BasicVar<T>::record("expected_height", out, {probability}, [=](Node<T>& n) {
    T* dp = n.grad_in(0);
    if (dp == nullptr) return;
    each_run(B, P, [&](Index b, Index begin, Index end) {
      const T *g = n.grad.data() + b * P, *z = heights.data() + b * D * P;
      T* to = dp + b * D * P;
      for (Index d = 0; d < D; ++d)
        for (Index i = begin; i < end; ++i) to[d * P + i] += g[i] * z[d * P + i];
    });
  });
}

template <class T>
BasicVar<T> max_probability(const BasicVar<T>& probability) {
  Dims dim("max_probability");
  dim.match("probability", probability, "B D H W");
  const Index B = dim["B"], D = dim["D"], H = dim["H"], W = dim["W"], P = H * W;
  if (D == 0)
    throw ShapeError("max_probability: probability has shape " + probability.shape().str() +
                     ", expected at least one hypothesis");

  auto out = BasicTensor<T>::uninitialised({B, H, W});
  each_run(B, P, [&](Index b, Index begin, Index end) {
    const T* p = probability.value().data() + b * D * P;
    T* y = out.data() + b * P;
    std::copy(p + begin, p + end, y + begin);
    for (Index d = 1; d < D; ++d)
      for (Index i = begin; i < end; ++i) y[i] = std::max(y[i], p[d * P + i]);
  });
  return BasicVar<T>::record("max_probability", out, {probability}, [=](Node<T>& n) {
    T* dp = n.grad_in(0);
    if (dp == nullptr) return;
    each_run(B, P, [&](Index b, Index begin, Index end) {
      const T *g = n.grad.data() + b * P, *top = n.value.data() + b * P, *p = n.in(0) + b * D * P;
      T* to = dp + b * D * P;
      for (Index i = begin; i < end; ++i)
        for (Index d = 0; d < D; ++d)
          if (p[d * P + i] == top[i]) {
            to[d * P + i] += g[i];
            break;
          }
    });
  });
}

template BasicVar<float> softmax_hypotheses(const BasicVar<float>&);
template BasicVar<double> softmax_hypotheses(const BasicVar<double>&);
template BasicVar<float> expected_height(const BasicVar<float>&, const BasicTensor<float>&);
template BasicVar<double> expected_height(const BasicVar<double>&, const BasicTensor<double>&);
template BasicVar<float> max_probability(const BasicVar<float>&);
template BasicVar<double> max_probability(const BasicVar<double>&);

}  // namespace satsurf
