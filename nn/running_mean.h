// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/module.h"

#include <string>
#include <vector>

namespace satsurf::nn {

/// A running mean of the parameters over the steps of a training, which does better than the
/// parameters of any one step:
///   mean <- k mean + (1 - k) parameters,  k = min(keep, (1 + t) / (10 + t)) after t steps
/// Source: Polyak and Juditsky 1992, in the exponential form.
class RunningMean {
 public:
  /// Begins with the parameters as they are; keeps a reference to them, which must outlive this.
  /// keep  in [0, 1); 0 does nothing and keeps nothing
  RunningMean(ParameterSet<float>& parameters, double keep);

  /// Takes the parameters after a step in.
  void add();
  /// Exchanges the parameters and their mean: once to use the mean, once more to go on.
  void swap();

  /// The mean under `mean.` + parameter name, the number of steps as metadata `mean.steps`.
  void store(TensorFile& file) const;
  /// Takes it from a file that `store` filled.
  /// where   begins the error texts
  /// throws  IoError
  void load(const TensorFile& file, const std::string& where);

 private:
  ParameterSet<float>& parameters_;
  double keep_;
  Index steps_ = 0;
  std::vector<Tensor> mean_;
};

}  // namespace satsurf::nn
