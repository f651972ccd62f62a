// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/module.h"

#include <vector>

namespace satsurf::nn {

/// Settings of AdamW besides the learning rate.
struct AdamWOptions {
  /// What the running means of the gradient and of its square keep from step to step, and what is
  /// added to the root of the latter.
  double beta1 = 0.9, beta2 = 0.999, epsilon = 1e-8;
  double weight_decay = 0.01;  ///< decoupled; only for parameters that decay
};

/// Adam with decoupled weight decay.
/// Source: Loshchilov and Hutter 2019, algorithm 2 (the decay multiplies the learning rate).
class AdamW {
 public:
  /// Keeps a reference to `parameters`, which must outlive this object; moments start at zero.
  AdamW(ParameterSet<float>& parameters, const AdamWOptions& options);

  /// One update from the parameters' gradients; a parameter without a gradient stays as it is, its
  /// moments too.
  void step(double lr);
  /// Updates made so far.
  Index steps() const { return steps_; }

  /// State under `adam.m.` and `adam.v.` + parameter name; the step count is metadata `adam.steps`.
  void store(TensorFile& file) const;
  /// Takes the state from a file that `store` filled.
  /// where   begins the error texts
  /// throws  IoError
  void load(const TensorFile& file, const std::string& where);

 private:
  ParameterSet<float>& parameters_;
  AdamWOptions options_;
  std::vector<Tensor> m_, v_;
  Index steps_ = 0;
};

/// Square root of the sum of all squared gradients, in a fixed order.
double gradient_norm(const ParameterSet<float>& parameters);
/// Multiplies every gradient so that the norm is at most `limit`.
/// returns  the norm before
double clip_gradient_norm(ParameterSet<float>& parameters, double limit);

/// One-cycle learning rate: a cosine from peak/25 up to the peak at `warmup` * steps, then a cosine
/// down to peak/1e4 at the last step.
/// Source: Smith and Topin 2018, with cosines.
/// peak     largest learning rate
/// warmup   share of the steps before the peak
/// step     counts from 0
/// steps    of the whole run
/// returns  the learning rate of that step
double one_cycle_lr(double peak, double warmup, Index step, Index steps);

}  // namespace satsurf::nn
