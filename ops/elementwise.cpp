// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/elementwise.h"

#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/pointwise_kernels.h"

#include <cmath>
#include <string>

namespace satsurf {
namespace {

constexpr Index kGrain = 1 << 15;  // elements per piece: some 10 us of a memory-bound loop

template <class T>
void check_equal(const char* op, const BasicVar<T>& a, const BasicVar<T>& b) {
  if (a.shape() != b.shape())
    throw ShapeError(std::string(op) + ": b has shape " + b.shape().str() + ", expected " +
                     a.shape().str() + " from a");
}

/// out[i] = f(i) for all i.
template <class F>
void each(Index n, const F& f) {
  for_range(n, kGrain, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) f(i);
  });
}

/// Adds f(i), or stores it if it is the first, in the gradient of input k for all i.
template <class T, class F>
void each_gradient(Node<T>& n, std::size_t k, const F& f) {
  const GradientTarget<T> target = n.grad_out(k);
  T* d = target.data;
  if (d == nullptr) return;
  if (target.accumulate)
    each(n.grad.count(), [=](Index i) { d[i] += f(i); });
  else
    each(n.grad.count(), [=](Index i) { d[i] = f(i); });
}

/// The same by a kernel(count, v, g, accumulate, d); v is what it needs beside n's gradient g.
template <class T, class Kernel>
void gradient_by(Node<T>& n, const T* v, Kernel kernel) {
  const T* g = n.grad.data();
  if (const GradientTarget<T> d = n.grad_out(0))
    for_range(n.grad.count(), kGrain, [=](Index begin, Index end) {
      kernel(end - begin, v + begin, g + begin, d.accumulate, d.data + begin);
    });
}

}  // namespace

template <class T>
BasicVar<T> add(BasicVar<T> a, BasicVar<T> b) {
  check_equal("add", a, b);
  auto out = a.reuse_or_new();
  if (out.data() != a.value().data()) {
    out = {};  // or there would be two results for a moment
    out = b.reuse_or_new();
  }
  const T *pa = a.value().data(), *pb = b.value().data();
  T* y = out.data();
  each(out.count(), [=](Index i) { y[i] = pa[i] + pb[i]; });
  return BasicVar<T>::record("add", out, {a, b}, [](Node<T>& n) {
    const T* g = n.grad.data();
    for (const std::size_t k : {0, 1}) each_gradient(n, k, [=](Index i) { return g[i]; });
  });
}

template <class T>
BasicVar<T> sub(const BasicVar<T>& a, const BasicVar<T>& b) {
  check_equal("sub", a, b);
  auto out = BasicTensor<T>::uninitialised(a.shape());
  const T *pa = a.value().data(), *pb = b.value().data();
  T* y = out.data();
  each(out.count(), [=](Index i) { y[i] = pa[i] - pb[i]; });
  return BasicVar<T>::record("sub", out, {a, b}, [](Node<T>& n) {
    const T* g = n.grad.data();
    each_gradient(n, 0, [=](Index i) { return g[i]; });
    each_gradient(n, 1, [=](Index i) { return -g[i]; });
  });
}

template <class T>
BasicVar<T> mul(const BasicVar<T>& a, const BasicVar<T>& b) {
  check_equal("mul", a, b);
  auto out = BasicTensor<T>::uninitialised(a.shape());
  const T *pa = a.value().data(), *pb = b.value().data();
  T* y = out.data();
  each(out.count(), [=](Index i) { y[i] = pa[i] * pb[i]; });
  return BasicVar<T>::record("mul", out, {a, b}, [](Node<T>& n) {
    const T *g = n.grad.data(), *xa = n.in(0), *xb = n.in(1);
    each_gradient(n, 0, [=](Index i) { return g[i] * xb[i]; });
    each_gradient(n, 1, [=](Index i) { return g[i] * xa[i]; });
  });
}

template <class T>
BasicVar<T> affine(const BasicVar<T>& x, T factor, T offset) {
  auto out = BasicTensor<T>::uninitialised(x.shape());
  const T* px = x.value().data();
  T* y = out.data();
  each(out.count(), [=](Index i) { y[i] = factor * px[i] + offset; });
  return BasicVar<T>::record("affine", out, {x}, [factor](Node<T>& n) {
    const T* g = n.grad.data();
    each_gradient(n, 0, [=](Index i) { return factor * g[i]; });
  });
}

template <class T>
BasicVar<T> relu(const BasicVar<T>& x) {
  auto out = BasicTensor<T>::uninitialised(x.shape());
  const T* px = x.value().data();
  T* y = out.data();
  each(out.count(), [=](Index i) { y[i] = px[i] < 0 ? T(0) : px[i]; });  // NaN stays
  return BasicVar<T>::record("relu", out, {x}, [](Node<T>& n) {
    gradient_by(n, n.value.data(), active_kernels<PointwiseKernels<T>>().relu_backward);
  });
}

template <class T>
BasicVar<T> gelu(const BasicVar<T>& x) {
  auto out = BasicTensor<T>::uninitialised(x.shape());
  const T* px = x.value().data();
  T* y = out.data();
  const auto forward = active_kernels<PointwiseKernels<T>>().gelu;
  for_range(out.count(), kGrain,
            [=](Index begin, Index end) { forward(end - begin, px + begin, y + begin); });
  return BasicVar<T>::record("gelu", out, {x}, [](Node<T>& n) {
    gradient_by(n, n.in(0), active_kernels<PointwiseKernels<T>>().gelu_backward);
  });
}

template <class T>
BasicVar<T> sigmoid(const BasicVar<T>& x) {
  auto out = BasicTensor<T>::uninitialised(x.shape());
  const T* px = x.value().data();
  T* y = out.data();
  const auto kernel = active_kernels<PointwiseKernels<T>>().logistic;
  for_range(out.count(), kGrain,
            [=](Index begin, Index end) { kernel(end - begin, px + begin, y + begin); });
  return BasicVar<T>::record("sigmoid", out, {x}, [](Node<T>& n) {
    const T *g = n.grad.data(), *s = n.value.data();
    each_gradient(n, 0, [=](Index i) { return g[i] * s[i] * (T(1) - s[i]); });
  });
}

template BasicVar<float> add(BasicVar<float>, BasicVar<float>);
template BasicVar<double> add(BasicVar<double>, BasicVar<double>);
template BasicVar<float> sub(const BasicVar<float>&, const BasicVar<float>&);
template BasicVar<double> sub(const BasicVar<double>&, const BasicVar<double>&);
template BasicVar<float> mul(const BasicVar<float>&, const BasicVar<float>&);
template BasicVar<double> mul(const BasicVar<double>&, const BasicVar<double>&);
template BasicVar<float> affine(const BasicVar<float>&, float, float);
template BasicVar<double> affine(const BasicVar<double>&, double, double);
template BasicVar<float> relu(const BasicVar<float>&);
template BasicVar<double> relu(const BasicVar<double>&);
template BasicVar<float> gelu(const BasicVar<float>&);
template BasicVar<double> gelu(const BasicVar<double>&);
template BasicVar<float> sigmoid(const BasicVar<float>&);
template BasicVar<double> sigmoid(const BasicVar<double>&);

}  // namespace satsurf
