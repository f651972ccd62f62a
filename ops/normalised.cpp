// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/normalised.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/pointwise_kernels.h"

#include <algorithm>
#include <string>
#include <utility>

namespace satsurf {
namespace {

constexpr Index kChunk = 1 << 14;  // elements worked on together; they stay in the cache

/// [B C ...] as rows (b, c) of `size` positions, cut into chunks.
struct Rows {
  Index count, size, chunks;

  explicit Rows(const Shape& s)
      : count(s[0] * s[1]),
        size(s.count(2, s.rank())),
        chunks(std::max<Index>(1, (size + kChunk - 1) / kChunk)) {}

  /// body(row, chunk, begin, end) with the element range in x; chunks are grouped into pieces.
  template <class Body>
  void each_chunk(const Body& body) const {
    const Index grain = std::max<Index>(1, kChunk / std::max<Index>(1, std::min(size, kChunk)));
    for_range(count * chunks, grain, [&](Index first, Index last) {
      for (Index k = first; k < last; ++k) {
        const Index row = k / chunks, begin = k % chunks * kChunk;
        body(row, k, row * size + begin, row * size + std::min(size, begin + kChunk));
      }
    });
  }
};

}  // namespace

template <class T>
void detail::check_normalised(const char* op, const Normalised<T>& value) {
  const Shape& s = value.shape();
  if (s.rank() < 3)
    throw ShapeError(std::string(op) + ": x has shape " + s.str() +
                     ", expected [B C ...] of rank 3 to 5");
  const Shape wanted{3, s[0], s[1]};
  if (!value.affine.empty() && value.affine.shape() != wanted)
    throw ShapeError(std::string(op) + ": affine has shape " + value.affine.shape().str() +
                     ", expected " + wanted.str() + " for x " + s.str());
}

template <class T>
void detail::normalised_backward(Node<T>& n, std::size_t i, Activation activation, const T* dz) {
  const GradientTarget<T> dx = n.grad_out(i);
  T* const daffine = n.grad_in(i + 1);
  if (!dx && daffine == nullptr) return;
  const BasicTensor<T>& x = n.inputs[i]->value;
  const Rows rows(x.shape());
  const NormRows<T> norm(n.inputs[i + 1] ? n.in(i + 1) : nullptr, rows.count);
  std::vector<double> sums(2 * rows.count * rows.chunks);
  const auto kernel = active_kernels<PointwiseKernels<T>>().norm_backward;
  rows.each_chunk([&](Index row, Index k, Index begin, Index end) {
    kernel(end - begin, x.data() + begin, dz + begin, norm[row], activation, dx.accumulate,
           dx ? dx.data + begin : nullptr, sums.data() + 2 * k);
  });
  if (daffine == nullptr) return;
  for (Index row = 0; row < rows.count; ++row) {
    double sum = 0, products = 0;  // of dz act' and of dz act' (x - centre)
    for (Index k = row * rows.chunks; k < (row + 1) * rows.chunks; ++k) {
      sum += sums[2 * k];
      products += sums[2 * k + 1];
    }
    daffine[row] -= static_cast<T>(norm[row].scale * sum);
    daffine[rows.count + row] += static_cast<T>(products);
    daffine[2 * rows.count + row] += static_cast<T>(sum);
  }
}

template <class T>
void detail::add_affine(const BasicTensor<T>& x, const BasicTensor<T>& affine, T* d) {
  const Rows rows(x.shape());
  const NormRows<T> norm(affine.data(), rows.count);
  const auto kernel = active_kernels<PointwiseKernels<T>>().norm_add_linear;
  rows.each_chunk([&](Index row, Index, Index begin, Index end) {
    kernel(end - begin, x.data() + begin, norm[row], d + begin);
  });
}

template <class T>
BasicVar<T> materialise(Normalised<T> value) {
  detail::check_normalised("materialise", value);
  if (value.affine.empty() && value.activation == Activation::none) return std::move(value.x);
  const Rows rows(value.shape());
  const NormRows<T> norm(value.affine.empty() ? nullptr : value.affine.value().data(), rows.count);
  const Activation activation = value.activation;
  auto out = value.x.reuse_or_new();
  const T* x = value.x.value().data();
  const auto kernel = active_kernels<PointwiseKernels<T>>().norm_apply;
  rows.each_chunk([&](Index row, Index, Index begin, Index end) {
    kernel(end - begin, x + begin, norm[row], activation, nullptr, out.data() + begin);
  });
  return BasicVar<T>::record("materialise", out, {value.x, value.affine}, [activation](Node<T>& n) {
    detail::normalised_backward(n, 0, activation, n.grad.data());
  });
}

template <class T>
BasicVar<T> add(Normalised<T> a, Normalised<T> b) {
  detail::check_normalised("add", a);
  detail::check_normalised("add", b);
  if (a.shape() != b.shape())
    throw ShapeError("add: a has shape " + a.shape().str() + " and b " + b.shape().str() +
                     ", expected equal shapes");
  const Rows rows(a.shape());
  const NormRows<T> norm_a(a.affine.empty() ? nullptr : a.affine.value().data(), rows.count);
  const NormRows<T> norm_b(b.affine.empty() ? nullptr : b.affine.value().data(), rows.count);
  const Activation act_a = a.activation, act_b = b.activation;
  auto out = a.x.reuse_or_new();
  const T *pa = a.x.value().data(), *pb = b.x.value().data();
  const auto kernel = active_kernels<PointwiseKernels<T>>().norm_apply;
  rows.each_chunk([&](Index row, Index, Index begin, Index end) {
    T* sum = out.data() + begin;
    kernel(end - begin, pa + begin, norm_a[row], act_a, nullptr, sum);
    kernel(end - begin, pb + begin, norm_b[row], act_b, sum, sum);
  });
  return BasicVar<T>::record("add", out, {a.x, a.affine, b.x, b.affine},
                             [act_a, act_b](Node<T>& n) {
                               detail::normalised_backward(n, 0, act_a, n.grad.data());
                               detail::normalised_backward(n, 2, act_b, n.grad.data());
                             });
}

template <class T>
BasicVar<T> add_map(Normalised<T> volume, const BasicVar<T>& map) {
  Dims dim("add_map");
  dim.match("volume", volume.x, "B C D H W").match("map", map, "B C H W");
  detail::check_normalised("add_map", volume);
  const Index rows = dim["B"] * dim["C"], D = dim["D"], P = dim["H"] * dim["W"];
  const NormRows<T> norm(volume.affine.empty() ? nullptr : volume.affine.value().data(), rows);
  const Activation activation = volume.activation;
  auto out = volume.x.reuse_or_new();
  const T *x = volume.x.value().data(), *added = map.value().data();
  const auto kernel = active_kernels<PointwiseKernels<T>>().norm_apply;
  for_each_index(rows * D, [&](Index plane) {
    const Index row = plane / D;
    kernel(P, x + plane * P, norm[row], activation, added + row * P, out.data() + plane * P);
  });
  return BasicVar<T>::record("add_map", out, {volume.x, volume.affine, map}, [=](Node<T>& n) {
    detail::normalised_backward(n, 0, activation, n.grad.data());
    if (T* const d = n.grad_in(2))
      for_each_index(rows, [&](Index row) {
        for (Index k = 0; k < D; ++k) {
          const T* const g = n.grad.data() + (row * D + k) * P;
          for (Index i = 0; i < P; ++i) d[row * P + i] += g[i];
        }
      });
  });
}

Moments Moments::about(double centre, double n, double sum, double squares) {
  if (n == 0) return {};
  const double mean = sum / n;
  return {n, centre + mean, std::max(0.0, squares - sum * mean)};
}

void Moments::merge(const Moments& other) {
  if (other.count == 0) return;
  const double both = count + other.count, difference = other.mean - mean;
  mean += difference * other.count / both;
  m2 += other.m2 + difference * difference * count * other.count / both;
  count = both;
}

template <class T>
ChannelMoments channel_moments(const BasicTensor<T>& x) {
  const Rows rows(x.shape());
  ChannelMoments parts(rows.count * rows.chunks), all(rows.count);
  const auto kernel = active_kernels<PointwiseKernels<T>>().norm_sums;
  rows.each_chunk([&](Index, Index k, Index begin, Index end) {
    if (begin == end) return;
    double sums[2];  // about the first element: no cancellation where the mean is large
    kernel(end - begin, x.data() + begin, x[begin], sums);
    parts[k] = Moments::about(x[begin], static_cast<double>(end - begin), sums[0], sums[1]);
  });
  for (Index k = 0; k < rows.count * rows.chunks; ++k) all[k / rows.chunks].merge(parts[k]);
  return all;
}

template void detail::check_normalised(const char*, const Normalised<float>&);
template void detail::check_normalised(const char*, const Normalised<double>&);
template void detail::normalised_backward(Node<float>&, std::size_t, Activation, const float*);
template void detail::normalised_backward(Node<double>&, std::size_t, Activation, const double*);
template void detail::add_affine(const Tensor&, const Tensor&, float*);
template void detail::add_affine(const BasicTensor<double>&, const BasicTensor<double>&, double*);
template BasicVar<float> materialise(Normalised<float>);
template BasicVar<double> materialise(Normalised<double>);
template BasicVar<float> add(Normalised<float>, Normalised<float>);
template BasicVar<double> add(Normalised<double>, Normalised<double>);
template BasicVar<float> add_map(Normalised<float>, const BasicVar<float>&);
template BasicVar<double> add_map(Normalised<double>, const BasicVar<double>&);
template ChannelMoments channel_moments(const BasicTensor<float>&);
template ChannelMoments channel_moments(const BasicTensor<double>&);

}  // namespace satsurf
