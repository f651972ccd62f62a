// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/adamw.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace satsurf::nn {

AdamW::AdamW(ParameterSet<float>& parameters, const AdamWOptions& options)
    : parameters_(parameters), options_(options) {
  for (const auto& e : parameters_.entries()) {
    m_.emplace_back(e.var.shape());
    v_.emplace_back(e.var.shape());
  }
}

void AdamW::step(double lr) {
  ++steps_;
  const double t = static_cast<double>(steps_);
  const double correct1 = 1 - std::pow(options_.beta1, t),
               correct2 = 1 - std::pow(options_.beta2, t);
  for (std::size_t k = 0; k < m_.size(); ++k) {
    const auto& entry = parameters_.entries()[k];
    BasicVar<float> var = entry.var;
    if (var.grad().empty()) continue;
    const double decay = entry.decays ? 1 - lr * options_.weight_decay : 1;
    float* p = var.mutable_value().data();
    const float* g = var.grad().data();
    for (Index i = 0; i < var.count(); ++i) {
      m_[k][i] = static_cast<float>(options_.beta1 * m_[k][i] + (1 - options_.beta1) * g[i]);
      v_[k][i] = static_cast<float>(options_.beta2 * v_[k][i] + (1 - options_.beta2) * g[i] * g[i]);
      const double update =
          m_[k][i] / correct1 / (std::sqrt(v_[k][i] / correct2) + options_.epsilon);
      p[i] = static_cast<float>(decay * p[i] - lr * update);
    }
  }
}

void AdamW::store(TensorFile& file) const {
  for (std::size_t k = 0; k < m_.size(); ++k) {
    const std::string& name = parameters_.entries()[k].name;
    file.tensors["adam.m." + name] = m_[k].clone();
    file.tensors["adam.v." + name] = v_[k].clone();
  }
  file.metadata["adam.steps"] = std::to_string(steps_);
}

void AdamW::load(const TensorFile& file, const std::string& where) {
  const auto take = [&](const std::string& name, Tensor& into, bool is_square) {
    const auto it = file.tensors.find(name);
    if (it == file.tensors.end() || it->second.shape() != into.shape())
      throw IoError(where + ": optimiser state " + name +
                    " is missing or of another shape, expected " + into.shape().str());
    if (!std::ranges::all_of(it->second.values(),
                             [&](float v) { return std::isfinite(v) && (!is_square || v >= 0); }))
      throw IoError(where + ": optimiser state " + name + " has a value that is " +
                    (is_square ? "negative or " : "") + "not finite, expected moments");
    into = it->second.clone();
  };
  const auto steps = file.metadata.find("adam.steps");
  if (steps == file.metadata.end())
    throw IoError(where + ": no optimiser state, expected a training checkpoint");
  for (std::size_t k = 0; k < m_.size(); ++k) {
    const std::string& name = parameters_.entries()[k].name;
    take("adam.m." + name, m_[k], false);
    take("adam.v." + name, v_[k], true);
  }
  char* end = nullptr;
  steps_ = std::strtol(steps->second.c_str(), &end, 10);
  if (end == steps->second.c_str() || *end != '\0' || steps_ < 0)
    throw IoError(where + ": adam.steps is '" + steps->second + "', expected a count");
}

double gradient_norm(const ParameterSet<float>& parameters) {
  double sum = 0;
  for (const auto& e : parameters.entries())
    for (const float g : e.var.grad().values()) sum += static_cast<double>(g) * g;
  return std::sqrt(sum);
}

double clip_gradient_norm(ParameterSet<float>& parameters, double limit) {
  const double norm = gradient_norm(parameters);
  if (norm > limit)
    for (const auto& e : parameters.entries()) {
      BasicVar<float> var = e.var;
      for (float& g : var.mutable_grad().values()) g = static_cast<float>(g * (limit / norm));
    }
  return norm;
}

double one_cycle_lr(double peak, double warmup, Index step, Index steps) {
  constexpr double kStartDivisor = 25, kEndDivisor = 1e4;
  const auto cosine = [](double from, double to, double t) {
    return to + (from - to) * 0.5 * (1 + std::cos(std::numbers::pi * std::clamp(t, 0.0, 1.0)));
  };
  const double rise = std::max(1.0, warmup * static_cast<double>(steps)),
               now = static_cast<double>(step);
  if (now < rise) return cosine(peak / kStartDivisor, peak, now / rise);
  const double fall = std::max(1.0, static_cast<double>(steps) - 1 - rise);
  return cosine(peak, peak / kEndDivisor, (now - rise) / fall);
}

}  // namespace satsurf::nn
