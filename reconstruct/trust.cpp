// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/trust.h"

#include "satsurf/core/parallel.h"
#include "satsurf/reconstruct/cross_check.h"

#include <cmath>

namespace satsurf::reconstruct {
namespace {

constexpr double kAgreement = 2.5;  // m, between the heights two views give one point

/// Whether height z of pixel p in view i is borne out by another view.
bool trusted(const nn::NetworkInput& input, const CrossCheck& check, std::size_t i, Index p,
             double z) {
  bool seen = false, whole_range = false;
  for (std::size_t j = 0; j < input.sources.size(); ++j) {
    if (j == i) continue;
    const Index there = check.landing(i, j, p, z);
    if (there < 0) continue;
    seen = true;
    if (std::abs(check.height(j, there) - z) < kAgreement) return true;
    // The path over all heights is nearly straight: both ends inside mean all of it is.
    whole_range = whole_range || (check.landing(i, j, p, input.z_range.low) >= 0 &&
                                  check.landing(i, j, p, input.z_range.high) >= 0);
  }
  return seen && whole_range;
}

}  // namespace

std::vector<Index> trusted_surfels(const nn::NetworkInput& input, const Tensor& means,
                                   const Tensor& heights, const std::optional<Ground>& tile) {
  const Index N = static_cast<Index>(input.sources.size()), H = input.sources[0].rgb.dim(1),
              W = input.sources[0].rgb.dim(2), P = H * W;
  const CrossCheck check(input, heights);
  std::vector<char> good(static_cast<std::size_t>(N * P), 0);
  for_each_index(N * H, [&](Index row) {
    const auto i = static_cast<std::size_t>(row / H);
    for (Index x = 0; x < W; ++x) {
      const Index p = (row % H) * W + x, k = static_cast<Index>(i) * P + p;
      if (input.sources[i].valid[p] <= 0) continue;
      if (tile &&
          !tile->contains(static_cast<double>(means[3 * k]), static_cast<double>(means[3 * k + 1])))
        continue;
      good[static_cast<std::size_t>(k)] =
          trusted(input, check, i, p, static_cast<double>(means[3 * k + 2]));
    }
  });
  std::vector<Index> keep;
  for (Index k = 0; k < N * P; ++k)
    if (good[static_cast<std::size_t>(k)] != 0) keep.push_back(k);
  return keep;
}

}  // namespace satsurf::reconstruct
