// SPDX-License-Identifier: Apache-2.0
#include "satsurf/bench/bench.h"

#include "satsurf/core/rng.h"

namespace satsurf::bench {
namespace {

/// A scalar whose backward pass hands `y` a gradient, as the next op of a network would.
Var root_of(const Var& y, const Tensor& gradient) {
  return Var::record("root", Tensor::scalar(0.F), {y},
                     [gradient](Node<float>& n) { n.inputs[0]->grad = gradient; });
}

void forward_row(benchmark::State& state, const OpCase& c) {
  const NoGrad no_grad;
  time_row(state, c.forward, [&] { benchmark::DoNotOptimize(c.op(c.inputs).value().data()); });
}

void both_row(benchmark::State& state, OpCase& c) {
  Tensor gradient;
  {
    const NoGrad no_grad;
    gradient = Tensor(c.op(c.inputs).shape(), 1.F);
  }
  const auto clear = [&] {
    for (Var& v : c.inputs) v.clear_grad();
  };
  time_row(state, c.both, clear, [&] { root_of(c.op(c.inputs), gradient).backward(); });
}

}  // namespace

Var normal(const Shape& shape, std::uint64_t seed) {
  Rng rng(seed);
  return Var(normal_tensor<float>(shape, rng), true);
}

void report(benchmark::State& state, const Cost& cost, const Limits& most, double seconds) {
  state.counters["seconds"] = seconds;  // becomes the row's time, see report.cpp
  if (cost.flop > 0) state.counters["FLOP/s"] = cost.flop / seconds;
  if (cost.bytes > 0) state.counters["bytes_per_second"] = cost.bytes / seconds;
  const double fma = cost.flop > 0 ? cost.flop / most.flop_per_s : 0,
               memory = cost.bytes > 0 ? cost.bytes / most.bytes_per_s : 0;
  if (fma > 0 || memory > 0) {
    state.counters["share"] = std::max(fma, memory) / seconds;
    state.SetLabel(fma >= memory ? "fma" : "memory");
  }
}

void add_op(const std::string& name, const std::vector<std::string>& argument_names,
            const Shapes& shapes, const MakeCase& make) {
  for (const bool backward : {false, true}) {
    auto* rows = benchmark::RegisterBenchmark(
        (name + (backward ? "_fwd_bwd" : "_fwd")).c_str(), [=](benchmark::State& state) {
          OpCase c = make(state);
          backward ? both_row(state, c) : forward_row(state, c);
        });
    rows->ArgNames(argument_names);
    for (const auto& shape : shapes) rows->Args(shape);
  }
}

}  // namespace satsurf::bench
