// SPDX-License-Identifier: Apache-2.0
#include "satsurf/bench/bench.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"

#include <memory>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

/// The machine's limits, to judge all other rows by: single-precision multiply-adds per second and
/// bytes per second through memory, with as many threads as the engine uses.
namespace satsurf::bench {
namespace {

constexpr Index kRounds = 20000;
constexpr Index kChains = 12;  // independent sums: more than latency times throughput asks for

float peak_baseline(float seed) {
  float sum[16 * kChains] = {};
  for (Index r = 0; r < kRounds; ++r)
    for (float& s : sum) s = s * seed + seed;
  float total = 0;
  for (const float s : sum) total += s;
  return total;
}

#if defined(__x86_64__)
[[gnu::target("avx2,fma")]] float peak_avx2(float seed) {
  __m256 sum[kChains];
  const __m256 x = _mm256_set1_ps(seed);
  for (__m256& s : sum) s = _mm256_setzero_ps();
  for (Index r = 0; r < kRounds; ++r)
#pragma GCC unroll 12
    for (Index i = 0; i < kChains; ++i) sum[i] = _mm256_fmadd_ps(sum[i], x, x);
  for (const __m256 s : sum) sum[0] = _mm256_add_ps(sum[0], s);
  return _mm256_cvtss_f32(sum[0]);
}

[[gnu::target("avx512f")]] float peak_avx512(float seed) {
  __m512 sum[kChains];
  const __m512 x = _mm512_set1_ps(seed);
  for (__m512& s : sum) s = _mm512_setzero_ps();
  for (Index r = 0; r < kRounds; ++r)
#pragma GCC unroll 12
    for (Index i = 0; i < kChains; ++i) sum[i] = _mm512_fmadd_ps(sum[i], x, x);
  for (const __m512 s : sum) sum[0] = _mm512_add_ps(sum[0], s);
  return _mm512_cvtss_f32(sum[0]);
}
#endif

/// Multiply-adds that touch no memory.
class PeakRun {
 public:
  PeakRun() : sums_(static_cast<std::size_t>(8 * threads())) {
#if defined(__x86_64__)
    if (active_isa() == Isa::avx512) run_ = peak_avx512;
    if (active_isa() == Isa::avx2) run_ = peak_avx2, lanes_ = 8;
#endif
  }
  Cost cost() const {
    return {.flop = number(static_cast<Index>(sums_.size()) * kRounds * kChains * lanes_ * 2)};
  }
  void operator()() {
    for_each_index(static_cast<Index>(sums_.size()),
                   [&](Index i) { sums_[static_cast<std::size_t>(i)] = run_(0.5F); });
    benchmark::DoNotOptimize(sums_.data());
  }

 private:
  float (*run_)(float) = peak_baseline;
  Index lanes_ = 16;
  std::vector<float> sums_;
};

/// a = b + s c.
class TriadRun {
 public:
  Cost cost() const { return {.bytes = bytes_of(3 * number(kCount))}; }
  void operator()() {
    float* a = a_.data();
    const float *b = b_.data(), *c = c_.data();
    for_range(kCount, kCount / 64, [=](Index begin, Index end) {
      for (Index i = begin; i < end; ++i) a[i] = b[i] + 0.5F * c[i];
    });
    benchmark::ClobberMemory();
  }

 private:
  static constexpr Index kCount = Index{16} << 20;  // 64 MiB each: beyond every cache
  std::vector<float> a_ = std::vector<float>(kCount, 0.F), b_ = std::vector<float>(kCount, 1.F),
                     c_ = std::vector<float>(kCount, 2.F);
};

/// One each, made when first needed.
PeakRun& peak_run() {
  static PeakRun run;
  return run;
}
std::unique_ptr<TriadRun>& triad_slot() {
  static std::unique_ptr<TriadRun> run;
  return run;
}
TriadRun& triad_run() {
  if (!triad_slot()) triad_slot() = std::make_unique<TriadRun>();
  return *triad_slot();
}

/// Runs per second over at least that time.
template <class Run>
double rate(Run& run, double for_seconds) {
  double runs = 0, seconds = 0;
  const auto begin = Clock::now();
  do {
    run();
    ++runs;
    seconds = seconds_since(begin);
  } while (seconds < for_seconds);
  return runs / seconds;
}

Limits measure_limits() {
  constexpr double kSlice = 0.02;
  std::vector<double> peak, triad;
  for (int i = 0; i < 25; ++i) {
    peak.push_back(rate(peak_run(), kSlice));
    triad.push_back(rate(triad_run(), kSlice));
  }
  return {peak_run().cost().flop * median(peak), triad_run().cost().bytes * median(triad)};
}

template <class Run>
void limit_row(benchmark::State& state) {
  Run run;
  time_row(state, run.cost(), [&] { run(); });
}

}  // namespace

const Limits& limits() {
  static const Limits most = measure_limits();
  return most;
}

void release_limit_arrays() { triad_slot().reset(); }

void LimitProbe::after(double run_seconds) {
  // About as long as the run, so that both suffer alike when other programs take the processor.
  constexpr double kEvery = 0.04, kLongest = 0.25;
  due_ += run_seconds;
  if (due_ < kEvery) return;
  measure(std::min(run_seconds, kLongest));
  due_ = 0;
}

Limits LimitProbe::typical() {
  if (due_ > 0) measure(0);
  return {flop_per_s_.empty() ? 0 : median(flop_per_s_),
          bytes_per_s_.empty() ? 0 : median(bytes_per_s_)};
}

void LimitProbe::measure(double for_seconds) {
  if (cost_.flop > 0) flop_per_s_.push_back(peak_run().cost().flop * rate(peak_run(), for_seconds));
  if (cost_.bytes > 0)
    bytes_per_s_.push_back(triad_run().cost().bytes * rate(triad_run(), for_seconds));
}

void add_limit_rows() {
  benchmark::RegisterBenchmark("peak_fma", limit_row<PeakRun>);
  benchmark::RegisterBenchmark("triad", limit_row<TriadRun>);
}

}  // namespace satsurf::bench
