// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

#include <cstddef>

#include <xsimd/xsimd.hpp>

/// For kernel sources only (compiled once per instruction set, see core/isa.h): the widest batch of
/// the instruction set at hand, shuffles, and vectors shorter than a batch.
namespace satsurf::SATSURF_ISA_NS {

template <class T>
using Batch = xsimd::batch<T>;

template <class T>
inline constexpr Index kLanes = static_cast<Index>(Batch<T>::size);

/// Indices of one vector, for shuffles.
template <Index... I>
struct Lanes {};
template <Index N, Index... I>
struct CountLanes : CountLanes<N - 1, N - 1, I...> {};
template <Index... I>
struct CountLanes<0, I...> {
  using Type = Lanes<I...>;
};

template <class T>
using AllLanes = typename CountLanes<kLanes<T>>::Type;

/// a, b = even[0], odd[0], even[1], odd[1], ..
template <class T, Index... I>
void interleave(const Batch<T>& even, const Batch<T>& odd, Batch<T>& a, Batch<T>& b, Lanes<I...>) {
  constexpr Index L = kLanes<T>;
  a = Batch<T>(__builtin_shufflevector(even.data, odd.data, (I / 2 + I % 2 * L)...));
  b = Batch<T>(__builtin_shufflevector(even.data, odd.data, (I / 2 + L / 2 + I % 2 * L)...));
}

/// Part of a vector, for rows shorter than one; xsimd's batches of other instruction sets would be
/// shared with the sources compiled for those.
template <class T, std::size_t Bytes>
struct Part {
  typedef T Vector __attribute__((vector_size(Bytes)));
  static constexpr Index kCount = static_cast<Index>(Bytes / sizeof(T));
  using Indices = typename CountLanes<kCount>::Type;

  static Vector load(const T* p) {
    Vector v;
    __builtin_memcpy(&v, p, Bytes);
    return v;
  }
  static void store(T* p, const Vector& v) { __builtin_memcpy(p, &v, Bytes); }
};

template <class T>
constexpr std::size_t kVectorBytes = static_cast<std::size_t>(kLanes<T>) * sizeof(T);

}  // namespace satsurf::SATSURF_ISA_NS
