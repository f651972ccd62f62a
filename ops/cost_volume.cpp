// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/cost_volume.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/cost_volume_kernels.h"

#include <algorithm>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>

namespace satsurf {

/// What one call works on, all but the features; shared by forward and backward.
template <class T>
struct detail::Sweep {
  Index N, C, D, H, W, Cs, reference;
  std::vector<Quadratic> maps;  // of the source views, in order
  std::vector<Index> sources;   // their indices
  BasicTensor<T> heights, valid;
  T reference_counts;
  std::shared_ptr<std::int8_t[]> best;  // [D H W] the most similar source, or none

  Index J() const { return std::ssize(sources); }
  Index row() const { return W * Cs; }

  /// [N H W Cs]
  BasicTensor<T> channels_last(const T* features) const {
    auto out = BasicTensor<T>::uninitialised({N * H, row()});
    const auto to_pixels = active_kernels<SweepKernels<T>>().to_pixels;
    for_range(N * H, 4, [&](Index begin, Index end) {
      for (Index r = begin; r < end; ++r)
        to_pixels(features + (r / H * C * H + r % H) * W, H * W, W, C, Cs, out.data() + r * row());
    });
    return out;
  }
};

namespace {

using detail::Sweep;

Index channel_stride(Index C) { return C <= 4 ? 4 : C <= 8 ? 8 : (C + 15) / 16 * 16; }

SweepMap restrict_to_row(const Quadratic& q, Index y) {
  const double b = (static_cast<double>(y) - q.offset[1]) / q.scale[1];
  SweepMap m{1 / q.scale[0], -q.offset[0] / q.scale[0], 1 / q.scale[2], q.offset[2], {}, {}};
  for (std::size_t k = 0; k < 2; ++k) {
    const auto& c = q.coeff[k];
    double* out = k == 0 ? m.u : m.v;
    out[0] = c[0] + b * (c[2] + b * c[7]);
    out[1] = c[1] + b * c[5];
    out[2] = c[4];
    out[3] = c[3] + b * c[8];
    out[4] = c[6];
    out[5] = c[9];
  }
  return m;
}

/// The kernel's view of reference rows, with the scratch of one thread's piece.
template <class T>
class RowWork {
 public:
  /// plane  numbers between the planes that are written forward
  RowWork(const Sweep<T>& sweep, const T* pixels, Index plane = 0)
      : sweep_(sweep), pixels_(pixels), maps_(sweep.J()), lines_(sweep.J()), taps_(sweep.J()) {
    const Index P = sweep.H * sweep.W, Cs = sweep.Cs;
    for (const Index j : sweep.sources) {
      sources_.push_back(pixels + j * sweep.H * sweep.row());
      if (!sweep.valid.empty()) valid_.push_back(sweep.valid.data() + j * P);
    }
    scratch_ = BasicTensor<T>({2 * kSweepTile + sweep.J(), Cs});
    pair_scratch_ = BasicTensor<T>(
        {kSweepTile * kPairStride + (kDistanceLanes + kSweepTile * kDistanceParts) * sweep.J()});
    T *tile = scratch_.data(), *pairs = pair_scratch_.data();
    s_ = {sweep.H,
          sweep.W,
          sweep.C,
          Cs,
          sweep.D,
          sweep.J(),
          maps_.data(),
          sources_.data(),
          valid_.empty() ? nullptr : valid_.data(),
          nullptr,
          sweep.reference_counts,
          nullptr,
          plane,
          nullptr,
          lines_.data(),
          taps_.data(),
          tile,
          tile + kSweepTile * Cs,
          tile + 2 * kSweepTile * Cs,
          pairs,
          pairs + kSweepTile * kPairStride,
          pairs + kSweepTile * kPairStride + kDistanceLanes * sweep.J()};
  }
  const SweepRow<T>& at_row(Index y) {
    for (std::size_t j = 0; j < maps_.size(); ++j) maps_[j] = restrict_to_row(sweep_.maps[j], y);
    s_.reference = pixels_ + (sweep_.reference * sweep_.H + y) * sweep_.row();
    s_.heights = sweep_.heights.data() + y * sweep_.W;
    if (sweep_.best) s_.best = sweep_.best.get() + y * sweep_.W;
    return s_;
  }

 private:
  const Sweep<T>& sweep_;
  const T* pixels_;
  std::vector<SweepMap> maps_;
  std::vector<SweepLines<T>> lines_;
  std::vector<SweepTaps<T>> taps_;
  std::vector<const T*> sources_, valid_;
  BasicTensor<T> scratch_, pair_scratch_;
  SweepRow<T> s_;
};

/// Source rows first..last of one view that a band of reference rows reads, and where their
/// gradients lie in the shared buffer.
struct Touched {
  std::int32_t first = 0, last = -1;
  Index offset = 0;

  Index rows() const { return last < first ? 0 : last - first + 1; }
};

/// Cuts the reference rows into bands. Each band scatters into rows of its own, which are then
/// added in the order of the bands, so the sums are the same for any number of threads.
struct Bands {
  Index height = 1, count = 1, J = 0, rows = 0;
  std::vector<Touched> touched;  // [count J]

  Bands(const std::vector<std::int32_t>& range, Index H, Index sources) : J(sources) {
    constexpr Index kMostBands = 32, kLeastHeight = 2;
    // copies of the source maps' gradients, unless there is one band only
    constexpr Index kMostCopies = 4;
    for (height = std::max(kLeastHeight, (H + kMostBands - 1) / kMostBands);; height *= 2) {
      cut(range, H);
      if (rows <= kMostCopies * J * H || count == 1) break;
    }
  }

 private:
  void cut(const std::vector<std::int32_t>& range, Index H) {
    count = (H + height - 1) / height;
    rows = 0;
    touched.assign(count * J, {});
    for (Index b = 0; b < count; ++b)
      for (Index j = 0; j < J; ++j) {
        Touched& t = touched[b * J + j];
        t.first = static_cast<std::int32_t>(H);
        for (Index y = b * height; y < std::min(H, (b + 1) * height); ++y) {
          t.first = std::min(t.first, range[2 * (y * J + j)]);
          t.last = std::max(t.last, range[2 * (y * J + j) + 1]);
        }
        t.offset = rows;
        rows += t.rows();
      }
  }
};

template <class T>
void add_gradient(const Sweep<T>& sweep, const std::vector<std::int32_t>& range, const T* features,
                  const T* g, T* d_features) {
  const Index H = sweep.H, W = sweep.W, C = sweep.C, J = sweep.J();
  const Bands bands(range, H, J);
  const BasicTensor<T> pixels = sweep.channels_last(features);
  auto partial = BasicTensor<T>::uninitialised({bands.rows, sweep.row()});

  const auto backward = active_kernels<SweepKernels<T>>().backward;
  for_each_index(bands.count, [&](Index b) {
    RowWork<T> work(sweep, pixels.data());
    std::vector<T*> d_sources;
    std::vector<std::int32_t> first;
    for (Index j = 0; j < J; ++j) {
      const Touched& t = bands.touched[b * J + j];
      d_sources.push_back(partial.data() + t.offset * sweep.row());
      std::fill_n(d_sources.back(), t.rows() * sweep.row(), T(0));
      first.push_back(t.first);
    }
    for (Index y = b * bands.height; y < std::min(H, (b + 1) * bands.height); ++y)
      backward(work.at_row(y), g + y * W, d_features + (sweep.reference * C * H + y) * W,
               d_sources.data(), first.data());
  });

  const auto add_rows = active_kernels<SweepKernels<T>>().add_rows;
  for_range(J * H, 4, [&](Index begin, Index end) {
    std::vector<const T*> rows;
    BasicTensor<T> tile({kSweepTile, sweep.Cs});
    for (Index r = begin; r < end; ++r) {
      const Index j = r / H, y = r % H;
      rows.clear();
      for (Index b = 0; b < bands.count; ++b)
        if (const Touched& t = bands.touched[b * J + j]; y >= t.first && y <= t.last)
          rows.push_back(partial.data() + (t.offset + y - t.first) * sweep.row());
      if (!rows.empty())
        add_rows(rows.data(), std::ssize(rows), W, C, sweep.Cs,
                 d_features + (sweep.sources[j] * C * H + y) * W, H * W, tile.data());
    }
  });
}

/// Throws ShapeError.
template <class T>
Sweep<T> checked_sweep(const BasicTensor<T>& features, Index reference,
                       const std::vector<Quadratic>& maps, const BasicTensor<T>& heights,
                       const BasicTensor<T>& valid, const SweepOptions& options) {
  Dims dim("plane_sweep_variance");
  dim.match("features", features, "N C H W").match("heights", heights, "D H W");
  if (!valid.empty()) dim.match("valid", valid, "N H W");
  Sweep<T> sweep{
      dim["N"],  dim["C"], dim["D"], dim["H"], dim["W"], channel_stride(dim["C"]),
      reference, {},       {},       heights,  valid,    options.include_reference ? T(1) : T(0),
      {}};
  const Index N = sweep.N;
  if (reference < 0 || reference >= N)
    throw ShapeError("plane_sweep_variance: reference is " + std::to_string(reference) +
                     ", expected one of " + std::to_string(N) + " views");
  if (std::ssize(maps) != N)
    throw ShapeError("plane_sweep_variance: " + std::to_string(maps.size()) +
                     " maps, expected one for each of " + std::to_string(N) + " views");
  for (Index j = 0; j < N; ++j) {
    if (j == reference) continue;
    sweep.sources.push_back(j);
    sweep.maps.push_back(maps[j]);
  }
  if (options.best_pair) {
    if (sweep.J() > std::numeric_limits<std::int8_t>::max())
      throw ShapeError("plane_sweep_variance: " + std::to_string(N) +
                       " views, expected 128 or fewer for the best pair");
    sweep.best = std::make_shared_for_overwrite<std::int8_t[]>(
        static_cast<std::size_t>(sweep.D * sweep.H * sweep.W));
  }
  return sweep;
}

template <class T>
Shape volume_shape(const Sweep<T>& sweep) {
  return {sweep.C + (sweep.best ? kPairChannels : 0), sweep.D, sweep.H, sweep.W};
}

/// Rows first .. last - 1 of the volume.
/// to, plane  as PlaneSweep::rows
/// range      [H J 2] takes the source rows that each of these reads, or nullptr
template <class T>
void sweep_rows(const Sweep<T>& sweep, const BasicTensor<T>& pixels, Index first, Index last, T* to,
                Index plane, std::int32_t* range) {
  const auto forward = active_kernels<SweepKernels<T>>().forward;
  for_range(last - first, 2, [&](Index begin, Index end) {
    RowWork<T> work(sweep, pixels.data(), plane);
    for (Index y = first + begin; y < first + end; ++y)
      forward(work.at_row(y), to + (y - first) * sweep.W,
              range == nullptr ? nullptr : range + 2 * sweep.J() * y);
  });
}

}  // namespace

template <class T>
BasicVar<T> plane_sweep_variance(const BasicVar<T>& features, Index reference,
                                 const std::vector<Quadratic>& maps, const BasicTensor<T>& heights,
                                 const BasicTensor<T>& valid, const SweepOptions& options) {
  Sweep<T> sweep = checked_sweep(features.value(), reference, maps, heights, valid, options);
  const Index H = sweep.H;
  auto out = BasicTensor<T>::uninitialised(volume_shape(sweep));
  std::vector<std::int32_t> range(2 * sweep.J() * H);  // source rows read by each reference row
  sweep_rows(sweep, sweep.channels_last(features.value().data()), 0, H, out.data(), H * sweep.W,
             range.data());
  return BasicVar<T>::record("plane_sweep_variance", out, {features},
                             [sweep = std::move(sweep), range = std::move(range)](Node<T>& n) {
                               if (T* df = n.grad_in(0))
                                 add_gradient(sweep, range, n.in(0), n.grad.data(), df);
                             });
}

template <class T>
PlaneSweep<T>::PlaneSweep(const BasicTensor<T>& features, Index reference,
                          const std::vector<Quadratic>& maps, const BasicTensor<T>& heights,
                          const BasicTensor<T>& valid, const SweepOptions& options)
    : sweep_(std::make_shared<const Sweep<T>>(
          checked_sweep(features, reference, maps, heights, valid, options))),
      pixels_(sweep_->channels_last(features.data())),
      shape_(volume_shape(*sweep_)) {}

template <class T>
void PlaneSweep<T>::rows(Index first, Index last, T* to, Index plane) const {
  sweep_rows(*sweep_, pixels_, first, last, to, plane, nullptr);
}

template class PlaneSweep<float>;
template class PlaneSweep<double>;

template BasicVar<float> plane_sweep_variance(const BasicVar<float>&, Index,
                                              const std::vector<Quadratic>&,
                                              const BasicTensor<float>&, const BasicTensor<float>&,
                                              const SweepOptions&);
template BasicVar<double> plane_sweep_variance(const BasicVar<double>&, Index,
                                               const std::vector<Quadratic>&,
                                               const BasicTensor<double>&,
                                               const BasicTensor<double>&, const SweepOptions&);

}  // namespace satsurf
