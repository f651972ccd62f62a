// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"

#include <vector>

#include <doctest/doctest.h>

namespace satsurf::test {

/// The instruction sets whose kernels can be tested here: those that this processor has. The others
/// are told, once in a process.
inline std::vector<Isa> tested_isas() {
  static bool told = false;
  std::vector<Isa> all;
  for (const Isa isa : kAllIsas)
    if (isa_available(isa))
      all.push_back(isa);
    else if (!told)
      MESSAGE("kernels for ", isa_name(isa), " are not tested: this processor has none of it");
  told = true;
  return all;
}

/// A table of kernels and the name of its instruction set.
template <class Kernels>
struct KernelVariant : Kernels {
  const char* name;
};

/// A table of kernels as compiled for each of them.
template <class Kernels>
std::vector<KernelVariant<Kernels>> kernel_variants() {
  std::vector<KernelVariant<Kernels>> all;
  for (const Isa isa : tested_isas()) all.push_back({kernels_for<Kernels>(isa), isa_name(isa)});
  return all;
}

}  // namespace satsurf::test
