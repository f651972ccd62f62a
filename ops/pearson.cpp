// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/pearson.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>

namespace satsurf {
namespace {

constexpr Index kGrain = 1 << 14;

/// How a grid cuts one axis: patch k covers [first + k side, first + (k + 1) side).
struct Axis {
  Index extent, first, side, patches;

  Axis(Index extent_px, Index side_px, Index offset)
      : extent(extent_px),
        first(side_px < extent_px && offset > 0 ? offset - side_px : 0),
        side(std::min(side_px, extent_px)),
        patches(extent > 0 ? (extent - first + side - 1) / side : 0) {}
  Index begin(Index k) const { return std::max<Index>(0, first + k * side); }
  Index end(Index k) const { return std::min(extent, first + (k + 1) * side); }
};

struct Patch {
  Index first, rows, columns;  ///< first pixel and extents
};

template <class Body>
void each_pixel(const Patch& p, Index W, const Body& body) {
  for (Index y = 0; y < p.rows; ++y) {
    const Index row = p.first + y * W;
    for (Index i = row; i < row + p.columns; ++i) body(i);
  }
}

/// Sums over pixels, of differences from a value among them: cancellation stays harmless, and
/// where all are equal the deviation is 0 to the last bit.
struct Sums {
  double n = 0, x = 0, y = 0, xx = 0, xy = 0, yy = 0;

  template <class T>
  void add(T counts, T at_x, T at_y, double pivot_x, double pivot_y) {
    const auto w = static_cast<double>(counts);
    const double dx = w * (at_x - pivot_x);
    const double dy = w * (at_y - pivot_y);
    n += w;
    x += dx;
    y += dy;
    xx += dx * dx;
    xy += dx * dy;
    yy += dy * dy;
  }
  Sums& operator+=(const Sums& o) {
    n += o.n, x += o.x, y += o.y;
    xx += o.xx, xy += o.xy, yy += o.yy;
    return *this;
  }
  double covariance() const { return (xy - x * y / n) / n; }
  double deviation_x() const { return root((xx - x * x / n) / n); }
  double deviation_y() const { return root((yy - y * y / n) / n); }

 private:
  static double root(double variance) { return std::sqrt(variance < 0 ? 0 : variance); }
};

/// What backward needs of a patch: d rho / dx_i = by_x (x_i - mean_x) + by_y (y_i - mean_y).
struct PatchMoments {
  double n = 0;  ///< valid pixels; 0 if the patch does not count
  double mean_x = 0, mean_y = 0, rho = 0, by_x = 0, by_y = 0;
};

/// 1 / (S_x + eps), 1 / S_y and S_y of one view.
struct ViewScale {
  double inverse_x = 0, inverse_y = 0, deviation_y = 0;
};

/// The patches of all views under one grid.
struct GridMoments {
  Axis rows, columns;
  std::vector<PatchMoments> patches;  ///< by view, row, column
};

/// Runs body(view, patch, moments) for every patch of every view; no two patches share a pixel.
template <class Grid, class Body>
void each_patch(Index N, Grid& grid, const Body& body) {
  const Index R = grid.rows.patches, C = grid.columns.patches, W = grid.columns.extent;
  for_each_index(N * R, [&](Index piece) {
    const Index n = piece / R, y = grid.rows.begin(piece % R);
    for (Index c = 0; c < C; ++c) {
      const Index x = grid.columns.begin(c);
      const Patch patch{(n * grid.rows.extent + y) * W + x, grid.rows.end(piece % R) - y,
                        grid.columns.end(c) - x};
      body(n, patch, grid.patches[piece * C + c]);
    }
  });
}

/// What the backward passes of both losses share. Everything is finite where it does not count, so
/// that no loop has to branch on a mask.
template <class T>
struct Saved {
  std::vector<GridMoments> grids;
  std::vector<ViewScale> views;
  BasicTensor<T> x, y;   ///< 0 where not valid
  BasicTensor<T> share;  ///< 1 / number of grids that count at the pixel, or 0
};

/// from[i] where mask[i] is not 0, else 0.
template <class T>
BasicTensor<T> where(const BasicTensor<T>& mask, const BasicTensor<T>& from) {
  auto out = BasicTensor<T>::uninitialised(from.shape());
  const T *m = mask.data(), *f = from.data();
  T* to = out.data();
  for_range(from.count(), kGrain, [=](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const T value = f[i];
      to[i] = m[i] != T(0) ? value : T(0);
    }
  });
  return out;
}

template <class T>
struct Problem {
  const T *x, *y, *valid;  ///< 0 where not valid; 1 and 0
  const PatchPearsonOptions& options;
  Index H, W;

  /// The first valid pixel of a patch, or -1.
  Index pivot(const Patch& p) const {
    for (Index r = 0; r < p.rows; ++r)
      for (Index i = p.first + r * W; i < p.first + r * W + p.columns; ++i)
        if (valid[i] != T(0)) return i;
    return -1;
  }

  Sums sums(const Patch& p, Index at) const {
    const double px = x[at], py = y[at];
    Sums s;
    each_pixel(p, W, [&](Index i) { s.add(valid[i], x[i], y[i], px, py); });
    return s;
  }

  ViewScale view_scale(Index n) const {
    const Patch view{n * H * W, H, W};
    const Index at = pivot(view);
    if (at < 0) return {};
    const Index rows = std::max<Index>(1, kGrain / W);
    const Sums s = ordered_reduce(H, rows, Sums{}, [&](Index begin, Index end) {
      return sums({view.first + begin * W, end - begin, W}, at);
    });
    return {1 / (s.deviation_x() + options.eps), 1 / s.deviation_y(), s.deviation_y()};
  }

  PatchMoments moments(const Patch& p, double full, double view_deviation_y) const {
    const Index at = pivot(p);
    if (at < 0) return {};
    const Sums s = sums(p, at);
    const double sx = s.deviation_x(), sy = s.deviation_y();
    if (s.n < options.min_valid * full || sy == 0 || sy < options.flat * view_deviation_y)
      return {};
    PatchMoments m{s.n, x[at] + s.x / s.n, y[at] + s.y / s.n};
    const double spread = sx + options.eps;
    m.rho = s.covariance() / (spread * sy);
    m.by_y = 1 / (s.n * spread * sy);
    m.by_x = sx > 0 ? -m.rho / (s.n * spread * sx) : 0;  // x - mean is 0 where sx is
    return m;
  }
};

/// The pixel's difference of normalised deviations from the patch means.
template <class T>
double difference(const PatchMoments& m, const ViewScale& v, T x, T y) {
  return (x - m.mean_x) * v.inverse_x - (y - m.mean_y) * v.inverse_y;
}

/// Every pixel is written once per grid, and grids come one after the other.
template <class T, class Body>
void each_counted_patch(const Saved<T>& saved, const Body& body) {
  for (const GridMoments& grid : saved.grids)
    each_patch(std::ssize(saved.views), grid, [&](Index n, const Patch& p, const PatchMoments& m) {
      if (m.n > 0) body(saved.views[n], p, m);
    });
}

/// The upstream gradients of one patch's share of the losses.
template <class T>
BasicTensor<T> shared_gradient(const BasicTensor<T>& g, const BasicTensor<T>& share) {
  auto out = where(share, g);
  for_range(g.count(), kGrain, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) out[i] *= share[i];
  });
  return out;
}

template <class T>
void local_backward(Node<T>& node, const Saved<T>& saved) {
  T* d = node.grad_in(0);
  if (d == nullptr) return;
  const Index W = node.grad.dim(2);
  const auto upstream = shared_gradient(node.grad, saved.share);
  const T *g = upstream.data(), *x = saved.x.data(), *y = saved.y.data(),
          *share = saved.share.data();
  each_counted_patch(saved, [=](const ViewScale&, const Patch& p, const PatchMoments& m) {
    double total = 0;  // one rho serves all pixels of the patch
    each_pixel(p, W, [&](Index i) { total += g[i]; });
    const double by_x = total * m.by_x, by_y = total * m.by_y;
    each_pixel(p, W, [=, mx = m.mean_x, my = m.mean_y](Index i) {
      const T slope = static_cast<T>(by_x * (x[i] - mx) + by_y * (y[i] - my));
      d[i] -= share[i] != T(0) ? slope : T(0);
    });
  });
}

template <class T>
void global_backward(Node<T>& node, const Saved<T>& saved) {
  T* d = node.grad_in(0);
  if (d == nullptr) return;
  const Index W = node.grad.dim(2);
  const auto upstream = shared_gradient(node.grad, saved.share);
  const T *g = upstream.data(), *x = saved.x.data(), *y = saved.y.data(),
          *share = saved.share.data();
  each_counted_patch(saved, [=](const ViewScale& v, const Patch& p, const PatchMoments& m) {
    const auto slope = [=](Index i) { return g[i] * difference(m, v, x[i], y[i]); };
    double sum = 0;  // each pixel also moves the mean
    each_pixel(p, W, [&](Index i) { sum += slope(i); });
    const double mean = sum / m.n;
    each_pixel(p, W, [=](Index i) {
      const T along = static_cast<T>((slope(i) - mean) * v.inverse_x);
      d[i] += share[i] != T(0) ? along : T(0);
    });
  });
}

void check_options(const PatchPearsonOptions& options) {
  const auto refuse = [](const std::string& what) { throw ConfigError("patch_pearson: " + what); };
  if (options.grids.empty()) refuse("no grids came, expected at least one");
  for (const PatchGrid& g : options.grids) {
    const std::string side = std::to_string(g.side);
    if (g.side < 2) refuse("a grid's side is " + side + ", expected at least 2");
    if (g.top < 0 || g.top >= g.side || g.left < 0 || g.left >= g.side)
      refuse("a grid's corner is " + std::to_string(g.top) + ", " + std::to_string(g.left) +
             ", expected numbers from 0 to below its side " + side);
  }
  if (!(options.min_valid >= 0 && options.min_valid <= 1))
    refuse("min_valid is " + std::to_string(options.min_valid) + ", expected 0 to 1");
  if (!(options.flat >= 0))
    refuse("flat is " + std::to_string(options.flat) + ", expected 0 or more");
  if (!(options.eps > 0))
    refuse("eps is " + std::to_string(options.eps) + ", expected a positive number");
}

}  // namespace

template <class T>
PatchPearson<T> patch_pearson(const BasicVar<T>& x, const BasicTensor<T>& target,
                              const BasicTensor<T>& valid, const PatchPearsonOptions& options) {
  Dims dim("patch_pearson");
  dim.match("x", x, "N H W").match("target", target, "N H W");
  if (!valid.empty()) dim.match("valid", valid, "N H W");
  check_options(options);
  const Index N = dim["N"], H = dim["H"], W = dim["W"];
  const BasicTensor<T> ones(x.shape(), T(1));
  const BasicTensor<T> counts = valid.empty() ? ones : where(valid, ones);
  const auto saved = std::make_shared<Saved<T>>();
  saved->x = valid.empty() ? x.value() : where(valid, x.value());
  saved->y = valid.empty() ? target : where(valid, target);
  saved->share = BasicTensor<T>(x.shape());
  const Problem<T> problem{saved->x.data(), saved->y.data(), counts.data(), options, H, W};
  for (Index n = 0; n < N; ++n) saved->views.push_back(problem.view_scale(n));

  BasicTensor<T> local(x.shape()), global(x.shape()), defined(x.shape());
  T *l = local.data(), *e = global.data(), *number = saved->share.data();
  for (const PatchGrid& g : options.grids) {
    GridMoments grid{Axis(H, g.side, g.top), Axis(W, g.side, g.left), {}};
    grid.patches.resize(N * grid.rows.patches * grid.columns.patches);
    const auto full = static_cast<double>(grid.rows.side * grid.columns.side);
    each_patch(N, grid, [&, l, e, number](Index n, const Patch& p, PatchMoments& moments) {
      const ViewScale view = saved->views[n];
      const PatchMoments m = moments = problem.moments(p, full, view.deviation_y);
      if (m.n == 0) return;
      const T loss = static_cast<T>(1 - m.rho);
      each_pixel(p, W, [=](Index i) {
        const T w = problem.valid[i];
        const double apart = difference(m, view, problem.x[i], problem.y[i]);
        l[i] += w * loss;
        e[i] += w * static_cast<T>(0.5 * apart * apart);
        number[i] += w;
      });
    });
    saved->grids.push_back(std::move(grid));
  }
  for_range(x.count(), kGrain, [=, d = defined.data()](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      d[i] = number[i] > T(0) ? T(1) : T(0);
      number[i] = d[i] / std::max(number[i], T(1));
      l[i] *= number[i];
      e[i] *= number[i];
    }
  });

  const auto back = [saved](void (*pass)(Node<T>&, const Saved<T>&)) {
    return [saved, pass](Node<T>& node) { pass(node, *saved); };
  };
  return {BasicVar<T>::record("patch_pearson", local, {x}, back(local_backward<T>)),
          BasicVar<T>::record("patch_pearson", global, {x}, back(global_backward<T>)), defined};
}

template PatchPearson<float> patch_pearson(const BasicVar<float>&, const BasicTensor<float>&,
                                           const BasicTensor<float>&, const PatchPearsonOptions&);
template PatchPearson<double> patch_pearson(const BasicVar<double>&, const BasicTensor<double>&,
                                            const BasicTensor<double>&, const PatchPearsonOptions&);

}  // namespace satsurf
