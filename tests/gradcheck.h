// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/rng.h"
#include "satsurf/core/var.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include <doctest/doctest.h>

namespace satsurf::test {

/// Standard normals; every test names its own seed.
inline BasicTensor<double> normal(const Shape& shape, std::uint64_t seed, double sigma = 1.0) {
  Rng rng(seed);
  auto t = normal_tensor<double>(shape, rng);
  for (double& v : t.values()) v *= sigma;
  return t;
}

/// Moves every element at least `distance` away from `kink`, for ops that are not differentiable
/// there.
inline BasicTensor<double> away_from(BasicTensor<double> t, double kink, double distance) {
  for (double& v : t.values())
    if (std::abs(v - kink) < distance) v = v < kink ? kink - distance : kink + distance;
  return t;
}

struct GradcheckOptions {
  double tolerance = 1e-6;        ///< |analytic - numeric| / max(1, |analytic|, |numeric|)
  double step = 1e-6;             ///< times max(1, |x|)
  std::set<std::size_t> zero_ok;  ///< inputs whose gradient may vanish altogether
  std::uint64_t seed = 99;        ///< of the random cotangent
};

struct GradcheckReport {
  bool ok = true;
  std::string text;
  explicit operator bool() const { return ok; }
};

inline std::ostream& operator<<(std::ostream& out, const GradcheckReport& r) {
  return out << r.text;
}
inline doctest::String toString(const GradcheckReport& r) { return r.text.c_str(); }

using DoubleVars = std::vector<BasicVar<double>>;

/// Compares the backward pass of `f` in double with central differences of <cotangent, f(x)>,
/// element by element. Fails too where an input's gradient is all zero without being declared so:
/// tolerances alone would let a forgotten gradient pass.
inline GradcheckReport gradcheck(const std::function<BasicVar<double>(const DoubleVars&)>& f,
                                 const std::vector<BasicTensor<double>>& inputs,
                                 const GradcheckOptions& opt = {}) {
  DoubleVars vars;
  for (const auto& t : inputs) vars.emplace_back(t.clone(), true);
  const BasicVar<double> out = f(vars);
  Rng rng(opt.seed);
  const auto cotangent = normal_tensor<double>(out.shape(), rng);
  out.backward(cotangent);

  const auto objective = [&] {
    const NoGrad no_grad;
    const BasicVar<double> y = f(vars);
    double sum = 0;
    for (Index i = 0; i < y.count(); ++i) sum += cotangent[i] * y.value()[i];
    return sum;
  };
  GradcheckReport report;
  std::ostringstream text;
  double worst = -1;
  for (std::size_t k = 0; k < vars.size(); ++k) {
    auto& x = vars[k].mutable_value();
    bool all_zero = true;
    for (Index i = 0; i < x.count(); ++i) {
      const double saved = x[i], h = opt.step * std::max(1.0, std::abs(saved));
      x[i] = saved + h;
      const double up = objective();
      x[i] = saved - h;
      const double down = objective();
      x[i] = saved;
      const double numeric = (up - down) / (2 * h),
                   analytic = vars[k].grad().empty() ? 0.0 : vars[k].grad()[i];
      all_zero = all_zero && analytic == 0.0;
      const double error =
          std::abs(analytic - numeric) / std::max({1.0, std::abs(analytic), std::abs(numeric)});
      if (!(error <= worst)) {
        worst = error;
        text.str("");
        text << "input " << k << " element " << i << ": analytic " << analytic << ", numeric "
             << numeric << ", rel. error " << error;
        report.ok = report.ok && error <= opt.tolerance;
      }
    }
    if (all_zero && x.count() > 0 && !opt.zero_ok.contains(k)) {
      report.ok = false;
      report.text = "input " + std::to_string(k) + ": the whole gradient is zero";
      return report;
    }
  }
  report.text = text.str();
  return report;
}

}  // namespace satsurf::test
