// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/cell_mode.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>
#include <utility>

namespace satsurf::reconstruct {
namespace {

/// Where the density is largest, of candidates sorted by height. One sweep: what a kernel takes from
/// either side are sums over neighbours, to which each step adds some and from which it takes some.
std::size_t densest(std::span<const CellCandidate> sorted, double b) {
  constexpr double kTie = 1e-6;
  double best = 0;
  std::size_t at = 0, low = 0, high = 0;
  // sums of weight and weighed height, below and with the candidate, and above it
  double below = 0, below_z = 0, above = 0, above_z = 0;
  const double origin = sorted[0].z;
  for (std::size_t i = 0; i < sorted.size(); ++i) {
    const double z = sorted[i].z - origin, w = sorted[i].weight;
    if (high > i) above -= w, above_z -= w * z;
    high = std::max(high, i + 1);
    for (; high < sorted.size() && sorted[high].z - sorted[i].z < b; ++high)
      above += sorted[high].weight, above_z += sorted[high].weight * (sorted[high].z - origin);
    below += w, below_z += w * z;
    for (; sorted[i].z - sorted[low].z >= b; ++low)
      below -= sorted[low].weight, below_z -= sorted[low].weight * (sorted[low].z - origin);
    const double density = below + above - (below * z - below_z + above_z - above * z) / b;
    if (density > best * (1 + kTie)) best = density, at = i;
  }
  return at;
}

/// Those within b of the densest place.
/// sorted  by height, one or more
auto members_of(std::vector<CellCandidate>& sorted, double b) {
  const double mode = sorted[densest(sorted, b)].z;
  const auto first = std::partition_point(sorted.begin(), sorted.end(),
                                          [&](const auto& c) { return c.z < mode - b; });
  return std::pair(first, std::partition_point(first, sorted.end(),
                                               [&](const auto& c) { return c.z <= mode + b; }));
}

}  // namespace

CellMode densest_mode(std::vector<CellCandidate>& candidates, double b) {
  if (candidates.empty()) return {};
  const auto lower = [](const CellCandidate& x, const CellCandidate& y) { return x.z < y.z; };
  const auto [low, high] = std::minmax_element(candidates.begin(), candidates.end(), lower);
  std::span<const CellCandidate> members = candidates;
  // On most cells all agree, and then all are members whichever is the densest.
  if (high->z - low->z > b) {
    std::sort(candidates.begin(), candidates.end(), lower);
    const auto [first, last] = members_of(candidates, b);
    members = {first, last};
  }
  double all = 0, weight = 0, z = 0, confidence = 0;
  for (const CellCandidate& c : candidates) all += c.weight;
  for (const CellCandidate& c : members)
    weight += c.weight, z += c.weight * c.z, confidence += c.weight * c.confidence;
  return {z / weight, confidence / all};
}

CellSummary summary_of(std::vector<CellCandidate>& candidates, double b) {
  CellSummary out;
  if (candidates.empty()) return out;
  constexpr double kTail = 0.1;
  std::sort(candidates.begin(), candidates.end(),
            [](const CellCandidate& x, const CellCandidate& y) { return x.z < y.z; });
  double z = 0, zz = 0;
  const double origin = candidates[0].z;
  for (const CellCandidate& c : candidates) {
    out.weight += c.weight;
    out.confidence += c.weight * c.confidence;
    z += c.weight * (c.z - origin);
    zz += c.weight * (c.z - origin) * (c.z - origin);
  }
  out.confidence /= out.weight;
  z /= out.weight;
  out.spread = std::sqrt(std::max(0.0, zz / out.weight - z * z));
  const auto quantile = [&](auto first, auto last) {
    double below = 0;
    for (auto c = first; c != last; ++c)
      if ((below += c->weight) >= kTail * out.weight) return c->z;
    return (last - 1)->z;
  };
  out.low = quantile(candidates.begin(), candidates.end());
  out.high = quantile(candidates.rbegin(), candidates.rend());

  // The members of a mode, taken out of the list.
  const auto take = [&](CellMode& mode, double& share) {
    const auto [first, last] = members_of(candidates, b);
    double weight = 0, height = 0, confidence = 0;
    for (auto c = first; c != last; ++c)
      weight += c->weight, height += c->weight * c->z, confidence += c->weight * c->confidence;
    mode = {height / weight, confidence / out.weight};
    share = weight / out.weight;
    candidates.erase(first, last);
  };
  take(out.mode, out.mode_share);
  if (candidates.empty()) return out;
  CellMode second;
  take(second, out.second_share);
  out.second = second.height;
  return out;
}

}  // namespace satsurf::reconstruct
