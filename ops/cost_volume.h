// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/core/var.h"

#include <memory>
#include <vector>

namespace satsurf {

namespace detail {
template <class T>
struct Sweep;
}

/// What a plane sweep measures.
struct SweepOptions {
  bool include_reference = true;  ///< false: the variance is over the other views alone
  /// A view in which a point is hidden spoils the variance of all. With this the volume has
  /// kPairChannels more channels, about the other view b that looks most like the reference there:
  ///   4 / C sum_{c mod 4 = k} (f_ref,c - f_b,c)^2  for k = 0 .. 3,  b the least of their sums,
  /// and, without gradient, the share of the other views that see the point. All are 0 where none
  /// does. Source: after Kang et al. 2001, who take the better half of the views.
  bool best_pair = false;
};
inline constexpr Index kPairChannels = 5;

/// Plane-sweep variance volume of one reference view. For every reference pixel and height
/// hypothesis, the features of the other views are sampled bilinearly at the transferred pixel and
/// the variance per channel is taken over the views that see the point:
///   V = (sum_j m_j f_j^2) / n - ((sum_j m_j f_j) / n)^2,   n = sum_j m_j
/// m_j = 1 if the transferred pixel lies inside view j (0 <= x <= W-1, likewise y) and its nearest
/// pixel is valid; the reference itself always counts. Where n < 2 the variance is 0. The gradient
/// flows to the features, not to heights or sampling positions.
/// Source: Yao et al. 2018 (MVSNet), eq. 2, with RPC transfer by quadratics and counts per sample
/// (ours).
/// features           [N C H W], one map per view
/// reference          index of the reference view
/// maps               N entries; maps[j](x, y, z) is the pixel in view j of reference pixel (x, y)
///                    at height z, both in pixels of these maps; entry `reference` is ignored
/// heights            [D H W] hypotheses, m, in the frame of the maps
/// valid              [N H W], 1 where a pixel may be sampled; empty for everywhere
/// returns            [C D H W], and with `best_pair` kPairChannels more of them
/// throws             ShapeError
/// memory             nothing is kept of the warps but which pair was the best: backward computes
///                    them again
template <class T>
BasicVar<T> plane_sweep_variance(const BasicVar<T>& features, Index reference,
                                 const std::vector<Quadratic>& maps, const BasicTensor<T>& heights,
                                 const BasicTensor<T>& valid, const SweepOptions& options = {});

/// The same volume without a tape, for who reads it once and does not want it whole: it is the
/// largest tensor of all.
template <class T>
class PlaneSweep {
 public:
  /// Arguments and errors are those of `plane_sweep_variance`.
  PlaneSweep(const BasicTensor<T>& features, Index reference, const std::vector<Quadratic>& maps,
             const BasicTensor<T>& heights, const BasicTensor<T>& valid,
             const SweepOptions& options = {});
  /// [C D H W] of the volume, C with those of the best pair.
  const Shape& shape() const { return shape_; }
  /// Computes the rows from `first` to before `last`.
  /// to     where row `first` of the first plane goes
  /// plane  numbers between the planes there
  void rows(Index first, Index last, T* to, Index plane) const;

 private:
  std::shared_ptr<const detail::Sweep<T>> sweep_;
  BasicTensor<T> pixels_;
  Shape shape_;
};

}  // namespace satsurf
