// SPDX-License-Identifier: Apache-2.0
// Operators and optimiser against values from PyTorch, see golden/make_golden.py.
#include "satsurf/core/safetensors.h"
#include "satsurf/nn/adamw.h"
#include "satsurf/ops/conv/conv.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/loss.h"
#include "satsurf/ops/norm.h"
#include "satsurf/ops/resize.h"
#include "satsurf/ops/softmax.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include "tests/paths.h"
#include <doctest/doctest.h>

using namespace satsurf;

namespace {

const TensorFile& golden() {
  static const TensorFile file =
      load_safetensors(test::tests_folder() / "golden" / "golden.safetensors");
  return file;
}

template <class T>
BasicTensor<T> golden(const std::string& name) {
  CAPTURE(name);
  const auto found = golden().doubles.find(name);
  REQUIRE(found != golden().doubles.end());
  return found->second.template cast<T>();
}

/// Largest difference, relative to the largest value.
template <class T>
double difference(const BasicTensor<T>& a, const BasicTensor<T>& b) {
  REQUIRE(a.shape() == b.shape());
  double worst = 0, largest = 1e-300;
  for (Index i = 0; i < a.count(); ++i) {
    worst = std::max(worst, std::abs(static_cast<double>(a[i]) - static_cast<double>(b[i])));
    largest = std::max(largest, std::abs(static_cast<double>(b[i])));
  }
  return worst / largest;
}

/// Output and gradients of one case, in one precision.
template <class T, class F>
void compare(const std::string& name, const std::vector<std::string>& inputs, const F& f) {
  CAPTURE(name);
  const double tolerance = sizeof(T) == 4 ? 1e-5 : 1e-10;
  std::vector<BasicVar<T>> v;
  for (const std::string& input : inputs) v.emplace_back(golden<T>(name + "." + input), true);
  const BasicVar<T> y = f(v);
  CHECK(difference(y.value(), golden<T>(name + ".y")) < tolerance);
  y.backward(golden<T>(name + ".g"));
  for (std::size_t i = 0; i < inputs.size(); ++i) {
    CAPTURE(inputs[i]);
    CHECK(difference(v[i].grad(), golden<T>(name + ".d" + inputs[i])) < tolerance);
  }
}

}  // namespace

TEST_CASE_TEMPLATE("operators agree with PyTorch", T, float, double) {
  using Vars = std::vector<BasicVar<T>>;
  const std::vector<std::string> conv{"x", "w", "b"};
  compare<T>("conv2d", conv, [](const Vars& v) {
    return conv2d(v[0], v[1], v[2], {.stride = {2, 1}, .padding = {1, 2}});
  });
  compare<T>("conv2d_half", conv, [](const Vars& v) {
    return conv2d(v[0], v[1], v[2], {.stride = {2, 2}, .padding = {1, 1}});
  });
  compare<T>("conv3d", conv, [](const Vars& v) {
    return conv3d(v[0], v[1], v[2], {.stride = {1, 2, 2}, .padding = {1, 1, 0}});
  });
  compare<T>("conv_transpose3d", conv, [](const Vars& v) {
    return conv_transpose3d(
        v[0], v[1], v[2], {.stride = {2, 2, 2}, .padding = {1, 1, 1}, .output_padding = {1, 1, 1}});
  });
  compare<T>("group_norm", {"x", "gamma", "beta"},
             [](const Vars& v) { return materialise(group_normalised(v[0], v[1], v[2], 3)); });
  compare<T>("bilinear_up", {"x"}, [](const Vars& v) { return resize_bilinear(v[0], 8, 11); });
  compare<T>("bilinear_down", {"x"}, [](const Vars& v) { return resize_bilinear(v[0], 3, 4); });
  compare<T>("nearest_up", {"x"}, [](const Vars& v) { return resize_nearest(v[0], 7, 12); });
  compare<T>("nearest_down", {"x"}, [](const Vars& v) { return resize_nearest(v[0], 3, 4); });
  compare<T>("softmax", {"x"}, [](const Vars& v) {
    return height_distribution(v[0], BasicTensor<T>(v[0].shape())).probability;
  });
  compare<T>("gelu", {"x"}, [](const Vars& v) { return gelu(v[0]); });
  compare<T>("smooth_l1", {"x"}, [](const Vars& v) {
    return smooth_l1(v[0], golden<T>("smooth_l1.target"), {}, static_cast<T>(0.7));
  });
}

TEST_CASE("AdamW's steps agree with PyTorch") {
  const auto stored = [](const std::string& name) {
    CAPTURE(name);
    const auto found = golden().tensors.find("adamw." + name);
    REQUIRE(found != golden().tensors.end());
    return found->second;
  };
  nn::ParameterSet<float> parameters(0);
  Var weight = parameters.create("weight", {4, 3}, nn::Init::constant(0), true);
  Var bias = parameters.create("bias", {4}, nn::Init::constant(0), false);
  weight.mutable_value() = stored("weight").clone();
  bias.mutable_value() = stored("bias").clone();
  nn::AdamW optimiser(parameters,
                      {.beta1 = 0.9, .beta2 = 0.99, .epsilon = 1e-6, .weight_decay = 0.05});
  const std::array<double, 3> rates{1e-2, 2e-2, 5e-3};
  for (std::size_t step = 0; step < rates.size(); ++step) {
    CAPTURE(step);
    const std::string prefix = std::to_string(step) + ".";
    weight.mutable_grad() = stored(prefix + "dweight").clone();
    bias.mutable_grad() = stored(prefix + "dbias").clone();
    optimiser.step(rates[step]);
    CHECK(difference(weight.value(), stored(prefix + "weight")) < 1e-6);
    CHECK(difference(bias.value(), stored(prefix + "bias")) < 1e-6);
  }
}
