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

/// Mean quality of a view with those that were taken; 0 where it does not go with one of them.
double goes_with(const Pairs& pairs, std::size_t view, const std::vector<std::size_t>& taken) {
  double sum = 0;
  for (const std::size_t other : taken) {
    if (!(pairs.quality(view, other) > 0)) return 0;
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
                     const std::vector<std::size_t>& taken) {
  for (const std::size_t other : taken) {
    const ViewPair& pair = pairs.pair(view, other);
    if (pair.share <= 0) return "shares no ground with " + views[other].label();
    if (pair.parallax < kLeastParallax)
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
                        const std::function<double(const View&)>& height_of, Index most) {
  const Pairs pairs(views, height_of);
  std::vector<std::size_t> taken = best_pair(pairs);
  ViewChoice out;
  if (taken.empty()) return out;
  while (taken.size() < static_cast<std::size_t>(most)) {
    double highest = 0;
    std::size_t best = 0;
    for (std::size_t view = 0; view < views.size(); ++view) {
      if (std::ranges::count(taken, view) > 0) continue;
      if (const double q = goes_with(pairs, view, taken); q > highest) highest = q, best = view;
    }
    if (highest <= 0) break;
    taken.push_back(best);
  }
  std::ranges::sort(taken);
  for (std::size_t view = 0; view < views.size(); ++view)
    if (std::ranges::count(taken, view) > 0)
      out.kept.push_back(static_cast<Index>(view));
    else
      out.left_out.push_back({views[view].label(), why_left(pairs, views, view, taken)});
  return out;
}

}  // namespace satsurf::scene
