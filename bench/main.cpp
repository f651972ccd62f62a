// SPDX-License-Identifier: Apache-2.0
#include "satsurf/bench/bench.h"
#include "satsurf/bench/report.h"
#include "satsurf/core/error.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"

#include <charconv>
#include <cstdlib>
#include <iostream>
#include <string_view>

namespace satsurf::bench {
namespace {

/// The threads that `SATSURF_THREADS` asks for; 0, that is all cores, if it is not set.
int wanted_threads() {
  const char* variable = std::getenv("SATSURF_THREADS");
  const std::string_view text = variable == nullptr ? "" : variable;
  if (text.empty()) return 0;
  int count = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), count);
  if (error != std::errc() || end != text.data() + text.size() || count < 1)
    throw ConfigError("SATSURF_THREADS: '" + std::string(text) + "', expected a positive number");
  return count;
}

bool writes_file(int argc, char** argv) {
  if (std::getenv("BENCHMARK_OUT") != nullptr) return true;
  return std::any_of(argv, argv + argc, [](const char* argument) {
    return std::string_view(argument).starts_with("--benchmark_out=");
  });
}

int run(int argc, char** argv) {
  set_threads(wanted_threads());
  const std::string isa = isa_name(active_isa());
  const bool to_file = writes_file(argc, argv);
  benchmark::SetDefaultTimeUnit(benchmark::kMillisecond);
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  benchmark::AddCustomContext("satsurf_version", SATSURF_VERSION);
  benchmark::AddCustomContext("isa", isa);
  benchmark::AddCustomContext("threads", std::to_string(threads()));
  benchmark::AddCustomContext("cpu_model", cpu_model());

  add_limit_rows();
  add_conv_rows();
  add_op_rows();
  add_splat_rows();
#ifdef SATSURF_WITH_GEO
  add_fusion_rows();
#endif
  add_model_rows();

  const std::unique_ptr<benchmark::BenchmarkReporter> wanted(
      benchmark::CreateDefaultDisplayReporter());
  const auto table = table_reporter();
  const bool is_console = dynamic_cast<benchmark::ConsoleReporter*>(wanted.get()) != nullptr;
  MedianReporter display(is_console ? *table : *wanted);
  benchmark::JSONReporter json;
  MedianReporter file(json);
  const std::size_t rows = benchmark::RunSpecifiedBenchmarks(&display, to_file ? &file : nullptr);
  benchmark::Shutdown();
  return rows > 0 ? 0 : 2;
}

}  // namespace
}  // namespace satsurf::bench

int main(int argc, char** argv) {
  try {
    return satsurf::bench::run(argc, argv);
  } catch (const std::exception& e) {
    std::cerr << "satsurf-bench: " << e.what() << '\n';
    return 2;
  }
}
