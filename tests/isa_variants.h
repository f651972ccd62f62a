// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"

#include <vector>

namespace satsurf::test {

/// A table of kernels and the name of its instruction set.
template <class Kernels>
struct KernelVariant : Kernels {
  const char* name;
};

/// A table of kernels as compiled for every instruction set that this processor has.
template <class Kernels>
std::vector<KernelVariant<Kernels>> kernel_variants() {
  std::vector<KernelVariant<Kernels>> all;
  for (const Isa isa : kAllIsas)
    if (isa_available(isa)) all.push_back({kernels_for<Kernels>(isa), isa_name(isa)});
  return all;
}

}  // namespace satsurf::test
