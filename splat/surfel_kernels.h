// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/simd.h"
#include "satsurf/splat/rasterize_kernels.h"

/// For the kernel sources of this folder only: the passes over surfels, see splat::Kernels.
namespace satsurf::SATSURF_ISA_NS {

template <class T>
void prepare_surfels(const splat::SurfelArrays<T>& in, Index height, Index width, bool smooth,
                     Index begin, Index end, T* records, splat::Box* boxes);
template <class T>
void gather_surfels(const splat::SurfelArrays<T>& in, const Index* first_slot, const T* slots,
                    Index begin, Index end, const splat::SurfelGradients<T>& out);

}  // namespace satsurf::SATSURF_ISA_NS
