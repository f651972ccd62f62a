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

/// body(b, first pixel, last pixel + 1) for runs of at most `most` pixels of one batch element.
template <class Body>
void each_run(Index B, Index P, Index most, const Body& body) {
  const Index runs = (P + most - 1) / most;
  for_each_index(B * runs, [&](Index r) {
    const Index b = r / runs, begin = r % runs * most;
    body(b, begin, std::min(P, begin + most));
  });
}
template <class Body>
void each_run(Index B, Index P, const Body& body) {
  each_run(B, P, kSoftmaxPixels, body);
}

/// Pixels of a run where hardly anything is kept from hypothesis to hypothesis: memory likes long
/// ones, and threads like many.
Index long_run(Index pixels) {
  return std::clamp<Index>(pixels / 16 / kSoftmaxPixels, 1, 8) * kSoftmaxPixels;
}

/// `rows` rows of the calling thread's own, kept from one piece to the next.
template <class T>
T* tile_of(Index rows) {
  thread_local std::vector<T> tile;
  const auto count = static_cast<std::size_t>(rows * kSoftmaxRow);
  if (tile.size() < count) tile.resize(count);
  return tile.data();
}

/// Fills `out`, and the other two if there are heights.
template <class T>
void softmax_forward(const BasicTensor<T>& logits, const T* heights, T* out, T* height,
                     T* confidence) {
  const Index B = logits.dim(0), D = logits.dim(1), P = logits.dim(2) * logits.dim(3);
  const auto forward = SATSURF_DISPATCH(softmax_kernels<T>)().forward;
  each_run(B, P, [&](Index b, Index begin, Index end) {
    const Index at = b * D * P + begin, pixel = b * P + begin;
    if (heights == nullptr)
      forward(D, P, end - begin, logits.data() + at, nullptr, out + at, nullptr, nullptr,
              tile_of<T>(D + 3));
    else
      forward(D, P, end - begin, logits.data() + at, heights + at, out + at, height + pixel,
              confidence + pixel, tile_of<T>(D + 3));
  });
}

/// Fills of.d or adds to it; the pointers of `of` are to the first element of all.
template <class T>
void softmax_backward(Index B, Index D, Index P, const SoftmaxGradient<T>& of) {
  const auto backward = SATSURF_DISPATCH(softmax_kernels<T>)().backward;
  each_run(B, P, [&](Index b, Index begin, Index end) {
    const Index at = b * D * P + begin, pixel = b * P + begin;
    SoftmaxGradient<T> here{.p = of.p + at, .d = of.d + at, .accumulate = of.accumulate};
    if (of.g != nullptr) here.g = of.g + at;
    if (of.z != nullptr) {
      here.z = of.z + at;
      here.height = of.height + pixel;
      here.confidence = of.confidence + pixel;
      here.g_height = of.g_height + pixel;
      here.g_confidence = of.g_confidence + pixel;
    }
    backward(D, P, end - begin, here, tile_of<T>(2));
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
  softmax_forward<T>(logits.value(), nullptr, out.data(), nullptr, nullptr);
  return BasicVar<T>::record("softmax_hypotheses", out, {logits}, [=](Node<T>& n) {
    if (const auto d = n.grad_out(0))  // dL/dx_d = p_d (g_d - sum_k p_k g_k)
      softmax_backward<T>(
          B, D, P,
          {.p = n.value.data(), .g = n.grad.data(), .d = d.data, .accumulate = d.accumulate});
  });
}

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
  softmax_forward<T>(logits.value(), heights.data(), p.data(), z.data(), c.data());

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

template <class T>
BasicVar<T> expected_height(const BasicVar<T>& probability, const BasicTensor<T>& heights) {
  Dims dim("expected_height");
  dim.match("probability", probability, "B D H W").match("heights", heights, "B D H W");
  const Index B = dim["B"], D = dim["D"], H = dim["H"], W = dim["W"], P = H * W;

  BasicTensor<T> out({B, H, W});
  each_run(B, P, long_run(B * P), [&](Index b, Index begin, Index end) {
    const T *p = probability.value().data() + b * D * P, *z = heights.data() + b * D * P;
    T* y = out.data() + b * P;
    for (Index d = 0; d < D; ++d)
      for (Index i = begin; i < end; ++i) y[i] += p[d * P + i] * z[d * P + i];
  });
  return BasicVar<T>::record("expected_height", out, {probability}, [=](Node<T>& n) {
    const GradientTarget<T> target = n.grad_out(0);
    if (!target) return;
    each_run(B, P, long_run(B * P), [&](Index b, Index begin, Index end) {
      const T *g = n.grad.data() + b * P, *z = heights.data() + b * D * P;
      T* to = target.data + b * D * P;
      for (Index d = 0; d < D; ++d)
        if (target.accumulate)
          for (Index i = begin; i < end; ++i) to[d * P + i] += g[i] * z[d * P + i];
        else
          for (Index i = begin; i < end; ++i) to[d * P + i] = g[i] * z[d * P + i];
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
  auto first = BasicTensor<T>::uninitialised({B, H, W});  // the hypothesis that has it
  const auto kernels = SATSURF_DISPATCH(softmax_kernels<T>)();
  each_run(B, P, long_run(B * P), [&](Index b, Index begin, Index end) {
    const Index pixel = b * P + begin;
    kernels.maximum(D, P, end - begin, probability.value().data() + b * D * P + begin,
                    out.data() + pixel, first.data() + pixel);
  });
  return BasicVar<T>::record("max_probability", out, {probability}, [=](Node<T>& n) {
    const GradientTarget<T> d = n.grad_out(0);
    if (!d) return;
    each_run(B, P, long_run(B * P), [&](Index b, Index begin, Index end) {
      const Index pixel = b * P + begin;
      kernels.max_backward(D, P, end - begin, first.data() + pixel, n.grad.data() + pixel,
                           d.accumulate, d.data + b * D * P + begin);
    });
  });
}

template BasicVar<float> softmax_hypotheses(const BasicVar<float>&);
template BasicVar<double> softmax_hypotheses(const BasicVar<double>&);
template BasicVar<float> expected_height(const BasicVar<float>&, const BasicTensor<float>&);
template BasicVar<double> expected_height(const BasicVar<double>&, const BasicTensor<double>&);
template BasicVar<float> max_probability(const BasicVar<float>&);
template BasicVar<double> max_probability(const BasicVar<double>&);

template HeightDistribution<float> height_distribution(const BasicVar<float>&,
                                                       const BasicTensor<float>&);
template HeightDistribution<double> height_distribution(const BasicVar<double>&,
                                                        const BasicTensor<double>&);

}  // namespace satsurf
