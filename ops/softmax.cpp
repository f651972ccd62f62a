// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/softmax.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/softmax_kernels.h"

#include <algorithm>
#include <memory>
#include <vector>

namespace satsurf {
namespace {

/// body(b, first pixel, last pixel + 1) for runs of at most kSoftmaxPixels of one batch element.
template <class Body>
void each_run(Index B, Index P, const Body& body) {
  const Index runs = (P + kSoftmaxPixels - 1) / kSoftmaxPixels;
  for_each_index(B * runs, [&](Index r) {
    const Index begin = r % runs * kSoftmaxPixels;
    body(r / runs, begin, std::min(P, begin + kSoftmaxPixels));
  });
}

/// `rows` rows of the calling thread's own, kept from one piece to the next.
template <class T>
T* tile_of(Index rows) {
  thread_local std::vector<T> tile;
  const auto count = static_cast<std::size_t>(rows * kSoftmaxRow);
  if (tile.size() < count) tile.resize(count);
  return tile.data();
}

/// Fills probabilities p, expected heights and confidences.
template <class T>
void softmax_forward(const BasicTensor<T>& logits, const BasicTensor<T>& heights, T* p, T* height,
                     T* confidence) {
  const Index B = logits.dim(0), D = logits.dim(1), P = logits.dim(2) * logits.dim(3);
  const auto forward = active_kernels<SoftmaxKernels<T>>().forward;
  each_run(B, P, [&](Index b, Index begin, Index end) {
    const Index at = b * D * P + begin, pixel = b * P + begin;
    forward(D, P, end - begin, logits.data() + at, heights.data() + at, p + at, height + pixel,
            confidence + pixel, tile_of<T>(D + 3));
  });
}

/// Fills of.d or adds to it; the pointers of `of` are to the first element of all.
template <class T>
void softmax_backward(Index B, Index D, Index P, const SoftmaxGradient<T>& of) {
  const auto backward = active_kernels<SoftmaxKernels<T>>().backward;
  each_run(B, P, [&](Index b, Index begin, Index end) {
    const Index at = b * D * P + begin, pixel = b * P + begin;
    SoftmaxGradient<T> here = of;
    here.p += at;
    if (of.g != nullptr) here.g += at;
    here.z += at;
    here.height += pixel;
    here.confidence += pixel;
    here.g_height += pixel;
    here.g_confidence += pixel;
    here.d += at;
    backward(D, P, end - begin, here, tile_of<T>(2));
  });
}

}  // namespace

template <class T>
HeightDistribution<T> height_distribution(const BasicVar<T>& logits,
                                          const BasicTensor<T>& heights) {
  Dims dim("height_distribution");
  dim.match("logits", logits, "B D H W").match("heights", heights, "B D H W");
  const Index B = dim["B"], D = dim["D"], H = dim["H"], W = dim["W"], P = H * W;
  if (D == 0)
    throw ShapeError("height_distribution: logits has shape " + logits.shape().str() +
                     ", expected at least one hypothesis");

  auto p = BasicTensor<T>::uninitialised(logits.shape());
  auto z = BasicTensor<T>::uninitialised({B, H, W}), c = BasicTensor<T>::uninitialised({B, H, W});
  softmax_forward(logits.value(), heights, p.data(), z.data(), c.data());

  /// What the other two leave for height's backward.
  struct Gradients {
    BasicTensor<T> probability, confidence;
  };
  const auto kept = std::make_shared<Gradients>();
  const auto height = BasicVar<T>::record("height_distribution", z, {logits}, [=](Node<T>& n) {
    // dL/dx_d = p_d (g_d - sum_k p_k g_k), where g_d = gP_d + gH z_d + gC [d is the maximum]
    const GradientTarget<T> d = n.grad_out(0);
    if (!d) return;
    const BasicTensor<T>& gc = kept->confidence.empty()
                                   ? kept->confidence = BasicTensor<T>::zeros_like(c)
                                   : kept->confidence;
    softmax_backward<T>(B, D, P,
                        {.p = p.data(),
                         .g = kept->probability.data(),
                         .z = heights.data(),
                         .height = n.value.data(),
                         .confidence = c.data(),
                         .g_height = n.grad.data(),
                         .g_confidence = gc.data(),
                         .d = d.data,
                         .accumulate = d.accumulate});
  });
  const auto leave = [&](const char* op, const BasicTensor<T>& value,
                         BasicTensor<T> Gradients::*gradient) {
    return BasicVar<T>::record(op, value, {height}, [kept, gradient](Node<T>& n) {
      (*kept).*gradient = n.grad;
      n.grad_in(0);  // zeros, if nothing else: without a gradient height's backward would not run
    });
  };
  return {leave("height_distribution.probability", p, &Gradients::probability), height,
          leave("height_distribution.confidence", c, &Gradients::confidence)};
}

template HeightDistribution<float> height_distribution(const BasicVar<float>&,
                                                       const BasicTensor<float>&);
template HeightDistribution<double> height_distribution(const BasicVar<double>&,
                                                        const BasicTensor<double>&);

}  // namespace satsurf
