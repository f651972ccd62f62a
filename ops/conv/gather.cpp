// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/conv/engine.h"
#include "satsurf/ops/conv/slab.h"
#include "satsurf/ops/conv/weights.h"
#include "satsurf/ops/conv/winograd.h"

#include <algorithm>
#include <vector>

namespace satsurf::conv {
namespace {

constexpr Index kPieces = 16;  // enough for some threads to balance

/// How outputs get from the sums to where they belong.
enum class Route {
  lines,   ///< to lines of the slab's layout first, which are then combined or interleaved
  direct,  ///< there at once: outputs stand like the slab's positions
  lanes,   ///< there at once, from vectors whose lanes are channels: columns need not be split
};

bool single_tap(const Geometry& g) {
  return g.taps() == 1 && g.x_size == g.y_size && g.stride == std::array<Index, 3>{1, 1, 1};
}

/// The same rows as planes of one row, some joined: planes are loaded while others are computed.
Geometry as_lines(Geometry g) {
  constexpr Index kLine = 1024;
  Index lines = g.x_size[0] * g.x_size[1], width = g.x_size[2];
  for (const Index factor : {2, 3, 5})
    while (lines % factor == 0 && width * factor <= kLine) {
      lines /= factor;
      width *= factor;
    }
  g.x_size = g.y_size = {lines, 1, width};
  return g;
}

template <class T>
Route correlation_route(const ConvKernels<T>& kernels, const Geometry& g) {
  if (single_tap(g) && g.y_size[2] % kernels.lanes == 0) return Route::direct;
  return kernels.keeps_channels_in_lanes && g.O >= kernels.lanes && g.stride[2] == 2 ? Route::lanes
                                                                                     : Route::lines;
}

/// Where outputs go and what else happens to them.
template <class T>
struct Result {
  const T* bias;  ///< [O], or nullptr
  T* out;
  bool accumulate;   ///< add to what is there
  Moments* moments;  ///< [O] of one piece, or nullptr
};

/// What a correlation and its adjoint share: O channels gathered from C channels.
template <class T>
class Gather {
 public:
  /// out_plane  elements between the planes of the output
  Gather(const ConvKernels<T>& kernels, Axes axes, const Geometry& g, Index C, Index O,
         const std::array<Index, 3>& out_size, Index out_plane, Route route)
      : kernels_(kernels),
        route_(route),
        block_(route == Route::lanes ? kernels.lanes : kConvBlock),
        axes_(route == Route::lines   ? with_mixed_rows(std::move(axes), g.B)
              : route == Route::lanes ? with_whole_columns(std::move(axes), g)
                                      : std::move(axes)),
        g_(g),
        kernel_(kernel_of(axes_, g)),
        B_(g.B),
        C_(C),
        O_(O),
        K_(kernel_[0] * kernel_[1] * kernel_[2]),
        out_size_(out_size),
        out_plane_(out_plane),
        phases_(list_phases(axes_, kernel_)) {}

  /// o_stride, c_stride  between the kernels of neighbouring outputs and channels, in kernels
  void run(const Input<T>& in, const T* weight, Index o_stride, Index c_stride, const T* bias,
           T* out, bool accumulate, ChannelMoments* moments) const {
    if (B_ == 0) return;
    const auto packed =
        packed_weights(g_, axes_, phases_, {O_, C_, o_stride, c_stride, block_}, weight);
    const Index planes = axes_[0].span();
    const Pieces pieces(B_, axes_, rows_in_cache<T>(axes_, C_, planes), kPieces);
    // of each piece's outputs, added up in the pieces' order
    std::vector<Moments> parts(moments == nullptr ? 0 : pieces.count() * O_);
    for_each_index(pieces.count(), [&](Index i) {
      const Piece piece = pieces[i];
      Slab<T> slab(kernels_, axes_, in, B_ * C_, C_, piece.rows, planes);
      slab.start(piece.b * C_, piece.row);
      run_piece(piece, slab, packed.data(),
                {bias, out, accumulate, parts.empty() ? nullptr : parts.data() + i * O_});
    });
    if (moments == nullptr) return;
    moments->assign(B_ * O_, {});
    for (Index i = 0; i < pieces.count(); ++i)
      for (Index o = 0; o < O_; ++o) (*moments)[pieces[i].b * O_ + o].merge(parts[i * O_ + o]);
  }

 private:
  /// Phases that fill the same output rows and are stored together: those that differ in the
  /// column only, or all mixes of the rows.
  Index joint_phases() const { return std::ssize((axes_[1].mixed ? axes_[1] : axes_[2]).phases); }

  void run_piece(const Piece& piece, Slab<T>& slab, const T* packed, const Result<T>& to) const {
    const Index depth_phases = std::ssize(axes_[0].phases);
    const Index width = ceil_div(piece.rows * slab.pitch(), kernels_.lanes) * kernels_.lanes;
    auto lines = BasicTensor<T>::uninitialised(
        {joint_phases(), kConvBlock, route_ == Route::lines ? width : 0});
    std::vector<Index> shifts(K_);
    for (Index m = piece.z; m < piece.z_end; ++m) {
      slab.load(m * axes_[0].input_phases, m * axes_[0].input_phases + axes_[0].span());
      for (std::size_t f = 0; f < phases_.size(); f += joint_phases()) {
        const PhaseTaps* phase = &phases_[f];
        const Index rows = std::min(piece.rows, phase->y->count - piece.row);
        if (m >= phase->z->count || rows <= 0) continue;
        const Index z = (phase->z - axes_[0].phases.data()) + m * depth_phases;
        set_shifts(phase, m, slab, shifts.data());
        for (Index o = 0; o < O_; o += block_) {
          const Index outputs = std::min(block_, O_ - o);
          prefetch_results(piece, *phase, z, rows, o, outputs, to.out);
          ConvGather<T> gather{.x = slab.data(),
                               .c_stride = slab.c_stride(),
                               .C = C_,
                               .shift = shifts.data(),
                               .taps = 0,
                               .weight = nullptr,
                               .bias = kNoBias,
                               .add = false,
                               .outputs = outputs,
                               .out = nullptr,
                               .out_stride = width};
          if (route_ != Route::lines) {
            gather_directly(piece, z, rows, o, slab, packed, to, gather);
            continue;
          }
          for (Index i = 0; i < joint_phases(); ++i) {
            const Index count = (rows - 1) * slab.pitch() + phase[i].x->count;
            gather.taps = std::ssize(phase[i].taps);
            gather.weight = packed + (o * K_ + phase[i].taps_before * kConvBlock) * C_;
            gather.out = lines.data() + i * kConvBlock * width;
            kernels_.gather(gather, count);
            gather.shift += gather.taps;
          }
          store(piece, *phase, z, rows, o, outputs, slab.pitch(), lines, to);
        }
      }
    }
  }

  void set_shifts(const PhaseTaps* phase, Index m, const Slab<T>& slab, Index* shift) const {
    for (Index f = 0; f < joint_phases(); ++f)
      for (const AxisTap& i : phase[f].z->taps)
        for (const AxisTap& j : phase[f].y->taps)
          for (const AxisTap& k : phase[f].x->taps) *shift++ = slab.shift(m, i, j, k);
  }

  /// Asks for the rows that `store` writes after the gathering: by then they are there.
  void prefetch_results(const Piece& piece, const PhaseTaps& phase, Index z, Index rows, Index o,
                        Index outputs, const T* out) const {
    const Index H = out_size_[1], W = out_size_[2], group = axes_[1].mixed ? winograd::kOutputs : 1;
    const Index step = axes_[1].mixed ? 1 : std::ssize(axes_[1].phases);
    const Index first = (axes_[1].mixed ? 0 : phase.first_row) + piece.row * group * step;
    const Index last = std::min(H, first + rows * group * step);
    for (Index i = o; i < o + outputs; ++i) {
      const T* plane = out + ((piece.b * O_ + i) * out_size_[0] + z) * out_plane_;
      if (step == 1) {
        prefetch(plane + first * W, plane + last * W);
        continue;
      }
      for (Index y = first; y < last; y += step) prefetch(plane + y * W, plane + (y + 1) * W);
    }
  }

  /// The routes without lines. They have one phase.
  void gather_directly(const Piece& piece, Index z, Index rows, Index o, const Slab<T>& slab,
                       const T* packed, const Result<T>& to, ConvGather<T>& gather) const {
    const Index W = out_size_[2], count = out_size_[0] * out_plane_;
    T* const first = to.out + (piece.b * O_ + o) * count + z * out_plane_ + piece.row * W;
    alignas(64) T start[kMostLanes] = {};
    if (to.bias != nullptr) std::copy_n(to.bias + o, gather.outputs, start);
    gather.taps = K_;
    gather.weight = packed + o * K_ * C_;
    gather.bias = start;
    gather.add = to.accumulate;
    gather.out = first;
    gather.out_stride = count;
    for (Index r = 0; r < rows; ++r, gather.x += slab.pitch(), gather.out += W) {
      if (route_ == Route::lanes)
        kernels_.gather_in_lanes(gather, W, g_.stride[2]);
      else
        kernels_.gather(gather, W);
    }
    if (to.moments == nullptr) return;
    for (Index i = 0; i < gather.outputs; ++i)
      add_moments(first + i * count, rows * W, to.moments[o + i]);
  }

  void store(const Piece& piece, const PhaseTaps& phase, Index z, Index rows, Index o,
             Index outputs, Index pitch, const BasicTensor<T>& lines, const Result<T>& to) const {
    const Index H = out_size_[1], W = out_size_[2];
    const Index row_phases = axes_[1].mixed ? 1 : std::ssize(axes_[1].phases);
    const Index width = lines.dim(2), phase_stride = kConvBlock * width;
    for (Index i = 0; i < outputs; ++i) {
      T* plane = to.out + ((piece.b * O_ + o + i) * out_size_[0] + z) * out_plane_;
      const T b = to.bias == nullptr ? T(0) : to.bias[o + i];
      for (Index r = 0; r < rows; ++r) {
        const T* line = lines.data() + i * width + r * pitch;
        if (axes_[1].mixed) {
          const Index y = (piece.row + r) * winograd::kOutputs;
          kernels_.rows.mix_output(line, phase_stride, b, to.accumulate, plane + y * W, W,
                                   std::min(winograd::kOutputs, H - y), W);
        } else {
          const Index y = phase.first_row + (piece.row + r) * row_phases;
          kernels_.rows.store(line, phase_stride, lines.dim(0), b, to.accumulate, plane + y * W, W);
        }
      }
      if (to.moments == nullptr) continue;
      const Index group = axes_[1].mixed ? winograd::kOutputs : 1;
      const Index first = phase.first_row + piece.row * group * row_phases;
      if (row_phases == 1) {
        add_moments(plane + first * W, std::min(rows * group, H - first) * W, to.moments[o + i]);
        continue;
      }
      for (Index r = 0; r < rows; ++r)
        add_moments(plane + (first + r * row_phases) * W, W, to.moments[o + i]);
    }
  }

  /// About the first element, so that nothing cancels where the mean is large.
  void add_moments(const T* x, Index n, Moments& moments) const {
    double sums[2];
    kernels_.rows.sums(n, x, x[0], sums);
    moments.merge(Moments::about(x[0], static_cast<double>(n), sums[0], sums[1]));
  }

  static constexpr Index kMostLanes = 64 / static_cast<Index>(sizeof(T));
  static constexpr T kNoBias[kConvBlock] = {};

  const ConvKernels<T>& kernels_;
  const Route route_;
  const Index block_;  ///< outputs whose weights stand next to each other
  const Axes axes_;
  const Geometry& g_;
  const std::array<Index, 3> kernel_;
  const Index B_, C_, O_, K_;
  const std::array<Index, 3> out_size_;
  const Index out_plane_;
  const std::vector<PhaseTaps> phases_;
};

}  // namespace

template <class T>
void correlate(const ConvKernels<T>& kernels, const Geometry& g, const Input<T>& x, const T* weight,
               const T* bias, T* y, bool accumulate, ChannelMoments* moments, Index y_plane) {
  const Geometry shape = single_tap(g) && y_plane == 0 ? as_lines(g) : g;
  const Gather<T> gather(kernels, correlation_axes(shape), shape, g.C, g.O, shape.y_size,
                         y_plane > 0 ? y_plane : shape.y_size[1] * shape.y_size[2],
                         correlation_route(kernels, shape));
  gather.run(x, weight, g.C, 1, bias, y, accumulate, moments);
}

template <class T>
void correlate_adjoint(const ConvKernels<T>& kernels, const Geometry& g, const Input<T>& y,
                       const T* weight, const T* bias, T* x, bool accumulate,
                       ChannelMoments* moments) {
  const Geometry shape = single_tap(g) ? as_lines(g) : g;
  const Route route = single_tap(g) ? correlation_route(kernels, shape) : Route::lines;
  const Gather<T> gather(kernels, adjoint_axes(shape), shape, g.O, g.C, shape.x_size,
                         shape.x_size[1] * shape.x_size[2], route);
  gather.run(y, weight, 1, g.C, bias, x, accumulate, moments);
}

template void correlate(const ConvKernels<float>&, const Geometry&, const Input<float>&,
                        const float*, const float*, float*, bool, ChannelMoments*, Index);
template void correlate(const ConvKernels<double>&, const Geometry&, const Input<double>&,
                        const double*, const double*, double*, bool, ChannelMoments*, Index);
template void correlate_adjoint(const ConvKernels<float>&, const Geometry&, const Input<float>&,
                                const float*, const float*, float*, bool, ChannelMoments*);
template void correlate_adjoint(const ConvKernels<double>&, const Geometry&, const Input<double>&,
                                const double*, const double*, double*, bool, ChannelMoments*);

}  // namespace satsurf::conv
