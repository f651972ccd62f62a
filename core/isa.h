// SPDX-License-Identifier: Apache-2.0
#pragma once

/// How to add a kernel, that is a loop compiled for every instruction set, with `ops/loss_kernels`
/// as the example to look at:
///   1. `ops/x_kernels.h` declares a table: `template <class T> struct XKernels` with one documented
///      function pointer per loop and, last, `template <Isa isa> static XKernels compiled_for();`
///   2. `ops/x_kernels.cpp` defines the loops in an unnamed namespace of
///      `satsurf::SATSURF_KERNEL_ISA`, with the vectors of core/simd.h, and below, in `satsurf`,
///      fills the table: `return {.loop = here::loop<T>};`. It instantiates `compiled_for<kIsa>()`
///      for float and double.
///   3. CMakeLists.txt lists the source as a kernel. It is then compiled once per instruction set,
///      each time with SATSURF_KERNEL_ISA set to one of the names in `Isa`.
///   4. The operator calls `active_kernels<XKernels<T>>().loop(..)`, and its test compares the loops
///      of `test::kernel_variants<XKernels<T>>()`, every set this processor has, with an oracle.
namespace satsurf {

/// Instruction sets the kernels are compiled for. Results are reproducible per instruction set.
enum class Isa { baseline, avx2, avx512 };

inline constexpr Isa kAllIsas[] = {Isa::baseline, Isa::avx2, Isa::avx512};

/// Whether this processor and operating system offer it.
bool isa_available(Isa isa);
/// The best set there is, or the one that the environment variable `SATSURF_ISA` (baseline, avx2,
/// avx512) asks for. Fixed at the first call.
/// throws  ConfigError if the variable names an unknown or unavailable set
Isa active_isa();
/// As `SATSURF_ISA` spells it.
const char* isa_name(Isa isa);

/// A table of kernels as compiled for one instruction set, which must be available.
template <class Kernels>
Kernels kernels_for(Isa isa) {
  switch (isa) {
    case Isa::avx512:
      return Kernels::template compiled_for<Isa::avx512>();
    case Isa::avx2:
      return Kernels::template compiled_for<Isa::avx2>();
    case Isa::baseline:
      break;
  }
  return Kernels::template compiled_for<Isa::baseline>();
}

/// The same for `active_isa()`.
template <class Kernels>
const Kernels& active_kernels() {
  static const Kernels kernels = kernels_for<Kernels>(active_isa());
  return kernels;
}

}  // namespace satsurf
