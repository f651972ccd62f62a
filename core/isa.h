// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace satsurf {

/// Instruction sets the kernels are compiled for. Results are reproducible per instruction set.
enum class Isa { baseline, avx2, avx512 };

/// The best set this processor and operating system offer, or the one `SATSURF_ISA` (baseline,
/// avx2, avx512) asks for. Fixed at the first call.
/// throws  ConfigError if the variable names an unknown or unavailable set
Isa active_isa();
/// As `SATSURF_ISA` spells it.
const char* isa_name(Isa isa);

}  // namespace satsurf

/// Kernel sources (`*_kernels.cpp`) are compiled once per instruction set, each time with
/// SATSURF_ISA_NS set to isa_baseline, isa_avx2 or isa_avx512, and put their code into namespace
/// satsurf::SATSURF_ISA_NS. SATSURF_DISPATCH(f) picks that namespace's `f` at run time.
#define SATSURF_DISPATCH(function)                                                      \
  (::satsurf::active_isa() == ::satsurf::Isa::avx512 ? &::satsurf::isa_avx512::function \
   : ::satsurf::active_isa() == ::satsurf::Isa::avx2 ? &::satsurf::isa_avx2::function   \
                                                     : &::satsurf::isa_baseline::function)
