// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

#include <xsimd/xsimd.hpp>

/// For kernel sources only (compiled once per instruction set, see core/isa.h): the widest batch of
/// the instruction set at hand.
namespace satsurf::SATSURF_ISA_NS {

template <class T>
using Batch = xsimd::batch<T>;

template <class T>
inline constexpr Index kLanes = static_cast<Index>(Batch<T>::size);

}  // namespace satsurf::SATSURF_ISA_NS
