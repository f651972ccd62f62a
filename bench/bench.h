// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

#include <algorithm>
#include <chrono>
#include <functional>
#include <string>
#include <vector>

#include <benchmark/benchmark.h>

/// What the rows of satsurf-bench have in common: how a row is timed, what its work costs, and what
/// this machine could do at most.
namespace satsurf::bench {

/// The least a piece of work must do: floating-point operations (two per multiply-add of the
/// definition, padding included) and bytes read and written, each once, as if nothing stayed in a
/// cache between two passes.
struct Cost {
  double flop = 0, bytes = 0;
};

/// What this machine does at most with the threads in use.
struct Limits {
  double flop_per_s = 0;   ///< single-precision multiply-adds in registers, two operations each
  double bytes_per_s = 0;  ///< a = b + s c over arrays beyond every cache
};
/// Measured once, at the first call, over half a second each.
const Limits& limits();
/// Frees the arrays of the bandwidth test until they are needed again.
void release_limit_arrays();

/// Measures the limits that a row's share refers to between the row's own runs, because other
/// programs and the processor's clock change what a machine can do from second to second.
class LimitProbe {
 public:
  explicit LimitProbe(const Cost& cost) : cost_(cost) {}
  /// To be called after each run: measures now and then, for about as long as the run.
  void after(double run_seconds);
  /// Medians of what was measured; 0 for a limit that the cost does not refer to.
  Limits typical();

 private:
  void measure(double for_seconds);

  Cost cost_;
  double due_ = 0;  ///< seconds of runs since the last measurement
  std::vector<double> flop_per_s_, bytes_per_s_;
};

using Clock = std::chrono::steady_clock;
inline double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

inline double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Records the median time of the runs and what follows from the cost: rates, and the share of the
/// limit, that is the least time the machine needs for this cost divided by the time it took.
void report(benchmark::State& state, const Cost& cost, const Limits& most, double seconds);

/// Times `work()` over and over, at least three times after one run that warms caches and pages;
/// what `prepare()` does before each run is not counted.
template <class Prepare, class Work>
void time_row(benchmark::State& state, const Cost& cost, const Prepare& prepare, const Work& work) {
  std::vector<double> seconds;
  LimitProbe probe(cost);
  const auto run = [&] {
    const auto begin = Clock::now();
    work();
    seconds.push_back(seconds_since(begin));
  };
  const auto between = [&] {
    probe.after(seconds.back());
    prepare();
  };
  prepare();
  run();
  between();
  seconds.clear();
  for (auto _ : state) {
    run();
    state.PauseTiming();
    between();
    state.ResumeTiming();
  }
  while (seconds.size() < 3) run(), between();
  report(state, cost, probe.typical(), median(seconds));
}
template <class Work>
void time_row(benchmark::State& state, const Cost& cost, const Work& work) {
  time_row(
      state, cost, [] {}, work);
}

/// An op on inputs that stay the same.
struct OpCase {
  std::vector<Var> inputs;  ///< those that want gradients get them
  std::function<Var(const std::vector<Var>&)> op;
  Cost forward, both;  ///< of the forward pass alone, and with the backward pass
};

using Shapes = std::vector<std::vector<std::int64_t>>;
using MakeCase = std::function<OpCase(const benchmark::State&)>;

/// Adds the rows `name_fwd` and `name_fwd_bwd` for every shape. The backward pass is handed a
/// gradient of ones and writes fresh gradients, as inside a network.
void add_op(const std::string& name, const std::vector<std::string>& argument_names,
            const Shapes& shapes, const MakeCase& make);

/// Normally distributed numbers that want a gradient.
Var normal(const Shape& shape, std::uint64_t seed = 1);
inline double bytes_of(double elements) { return 4 * elements; }
inline double number(Index i) { return static_cast<double>(i); }

void add_limit_rows();
void add_conv_rows();
void add_op_rows();
void add_splat_rows();
/// Only in a build with the whole library.
void add_fusion_rows();
void add_model_rows();

}  // namespace satsurf::bench
