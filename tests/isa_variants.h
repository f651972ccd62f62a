// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/ops/norm.h"
#include "satsurf/ops/pointwise_kernels.h"

#include <vector>

namespace satsurf::test {

/// The pointwise kernels of one instruction set.
template <class T>
struct PointwiseKernels {
  const char* name;
  decltype(&isa_baseline::gelu<T>) gelu;
  decltype(&isa_baseline::gelu_backward<T>) gelu_backward;
  decltype(&isa_baseline::relu_backward<T>) relu_backward;
  decltype(&isa_baseline::logistic<T>) logistic;
  decltype(&isa_baseline::norm_sums<T>) norm_sums;
  decltype(&isa_baseline::norm_apply<T>) norm_apply;
  decltype(&isa_baseline::norm_backward<T>) norm_backward;
  decltype(&isa_baseline::norm_add_linear<T>) norm_add_linear;
  decltype(&isa_baseline::softmax<T>) softmax;
  decltype(&isa_baseline::softmax_backward<T>) softmax_backward;
};

/// Those of every instruction set this processor has.
template <class T>
std::vector<PointwiseKernels<T>> pointwise_variants() {
  std::vector<PointwiseKernels<T>> all;
  all.push_back({"baseline", &isa_baseline::gelu<T>, &isa_baseline::gelu_backward<T>,
                 &isa_baseline::relu_backward<T>, &isa_baseline::logistic<T>,
                 &isa_baseline::norm_sums<T>, &isa_baseline::norm_apply<T>,
                 &isa_baseline::norm_backward<T>, &isa_baseline::norm_add_linear<T>,
                 &isa_baseline::softmax<T>, &isa_baseline::softmax_backward<T>});
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
    all.push_back({"avx2", &isa_avx2::gelu<T>, &isa_avx2::gelu_backward<T>,
                   &isa_avx2::relu_backward<T>, &isa_avx2::logistic<T>, &isa_avx2::norm_sums<T>,
                   &isa_avx2::norm_apply<T>, &isa_avx2::norm_backward<T>,
                   &isa_avx2::norm_add_linear<T>, &isa_avx2::softmax<T>,
                   &isa_avx2::softmax_backward<T>});
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
    all.push_back({"avx512", &isa_avx512::gelu<T>, &isa_avx512::gelu_backward<T>,
                   &isa_avx512::relu_backward<T>, &isa_avx512::logistic<T>,
                   &isa_avx512::norm_sums<T>, &isa_avx512::norm_apply<T>,
                   &isa_avx512::norm_backward<T>, &isa_avx512::norm_add_linear<T>,
                   &isa_avx512::softmax<T>, &isa_avx512::softmax_backward<T>});
  return all;
}

}  // namespace satsurf::test
