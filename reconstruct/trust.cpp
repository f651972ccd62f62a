// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/trust.h"

#include "satsurf/core/parallel.h"
#include "satsurf/rpc/model.h"

#include <algorithm>
#include <cmath>

namespace satsurf::reconstruct {
namespace {

constexpr double kAgreement = 2.5;  // m, between the heights two views give one point

/// Compares what the views of a window say of one another's points.
class CrossCheck {
 public:
  CrossCheck(const nn::NetworkInput& input, const Tensor& heights)
      : input_(input),
        heights_(heights),
        H_(input.sources[0].rgb.dim(1)),
        W_(input.sources[0].rgb.dim(2)) {}

  /// Whether height z of pixel p in view i is borne out by another view.
  bool trusted(std::size_t i, Index p, double z) const {
    bool seen = false, whole_range = false;
    for (std::size_t j = 0; j < input_.sources.size(); ++j) {
      if (j == i) continue;
      const Index there = landing(i, j, p, z);
      if (there < 0) continue;
      seen = true;
      const float other = heights_[static_cast<Index>(j) * H_ * W_ + there];
      if (std::abs(static_cast<double>(other) - z) < kAgreement) return true;
      // The path over all heights is nearly straight: both ends inside mean all of it is.
      whole_range = whole_range || (landing(i, j, p, input_.z_range.low) >= 0 &&
                                    landing(i, j, p, input_.z_range.high) >= 0);
    }
    return seen && whole_range;
  }

 private:
  /// Pixel of view j on which the point at height z of pixel p in view i falls; -1 where that is
  /// outside or not valid.
  Index landing(std::size_t i, std::size_t j, Index p, double z) const {
    const auto q =
        input_.transfer[i][j](static_cast<double>(p % W_), static_cast<double>(p / W_), z);
    if (!rpc::inside_image({q[0], q[1]}, W_, H_)) return -1;
    // -0.5 is the first pixel's edge, and the only place that is rounded out of the image
    const Index x = std::max<Index>(0, std::lround(q[0])),
                y = std::max<Index>(0, std::lround(q[1]));
    return input_.sources[j].valid[y * W_ + x] > 0 ? y * W_ + x : -1;
  }

  const nn::NetworkInput& input_;
  const Tensor& heights_;
  Index H_, W_;
};

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
          check.trusted(i, p, static_cast<double>(means[3 * k + 2]));
    }
  });
  std::vector<Index> keep;
  for (Index k = 0; k < N * P; ++k)
    if (good[static_cast<std::size_t>(k)] != 0) keep.push_back(k);
  return keep;
}

}  // namespace satsurf::reconstruct
