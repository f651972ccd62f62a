// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/module.h"

#include <vector>

namespace satsurf::nn {

struct AdamWOptions {
  double beta1 = 0.9, beta2 = 0.999, epsilon = 1e-8;
  double weight_decay = 0.01;  ///< decoupled; only for parameters that decay
};

/// Adam with decoupled weight decay.
/// Source: Loshchilov and Hutter 2019, algorithm 2 (the decay multiplies the learning rate).
class AdamW {
 public:
  AdamW(ParameterSet<float>& parameters, const AdamWOptions& options);

  /// One update from the parameters' gradients; a parameter without a gradient stays, its moments
  /// too.
  void step(double lr);
  Index steps() const { return steps_; }

  /// State under `adam.m.` and `adam.v.` + parameter name; the step count is metadata `adam.steps`.
  void store(TensorFile& file) const;
  /// throws IoError
  void load(const TensorFile& file, const std::string& where);

 private:
  ParameterSet<float>& parameters_;
  AdamWOptions options_;
  std::vector<Tensor> m_, v_;
  Index steps_ = 0;
};

/// Square root of the sum of all squared gradients, in a fixed order.
double gradient_norm(const ParameterSet<float>& parameters);
/// Multiplies every gradient so that the norm is at most `limit`; returns the norm before.
double clip_gradient_norm(ParameterSet<float>& parameters, double limit);

/// One-cycle learning rate: a cosine from peak/25 up to the peak at `warmup` * steps, then a cosine
/// down to peak/1e4 at the last step. Source: Smith and Topin 2018, with cosines. step counts from
/// 0.
double one_cycle_lr(double peak, double warmup, Index step, Index steps);

}  // namespace satsurf::nn
