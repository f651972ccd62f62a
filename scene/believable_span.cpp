// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/believable_span.h"

#include "satsurf/core/whole.h"

#include <algorithm>
#include <map>
#include <utility>

namespace satsurf::scene {
namespace {

constexpr double kUnconfirmed = 25;  // m beyond the other way's span that one way may say alone

}  // namespace

rpc::HeightRange believable_span(std::vector<float> heights, const rpc::HeightRange& searched,
                                 double largest_step, double quantile) {
  constexpr double kBin = 10;  // m
  std::sort(heights.begin(), heights.end());
  const double n = static_cast<double>(heights.size());
  const auto percentile = [&](double q) {
    return static_cast<double>(heights[static_cast<std::size_t>(q * (n - 1))]);
  };
  const double core_low = percentile(0.05), core_high = percentile(0.95);
  std::map<Index, Index> count;  // by bin, outside the core
  const auto bin_of = [](float z) { return floored(static_cast<double>(z) / kBin); };
  const auto outside = [&](float z) {
    return static_cast<double>(z) < core_low || static_cast<double>(z) > core_high;
  };
  for (const float z : heights)
    if (outside(z)) ++count[bin_of(z)];
  // The bins outside with the fewest heights are filled by chance alone.
  std::vector<Index> sizes;
  for (Index bin = bin_of(static_cast<float>(searched.low));
       bin <= bin_of(static_cast<float>(searched.high)); ++bin)
    if (const double middle = (static_cast<double>(bin) + 0.5) * kBin;
        middle < core_low || middle > core_high)
      sizes.push_back(count[bin]);
  std::sort(sizes.begin(), sizes.end());
  const auto nth = static_cast<std::size_t>(quantile * static_cast<double>(sizes.size()));
  const double chance =
      sizes.empty() ? 0 : static_cast<double>(sizes[std::min(nth, sizes.size() - 1)]);
  const auto believable = [&](float z) {
    return static_cast<double>(count[bin_of(z)]) >= 0.0005 * n + 4 * chance;
  };
  double low = core_low, high = core_high;
  for (auto z = heights.rbegin(); z != heights.rend(); ++z)  // downwards from the core
    if (const double h = static_cast<double>(*z);
        h < low && low - h <= largest_step && believable(*z))
      low = h;
  for (const float z : heights)
    if (const double h = static_cast<double>(z);
        h > high && h - high <= largest_step && believable(z))
      high = h;
  return {low, high};
}

rpc::HeightRange span_of_all_but(double share, std::vector<float> heights) {
  const auto rank = [&](double part) {
    const auto k = heights.begin() +
                   static_cast<std::ptrdiff_t>(part * static_cast<double>(heights.size() - 1));
    std::ranges::nth_element(heights, k);
    return static_cast<double>(*k);
  };
  const double low = rank(share);
  return {low, rank(1 - share)};
}

rpc::HeightRange near_span(std::vector<float> heights, const rpc::HeightRange& searched) {
  return believable_span(std::move(heights), searched, kNear);
}

rpc::HeightRange widened(rpc::HeightRange span, const std::vector<Patch>& patches,
                         const std::function<bool(std::size_t, double)>& confirmed) {
  struct Beyond {
    std::size_t patch;
    double nearest, farthest;  // m
  };
  std::vector<Beyond> above, below;
  for (std::size_t k = 0; k < patches.size(); ++k) {
    const auto [least, most] = std::ranges::minmax(patches[k]);
    const double low = static_cast<double>(least), high = static_cast<double>(most);
    if (low > span.high) above.push_back({k, low, high});
    if (high < span.low) below.push_back({k, high, low});
  }
  std::ranges::sort(above, {}, &Beyond::nearest);
  std::ranges::sort(below, std::greater<>(), &Beyond::nearest);
  for (const Beyond& b : above) {
    const double gap = b.nearest - span.high;
    if (gap > kLargestStep) break;
    if (b.farthest > span.high && confirmed(b.patch, gap)) span.high = b.farthest;
  }
  for (const Beyond& b : below) {
    const double gap = span.low - b.nearest;
    if (gap > kLargestStep) break;
    if (b.farthest < span.low && confirmed(b.patch, gap)) span.low = b.farthest;
  }
  return span;
}

std::optional<rpc::HeightRange> confirmed_span(const std::optional<rpc::HeightRange>& a,
                                               const std::optional<rpc::HeightRange>& b) {
  if (!a || !b) return a ? a : b;
  const rpc::HeightRange both{std::max(a->low, b->low), std::min(a->high, b->high)},
      either = hull(*a, *b);
  if (both.low > both.high) return either;
  return rpc::HeightRange{std::max(either.low, both.low - kUnconfirmed),
                          std::min(either.high, both.high + kUnconfirmed)};
}

}  // namespace satsurf::scene
