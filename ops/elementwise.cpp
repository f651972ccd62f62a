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

}  // namespace

template <class T>
BasicVar<T> add(BasicVar<T> a, BasicVar<T> b) {
  check_equal("add", a, b);
  auto out = a.reuse_or_new();
  if (out.data() != a.value().data()) out = b.reuse_or_new();
  const T *pa = a.value().data(), *pb = b.value().data();
  T* y = out.data();
  each(out.count(), [=](Index i) { y[i] = pa[i] + pb[i]; });
  return BasicVar<T>::record("add", out, {a, b}, [](Node<T>& n) {
    const T* g = n.grad.data();
    for (std::size_t k = 0; k < 2; ++k)
      if (T* d = n.grad_in(k)) each(n.grad.count(), [=](Index i) { d[i] += g[i]; });
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
    if (T* da = n.grad_in(0)) each(n.grad.count(), [=](Index i) { da[i] += g[i]; });
    if (T* db = n.grad_in(1)) each(n.grad.count(), [=](Index i) { db[i] -= g[i]; });
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
    if (T* da = n.grad_in(0)) each(n.grad.count(), [=](Index i) { da[i] += g[i] * xb[i]; });
    if (T* db = n.grad_in(1)) each(n.grad.count(), [=](Index i) { db[i] += g[i] * xa[i]; });
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
    if (T* dx = n.grad_in(0)) each(n.grad.count(), [=](Index i) { dx[i] += factor * g[i]; });
  });
}

template <class T>
BasicVar<T> relu(const BasicVar<T>& x) {
  auto out = BasicTensor<T>::uninitialised(x.shape());
  const T* px = x.value().data();
  T* y = out.data();
  each(out.count(), [=](Index i) { y[i] = px[i] < 0 ? T(0) : px[i]; });  // NaN stays
  return BasicVar<T>::record("relu", out, {x}, [](Node<T>& n) {
    const T *g = n.grad.data(), *v = n.value.data();
    const auto kernel = SATSURF_DISPATCH(relu_backward<T>);
    if (T* dx = n.grad_in(0))
      for_range(n.grad.count(), kGrain, [=](Index begin, Index end) {
        kernel(end - begin, v + begin, g + begin, dx + begin);
      });
  });
}

template <class T>
BasicVar<T> gelu(const BasicVar<T>& x) {
  auto out = BasicTensor<T>::uninitialised(x.shape());
  const T* px = x.value().data();
  T* y = out.data();
  const auto forward = SATSURF_DISPATCH(gelu<T>);
  for_range(out.count(), kGrain,
            [=](Index begin, Index end) { forward(end - begin, px + begin, y + begin); });
  return BasicVar<T>::record("gelu", out, {x}, [](Node<T>& n) {
    const T *g = n.grad.data(), *v = n.in(0);
    const auto backward = SATSURF_DISPATCH(gelu_backward<T>);
    if (T* dx = n.grad_in(0))
      for_range(n.grad.count(), kGrain, [=](Index begin, Index end) {
        backward(end - begin, v + begin, g + begin, dx + begin);
      });
  });
}

template <class T>
BasicVar<T> sigmoid(const BasicVar<T>& x) {
  auto out = BasicTensor<T>::uninitialised(x.shape());
  const T* px = x.value().data();
  T* y = out.data();
  const auto kernel = SATSURF_DISPATCH(logistic<T>);
  for_range(out.count(), kGrain,
            [=](Index begin, Index end) { kernel(end - begin, px + begin, y + begin); });
  return BasicVar<T>::record("sigmoid", out, {x}, [](Node<T>& n) {
    const T *g = n.grad.data(), *s = n.value.data();
    if (T* dx = n.grad_in(0))
      each(n.grad.count(), [=](Index i) { dx[i] += g[i] * s[i] * (T(1) - s[i]); });
  });
}

template <class T>
BasicVar<T> softplus(const BasicVar<T>& x) {
  auto out = BasicTensor<T>::uninitialised(x.shape());
  const T* px = x.value().data();
  T* y = out.data();
  const auto forward = SATSURF_DISPATCH(softplus<T>);
  for_range(out.count(), kGrain,
            [=](Index begin, Index end) { forward(end - begin, px + begin, y + begin); });
  return BasicVar<T>::record("softplus", out, {x}, [](Node<T>& n) {
    const T *g = n.grad.data(), *v = n.in(0);
    const auto backward = SATSURF_DISPATCH(softplus_backward<T>);
    if (T* dx = n.grad_in(0))
      for_range(n.grad.count(), kGrain, [=](Index begin, Index end) {
        backward(end - begin, v + begin, g + begin, dx + begin);
      });
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
template BasicVar<float> softplus(const BasicVar<float>&);
template BasicVar<double> softplus(const BasicVar<double>&);

}  // namespace satsurf
