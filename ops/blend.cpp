// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/blend.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <algorithm>

namespace satsurf {
namespace {

/// Maps of N views, C channels and P pixels, worked on by stretches of the pixels of a view.
struct Maps {
  Index N, C, P;

  /// body(view, first pixel, last pixel)
  template <class Body>
  void each_stretch(const Body& body) const {
    constexpr Index kStretch = 2048;  // a channel's part stays in the first-level cache
    const Index stretches = (P + kStretch - 1) / kStretch;
    for_each_index(N * stretches, [&](Index i) {
      const Index begin = i % stretches * kStretch;
      body(i / stretches, begin, std::min(P, begin + kStretch));
    });
  }
};

template <class T>
void add_products(const T* a, const T* b, Index n, T* sum) {
  for (Index i = 0; i < n; ++i) sum[i] += a[i] * b[i];
}

/// d = a w, or added to it.
template <class T>
void put_products(const T* a, const T* w, Index n, const GradientTarget<T>& d, Index at) {
  T* to = d.data + at;
  if (d.accumulate) return add_products(a, w, n, to);
  for (Index i = 0; i < n; ++i) to[i] = a[i] * w[i];
}

}  // namespace

template <class T>
BasicVar<T> channel_dot(const BasicVar<T>& a, const BasicVar<T>& b) {
  Dims dim("channel_dot");
  dim.match("a", a, "N C H W").match("b", b, "N C H W");
  const Maps maps{dim["N"], dim["C"], dim["H"] * dim["W"]};
  BasicTensor<T> out({dim["N"], dim["H"], dim["W"]});
  const T *pa = a.value().data(), *pb = b.value().data();
  maps.each_stretch([&](Index n, Index begin, Index end) {
    for (Index c = 0; c < maps.C; ++c) {
      const Index at = (n * maps.C + c) * maps.P + begin;
      add_products(pa + at, pb + at, end - begin, out.data() + n * maps.P + begin);
    }
  });
  return BasicVar<T>::record("channel_dot", out, {a, b}, [maps](Node<T>& node) {
    const T* g = node.grad.data();
    for (std::size_t k = 0; k < 2; ++k) {
      const GradientTarget<T> d = node.grad_out(k);
      if (!d) continue;
      const T* other = node.in(1 - k);
      maps.each_stretch([&](Index n, Index begin, Index end) {
        for (Index c = 0; c < maps.C; ++c) {
          const Index at = (n * maps.C + c) * maps.P + begin;
          put_products(other + at, g + n * maps.P + begin, end - begin, d, at);
        }
      });
    }
  });
}

template <class T>
BasicVar<T> add_weighted(const BasicVar<T>& a, const BasicVar<T>& weight, const BasicVar<T>& b) {
  Dims dim("add_weighted");
  dim.match("a", a, "N C H W").match("b", b, "N C H W").match("weight", weight, "N H W");
  const Maps maps{dim["N"], dim["C"], dim["H"] * dim["W"]};
  auto out = BasicTensor<T>::uninitialised(a.shape());
  const T *pa = a.value().data(), *pb = b.value().data(), *pw = weight.value().data();
  maps.each_stretch([&](Index n, Index begin, Index end) {
    const T* w = pw + n * maps.P;
    for (Index c = 0; c < maps.C; ++c) {
      const Index at = (n * maps.C + c) * maps.P;
      for (Index i = begin; i < end; ++i) out[at + i] = pa[at + i] + w[i] * pb[at + i];
    }
  });
  return BasicVar<T>::record("add_weighted", out, {a, weight, b}, [maps](Node<T>& node) {
    const T *g = node.grad.data(), *w = node.in(1), *other = node.in(2);
    if (const GradientTarget<T> da = node.grad_out(0))
      for_range(maps.N * maps.C * maps.P, Index{1} << 16, [&](Index begin, Index end) {
        for (Index i = begin; i < end; ++i) da.data[i] = (da.accumulate ? da.data[i] : T(0)) + g[i];
      });
    if (T* dw = node.grad_in(1))
      maps.each_stretch([&](Index n, Index begin, Index end) {
        for (Index c = 0; c < maps.C; ++c) {
          const Index at = (n * maps.C + c) * maps.P + begin;
          add_products(g + at, other + at, end - begin, dw + n * maps.P + begin);
        }
      });
    if (const GradientTarget<T> db = node.grad_out(2))
      maps.each_stretch([&](Index n, Index begin, Index end) {
        for (Index c = 0; c < maps.C; ++c) {
          const Index at = (n * maps.C + c) * maps.P + begin;
          put_products(g + at, w + n * maps.P + begin, end - begin, db, at);
        }
      });
  });
}

template BasicVar<float> channel_dot(const BasicVar<float>&, const BasicVar<float>&);
template BasicVar<double> channel_dot(const BasicVar<double>&, const BasicVar<double>&);
template BasicVar<float> add_weighted(const BasicVar<float>&, const BasicVar<float>&,
                                      const BasicVar<float>&);
template BasicVar<double> add_weighted(const BasicVar<double>&, const BasicVar<double>&,
                                       const BasicVar<double>&);

}  // namespace satsurf
