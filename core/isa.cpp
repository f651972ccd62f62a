// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/isa.h"

#include "satsurf/core/error.h"

#include <cstdlib>
#include <string>

namespace satsurf {

bool isa_available(Isa isa) {
#if defined(__x86_64__)
  switch (isa) {
    case Isa::avx512:
      return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
             __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
             __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("fma");
    case Isa::avx2:
      return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    case Isa::baseline:
      return true;
  }
#endif
  return isa == Isa::baseline;
}

namespace {

Isa choose() {
  constexpr Isa kBestFirst[] = {Isa::avx512, Isa::avx2, Isa::baseline};
  const char* wanted = std::getenv("SATSURF_ISA");
  for (const Isa isa : kBestFirst) {
    if (wanted != nullptr && *wanted != '\0' && std::string(wanted) != isa_name(isa)) continue;
    if (isa_available(isa)) return isa;
    if (wanted != nullptr && *wanted != '\0')
      throw ConfigError(std::string("SATSURF_ISA: ") + wanted +
                        ", expected a set that this processor has");
  }
  throw ConfigError(std::string("SATSURF_ISA: '") + wanted +
                    "', expected baseline, avx2 or avx512");
}

}  // namespace

Isa active_isa() {
  static const Isa isa = choose();
  return isa;
}

const char* isa_name(Isa isa) {
  switch (isa) {
    case Isa::avx512:
      return "avx512";
    case Isa::avx2:
      return "avx2";
    case Isa::baseline:
      break;
  }
  return "baseline";
}

}  // namespace satsurf
