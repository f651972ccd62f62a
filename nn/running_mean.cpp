// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/running_mean.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <utility>

namespace satsurf::nn {

RunningMean::RunningMean(ParameterSet<float>& parameters, double keep)
    : parameters_(parameters), keep_(keep) {
  if (keep_ <= 0) return;
  for (const auto& e : parameters_.entries()) mean_.push_back(e.var.value().clone());
}

void RunningMean::add() {
  ++steps_;
  const double t = static_cast<double>(steps_), k = std::min(keep_, (1 + t) / (10 + t));
  for (std::size_t i = 0; i < mean_.size(); ++i) {
    const Tensor& value = parameters_.entries()[i].var.value();
    for (Index j = 0; j < value.count(); ++j)
      mean_[i][j] = static_cast<float>(k * mean_[i][j] + (1 - k) * value[j]);
  }
}

void RunningMean::swap() {
  for (std::size_t i = 0; i < mean_.size(); ++i) {
    BasicVar<float> var = parameters_.entries()[i].var;
    std::swap(var.mutable_value(), mean_[i]);
  }
}

void RunningMean::store(TensorFile& file) const {
  for (std::size_t i = 0; i < mean_.size(); ++i)
    file.tensors["mean." + parameters_.entries()[i].name] = mean_[i].clone();
  file.metadata["mean.steps"] = std::to_string(steps_);
}

void RunningMean::load(const TensorFile& file, const std::string& where) {
  const auto steps = file.metadata.find("mean.steps");
  if (steps == file.metadata.end())
    throw IoError(where + ": no averaged weights, expected a checkpoint of a run that has them");
  char* end = nullptr;
  steps_ = std::strtol(steps->second.c_str(), &end, 10);
  if (end == steps->second.c_str() || *end != '\0' || steps_ < 0)
    throw IoError(where + ": mean.steps is '" + steps->second + "', expected a count");
  for (std::size_t i = 0; i < mean_.size(); ++i) {
    const std::string name = "mean." + parameters_.entries()[i].name;
    const auto it = file.tensors.find(name);
    if (it == file.tensors.end() || it->second.shape() != mean_[i].shape())
      throw IoError(where + ": " + name + " is missing or of another shape, expected " +
                    mean_[i].shape().str());
    if (!std::ranges::all_of(it->second.values(), [](float v) { return std::isfinite(v); }))
      throw IoError(where + ": " + name + " has a value that is not finite, expected weights");
    mean_[i] = it->second.clone();
  }
}

}  // namespace satsurf::nn
