// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/cross_check.h"

#include "satsurf/rpc/model.h"

#include <algorithm>
#include <cmath>

namespace satsurf::reconstruct {

CrossCheck::CrossCheck(const nn::NetworkInput& input, const Tensor& heights)
    : input_(input),
      heights_(heights),
      H_(input.sources[0].valid.dim(0)),
      W_(input.sources[0].valid.dim(1)) {}

Index CrossCheck::landing(std::size_t i, std::size_t j, Index p, double z) const {
  const auto q = input_.transfer[i][j](static_cast<double>(p % W_), static_cast<double>(p / W_), z);
  if (!rpc::inside_image({q[0], q[1]}, W_, H_)) return -1;
  // -0.5 is the first pixel's edge, and the only place that is rounded out of the image
  const Index x = std::max<Index>(0, std::lround(q[0])), y = std::max<Index>(0, std::lround(q[1]));
  return input_.sources[j].valid[y * W_ + x] > 0 ? y * W_ + x : -1;
}

}  // namespace satsurf::reconstruct
