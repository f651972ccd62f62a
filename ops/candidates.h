// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

// One height out of a few candidates per cell, how unsure it is, and the losses that teach both.

namespace satsurf {

/// A height for every cell: the candidates by their weights, plus what is left.
///   h = sum_k w_k z_k + reach tanh(r),  w = softmax of the logits of the candidates there are
/// so that most of a height is chosen, and only what is smaller than `reach` is made up. Where a cell
/// has no candidate h is 0.
/// logits      [K H W], K at most 16; may be anything where there is no candidate
/// residual    [H W] r
/// candidates  [K H W] m, NaN where there is none; they carry no gradient
/// reach       m
/// returns     [H W] m
/// throws      ShapeError
template <class T>
BasicVar<T> chosen_height(const BasicVar<T>& logits, const BasicVar<T>& residual,
                          const BasicTensor<T>& candidates, double reach);

/// The mean error b that a number s tells of: unit exp(s), with s limited to [-4, 5], a fiftieth of a
/// unit to a hundred and fifty.
double laplace_scale(double log_scale, double unit);

/// Weighted mean of the negative log-likelihood of the truth under Laplace distributions,
///   |h - t| / b + log(2 b),  b as `laplace_scale`,
/// the one that teaches a height and its own mean error b at once.
/// height, log_scale  [H W] h in m, s
/// truth              [H W] m; may be anything where the weight is 0
/// weight             [H W]
/// unit               m
/// returns            a scalar, with lengths in units: log(2 b / unit); 0 where nothing counts
/// throws             ShapeError
/// Source: Stucker and Schindler 2022 (ResDepth) for the residual; Kendall and Gal 2017, eq. 5, for
/// the likelihood.
template <class T>
BasicVar<T> laplace_loss(const BasicVar<T>& height, const BasicVar<T>& log_scale,
                         const BasicTensor<T>& truth, const BasicTensor<T>& weight, double unit);

/// Weighted mean of
///   [e <= sigma] - two [e <= 2 sigma],   e = |h - t|,  sigma = times b,  b as `laplace_scale`,
/// where [e <= s] is smooth, 1 / (1 + (e / s)^(1 / 0.15)). It is least where of all cells that look alike
/// as few as possible have their error within sigma and as many as possible within two, so that it keeps
/// the errors between those; for normal errors and two = exp(1.5) / 2 at their standard deviation. Unlike
/// the likelihood it does not mind how far beyond the others are.
/// height             [H W] m; carries no gradient
/// log_scale          [H W]
/// truth, weight      [H W], as above
/// unit               m
/// times              above 0
/// two                above 1
/// returns            a scalar; 0 where nothing counts
/// throws             ShapeError
template <class T>
BasicVar<T> sigma_loss(const BasicTensor<T>& height, const BasicVar<T>& log_scale,
                       const BasicTensor<T>& truth, const BasicTensor<T>& weight, double unit,
                       double times, double two);

/// Weighted mean of the cross-entropy between the weights of `chosen_height` and a target that falls
/// off with a candidate's distance from the truth:
///   -sum_k q_k log w_k,  q_k ~ exp(-|z_k - t| / unit)
/// which says which candidate it should have been where the height alone does not, since the mean of
/// two wrong ones can be right. Cells farther than 4 units from every candidate do not count.
/// logits, candidates  as above
/// truth, weight       [H W], as above
/// unit                m
/// returns             a scalar; 0 where nothing counts
/// throws              ShapeError
template <class T>
BasicVar<T> candidate_cross_entropy(const BasicVar<T>& logits, const BasicTensor<T>& candidates,
                                    const BasicTensor<T>& truth, const BasicTensor<T>& weight,
                                    double unit);

}  // namespace satsurf
