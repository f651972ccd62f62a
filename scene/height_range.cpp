// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/height_range.h"

#include "satsurf/core/whole.h"
#include "satsurf/scene/believable_span.h"
#include "satsurf/scene/height_sweep.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <functional>
#include <numeric>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace satsurf::scene {
namespace {

/// Added at both ends, m: roofs and gullies smaller than a coarse window.
constexpr double kMargin = 15;
/// Added besides, of the span: the higher a city, the higher may a single tower rise above all that
/// is found; below it the margin once more at most, as banks hide what lies at their foot.
constexpr double kRelief = 0.25;
constexpr Index kFewest = 100;  // matches that make a range believable

std::string names_of(const Scene& scene) {
  std::string text;
  for (std::size_t i = 0; i < scene.views.size(); ++i)
    text += (i == 0 ? "" : i + 1 < scene.views.size() ? ", " : " and ") + scene.views[i].label();
  return text;
}

/// What is found from one view.
struct Look {
  Index view = 0;
  std::vector<std::vector<FoundPatch>> patches;  // in one way, or two
};

std::vector<float> heights_of(const std::vector<FoundPatch>& patches) {
  std::vector<float> heights;
  for (const FoundPatch& p : patches)
    heights.insert(heights.end(), p.heights.begin(), p.heights.end());
  return heights;
}

/// Of one or two ways: who has but one says the same in both.
template <class T>
const T& in_way(const std::vector<T>& ways, std::size_t way) {
  return ways[std::min(way, ways.size() - 1)];
}

class HeightSearch {
 public:
  HeightSearch(const Scene& scene, const rpc::HeightRange& searched,
               const std::function<void()>& poll,
               const std::function<bool(double, double)>& unwanted)
      : scene_(scene),
        searched_(searched),
        poll_(poll),
        unwanted_(unwanted),
        sweep_(scene, searched) {}

  std::optional<rpc::HeightRange> found() {
    looks_.push_back(look_of(0, sweep_.tried(0, views_from(1), sweep_.whole(0), poll_)));
    look_where_earlier_views_do_not();
    std::optional<rpc::HeightRange> span = span_of(0);
    if (looks_[0].patches.size() > 1) span = confirmed_span(span, span_of(1));
    if (span && agreed_by_more_) span = hull(*span, *agreed_by_more_);
    return span;
  }

  // of the way that finds more
  Index agreeing() const { return agreeing_; }
  Index masked() const { return masked_; }

 private:
  std::vector<Index> views_from(Index first) const {
    std::vector<Index> views(static_cast<std::size_t>(std::max<Index>(0, sweep_.views() - first)));
    std::iota(views.begin(), views.end(), first);
    return views;
  }

  /// Surfaces that the first view does not see, in two of the others.
  void look_where_earlier_views_do_not() {
    std::vector<float> heights = heights_of(looks_[0].patches[0]);
    if (heights.empty()) return;
    // m above what is found: a tower may lean out of the first view
    constexpr double kAbove = 50;
    const rpc::HeightRange near = near_span(std::move(heights), searched_);
    for (Index view = 1; view + 1 < sweep_.views(); ++view) {
      std::vector<BestHeights> found;
      for (const PixelBox& box : unseen_before(view, {near.low, near.middle(), near.high + kAbove}))
        try_box(view, box, found);
      if (!found.empty()) looks_.push_back(look_of(view, found));
    }
  }

  /// Parts of a view that none before it sees, but a later one, at some of the heights.
  std::vector<PixelBox> unseen_before(Index view, const std::array<double, 3>& heights) const {
    constexpr Index kTile = 32, kEvery = 8;  // px
    const Index H = sweep_.height(view), W = sweep_.width(view);
    const auto wanted = [&](Index x, Index y, double z) {
      const auto sees = [&](Index other) {
        return sweep_.sees(
            other, sweep_.transfer(view, other)(static_cast<double>(x), static_cast<double>(y), z));
      };
      for (Index other = 0; other < view; ++other)
        if (sees(other)) return false;
      const auto later = views_from(view + 1);
      return std::ranges::any_of(later, sees);
    };
    std::vector<PixelBox> boxes;
    for (Index y0 = 0; y0 < H; y0 += kTile) {
      const Index y1 = std::min(H, y0 + kTile);
      bool joins = false;  // the tile on its left
      for (Index x0 = 0; x0 < W; x0 += kTile) {
        const Index x1 = std::min(W, x0 + kTile);
        bool any = false;
        for (Index y = y0; y < y1 && !any; y += kEvery)
          for (Index x = x0; x < x1 && !any; x += kEvery)
            any = std::ranges::any_of(heights, [&](double z) { return wanted(x, y, z); });
        if (any && joins) boxes.back().x1 = x1;
        if (any && !joins) boxes.push_back({x0, y0, x1, y1});
        joins = any;
      }
    }
    return boxes;
  }

  /// found  takes what is found in the box, of the whole image
  void try_box(Index view, const PixelBox& box, std::vector<BestHeights>& found) const {
    const Index W = sweep_.width(view);
    const PixelBox around = with_windows(view, box);
    const auto part = sweep_.tried(view, views_from(view + 1), around, poll_);
    if (found.empty()) found.assign(part.size(), BestHeights(sweep_.height(view) * W));
    for (std::size_t way = 0; way < part.size(); ++way)
      for (Index y = box.y0; y < box.y1; ++y)
        for (Index x = box.x0; x < box.x1; ++x) {
          const Index from = (y - around.y0) * around.width() + x - around.x0, to = y * W + x;
          found[way].best[to] = part[way].best[from];
          found[way].rival[to] = part[way].rival[from];
          found[way].where[to] = part[way].where[from];
        }
  }

  /// With what the windows of its pixels reach to.
  PixelBox with_windows(Index view, const PixelBox& box) const {
    constexpr Index r = HeightSweep::kRadius;
    return {std::max<Index>(0, box.x0 - r), std::max<Index>(0, box.y0 - r),
            std::min(sweep_.width(view), box.x1 + r), std::min(sweep_.height(view), box.y1 + r)};
  }

  Look look_of(Index view, const std::vector<BestHeights>& ways) {
    Look look{view, {}};
    for (const BestHeights& heights : ways) look.patches.push_back(patches_of(view, heights));
    return look;
  }

  std::vector<FoundPatch> patches_of(Index index, const BestHeights& heights) {
    const Index H = sweep_.height(index), W = sweep_.width(index);
    const View& view = scene_.views[static_cast<std::size_t>(index)];
    const double f = static_cast<double>(sweep_.factor());
    std::vector<char> counted(static_cast<std::size_t>(H * W));
    Index left_out = 0;
    for (Index i = 0; i < H * W; ++i) {
      if (!heights.sure(i)) continue;
      counted[static_cast<std::size_t>(i)] = 1;
      if (!unwanted_) continue;
      const rpc::Pixel pixel{(static_cast<double>(i % W) + 0.5) * f - 0.5,
                             (static_cast<double>(i / W) + 0.5) * f - 0.5};
      const auto p = scene_.frame.local_from_geodetic(
          view.rpc.localize(pixel, static_cast<double>(heights.where[i]) + scene_.frame.h0));
      if (unwanted_(p[0], p[1])) counted[static_cast<std::size_t>(i)] = 0, ++left_out;
    }
    masked_ = std::max(masked_, left_out);
    return sweep_.patches(index, heights.where, std::move(counted));
  }

  std::optional<rpc::HeightRange> span_of(std::size_t way) {
    std::vector<float> of_first = heights_of(in_way(looks_[0].patches, way));
    agreeing_ = std::max(agreeing_, static_cast<Index>(of_first.size()));
    if (static_cast<Index>(of_first.size()) < kFewest) return {};
    std::vector<Patch> heights;
    std::vector<std::pair<Index, const FoundPatch*>> places;  // view, patch
    for (const Look& look : looks_)
      for (const FoundPatch& patch : in_way(look.patches, way)) {
        heights.push_back(patch.heights);
        places.emplace_back(look.view, &patch);
      }
    return widened(near_span(std::move(of_first), searched_), heights,
                   [&](std::size_t k, double gap) {
                     return others_agree(places[k].first, *places[k].second, gap, way);
                   });
  }

  /// Of a patch's pixels, those for which another view finds the same height; and is sure of it.
  struct Shares {
    double same = 0, sure = 0;
  };

  /// Whether the other views find the heights of a patch where it lies in them, when they in turn are
  /// compared with all others. What chance finds in one view, hardly any other finds too.
  /// gap  m between the patch and what is found besides
  bool others_agree(Index view, const FoundPatch& patch, double gap, std::size_t way) {
    // Shares of the pixels. Where one other view alone sees the patch, chance agrees too often with less
    // than two windows; but for what nearly touches the rest, where it widens the span by little.
    constexpr double kSame = 0.5, kSure = 0.3, kSameInOne = 0.75, kSureInOne = 0.5;
    constexpr double kSameTouching = 0.7, kSureTouching = 0.25;
    constexpr Index kLarge = 2 * HeightSweep::kPatch;
    int seeing = 0, agreeing = 0;
    Shares most;
    for (const Index other : views_from(0)) {
      if (other == view) continue;
      const std::optional<Shares> shares = shares_in(other, view, patch, way);
      if (!shares) continue;
      ++seeing, agreeing += shares->same >= kSame ? 1 : 0;
      most = {std::max(most.same, shares->same), std::max(most.sure, shares->sure)};
    }
    if (seeing == 1 && gap <= kNear)
      return most.same >= kSameTouching && most.sure >= kSureTouching;
    if (seeing == 1)
      return most.same >= kSameInOne && most.sure >= kSureInOne &&
             static_cast<Index>(patch.pixels.size()) >= kLarge;
    if (2 * agreeing <= seeing || most.sure < kSure) return false;
    const auto [low, high] = std::ranges::minmax(patch.heights);
    const rpc::HeightRange span{static_cast<double>(low), static_cast<double>(high)};
    agreed_by_more_ = agreed_by_more_ ? hull(*agreed_by_more_, span) : span;
    return true;
  }

  /// returns  nothing where the other view does not see the patch
  std::optional<Shares> shares_in(Index other, Index view, const FoundPatch& patch,
                                  std::size_t way) {
    struct Place {
      Index x, y;
      float z;
    };
    const auto& [pixels, heights] = patch;
    const Quadratic& transfer = sweep_.transfer(view, other);
    const Index W = sweep_.width(view);
    std::vector<Place> places;
    PixelBox box{sweep_.width(other), sweep_.height(other), 0, 0};
    for (std::size_t k = 0; k < pixels.size(); ++k) {
      const auto q = transfer(static_cast<double>(pixels[k] % W),
                              static_cast<double>(pixels[k] / W), static_cast<double>(heights[k]));
      if (!sweep_.sees(other, q)) continue;
      const Index x = floored(q[0] + 0.5), y = floored(q[1] + 0.5);
      places.push_back({x, y, heights[k]});
      box = {std::min(box.x0, x), std::min(box.y0, y), std::max(box.x1, x + 1),
             std::max(box.y1, y + 1)};
    }
    if (2 * places.size() < pixels.size()) return {};
    const PixelBox around = with_windows(other, box);
    left_to_check_ -= around.height() * around.width();
    if (left_to_check_ < 0) return Shares{};
    std::vector<Index> all_others = views_from(0);
    std::erase(all_others, other);
    const auto ways = sweep_.tried(other, all_others, around, poll_);
    const BestHeights& found = in_way(ways, way);
    double compared = 0, same = 0, sure = 0;
    for (const Place& p : places) {
      const Index i = (p.y - around.y0) * around.width() + p.x - around.x0;
      compared += found.best[i] > -1 ? 1 : 0;
      if (std::abs(found.where[i] - p.z) > sweep_.peak()) continue;
      same += 1, sure += found.sure(i) ? 1 : 0;
    }
    const double n = static_cast<double>(pixels.size());
    if (2 * compared < n) return {};
    return Shares{same / n, sure / n};
  }

  const Scene& scene_;
  const rpc::HeightRange& searched_;
  const std::function<void()>& poll_;
  const std::function<bool(double, double)>& unwanted_;
  HeightSweep sweep_;
  std::vector<Look> looks_;
  Index agreeing_ = 0, masked_ = 0;
  /// Heights of patches that two other views or more confirm: one way to find them is enough.
  std::optional<rpc::HeightRange> agreed_by_more_;
  /// Pixels that may still be compared to check patches: twice an image, however many there are.
  Index left_to_check_ = 2 * sweep_.height(0) * sweep_.width(0);
};

}  // namespace

FoundHeights find_height_range(const Scene& scene, const rpc::HeightRange& searched,
                               const std::function<void()>& poll,
                               const std::function<bool(double, double)>& unwanted) {
  if (!searched.has_span())
    throw ConfigError("height range: " + std::to_string(searched.low) + " to " +
                      std::to_string(searched.high) + " m, expected a positive span to search");
  if (scene.views.size() < 2)
    throw Error(names_of(scene) +
                ": no other image sees its ground, expected one or more to compare it with");
  HeightSearch search(scene, searched, poll, unwanted);
  const std::optional<rpc::HeightRange> found = search.found();
  if (!found) {
    char text[120];
    std::snprintf(text, sizeof text,
                  "%td windows agree at any height from %.0f to %.0f m, expected %td or more",
                  search.agreeing(), scene.frame.heights_from_z(searched).low,
                  scene.frame.heights_from_z(searched).high, kFewest);
    const std::string why =
        search.masked() >= kFewest
            ? ", " + std::to_string(search.masked()) + " more do under --mask; give a height range"
            : "; do the cameras belong to the images?";
    throw Error(names_of(scene) + ": " + text + why);
  }
  const double relief = kRelief * found->span();
  return {*found,
          {found->low - kMargin - std::min(relief, kMargin), found->high + kMargin + relief}};
}

}  // namespace satsurf::scene
