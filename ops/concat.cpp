// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/concat.h"

#include "satsurf/core/parallel.h"

#include <algorithm>
#include <string>

namespace satsurf {
namespace {

constexpr Index kGrain = 1 << 15;  // elements per piece

/// Where a stretch of one axis lies in the memory of a larger tensor: `outer` runs of `run` elements,
/// `stride` apart, the first one at element `begin`.
struct Runs {
  Index outer, run, stride, begin;
};

Runs runs_of(const Shape& whole, Index axis, Index begin, Index extent) {
  const Index inner = whole.count(axis + 1, whole.rank());
  return {whole.count(0, axis), extent * inner, whole[axis] * inner, begin * inner};
}

/// Calls body(there, here, n) for pieces of all runs: n elements from `there` on in the larger tensor
/// and from `here` on in that of the stretch alone.
template <class Body>
void each_run(const Runs& r, const Body& body) {
  if (r.run == 0) return;
  for_range(r.outer * r.run, kGrain, [&](Index begin, Index end) {
    for (Index here = begin; here < end;) {
      const Index o = here / r.run, n = std::min(end, (o + 1) * r.run) - here;
      body(r.begin + o * r.stride + here - o * r.run, here, n);
      here += n;
    }
  });
}

/// Adds the stretch's gradient g, a tensor of its own, to the gradient of the whole, or stores it
/// there with zeros around it.
template <class T>
void put_runs(const Runs& r, const T* g, const GradientTarget<T>& target) {
  T* d = target.data;
  if (target.accumulate)
    each_run(r, [&](Index to, Index from, Index count) {
      for (Index i = 0; i < count; ++i) d[to + i] += g[from + i];
    });
  else
    for_range(r.outer, std::max<Index>(1, kGrain / std::max<Index>(1, r.stride)),
              [&](Index begin, Index end) {
                for (Index o = begin; o < end; ++o) {
                  T* row = d + o * r.stride;
                  std::fill_n(row, r.begin, T(0));
                  std::copy_n(g + o * r.run, r.run, row + r.begin);
                  std::fill(row + r.begin + r.run, row + r.stride, T(0));
                }
              });
}

void check_axis(const char* op, Index axis, const Shape& shape) {
  if (axis < 0 || axis >= shape.rank())
    throw ShapeError(std::string(op) + ": axis " + std::to_string(axis) +
                     ", expected one of shape " + shape.str());
}

}  // namespace

template <class T>
BasicVar<T> concat(const std::vector<BasicVar<T>>& parts, Index axis) {
  if (parts.empty()) throw ShapeError("concat: no parts, expected at least one");
  const Shape& first = parts[0].shape();
  check_axis("concat", axis, first);
  Index extent = 0;
  for (std::size_t k = 0; k < parts.size(); ++k) {
    const Shape& s = parts[k].shape();
    if (s.rank() != first.rank() || s.with(axis, 0) != first.with(axis, 0))
      throw ShapeError("concat: part " + std::to_string(k) + " has shape " + s.str() +
                       ", expected " + first.str() + " from part 0 except along axis " +
                       std::to_string(axis));
    extent += s[axis];
  }
  const Shape shape = first.with(axis, extent);
  auto out = BasicTensor<T>::uninitialised(shape);
  Index begin = 0;
  for (const BasicVar<T>& p : parts) {
    const Runs r = runs_of(shape, axis, begin, p.dim(axis));
    const T* x = p.value().data();
    T* y = out.data();
    each_run(r, [&](Index to, Index from, Index count) { std::copy_n(x + from, count, y + to); });
    begin += p.dim(axis);
  }
  return BasicVar<T>::record("concat", out, parts, [axis](Node<T>& n) {
    const T* g = n.grad.data();
    Index offset = 0;
    for (std::size_t k = 0; k < n.inputs.size(); ++k) {
      const Index e = n.inputs[k]->value.dim(axis);
      if (const GradientTarget<T> d = n.grad_out(k)) {
        const Runs r = runs_of(n.value.shape(), axis, offset, e);
        each_run(r, [&](Index from, Index to, Index count) {
          if (!d.accumulate) return void(std::copy_n(g + from, count, d.data + to));
          for (Index i = 0; i < count; ++i) d.data[to + i] += g[from + i];
        });
      }
      offset += e;
    }
  });
}

template <class T>
BasicVar<T> slice(const BasicVar<T>& x, Index axis, Index begin, Index end) {
  check_axis("slice", axis, x.shape());
  if (begin < 0 || end < begin || end > x.dim(axis))
    throw ShapeError("slice: elements " + std::to_string(begin) + ".." + std::to_string(end) +
                     " of axis " + std::to_string(axis) + ", expected a range within shape " +
                     x.shape().str());
  const Runs r = runs_of(x.shape(), axis, begin, end - begin);
  auto out = BasicTensor<T>::uninitialised(x.shape().with(axis, end - begin));
  const T* px = x.value().data();
  T* y = out.data();
  each_run(r, [&](Index from, Index to, Index count) { std::copy_n(px + from, count, y + to); });
  return BasicVar<T>::record("slice", out, {x}, [r](Node<T>& n) {
    if (const GradientTarget<T> d = n.grad_out(0)) put_runs(r, n.grad.data(), d);
  });
}

template <class T>
BasicVar<T> reshape(const BasicVar<T>& x, const Shape& shape) {
  if (shape.count() != x.count())
    throw ShapeError("reshape: x has shape " + x.shape().str() + ", expected as many elements as " +
                     shape.str());
  return BasicVar<T>::record("reshape", x.value().reshaped(shape), {x}, [](Node<T>& n) {
    const T* g = n.grad.data();
    if (const GradientTarget<T> d = n.grad_out(0))
      for_range(n.grad.count(), kGrain, [=](Index begin, Index end) {
        if (!d.accumulate) return void(std::copy(g + begin, g + end, d.data + begin));
        for (Index i = begin; i < end; ++i) d.data[i] += g[i];
      });
  });
}

template BasicVar<float> concat(const std::vector<BasicVar<float>>&, Index);
template BasicVar<double> concat(const std::vector<BasicVar<double>>&, Index);
template BasicVar<float> slice(const BasicVar<float>&, Index, Index, Index);
template BasicVar<double> slice(const BasicVar<double>&, Index, Index, Index);
template BasicVar<float> reshape(const BasicVar<float>&, const Shape&);
template BasicVar<double> reshape(const BasicVar<double>&, const Shape&);

}  // namespace satsurf
