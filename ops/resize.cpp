// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/resize.h"

#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/resize_kernels.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

namespace satsurf {
namespace {

constexpr Index kGrain = 1 << 14;  // elements per piece

/// Where each output element of one axis reads: weight 1 - weight[i] at low[i], weight[i] at
/// high[i]. low is non-decreasing, which is what makes the gradient a gather over ranges of
/// outputs.
struct Axis {
  std::vector<Index> low, high;
  std::vector<double> weight;
  bool nearest = false;

  Index out() const { return std::ssize(low); }
};

Axis nearest_axis(Index in, Index out) {
  Axis a;
  for (Index i = 0; i < out; ++i) {
    a.low.push_back((2 * i + 1) * in / (2 * out));  // floor((i + 0.5) in / out), in integers
    a.weight.push_back(0);
  }
  a.high = a.low;
  a.nearest = true;
  return a;
}

Axis bilinear_axis(Index in, Index out) {
  Axis a;
  for (Index i = 0; i < out; ++i) {
    const double x =
        (static_cast<double>(i) + 0.5) * static_cast<double>(in) / static_cast<double>(out) - 0.5;
    const double inside = std::clamp(x, 0.0, static_cast<double>(in - 1));
    const Index low = std::min(static_cast<Index>(inside), std::max<Index>(0, in - 2));
    a.low.push_back(low);
    a.high.push_back(std::min(low + 1, in - 1));
    a.weight.push_back(inside - static_cast<double>(low));
  }
  return a;
}

/// first[k]..last[k]-1: the outputs that read input k.
struct Readers {
  std::vector<Index> first, last;
  Readers(const Axis& a, Index in) : first(in, 0), last(in, 0) {
    for (Index i = a.out() - 1; i >= 0; --i)
      for (const Index k : {a.low[i], a.high[i]}) {
        if (last[k] == 0) last[k] = i + 1;
        first[k] = i;
      }
  }
};

template <class T>
struct Size {
  Index planes, H, W;
  Shape out;
  Size(const char* op, const BasicVar<T>& x, Index height, Index width) {
    const Shape& s = x.shape();
    if (s.rank() < 2 || s.count() == 0)
      throw ShapeError(std::string(op) + ": x has shape " + s.str() +
                       ", expected a non-empty [... H W]");
    if (height < 1 || width < 1)
      throw ShapeError(std::string(op) + ": size " + std::to_string(height) + " x " +
                       std::to_string(width) + ", expected at least 1 x 1");
    const Index r = s.rank();
    planes = s.count(0, r - 2);
    H = s[r - 2];
    W = s[r - 1];
    out = s.with(r - 2, height).with(r - 1, width);
  }
};

/// body(plane, row) for all rows of all planes, in pieces of about kGrain elements.
template <class Body>
void each_row(Index planes, Index rows, Index row_cost, const Body& body) {
  for_range(planes * rows, std::max<Index>(1, kGrain / std::max<Index>(1, row_cost)),
            [&](Index begin, Index end) {
              for (Index r = begin; r < end; ++r) body(r / rows, r % rows);
            });
}

/// One row with an element to spare on either side, the calling thread's own.
template <class T>
T* scratch_row(Index width) {
  thread_local std::vector<T> row;
  const auto count = static_cast<std::size_t>(width + 2);
  if (row.size() < count) row.resize(count);
  return row.data() + 1;
}

/// Repeats the values at the borders.
template <class T>
void extend(T* row, Index width) {
  row[-1] = row[0];
  row[width] = row[width - 1];
}

template <class T>
BasicVar<T> resample(const char* op, const BasicVar<T>& x, const Size<T>& size, Axis vertical,
                     Axis horizontal) {
  const Index H = size.H, W = size.W, planes = size.planes;
  const Index out_H = vertical.out(), out_W = horizontal.out();
  const bool doubles = out_W == 2 * W;
  const auto& kernels = active_kernels<ResizeKernels<T>>();
  auto out = BasicTensor<T>::uninitialised(size.out);
  each_row(planes, out_H, out_W, [&](Index p, Index i) {
    const Axis &v = vertical, &h = horizontal;
    const T* plane = x.value().data() + p * H * W;
    const T *a = plane + v.low[i] * W, *b = plane + v.high[i] * W;
    T* y = out.data() + (p * out_H + i) * out_W;
    if (doubles && h.nearest) return kernels.repeat(W, a, y);
    if (h.nearest) {  // copied: mixing would make NaN of infinity, and of -0 a 0
      for (Index j = 0; j < out_W; ++j) y[j] = a[h.low[j]];
      return;
    }
    T* mixed = scratch_row<T>(W);
    kernels.between(W, a, b, static_cast<T>(v.weight[i]), mixed);
    if (doubles) {
      extend(mixed, W);
      return kernels.expand(W, mixed, y);
    }
    for (Index j = 0; j < out_W; ++j) {
      const T left = mixed[h.low[j]], right = mixed[h.high[j]];
      y[j] = left + static_cast<T>(h.weight[j]) * (right - left);
    }
  });
  return BasicVar<T>::record(
      op, out, {x}, [=, v = std::move(vertical), h = std::move(horizontal)](Node<T>& n) {
        const GradientTarget<T> d = n.grad_out(0);
        if (!d) return;
        const Readers readers(v, H);
        const T* g = n.grad.data();
        each_row(planes, H, W, [&](Index p, Index k) {  // every input row gathers its readers
          thread_local std::vector<const T*> rows;
          thread_local std::vector<T> shares;
          rows.clear();
          shares.clear();
          for (Index i = readers.first[k]; i < readers.last[k]; ++i) {
            const T w = static_cast<T>(v.weight[i]);
            const T share = (v.low[i] == k ? T(1) - w : T(0)) + (v.high[i] == k ? w : T(0));
            if (share == 0) continue;
            rows.push_back(g + (p * out_H + i) * out_W);
            shares.push_back(share);
          }
          T *to = d.data + (p * H + k) * W, *mixed = scratch_row<T>(out_W);
          // Without kernels for the width, elements are added one by one, and some get none.
          const bool steps = !doubles || rows.empty();
          if (steps && !d.accumulate) std::fill_n(to, W, T(0));
          if (rows.empty()) return;
          kernels.mix(std::ssize(rows), rows.data(), shares.data(), out_W, mixed);
          if (doubles && h.nearest) return kernels.pair_sums(W, mixed, T(1), d.accumulate, to);
          if (doubles) {
            extend(mixed, out_W);
            return kernels.expand_backward(W, mixed, d.accumulate, to);
          }
          if (h.nearest) {
            for (Index j = 0; j < out_W; ++j) to[h.low[j]] += mixed[j];
            return;
          }
          for (Index j = 0; j < out_W; ++j) {
            const T w = static_cast<T>(h.weight[j]), m = mixed[j];
            to[h.low[j]] += (T(1) - w) * m;
            to[h.high[j]] += w * m;
          }
        });
      });
}

}  // namespace

template <class T>
BasicVar<T> resize_nearest(const BasicVar<T>& x, Index height, Index width) {
  const Size<T> size("resize_nearest", x, height, width);
  return resample("resize_nearest", x, size, nearest_axis(size.H, height),
                  nearest_axis(size.W, width));
}

template <class T>
BasicVar<T> resize_bilinear(const BasicVar<T>& x, Index height, Index width) {
  const Size<T> size("resize_bilinear", x, height, width);
  return resample("resize_bilinear", x, size, bilinear_axis(size.H, height),
                  bilinear_axis(size.W, width));
}

template <class T>
BasicVar<T> area_downsample(const BasicVar<T>& x, Index factor) {
  const Shape& s = x.shape();
  const Index r = s.rank();
  if (factor < 1 || r < 2 || s[r - 2] % factor != 0 || s[r - 1] % factor != 0)
    throw ShapeError("area_downsample: x has shape " + s.str() +
                     ", expected [... H W] with H and W multiples of factor " +
                     std::to_string(factor));
  const Index planes = s.count(0, r - 2), H = s[r - 2] / factor, W = s[r - 1] / factor;
  const T share = T(1) / static_cast<T>(factor * factor);
  const Index wide = W * factor;
  const auto& kernels = active_kernels<ResizeKernels<T>>();
  auto out = BasicTensor<T>::uninitialised(s.with(r - 2, H).with(r - 1, W));
  each_row(planes, H, wide * factor, [&](Index p, Index i) {
    thread_local std::vector<const T*> rows;
    thread_local std::vector<T> ones;
    rows.resize(factor);
    ones.assign(factor, T(1));
    for (Index a = 0; a < factor; ++a)
      rows[a] = x.value().data() + ((p * H + i) * factor + a) * wide;
    T *y = out.data() + (p * H + i) * W, *column_sums = scratch_row<T>(wide);
    kernels.mix(factor, rows.data(), ones.data(), wide, column_sums);
    Index left = factor;  // columns that are still to be added up to one
    for (; left % 2 == 0 && left > 2; left /= 2)
      kernels.pair_sums(W * left / 2, column_sums, T(1), false, column_sums);
    if (left == 2) return kernels.pair_sums(W, column_sums, share, false, y);
    for (Index j = 0; j < W; ++j) {
      T total = 0;
      for (Index b = 0; b < left; ++b) total += column_sums[j * left + b];
      y[j] = total * share;
    }
  });
  return BasicVar<T>::record("area_downsample", out, {x}, [=](Node<T>& n) {
    const GradientTarget<T> d = n.grad_out(0);
    if (!d) return;
    each_row(planes, H, wide * factor, [&](Index p, Index i) {
      const T* g = n.grad.data() + (p * H + i) * W;
      T *spread = scratch_row<T>(2 * wide), *other = spread + wide;  // written in turn
      Index done = 1;  // columns over which each gradient has been spread
      for (; factor % (2 * done) == 0; done *= 2, std::swap(spread, other), g = other)
        kernels.repeat(W * done, g, spread);
      if (done != factor) {
        const Index times = factor / done;
        for (Index j = 0; j < W * done; ++j) std::fill_n(spread + j * times, times, g[j]);
        g = spread;
      }
      for (Index a = 0; a < factor; ++a)
        kernels.scaled(wide, g, share, d.accumulate, d.data + ((p * H + i) * factor + a) * wide);
    });
  });
}

template BasicVar<float> resize_nearest(const BasicVar<float>&, Index, Index);
template BasicVar<double> resize_nearest(const BasicVar<double>&, Index, Index);
template BasicVar<float> resize_bilinear(const BasicVar<float>&, Index, Index);
template BasicVar<double> resize_bilinear(const BasicVar<double>&, Index, Index);
template BasicVar<float> area_downsample(const BasicVar<float>&, Index);
template BasicVar<double> area_downsample(const BasicVar<double>&, Index);

}  // namespace satsurf
