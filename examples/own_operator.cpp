// SPDX-License-Identifier: Apache-2.0
// An operator of one's own with its gradient: a polynomial, checked against differences and then
// fitted to a curve. Needs nothing but satsurf::engine.
#include <cmath>
#include <cstdio>
#include <numbers>

#include <satsurf/engine.h>

using namespace satsurf;

namespace {

/// y_n = sum_k c_k x_n^k
/// coefficients  [K]
/// at            [N]
/// returns       [N]
template <class T>
BasicVar<T> polynomial(const BasicVar<T>& coefficients, const BasicVar<T>& at) {
  Dims dim("polynomial");
  dim.match("coefficients", coefficients, "K").match("at", at, "N");
  const Index K = dim["K"], N = dim["N"];
  BasicTensor<T> y({N});
  for (Index n = 0; n < N; ++n)
    for (Index k = K; k-- > 0;) y[n] = y[n] * at.value()[n] + coefficients.value()[k];

  return BasicVar<T>::record("polynomial", y, {coefficients, at}, [K, N](Node<T>& node) {
    const T *g = node.grad.data(), *c = node.in(0), *x = node.in(1);
    if (T* dc = node.grad_in(0))  // dy_n/dc_k = x_n^k; a gradient is added, never assigned
      for (Index n = 0; n < N; ++n) {
        T power = 1;
        for (Index k = 0; k < K; ++k, power *= x[n]) dc[k] += g[n] * power;
      }
    if (T* dx = node.grad_in(1))  // dy_n/dx_n = sum_k k c_k x_n^(k-1)
      for (Index n = 0; n < N; ++n) {
        T slope = 0;
        for (Index k = K; k-- > 1;) slope = slope * x[n] + static_cast<T>(k) * c[k];
        dx[n] += g[n] * slope;
      }
  });
}

/// The largest difference between the gradient of sum(y^2) by one input, as the operator says, and
/// what central differences say. In double, or the differences would be mostly rounding.
/// input  0 for c, 1 for x
double gradient_error(int input) {
  Rng rng(3);
  BasicVar<double> inputs[] = {BasicVar<double>(normal_tensor<double>({4}, rng), input == 0),
                               BasicVar<double>(normal_tensor<double>({6}, rng), input == 1)};
  const auto objective = [&] {
    const auto y = polynomial(inputs[0], inputs[1]);
    return sum(y * y);
  };
  objective().backward();
  double worst = 0;
  for (Index i = 0; i < inputs[input].count(); ++i) {
    double& value = inputs[input].mutable_value()[i];
    const double was = value, step = 1e-6;
    value = was + step;
    const double above = objective().value().item();
    value = was - step;
    const double below = objective().value().item();
    value = was;
    worst = std::max(worst, std::abs((above - below) / (2 * step) - inputs[input].grad()[i]));
  }
  return worst;
}

/// Root mean square error of a cubic that is fitted to half a period of a sine.
double fit() {
  constexpr Index kPoints = 64, kSteps = 400;
  Tensor x({kPoints}), y({kPoints});
  for (Index n = 0; n < kPoints; ++n) {
    x[n] = static_cast<float>(2 * n + 1 - kPoints) / kPoints;
    y[n] = std::sin(0.5F * std::numbers::pi_v<float> * x[n]);
  }
  nn::ParameterSet<float> parameters(0);
  const Var c = parameters.create("c", {4}, nn::Init::constant(0), false);
  nn::AdamW adam(parameters, {.weight_decay = 0});
  Var loss;
  for (Index step = 0; step < kSteps; ++step) {
    loss = mse(polynomial(c, Var(x)), y, {});
    parameters.clear_grads();
    loss.backward();
    adam.step(nn::one_cycle_lr(0.1, 0.1, step, kSteps));
  }
  const auto k = [&](Index i) { return static_cast<double>(c.value()[i]); };
  std::printf("sin(pi x / 2) is nearly %.3f + %.3f x + %.3f x^2 + %.3f x^3\n", k(0), k(1), k(2),
              k(3));
  return std::sqrt(static_cast<double>(loss.value().item()));
}

}  // namespace

int main() {
  const double by_c = gradient_error(0), by_x = gradient_error(1);
  std::printf("gradient against differences: %.1e by c, %.1e by x\n", by_c, by_x);
  const double error = fit();
  std::printf("root mean square error of the fit: %.4f\n", error);
  return by_c < 1e-5 && by_x < 1e-5 && error < 0.02 ? 0 : 1;
}
