// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"
#include "satsurf/core/shape.h"

#include <cstddef>

#include <xsimd/xsimd.hpp>

/// For kernel sources only (compiled once per instruction set, see core/isa.h): vectors and how
/// their elements move. Everything lies in a namespace of the instruction set's own, because the
/// linker would merge functions of equal names from sources compiled with different flags.
namespace satsurf::SATSURF_KERNEL_ISA {

/// The instruction set that this source is being compiled for.
inline constexpr Isa kIsa = Isa::SATSURF_KERNEL_ISA;

/// The widest vector there is.
template <class T>
using Batch = xsimd::batch<T>;

/// Elements of a batch.
template <class T>
inline constexpr Index kLanes = static_cast<Index>(Batch<T>::size);

template <class T>
inline constexpr std::size_t kBatchBytes = sizeof(T) * static_cast<std::size_t>(kLanes<T>);

/// Indices 0, 1, .. of a vector's elements, to be expanded in shuffles.
template <Index... I>
struct Lanes {};
template <Index N, Index... I>
struct CountLanes : CountLanes<N - 1, N - 1, I...> {};
template <Index... I>
struct CountLanes<0, I...> {
  using Type = Lanes<I...>;
};

/// Vectors of a size of one's choice: for rows shorter than a batch and for groups of channels.
/// These are the compiler's own, because xsimd's batches of a narrower instruction set would be
/// shared with the sources compiled for that set.
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

  /// The first half of a[0], b[0], a[1], b[1], .. and the second half of it.
  static Vector interleave_low(const Vector& a, const Vector& b) {
    return shuffle(a, b, Indices{}, [](Index i) { return i / 2 + i % 2 * kCount; });
  }
  static Vector interleave_high(const Vector& a, const Vector& b) {
    return shuffle(a, b, Indices{}, [](Index i) { return i / 2 + kCount / 2 + i % 2 * kCount; });
  }
  /// The elements at even places of a and then of b, and those at odd places.
  static Vector even(const Vector& a, const Vector& b) {
    return shuffle(a, b, Indices{}, [](Index i) { return 2 * i; });
  }
  static Vector odd(const Vector& a, const Vector& b) {
    return shuffle(a, b, Indices{}, [](Index i) { return 2 * i + 1; });
  }

 private:
  /// Element i of the result is number place(i) of a's elements followed by b's.
  template <Index... I, class Place>
  static Vector shuffle(const Vector& a, const Vector& b, Lanes<I...>, Place) {
    return __builtin_shufflevector(a, b, Place{}(I)...);
  }
};

/// Part's shuffles of whole batches.
template <class T>
Batch<T> interleave_low(const Batch<T>& a, const Batch<T>& b) {
  return Batch<T>(Part<T, kBatchBytes<T>>::interleave_low(a.data, b.data));
}
template <class T>
Batch<T> interleave_high(const Batch<T>& a, const Batch<T>& b) {
  return Batch<T>(Part<T, kBatchBytes<T>>::interleave_high(a.data, b.data));
}
template <class T>
Batch<T> even(const Batch<T>& a, const Batch<T>& b) {
  return Batch<T>(Part<T, kBatchBytes<T>>::even(a.data, b.data));
}
template <class T>
Batch<T> odd(const Batch<T>& a, const Batch<T>& b) {
  return Batch<T>(Part<T, kBatchBytes<T>>::odd(a.data, b.data));
}

/// Transposes W vectors of N elements each, W a power of two: what was element k of vector i becomes
/// number k W + i of all elements, counted through the vectors. For W = N that is the transpose of a
/// square.
///
/// Interleaving the first half of all elements with the second half turns the bits of an element's
/// number, i N + k, round by one. After log2(W) rounds the bits of i, which were the upper ones, are
/// the lower ones.
template <class T, std::size_t Bytes, Index W>
[[gnu::always_inline]] inline void transpose(typename Part<T, Bytes>::Vector (&v)[W]) {
  using P = Part<T, Bytes>;
  static_assert((W & (W - 1)) == 0);
#pragma GCC unroll 4
  for (Index round = 1; round < W; round *= 2) {
    typename P::Vector turned[W];
#pragma GCC unroll 8
    for (Index i = 0; i < W / 2; ++i) {
      turned[2 * i] = P::interleave_low(v[i], v[i + W / 2]);
      turned[2 * i + 1] = P::interleave_high(v[i], v[i + W / 2]);
    }
#pragma GCC unroll 16
    for (Index i = 0; i < W; ++i) v[i] = turned[i];
  }
}

}  // namespace satsurf::SATSURF_KERNEL_ISA

namespace satsurf {
/// For the functions that fill the tables of kernels.
namespace here = SATSURF_KERNEL_ISA;
using here::kIsa;
}  // namespace satsurf
