// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/ops/layout_kernels.h"
#include "satsurf/ops/loss_kernels.h"
#include "satsurf/ops/norm.h"
#include "satsurf/ops/pointwise_kernels.h"
#include "satsurf/ops/resize_kernels.h"
#include "satsurf/ops/softmax_kernels.h"
#include "satsurf/ops/ssim_kernels.h"

#include <vector>

namespace satsurf::test {

/// The pointwise kernels of one instruction set.
template <class T>
struct PointwiseKernels {
  decltype(&isa_baseline::gelu<T>) gelu;
  decltype(&isa_baseline::gelu_backward<T>) gelu_backward;
  decltype(&isa_baseline::relu_backward<T>) relu_backward;
  decltype(&isa_baseline::logistic<T>) logistic;
  decltype(&isa_baseline::softplus<T>) softplus;
  decltype(&isa_baseline::softplus_backward<T>) softplus_backward;
  decltype(&isa_baseline::norm_sums<T>) norm_sums;
  decltype(&isa_baseline::norm_apply<T>) norm_apply;
  decltype(&isa_baseline::norm_backward<T>) norm_backward;
  decltype(&isa_baseline::norm_add_linear<T>) norm_add_linear;
};

/// Kernels of one instruction set and its name.
template <class Kernels>
struct Variant : Kernels {
  const char* name;
};

/// Those of every instruction set this processor has; the others' functions are not called.
template <class Kernels>
std::vector<Variant<Kernels>> variants(Kernels (*baseline)(), Kernels (*avx2)(),
                                       Kernels (*avx512)()) {
  std::vector<Variant<Kernels>> all{{baseline(), "baseline"}};
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
    all.push_back({avx2(), "avx2"});
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
    all.push_back({avx512(), "avx512"});
  return all;
}

template <class T>
auto pointwise_variants() {
  return variants<PointwiseKernels<T>>(
      [] {
        return PointwiseKernels<T>{
            isa_baseline::gelu<T>,          isa_baseline::gelu_backward<T>,
            isa_baseline::relu_backward<T>, isa_baseline::logistic<T>,
            isa_baseline::softplus<T>,      isa_baseline::softplus_backward<T>,
            isa_baseline::norm_sums<T>,     isa_baseline::norm_apply<T>,
            isa_baseline::norm_backward<T>, isa_baseline::norm_add_linear<T>};
      },
      [] {
        return PointwiseKernels<T>{isa_avx2::gelu<T>,          isa_avx2::gelu_backward<T>,
                                   isa_avx2::relu_backward<T>, isa_avx2::logistic<T>,
                                   isa_avx2::softplus<T>,      isa_avx2::softplus_backward<T>,
                                   isa_avx2::norm_sums<T>,     isa_avx2::norm_apply<T>,
                                   isa_avx2::norm_backward<T>, isa_avx2::norm_add_linear<T>};
      },
      [] {
        return PointwiseKernels<T>{isa_avx512::gelu<T>,          isa_avx512::gelu_backward<T>,
                                   isa_avx512::relu_backward<T>, isa_avx512::logistic<T>,
                                   isa_avx512::softplus<T>,      isa_avx512::softplus_backward<T>,
                                   isa_avx512::norm_sums<T>,     isa_avx512::norm_apply<T>,
                                   isa_avx512::norm_backward<T>, isa_avx512::norm_add_linear<T>};
      });
}

template <class T>
auto softmax_variants() {
  return variants<SoftmaxKernels<T>>(isa_baseline::softmax_kernels<T>, isa_avx2::softmax_kernels<T>,
                                     isa_avx512::softmax_kernels<T>);
}

template <class T>
auto loss_variants() {
  return variants<LossKernels<T>>(isa_baseline::loss_kernels<T>, isa_avx2::loss_kernels<T>,
                                  isa_avx512::loss_kernels<T>);
}

template <class T>
auto resize_variants() {
  return variants<ResizeKernels<T>>(isa_baseline::resize_kernels<T>, isa_avx2::resize_kernels<T>,
                                    isa_avx512::resize_kernels<T>);
}

template <class T>
auto layout_variants() {
  return variants<LayoutKernels<T>>(isa_baseline::layout_kernels<T>, isa_avx2::layout_kernels<T>,
                                    isa_avx512::layout_kernels<T>);
}

template <class T>
auto ssim_variants() {
  return variants<SsimKernels<T>>(isa_baseline::ssim_kernels<T>, isa_avx2::ssim_kernels<T>,
                                  isa_avx512::ssim_kernels<T>);
}

}  // namespace satsurf::test
