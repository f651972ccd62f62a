// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/ssim.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/ssim_kernels.h"
#include "satsurf/ops/weighted_sum.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace satsurf {
namespace {

constexpr Index R = kSsimRadius;
constexpr Index kRows = 16;             // rows per piece: some 50 us of a 1024 px wide image
constexpr Index kPad = R + kSsimSlack;  // the slopes of a cropped map reach twice the radius
constexpr double kSigma = 1.5, kC1 = 0.01 * 0.01, kC2 = 0.03 * 0.03;

template <class T>
SsimTerms<T> terms_of(SsimKind kind) {
  std::array<double, R + 1> weight{};
  double total = -1;  // the centre is counted twice below
  for (Index r = 0; r <= R; ++r) {
    const double w = std::exp(-0.5 * static_cast<double>(r * r) / (kSigma * kSigma));
    weight[r] = w;
    total += 2 * w;
  }
  constexpr double kCells = kSsimWindow * kSsimWindow;
  SsimTerms<T> terms{};
  for (Index r = 0; r <= R; ++r) terms.window[r] = static_cast<T>(weight[r] / total);
  terms.covariance = static_cast<T>(kind == SsimKind::skimage ? kCells / (kCells - 1) : 1);
  terms.c1 = static_cast<T>(kC1);
  terms.c2 = static_cast<T>(kC2);
  return terms;
}

/// Five rows of n elements with kPad zeros on either side, which belong to the calling thread.
template <class T>
std::array<T*, 5> padded_rows(Index n) {
  thread_local std::vector<T> buffer;
  const Index stride = n + 2 * kPad;
  buffer.assign(5 * stride, T(0));
  std::array<T*, 5> rows{};
  for (std::size_t k = 0; k < rows.size(); ++k) rows[k] = buffer.data() + k * stride + kPad;
  return rows;
}

/// The rows of a window around row `i` of a plane; `nothing` beyond its borders.
template <class T>
std::array<const T*, kSsimWindow> window_rows(const T* plane, Index H, Index W, Index i,
                                              const T* nothing) {
  std::array<const T*, kSsimWindow> rows{};
  for (Index r = 0; r < kSsimWindow; ++r) {
    const Index at = i + r - R;
    rows[r] = at >= 0 && at < H ? plane + at * W : nothing;
  }
  return rows;
}

/// The images' planes, and which of their pixels count.
template <class T>
struct Planes {
  Index planes, C, H, W;  // C of the planes share a mask
  Index top, left, map_H, map_W;
  BasicTensor<T> mask;
  std::vector<T> ones, zeros;

  Planes(const Shape& x, const Shape& reference, const BasicTensor<T>& mask_, SsimKind kind)
      : mask(mask_) {
    Dims dim("ssim");
    const bool batch = x.rank() == 4;
    const char* const pattern = batch ? "B C H W" : "C H W";
    dim.match("x", x, pattern).match("reference", reference, pattern);
    if (!mask.empty()) dim.match("mask", mask, batch && mask.rank() == 3 ? "B H W" : "H W");
    H = dim["H"], W = dim["W"], C = dim["C"];
    planes = x.count(0, x.rank() - 2);
    if (!mask.empty() && mask.rank() == 2) C = planes;
    if (x.count() == 0)
      throw ShapeError("ssim: x has shape " + x.str() + ", expected at least one pixel");
    if (kind == SsimKind::skimage && std::min(H, W) < kSsimWindow)
      throw ShapeError("ssim: x has shape " + x.str() +
                       ", expected H and W of at least 11, the window; or SsimKind::conv");
    top = left = kind == SsimKind::skimage ? R : 0;
    map_H = H - 2 * top, map_W = W - 2 * left;
    ones.assign(W, T(1));
    zeros.assign(W, T(0));
  }

  /// Row `i` of the mask of plane `p`.
  const T* counts(Index p, Index i) const {
    return mask.empty() ? ones.data() : mask.data() + (p / C * H + i) * W;
  }
  /// The image with 0 where a pixel does not count.
  BasicTensor<T> masked(const BasicTensor<T>& image) const {
    if (mask.empty()) return image;
    auto out = BasicTensor<T>::uninitialised(image.shape());
    for_range(planes * H, kRows, [&](Index begin, Index end) {
      for (Index r = begin; r < end; ++r) {
        const T *from = image.data() + r * W, *m = counts(r / H, r % H);
        T* to = out.data() + r * W;
        for (Index j = 0; j < W; ++j) to[j] = m[j] != 0 ? from[j] : T(0);
      }
    });
    return out;
  }
};

/// Adds up what a row of a map says.
/// xs, ys  the rows of the window around it
/// p, i    its plane and row
/// slopes  take its slopes; null where nobody wants them
template <class T>
WeightedSum row_sum(const Planes<T>& at, const SsimTerms<T>& terms,
                    const std::array<const T*, kSsimWindow>& xs,
                    const std::array<const T*, kSsimWindow>& ys, Index p, Index i,
                    const std::array<T*, 5>& filtered, T* const* slopes) {
  const auto& kernels = active_kernels<SsimKernels<T>>();
  std::array<const T*, 5> inner{};
  for (std::size_t k = 0; k < 5; ++k) inner[k] = filtered[k] + at.left;
  kernels.moments(terms, xs.data(), ys.data(), at.W, filtered.data());
  double of_row[2];
  kernels.compare(terms, inner.data(), at.counts(p, i) + at.left, at.map_W, slopes, of_row);
  return {of_row[0], of_row[1]};
}

/// Mean of all rows; 1 where nothing counts.
double mean_of(const WeightedSum& sums) { return sums.weight > 0 ? sums.sum / sums.weight : 1; }

}  // namespace

template <class T>
BasicVar<T> ssim(const BasicVar<T>& x, const BasicTensor<T>& reference, SsimKind kind,
                 const BasicTensor<T>& mask) {
  const Planes<T> at(x.shape(), reference.shape(), mask, kind);
  const SsimTerms<T> terms = terms_of<T>(kind);
  const auto& kernels = active_kernels<SsimKernels<T>>();
  const Index map = at.map_H * at.map_W;
  std::array<BasicTensor<T>, 3> slopes;  // by the filtered x, x^2 and x y
  const bool recorded = x.wants_grad() && !NoGrad::active();
  if (recorded)
    for (auto& s : slopes) s = BasicTensor<T>::uninitialised({at.planes, at.map_H, at.map_W});

  const BasicTensor<T> seen = at.masked(x.value()), expected = at.masked(reference);
  const WeightedSum sums =
      ordered_reduce(at.planes * at.map_H, kRows, WeightedSum{}, [&](Index begin, Index end) {
        WeightedSum of_piece;
        const std::array<T*, 5> filtered = padded_rows<T>(at.W);
        for (Index r = begin; r < end; ++r) {
          const Index p = r / at.map_H, i = r % at.map_H + at.top, plane = p * at.H * at.W;
          const auto xs = window_rows(seen.data() + plane, at.H, at.W, i, at.zeros.data());
          const auto ys = window_rows(expected.data() + plane, at.H, at.W, i, at.zeros.data());
          std::array<T*, 3> to{};
          if (recorded)
            for (std::size_t k = 0; k < 3; ++k) to[k] = slopes[k].data() + r * at.map_W;
          of_piece += row_sum(at, terms, xs, ys, p, i, filtered, recorded ? to.data() : nullptr);
        }
        return of_piece;
      });
  const double pixels = sums.weight;
  const auto out = BasicTensor<T>::scalar(static_cast<T>(mean_of(sums)));

  return BasicVar<T>::record("ssim", out, {x}, [=](Node<T>& n) {
    T* dx = n.grad_in(0);
    if (dx == nullptr || pixels == 0) return;
    const T factor = static_cast<T>(n.grad[0] / pixels);
    for_range(at.planes * at.H, kRows, [&](Index begin, Index end) {
      const std::array<T*, 5> filtered = padded_rows<T>(at.map_W);
      const std::array<const T*, 3> shifted{filtered[0] - at.left, filtered[1] - at.left,
                                            filtered[2] - at.left};
      for (Index r = begin; r < end; ++r) {  // the window is symmetric: its own adjoint
        const Index p = r / at.H, i = r % at.H;
        for (std::size_t k = 0; k < 3; ++k) {
          const auto rows = window_rows(slopes[k].data() + p * map, at.map_H, at.map_W, i - at.top,
                                        at.zeros.data());
          kernels.down(terms, rows.data(), at.map_W, filtered[k]);
        }
        kernels.gather(terms, shifted.data(), n.in(0) + r * at.W, reference.data() + r * at.W,
                       at.counts(p, i), factor, at.W, dx + r * at.W);
      }
    });
  });
}

double ssim_score(const Tensor& x, const Tensor& reference, SsimKind kind, const Tensor& mask) {
  const Planes<double> at(x.shape(), reference.shape(),
                          mask.empty() ? BasicTensor<double>() : mask.cast<double>(), kind);
  const SsimTerms<double> terms = terms_of<double>(kind);
  const WeightedSum sums =
      ordered_reduce(at.planes * at.map_H, kRows, WeightedSum{}, [&](Index begin, Index end) {
        WeightedSum of_piece;
        const std::array<double*, 5> filtered = padded_rows<double>(at.W);
        thread_local std::vector<double> wide;
        for (Index r = begin; r < end;) {  // the piece's rows of one plane after the other
          const Index p = r / at.map_H, first = r % at.map_H, i0 = first + at.top;
          const Index rows = std::min(end - r, at.map_H - first);
          const Index low = std::max<Index>(0, i0 - R), high = std::min(at.H, i0 + rows + R);
          const Index held = (high - low) * at.W;
          wide.resize(static_cast<std::size_t>(2 * held));
          for (Index k = low; k < high; ++k) {
            const double* counts = at.counts(p, k);
            const Index from = (p * at.H + k) * at.W;
            double* to = wide.data() + (k - low) * at.W;
            for (Index j = 0; j < at.W; ++j) {
              to[j] = counts[j] != 0 ? static_cast<double>(x[from + j]) : 0.0;
              to[held + j] = counts[j] != 0 ? static_cast<double>(reference[from + j]) : 0.0;
            }
          }
          for (Index k = 0; k < rows; ++k, ++r) {
            const auto xs =
                window_rows(wide.data(), high - low, at.W, i0 + k - low, at.zeros.data());
            const auto ys =
                window_rows(wide.data() + held, high - low, at.W, i0 + k - low, at.zeros.data());
            of_piece += row_sum<double>(at, terms, xs, ys, p, i0 + k, filtered, nullptr);
          }
        }
        return of_piece;
      });
  return mean_of(sums);
}

template BasicVar<float> ssim(const BasicVar<float>&, const BasicTensor<float>&, SsimKind,
                              const BasicTensor<float>&);
template BasicVar<double> ssim(const BasicVar<double>&, const BasicTensor<double>&, SsimKind,
                               const BasicTensor<double>&);

}  // namespace satsurf
