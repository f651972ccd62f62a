// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>

#include <benchmark/benchmark.h>

namespace satsurf::bench {

/// A table of times, rates and shares of the machine's limits.
std::unique_ptr<benchmark::BenchmarkReporter> table_reporter();

/// Passes every row on to `inner` with its median as its time. The machine's limits are measured
/// and put into the context before the first row.
class MedianReporter : public benchmark::BenchmarkReporter {
 public:
  explicit MedianReporter(benchmark::BenchmarkReporter& inner) : inner_(inner) {}
  bool ReportContext(const Context& context) override;
  void ReportRuns(const std::vector<Run>& runs) override;
  void Finalize() override { inner_.Finalize(); }

 private:
  benchmark::BenchmarkReporter& inner_;
};

/// The processor's name, or "unknown".
std::string cpu_model();

}  // namespace satsurf::bench
