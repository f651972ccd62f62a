// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/rng.h"
#include "satsurf/core/var.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
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
  double tolerance = 1e-6;        ///< |analytic - numeric| / largest gradient of that input
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
/// element by element. An error counts relative to the largest gradient of its input, however small
/// that is (a mean's are 1 / N), less what rounding alone does to the difference. Fails too where an
/// input's gradient is all zero without being declared so: tolerances alone would let a forgotten
/// gradient pass. And fails where a second pass does not add the same again.
/// f     reads `vars`, which have no gradient yet, as the parameters of a layer are
inline GradcheckReport gradcheck_of(const std::function<BasicVar<double>()>& f, DoubleVars vars,
                                    const GradcheckOptions& opt = {}) {
  const BasicVar<double> out = f();
  Rng rng(opt.seed);
  const auto cotangent = normal_tensor<double>(out.shape(), rng);
  std::vector<BasicTensor<double>> once;
  {
    const NanGuard guard;  // elements of new gradients that backward leaves out are NaN
    out.backward(cotangent);
    for (const auto& v : vars) once.push_back(v.grad().clone());
    f().backward(cotangent);  // adds
  }

  double magnitude = 0;  // sum of |terms| of the objective: what its rounding error scales with
  const auto objective = [&] {
    const NoGrad no_grad;
    const BasicVar<double> y = f();
    double sum = 0;
    magnitude = 0;
    for (Index i = 0; i < y.count(); ++i) {
      sum += cotangent[i] * y.value()[i];
      magnitude += std::abs(cotangent[i] * y.value()[i]);
    }
    return sum;
  };
  GradcheckReport report;
  std::ostringstream text;
  double worst = -1;
  for (std::size_t k = 0; k < vars.size(); ++k) {
    auto& x = vars[k].mutable_value();
    const auto count = static_cast<std::size_t>(x.count());
    std::vector<double> numeric(count), analytic(count), rounding(count);
    constexpr double kNone = std::numeric_limits<double>::min();
    double scale = kNone;
    bool all_zero = true;
    for (std::size_t e = 0; e < count; ++e) {
      const auto i = static_cast<Index>(e);
      const double saved = x[i], h = opt.step * std::max(1.0, std::abs(saved));
      x[i] = saved + h;
      const double up = objective();
      x[i] = saved - h;
      const double down = objective();
      x[i] = saved;
      numeric[e] = (up - down) / (2 * h);
      analytic[e] = once[k].empty() ? 0.0 : once[k][i];
      rounding[e] = 4 * std::numeric_limits<double>::epsilon() * magnitude / h;
      scale = std::max({scale, std::abs(analytic[e]), std::abs(numeric[e]) - rounding[e]});
      all_zero = all_zero && analytic[e] == 0.0;
    }
    for (std::size_t e = 0; e < count && !once[k].empty(); ++e) {
      const double twice = vars[k].grad()[static_cast<Index>(e)];
      if (std::abs(twice - 2 * analytic[e]) <= 1e-9 * scale) continue;
      report.ok = false;
      report.text = "input " + std::to_string(k) + " element " + std::to_string(e) +
                    ": a second pass makes " + std::to_string(analytic[e]) + " " +
                    std::to_string(twice);
      return report;
    }
    for (std::size_t e = 0; e < count; ++e) {
      // the cap keeps a noisy objective from excusing a wrong gradient
      const double excused = scale > kNone ? std::min(rounding[e], 1e-5 * scale) : rounding[e];
      const double error = (std::abs(analytic[e] - numeric[e]) - excused) / scale;
      if (!(error <= worst)) {
        worst = error;
        text.str("");
        text << "input " << k << " element " << e << ": analytic " << analytic[e] << ", numeric "
             << numeric[e] << ", error " << error << " of the input's largest gradient";
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

/// The same for a function of its own inputs.
inline GradcheckReport gradcheck(const std::function<BasicVar<double>(const DoubleVars&)>& f,
                                 const std::vector<BasicTensor<double>>& inputs,
                                 const GradcheckOptions& opt = {}) {
  DoubleVars vars;
  for (const auto& t : inputs) vars.emplace_back(t.clone(), true);
  return gradcheck_of([&] { return f(vars); }, vars, opt);
}

}  // namespace satsurf::test
