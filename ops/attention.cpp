// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/attention.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/matmul_kernels.h"
#include "satsurf/ops/softmax_kernels.h"

#include <algorithm>
#include <cmath>

namespace satsurf {
namespace {

constexpr Index kBlock = 128;  // queries whose weights are there at a time

/// One head, and the weights of a block of its queries. Weights stand transposed, [M queries]: the
/// softmax then runs over planes, as that of hypotheses does.
template <class T>
class Head {
 public:
  Head(Index N, Index M, Index d, Index e, const T* query, const T* key, const T* value)
      : N_(N), M_(M), d_(d), e_(e), query_(query), key_(key), value_(value) {}

  /// body(first query, queries)
  template <class Body>
  void each_block(const Body& body) const {
    for (Index n = 0; n < N_; n += kBlock) body(n, std::min(kBlock, N_ - n));
  }

  /// Fills `weights`, [M queries].
  void weigh(Index n, Index queries, BasicTensor<T>& weights) {
    gemm(matmul_, M_, queries, d_, key_, false, query_ + n * d_, true, weights.data(), false);
    const T factor = scale();
    for (T& w : weights.values()) w *= factor;
    each_run(queries, [&](Index begin, Index count, T* tile) {
      softmax_.forward(M_, queries, count, weights.data() + begin, nullptr, weights.data() + begin,
                       nullptr, nullptr, tile);
    });
  }

  void forward(Index n, Index queries, T* out) {
    auto weights = BasicTensor<T>::uninitialised({M_, queries});
    weigh(n, queries, weights);
    gemm(matmul_, queries, e_, M_, weights.data(), true, value_, false, out + n * e_, false);
  }

  /// Adds to the gradients, each nullptr for none; g is that of the head's output.
  void backward(Index n, Index queries, const T* g, T* d_query, T* d_key, T* d_value) {
    auto weights = BasicTensor<T>::uninitialised({M_, queries});
    weigh(n, queries, weights);
    const T* here = g + n * e_;
    if (d_value != nullptr)
      gemm(matmul_, M_, e_, queries, weights.data(), false, here, false, d_value, true);
    if (d_query == nullptr && d_key == nullptr) return;
    auto d_weights = BasicTensor<T>::uninitialised({M_, queries});
    gemm(matmul_, M_, queries, e_, value_, false, here, true, d_weights.data(), false);
    auto d_scores = BasicTensor<T>::uninitialised({M_, queries});
    each_run(queries, [&](Index begin, Index count, T* tile) {
      softmax_.backward(M_, queries, count,
                        {.p = weights.data() + begin,
                         .g = d_weights.data() + begin,
                         .d = d_scores.data() + begin,
                         .accumulate = false},
                        tile);
    });
    const T factor = scale();
    for (T& s : d_scores.values()) s *= factor;
    if (d_query != nullptr)
      gemm(matmul_, queries, d_, M_, d_scores.data(), true, key_, false, d_query + n * d_, true);
    if (d_key != nullptr)
      gemm(matmul_, M_, d_, queries, d_scores.data(), false, query_ + n * d_, false, d_key, true);
  }

 private:
  T scale() const { return static_cast<T>(1 / std::sqrt(static_cast<double>(d_))); }

  template <class Body>
  void each_run(Index queries, const Body& body) {
    if (tile_.empty()) tile_ = BasicTensor<T>::uninitialised({(M_ + 3) * kSoftmaxRow});
    for (Index begin = 0; begin < queries; begin += kSoftmaxPixels)
      body(begin, std::min(kSoftmaxPixels, queries - begin), tile_.data());
  }

  const Index N_, M_, d_, e_;
  const T *query_, *key_, *value_;
  const MatmulKernels<T>& matmul_ = active_kernels<MatmulKernels<T>>();
  const SoftmaxKernels<T>& softmax_ = active_kernels<SoftmaxKernels<T>>();
  BasicTensor<T> tile_;
};

}  // namespace

template <class T>
BasicVar<T> attention(const BasicVar<T>& query, const BasicVar<T>& key, const BasicVar<T>& value) {
  Dims dim("attention");
  dim.match("query", query, "H N d").match("key", key, "H M d").match("value", value, "H M e");
  const Index H = dim["H"], N = dim["N"], M = dim["M"], d = dim["d"], e = dim["e"];
  if (M == 0 || d == 0)
    throw ShapeError("attention: key has shape " + key.shape().str() +
                     ", expected no extent of 0 but the heads'");
  const auto head = [=](const T* q, const T* k, const T* v, Index h) {
    return Head<T>(N, M, d, e, q + h * N * d, k + h * M * d, v + h * M * e);
  };
  auto out = BasicTensor<T>::uninitialised({H, N, e});
  for_each_index(H, [&](Index h) {
    auto here = head(query.value().data(), key.value().data(), value.value().data(), h);
    here.each_block(
        [&](Index n, Index queries) { here.forward(n, queries, out.data() + h * N * e); });
  });
  return BasicVar<T>::record("attention", out, {query, key, value}, [=](Node<T>& node) {
    const T* g = node.grad.data();
    T *dq = node.grad_in(0), *dk = node.grad_in(1), *dv = node.grad_in(2);
    const auto of = [](T* p, Index offset) { return p == nullptr ? nullptr : p + offset; };
    for_each_index(H, [&](Index h) {
      auto here = head(node.in(0), node.in(1), node.in(2), h);
      here.each_block([&](Index n, Index queries) {
        here.backward(n, queries, g + h * N * e, of(dq, h * N * d), of(dk, h * M * d),
                      of(dv, h * M * e));
      });
    });
  });
}

template BasicVar<float> attention(const BasicVar<float>&, const BasicVar<float>&,
                                   const BasicVar<float>&);
template BasicVar<double> attention(const BasicVar<double>&, const BasicVar<double>&,
                                    const BasicVar<double>&);

}  // namespace satsurf
