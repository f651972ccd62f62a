// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/view_choice.h"

#include <algorithm>
#include <cmath>

namespace satsurf::scene {
namespace {

constexpr double kLeastBase = 0.1, kLargestBase = 0.5;  // m per m of height
constexpr double kSunsHalf = 40;                        // degrees
constexpr double kDaysHalf = 365;

/// What is known of every two of some views.
class Pairs {
 public:
  Pairs(const std::vector<View>& views, const std::function<double(const View&)>& height_of)
      : count_(views.size()), pairs_(count_ * count_), quality_(count_ * count_, 0.0) {
    for (std::size_t i = 0; i < count_; ++i)
      for (std::size_t j = i + 1; j < count_; ++j) {
        pairs_[at(i, j)] = pairs_[at(j, i)] =
            view_pair(views[i], views[j], 0.5 * (height_of(views[i]) + height_of(views[j])));
        quality_[at(i, j)] = quality_[at(j, i)] = pair_quality(pairs_[at(i, j)]);
      }
  }
  std::size_t count() const { return count_; }
  const ViewPair& pair(std::size_t i, std::size_t j) const { return pairs_[at(i, j)]; }
  double quality(std::size_t i, std::size_t j) const { return quality_[at(i, j)]; }

 private:
  std::size_t at(std::size_t i, std::size_t j) const { return i * count_ + j; }

  std::size_t count_;
  std::vector<ViewPair> pairs_;
  std::vector<double> quality_;
};

/// Mean quality of a view with those that were taken; 0 where it does not go with them.
double goes_with(const Pairs& pairs, std::size_t view, const std::vector<std::size_t>& taken,
                 Together together) {
  double sum = 0;
  for (const std::size_t other : taken) {
    const bool apart = together == Together::connected && pairs.pair(view, other).share <= 0;
    if (!(pairs.quality(view, other) > 0) && !apart) return 0;
    sum += pairs.quality(view, other);
  }
  return sum / static_cast<double>(taken.size());
}

/// The two views of the highest quality; none where no pair has any.
std::vector<std::size_t> best_pair(const Pairs& pairs) {
  std::vector<std::size_t> best;
  double highest = 0;
  for (std::size_t i = 0; i < pairs.count(); ++i)
    for (std::size_t j = i + 1; j < pairs.count(); ++j)
      if (pairs.quality(i, j) > highest) highest = pairs.quality(i, j), best = {i, j};
  return best;
}

std::string why_left(const Pairs& pairs, const std::vector<View>& views, std::size_t view,
                     const std::vector<std::size_t>& taken, Together together) {
  const bool alone = std::ranges::all_of(
      taken, [&](std::size_t other) { return pairs.pair(view, other).share <= 0; });
  for (const std::size_t other : taken) {
    const ViewPair& pair = pairs.pair(view, other);
    if (pair.share <= 0 && (together == Together::all || alone))
      return "shares no ground with " + views[other].label();
    if (pair.share > 0 && pair.parallax < kLeastParallax)
      return "seen from the same direction as " + views[other].label();
  }
  return "others go better together";
}

}  // namespace

double pair_quality(const ViewPair& pair) {
  if (pair.share <= 0 || pair.parallax < kLeastParallax) return 0;
  const double base = pair.base < kLeastBase     ? pair.base / kLeastBase
                      : pair.base > kLargestBase ? kLargestBase / pair.base
                                                 : 1;
  const double suns = pair.suns_deg ? 1 / (1 + std::pow(*pair.suns_deg / kSunsHalf, 2)) : 1;
  const double dates = pair.days ? 1 / (1 + *pair.days / kDaysHalf) : 1;
  return pair.share * base * suns * dates;
}

ViewChoice choose_views(const std::vector<View>& views,
                        const std::function<double(const View&)>& height_of, Index most,
                        Together together) {
  const Pairs pairs(views, height_of);
  std::vector<std::size_t> taken = best_pair(pairs);
  ViewChoice out;
  if (taken.empty()) return out;
  while (taken.size() < static_cast<std::size_t>(most)) {
    double highest = 0;
    std::size_t best = 0;
    for (std::size_t view = 0; view < views.size(); ++view) {
      if (std::ranges::count(taken, view) > 0) continue;
      if (const double q = goes_with(pairs, view, taken, together); q > highest)
        highest = q, best = view;
    }
    if (highest <= 0) break;
    taken.push_back(best);
  }
  std::ranges::sort(taken);
  for (std::size_t view = 0; view < views.size(); ++view)
    if (std::ranges::count(taken, view) > 0)
      out.kept.push_back(static_cast<Index>(view));
    else
      out.left_out.push_back({views[view].label(), why_left(pairs, views, view, taken, together)});
  return out;
}

std::vector<Index> choose_for_ground(const std::vector<View>& views,
                                     const std::vector<std::vector<char>>& shows, double height,
                                     Index most) {
  constexpr double kHalf = 0.25;  // quality of pairs that makes half of what a point can be worth
  const Pairs pairs(views, [&](const View&) { return height; });
  const std::size_t n = views.size(), P = shows.empty() ? 0 : shows[0].size();
  // What a pair is worth where both see the ground, whatever else they see.
  const auto worth = [&](std::size_t i, std::size_t j) {
    const double share = pairs.pair(i, j).share;
    return share > 0 ? pairs.quality(i, j) / share : 0;
  };
  const auto of_pairs = [&](const std::vector<std::size_t>& some) {
    std::vector<double> sum(P, 0.0);
    for (std::size_t a = 0; a < some.size(); ++a)
      for (std::size_t b = a + 1; b < some.size(); ++b)
        for (std::size_t p = 0; p < P; ++p)
          if (shows[some[a]][p] && shows[some[b]][p]) sum[p] += worth(some[a], some[b]);
    double out = 0;
    for (const double q : sum) out += q / (q + kHalf);
    return out;
  };
  std::vector<std::size_t> taken;
  const auto free = [&](std::size_t view) {
    return std::ranges::none_of(taken, [&](std::size_t other) {
      const ViewPair& pair = pairs.pair(view, other);
      return view == other || (pair.share > 0 && pair.parallax < kLeastParallax);
    });
  };
  // One view more, or two: ground that nothing has been taken of yet needs two at once.
  for (;;) {
    const double now = of_pairs(taken);
    double highest = 0;
    std::vector<std::size_t> best;
    const auto try_with = [&](const std::vector<std::size_t>& more) {
      if (taken.size() + more.size() > static_cast<std::size_t>(most)) return;
      std::vector<std::size_t> with = taken;
      with.insert(with.end(), more.begin(), more.end());
      const double gain = (of_pairs(with) - now) / static_cast<double>(more.size());
      if (gain > highest + 1e-9) highest = gain, best = more;
    };
    for (std::size_t i = 0; i < n; ++i) {
      if (!free(i)) continue;
      try_with({i});
      for (std::size_t j = i + 1; j < n; ++j)
        if (free(j) && worth(i, j) > 0) try_with({i, j});
    }
    if (best.empty()) break;
    taken.insert(taken.end(), best.begin(), best.end());
  }
  std::ranges::sort(taken);
  std::vector<Index> out;
  for (const std::size_t view : taken) out.push_back(static_cast<Index>(view));
  return out;
}

}  // namespace satsurf::scene
