// SPDX-License-Identifier: Apache-2.0
#include <string>
#include <vector>

#include <benchmark/benchmark.h>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"

/// The machine's limits, to judge the rows of the other files by: single-precision multiply-adds
/// per second and bytes per second through memory, with as many threads as the engine uses.
namespace {

using satsurf::Index;

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

void peak_fma(benchmark::State& state) {
  float (*run)(float) = peak_baseline;
  Index lanes = 16;
#if defined(__x86_64__)
  if (satsurf::active_isa() == satsurf::Isa::avx512) run = peak_avx512;
  if (satsurf::active_isa() == satsurf::Isa::avx2) run = peak_avx2, lanes = 8;
#endif
  const Index pieces = 8 * satsurf::threads();
  std::vector<float> sums(static_cast<std::size_t>(pieces));
  for (auto _ : state) {
    satsurf::for_each_index(pieces,
                            [&](Index i) { sums[static_cast<std::size_t>(i)] = run(0.5F); });
    benchmark::DoNotOptimize(sums.data());
  }
  state.counters["FLOP/s"] =
      benchmark::Counter(static_cast<double>(pieces * kRounds * kChains * lanes * 2),
                         benchmark::Counter::kIsIterationInvariantRate);
}
BENCHMARK(peak_fma)->UseRealTime();

void triad(benchmark::State& state) {
  const Index n = Index{16} << 20;  // 64 MiB each: beyond every cache
  std::vector<float> a(static_cast<std::size_t>(n), 0.F), b(a.size(), 1.F), c(a.size(), 2.F);
  float *pa = a.data(), *pb = b.data(), *pc = c.data();
  for (auto _ : state) {
    satsurf::for_range(n, n / 64, [&](Index begin, Index end) {
      for (Index i = begin; i < end; ++i) pa[i] = pb[i] + 0.5F * pc[i];
    });
    benchmark::ClobberMemory();
  }
  state.SetBytesProcessed(static_cast<int64_t>(state.iterations()) * n * 12);
}
BENCHMARK(triad)->UseRealTime();

}  // namespace

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  benchmark::AddCustomContext("isa", satsurf::isa_name(satsurf::active_isa()));
  benchmark::AddCustomContext("threads", std::to_string(satsurf::threads()));
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
  return 0;
}
