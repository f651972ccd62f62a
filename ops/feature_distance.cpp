// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/feature_distance.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace satsurf {
namespace {

constexpr double kLeastNorm = 1e-10;
constexpr Index kPixels = 128;  // per piece: what is kept per pixel stays in the first cache

/// What one piece keeps of its pixels.
template <class T>
struct Pixels {
  T norm[kPixels], share[kPixels], expected[kPixels], sum[kPixels];
};

/// Lengths of the vectors of n pixels, whose channels are `stride` apart, and what they are
/// multiplied by.
template <class T>
void norms(const T* f, Index C, Index stride, Index n, T* norm, T* share) {
  std::fill_n(norm, n, T(0));
  for (Index c = 0; c < C; ++c, f += stride)
    for (Index i = 0; i < n; ++i) norm[i] += f[i] * f[i];
  for (Index i = 0; i < n; ++i) {
    norm[i] = std::sqrt(norm[i]);
    share[i] = T(1) / (norm[i] + static_cast<T>(kLeastNorm));
  }
}

}  // namespace

template <class T>
BasicVar<T> feature_distance(const BasicVar<T>& features, const BasicTensor<T>& reference,
                             const BasicTensor<T>& weight) {
  Dims dim("feature_distance");
  dim.match("features", features, "B C H W")
      .match("reference", reference, "B C H W")
      .match("weight", weight, "C");
  const Index B = dim["B"], C = dim["C"], P = dim["H"] * dim["W"];
  if (features.count() == 0)
    throw ShapeError("feature_distance: features has shape " + features.shape().str() +
                     ", expected at least one element");
  const Index pieces = (P + kPixels - 1) / kPixels;  // of an image
  const T* w = weight.data();
  const double total = ordered_reduce(B * pieces, 1, 0.0, [&](Index piece, Index) {
    Pixels<T> at;
    const Index first = piece % pieces * kPixels, n = std::min(kPixels, P - first);
    const T* f = features.value().data() + piece / pieces * C * P + first;
    const T* r = reference.data() + piece / pieces * C * P + first;
    norms(f, C, P, n, at.norm, at.share);
    norms(r, C, P, n, at.norm, at.expected);
    std::fill_n(at.sum, n, T(0));
    for (Index c = 0; c < C; ++c)
      for (Index i = 0; i < n; ++i) {
        const T d = f[c * P + i] * at.share[i] - r[c * P + i] * at.expected[i];
        at.sum[i] += w[c] * (d * d);
      }
    double sum = 0;
    for (Index i = 0; i < n; ++i) sum += at.sum[i];
    return sum;
  });
  const double pixels = static_cast<double>(B * P);
  const auto out = BasicTensor<T>::scalar(static_cast<T>(total / pixels));
  return BasicVar<T>::record("feature_distance", out, {features}, [=](Node<T>& node) {
    T* df = node.grad_in(0);
    if (df == nullptr) return;
    const T factor = static_cast<T>(2 * static_cast<double>(node.grad[0]) / pixels);
    const T* scale = weight.data();
    for_each_index(B * pieces, [&](Index piece) {
      Pixels<T> at;
      const Index first = piece % pieces * kPixels, n = std::min(kPixels, P - first);
      const Index begin = piece / pieces * C * P + first;
      const T *f = node.in(0) + begin, *r = reference.data() + begin;
      norms(r, C, P, n, at.norm, at.expected);
      norms(f, C, P, n, at.norm, at.share);
      const auto slope = [&](Index c, Index i) {  // by the normalised feature
        return factor * scale[c] * (f[c * P + i] * at.share[i] - r[c * P + i] * at.expected[i]);
      };
      std::fill_n(at.sum, n, T(0));
      for (Index c = 0; c < C; ++c)
        for (Index i = 0; i < n; ++i) at.sum[i] += slope(c, i) * f[c * P + i];
      for (Index i = 0; i < n; ++i) {  // d|f| / df = f / |f|
        const bool any = at.norm[i] > 0;
        at.sum[i] = any ? at.sum[i] * at.share[i] * at.share[i] / at.norm[i] : T(0);
        at.norm[i] = any ? at.share[i] : T(0);
      }
      for (Index c = 0; c < C; ++c)
        for (Index i = 0; i < n; ++i)
          df[begin + c * P + i] += slope(c, i) * at.norm[i] - at.sum[i] * f[c * P + i];
    });
  });
}

template BasicVar<float> feature_distance(const BasicVar<float>&, const BasicTensor<float>&,
                                          const BasicTensor<float>&);
template BasicVar<double> feature_distance(const BasicVar<double>&, const BasicTensor<double>&,
                                           const BasicTensor<double>&);

}  // namespace satsurf
