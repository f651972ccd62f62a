// SPDX-License-Identifier: Apache-2.0
#include "satsurf/bench/report.h"

#include "satsurf/bench/bench.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"

#include <array>
#include <cstdio>
#include <fstream>

namespace satsurf::bench {
namespace {

using Run = benchmark::BenchmarkReporter::Run;

std::string text(const char* format, double value) {
  char buffer[64];
  std::snprintf(buffer, sizeof buffer, format, value);
  return buffer;
}

/// A counter of a row in units of `unit`, or nothing if the row has no such counter.
std::string cell(const Run& run, const char* name, const char* format, double unit) {
  const auto found = run.counters.find(name);
  return found == run.counters.end() ? "" : text(format, found->second.value / unit);
}

class Table : public benchmark::BenchmarkReporter {
 public:
  bool ReportContext(const Context& context) override {
    width_ = static_cast<int>(std::max<std::size_t>(context.name_field_width, 10));
    std::ostream& out = GetOutputStream();
    out << cpu_model() << ", " << context.cpu_info.num_cpus << " cores; " << threads()
        << " threads, " << isa_name(active_isa()) << ", satsurf " << SATSURF_VERSION << '\n'
        << "limits: FMA peak " << text("%.0f GFLOP/s", limits().flop_per_s * 1e-9) << ", triad "
        << text("%.1f GB/s", limits().bytes_per_s * 1e-9) << "\n\n";
    print({"row", "ms", "GFLOP/s", "GB/s", "share", "of", "tensor MB", "process MB"});
    return true;
  }

  void ReportRuns(const std::vector<Run>& runs) override {
    for (const Run& run : runs) {
      const std::string name = run.benchmark_name();
      if (run.error_occurred)
        print({name, run.error_message});
      else if (run.aggregate_unit == benchmark::StatisticUnit::kPercentage)
        print({name, text("%.1f %%", 100 * run.real_accumulated_time)});
      else
        print({name,
               text("%.3f", run.GetAdjustedRealTime() * 1e3 /
                                benchmark::GetTimeUnitMultiplier(run.time_unit)),
               cell(run, "FLOP/s", "%.1f", 1e9), cell(run, "bytes_per_second", "%.1f", 1e9),
               cell(run, "share", "%.1f %%", 0.01), run.report_label,
               cell(run, "peak_MB", "%.0f", 1), cell(run, "process_MB", "%.0f", 1)});
    }
  }

 private:
  void print(const std::array<std::string, 8>& cells) {
    char line[512];
    std::snprintf(line, sizeof line, "%-*s %11s %9s %8s %8s %-6s %9s %10s\n", width_,
                  cells[0].c_str(), cells[1].c_str(), cells[2].c_str(), cells[3].c_str(),
                  cells[4].c_str(), cells[5].c_str(), cells[6].c_str(), cells[7].c_str());
    GetOutputStream() << line << std::flush;
  }

  int width_ = 0;
};

}  // namespace

std::unique_ptr<benchmark::BenchmarkReporter> table_reporter() { return std::make_unique<Table>(); }

bool MedianReporter::ReportContext(const Context& context) {
  static const bool added = [] {
    benchmark::AddCustomContext("peak_fma_gflops", text("%.1f", limits().flop_per_s * 1e-9));
    benchmark::AddCustomContext("triad_gb_per_s", text("%.1f", limits().bytes_per_s * 1e-9));
    return true;
  }();
  inner_.SetOutputStream(&GetOutputStream());
  inner_.SetErrorStream(&GetErrorStream());
  return added && inner_.ReportContext(context);
}

void MedianReporter::ReportRuns(const std::vector<Run>& runs) {
  std::vector<Run> passed = runs;
  for (Run& run : passed) {
    const auto seconds = run.counters.find("seconds");
    if (seconds == run.counters.end()) continue;
    const bool is_time = run.aggregate_unit == benchmark::StatisticUnit::kTime;
    run.real_accumulated_time =
        seconds->second.value * (is_time ? static_cast<double>(run.iterations) : 1);
    run.counters.erase(seconds);
  }
  inner_.ReportRuns(passed);
}

std::string cpu_model() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);)
    if (line.starts_with("model name")) {
      const std::size_t colon = line.find(": ");
      if (colon != std::string::npos) return line.substr(colon + 2);
    }
  return "unknown";
}

}  // namespace satsurf::bench
