// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/ssi_loss.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

namespace satsurf {
namespace {

constexpr Index kGrain = 1 << 14;

/// The derivative of |e|, taken as 0 at 0.
template <class T>
T sign(T e) {
  return static_cast<T>((e > T(0)) - (e < T(0)));
}

/// A number and sums over valid pixels.
struct Sums {
  double n = 0, x = 0, y = 0;
  Sums& operator+=(const Sums& o) {
    n += o.n, x += o.x, y += o.y;
    return *this;
  }
};

/// Number and sum of some pairs.
struct Mean {
  double n = 0, sum = 0;
  Mean& operator+=(const Mean& o) {
    n += o.n, sum += o.sum;
    return *this;
  }
  double value() const { return n > 0 ? sum / n : 0; }
  double weight() const { return n > 0 ? 1 / n : 0; }
};

/// What backward needs to know of one map.
struct MapScale {
  double n = 0;        ///< valid pixels; 0 if the map does not count
  double mean = 0;     ///< of x
  double inverse = 0;  ///< 1 / (s_x + eps)
  double excess = 0;   ///< mean of sign(x - m_x)
};

/// Rows of a map whose pixels are about one grain.
Index grain_rows(Index W) { return std::max<Index>(1, kGrain / W); }

/// The maps' pixels, and which of them count.
template <class T>
struct Maps {
  Index N, H, W;
  BasicTensor<T> valid;  ///< empty for all

  bool counts(Index i) const { return valid.empty() || valid[i] != T(0); }

  /// The sum over the rows of map n of part(i) for every valid pixel i, a Value each.
  template <class Value, class Part>
  Value sum(Index n, const Part& part) const {
    return ordered_reduce(H, grain_rows(W), Value{}, [&](Index begin, Index end) {
      Value v{};
      for (Index i = (n * H + begin) * W; i < (n * H + end) * W; ++i)
        if (counts(i)) v += part(i);
      return v;
    });
  }
};

/// Mean and deviation of x over the valid pixels of map n, and R of those pixels.
template <class T>
MapScale normalise(const Maps<T>& maps, Index n, const T* x, const T* y,
                   const SsiLossOptions& options, T* residual) {
  const Index first = n * maps.H * maps.W, last = first + maps.H * maps.W;
  Index at = first;
  while (at < last && !maps.counts(at)) ++at;
  if (at == last) return {};
  // Sums of differences from one of the pixels: cancellation stays harmless, and where all are equal
  // the deviation is 0 to the last bit.
  const double px = x[at], py = y[at];
  const Sums s = maps.template sum<Sums>(n, [=](Index i) { return Sums{1, x[i] - px, y[i] - py}; });
  const double mean_x = px + s.x / s.n, mean_y = py + s.y / s.n;
  const Sums d = maps.template sum<Sums>(n, [=](Index i) {
    const double dx = x[i] - mean_x, dy = y[i] - mean_y;
    return Sums{sign(dx), std::abs(dx), std::abs(dy)};
  });
  const double spread = d.y / s.n;
  if (spread <= options.flat) return {};
  const MapScale m{s.n, mean_x, 1 / (d.x / s.n + options.eps), d.n / s.n};
  const double inverse_y = 1 / spread;
  for_range(maps.H, grain_rows(maps.W), [&](Index begin, Index end) {
    for (Index i = first + begin * maps.W; i < first + end * maps.W; ++i)
      if (maps.counts(i))
        residual[i] = static_cast<T>((x[i] - mean_x) * m.inverse - (y[i] - mean_y) * inverse_y);
  });
  return m;
}

/// R with the gradient through mean and deviation:
///   dx_i = (g_i - mean(g)) / (s + eps)
///        - (sign(x_i - m) - mean(sign)) sum_j g_j (x_j - m) / (n (s + eps)^2)
template <class T>
BasicVar<T> residual(const BasicVar<T>& x, const Maps<T>& maps, BasicTensor<T> value,
                     const std::vector<MapScale>& scales) {
  const auto backward = [maps, scales](Node<T>& node) {
    T* d = node.grad_in(0);
    if (d == nullptr) return;
    const T *g = node.grad.data(), *at = node.in(0);
    for (Index n = 0; n < maps.N; ++n) {
      const MapScale m = scales[n];
      if (m.n == 0) continue;
      struct Dots {
        double g = 0, gx = 0;
        Dots& operator+=(const Dots& o) {
          g += o.g, gx += o.gx;
          return *this;
        }
      };
      const Dots dots = maps.template sum<Dots>(n, [=](Index i) {
        const double up = g[i];
        return Dots{up, up * (at[i] - m.mean)};
      });
      const double mean_g = dots.g / m.n, by_spread = dots.gx * m.inverse * m.inverse / m.n;
      for_range(maps.H, grain_rows(maps.W), [&](Index begin, Index end) {
        for (Index i = (n * maps.H + begin) * maps.W; i < (n * maps.H + end) * maps.W; ++i)
          if (maps.counts(i))
            d[i] += static_cast<T>((g[i] - mean_g) * m.inverse -
                                   by_spread * (sign(at[i] - m.mean) - m.excess));
      });
    }
  };
  return BasicVar<T>::record("ssi_residual", std::move(value), {x}, backward);
}

/// The mean of |R| over the valid pixels of each map, then over the maps.
template <class T>
BasicVar<T> mean_distance(const BasicVar<T>& R, const Maps<T>& maps,
                          const std::vector<MapScale>& scales, Index count) {
  const T* r = R.value().data();
  std::vector<double> weights;
  double total = 0;
  for (Index n = 0; n < maps.N; ++n) {
    const double pixels = scales[n].n;
    weights.push_back(pixels > 0 ? 1 / (pixels * static_cast<double>(count)) : 0);
    if (pixels > 0)
      total += weights.back() * maps.template sum<double>(n, [r](Index i) {
        return static_cast<double>(std::abs(r[i]));
      });
  }
  return BasicVar<T>::record("ssi_distance", BasicTensor<T>::scalar(static_cast<T>(total)), {R},
                             [maps, weights](Node<T>& node) {
                               T* d = node.grad_in(0);
                               if (d == nullptr) return;
                               const T* of = node.in(0);
                               const Index P = maps.H * maps.W;
                               for (Index n = 0; n < maps.N; ++n) {
                                 const T w = static_cast<T>(node.grad[0] * weights[n]);
                                 for_range(P, kGrain, [&](Index begin, Index end) {
                                   for (Index i = n * P + begin; i < n * P + end; ++i)
                                     if (maps.counts(i)) d[i] += w * sign(of[i]);
                                 });
                               }
                             });
}

/// The pairs of one map at one distance: along rows, then along columns.
template <class T>
struct Pairs {
  const Maps<T>& maps;
  Index n, step;

  Index pixel(Index row, Index column) const {
    return (n * maps.H + row * step) * maps.W + column * step;
  }
  Index rows() const { return (maps.H - 1) / step + 1; }
  Index columns() const { return (maps.W - 1) / step + 1; }
  bool both(Index i, Index j) const { return maps.counts(i) && maps.counts(j); }

  /// Mean of |R_j - R_i| over the pairs, j right of i or below it.
  Mean mean(const T* r, bool down) const {
    const Index R = rows() - (down ? 1 : 0), C = columns() - (down ? 0 : 1),
                ahead = down ? step * maps.W : step;
    return ordered_reduce(R, grain_rows(maps.W), Mean{}, [&](Index begin, Index end) {
      Mean m;
      for (Index y = begin; y < end; ++y)
        for (Index x = 0; x < C; ++x) {
          const Index i = pixel(y, x), j = i + ahead;
          if (both(i, j)) m += {1, static_cast<double>(std::abs(r[j] - r[i]))};
        }
      return m;
    });
  }

  /// Adds the gradient of every pixel's up to four pairs.
  void backward(const T* r, T right, T down, T* d) const {
    const Index R = rows(), C = columns(), W = step * maps.W;
    for_range(R, grain_rows(maps.W), [&](Index begin, Index end) {
      for (Index y = begin; y < end; ++y)
        for (Index x = 0; x < C; ++x) {
          const Index i = pixel(y, x);
          const auto pair = [&](bool inside, Index j) {
            return inside && both(i, j) ? sign(r[i] - r[j]) : T(0);
          };
          d[i] += right * (pair(x > 0, i - step) + pair(x + 1 < C, i + step)) +
                  down * (pair(y > 0, i - W) + pair(y + 1 < R, i + W));
        }
    });
  }
};

template <class T>
BasicVar<T> mean_gradient(const BasicVar<T>& R, const Maps<T>& maps,
                          const std::vector<MapScale>& scales, Index count, Index levels) {
  struct Weight {
    Index n, step;
    double right, down;
  };
  std::vector<Weight> weights;
  double total = 0;
  for (Index n = 0; n < maps.N; ++n) {
    if (scales[n].n == 0) continue;
    for (Index k = 0; k < levels; ++k) {
      const Pairs<T> pairs{maps, n, Index{1} << k};
      const Mean right = pairs.mean(R.value().data(), false),
                 down = pairs.mean(R.value().data(), true);
      const double share = 1 / static_cast<double>(count);
      total += share * (right.value() + down.value());
      weights.push_back({n, pairs.step, share * right.weight(), share * down.weight()});
    }
  }
  return BasicVar<T>::record("ssi_gradient", BasicTensor<T>::scalar(static_cast<T>(total)), {R},
                             [maps, weights](Node<T>& node) {
                               T* d = node.grad_in(0);
                               if (d == nullptr) return;
                               const double g = node.grad[0];
                               for (const Weight& w : weights)
                                 Pairs<T>{maps, w.n, w.step}.backward(
                                     node.in(0), static_cast<T>(g * w.right),
                                     static_cast<T>(g * w.down), d);
                             });
}

void check_options(const SsiLossOptions& options) {
  const auto refuse = [](const std::string& what) { throw ConfigError("ssi_loss: " + what); };
  constexpr Index kMostScales = 32;
  if (options.scales < 0 || options.scales > kMostScales)
    refuse("scales is " + std::to_string(options.scales) + ", expected 0 to " +
           std::to_string(kMostScales));
  if (!(options.eps > 0))
    refuse("eps is " + std::to_string(options.eps) + ", expected a positive number");
  if (!(options.flat >= 0))
    refuse("flat is " + std::to_string(options.flat) + ", expected 0 or more");
}

}  // namespace

template <class T>
SsiLoss<T> ssi_loss(const BasicVar<T>& x, const BasicTensor<T>& target, const BasicTensor<T>& valid,
                    const SsiLossOptions& options) {
  Dims dim("ssi_loss");
  dim.match("x", x, "N H W").match("target", target, "N H W");
  if (!valid.empty()) dim.match("valid", valid, "N H W");
  check_options(options);
  const Maps<T> maps{dim["N"], dim["H"], dim["W"], valid};
  BasicTensor<T> value(x.shape());
  std::vector<MapScale> scales;
  SsiLoss<T> loss;
  for (Index n = 0; n < maps.N; ++n) {
    scales.push_back(normalise(maps, n, x.value().data(), target.data(), options, value.data()));
    loss.maps += scales.back().n > 0 ? 1 : 0;
  }
  const BasicVar<T> R = residual(x, maps, std::move(value), scales);
  loss.distance = mean_distance(R, maps, scales, loss.maps);
  loss.gradient = mean_gradient(R, maps, scales, loss.maps, options.scales);
  return loss;
}

template SsiLoss<float> ssi_loss(const BasicVar<float>&, const BasicTensor<float>&,
                                 const BasicTensor<float>&, const SsiLossOptions&);
template SsiLoss<double> ssi_loss(const BasicVar<double>&, const BasicTensor<double>&,
                                  const BasicTensor<double>&, const SsiLossOptions&);

}  // namespace satsurf
