// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/height_sweep.h"

#include "satsurf/core/parallel.h"
#include "satsurf/core/whole.h"
#include "satsurf/ops/resize.h"
#include "satsurf/rpc/fit.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <numeric>
#include <string>

namespace satsurf::scene {
namespace {

constexpr Index kCoarse = 256;       // px, side of the images
constexpr double kAgreement = 0.75;  // correlation from which a match counts
constexpr double kUnique = 0.1;      // by which the best height must beat every other peak
constexpr double kStepPx = 0.75;     // disparity between tried heights, half of which is survived
constexpr Index kFewestTextured = 100;  // windows of an image
constexpr Index kGrain = 1 << 12;       // pixels of one piece of work

/// Of two correlations the mean, or the one there is, and the better one.
void mean_and_better(const float* a, const float* b, Index n, float* __restrict__ mean,
                     float* __restrict__ better) {
  for (Index i = 0; i < n; ++i) {
    const float least = a[i] < b[i] ? a[i] : b[i], most = a[i] < b[i] ? b[i] : a[i];
    better[i] = most;
    mean[i] = least > -1 ? (least + most) / 2 : most;
  }
}

/// What the views say of one height together: the mean of their correlations, and that of the better
/// half of them. One alone says it once.
/// returns  one or two [P], -1 where none sees the pixel
std::vector<Tensor> scores_of(std::vector<Tensor> correlations) {
  if (correlations.size() == 1) return correlations;
  const Index P = correlations[0].count();
  auto all = Tensor::uninitialised({P}), better_half = Tensor::uninitialised({P});
  if (correlations.size() == 2) {  // as most scenes have: sorting them takes longer
    mean_and_better(correlations[0].data(), correlations[1].data(), P, all.data(),
                    better_half.data());
    return {all, better_half};
  }
  std::vector<float> seen;
  for (Index i = 0; i < P; ++i) {
    all[i] = better_half[i] = -1;
    seen.clear();
    for (const Tensor& c : correlations)
      if (c[i] > -1.f) seen.push_back(c[i]);
    if (seen.empty()) continue;
    std::sort(seen.begin(), seen.end(), std::greater<>());
    const auto mean = [&](std::size_t n) {
      return std::accumulate(seen.begin(), seen.begin() + static_cast<std::ptrdiff_t>(n), 0.f) /
             static_cast<float>(n);
    };
    all[i] = mean(seen.size());
    better_half[i] = mean((seen.size() + 1) / 2);
  }
  return {all, better_half};
}

/// One more height tried, for some pixels. Without a branch, so that it works on several at once.
void add(BestHeights& heights, const Tensor& score, float z, float peak, Index begin, Index end) {
  float *__restrict__ best = heights.best.data(), *__restrict__ rival = heights.rival.data(),
                     *__restrict__ where = heights.where.data();
  const float* scores = score.data();
  for (Index i = begin; i < end; ++i) {
    const float s = scores[i], b = best[i], r = rival[i], w = where[i];
    const bool same_peak = std::abs(z - w) <= peak, better = s > b;
    const float lesser = better ? b : s;  // of the two, what may be the rival
    rival[i] = !same_peak && lesser > r ? lesser : r;
    best[i] = better ? s : b;
    where[i] = better ? z : w;
  }
}

}  // namespace

bool BestHeights::sure(Index pixel) const {
  return best[pixel] >= kAgreement && best[pixel] - rival[pixel] >= kUnique;
}

MaskedGrey HeightSweep::coarse_of(const View& view, Index factor) {
  const Index h = view.rgb.dim(1) / factor * factor, w = view.rgb.dim(2) / factor * factor;
  Tensor grey({h, w}), valid({h, w});
  const Index P = view.valid.count(), W = view.rgb.dim(2);
  for (Index y = 0; y < h; ++y)
    for (Index x = 0; x < w; ++x) {
      const Index i = y * W + x;
      grey[y * w + x] = (view.rgb[i] + view.rgb[P + i] + view.rgb[2 * P + i]) / 3;
      valid[y * w + x] = view.valid[i];
    }
  return {area_downsample(Var(grey), factor).value(), area_downsample(Var(valid), factor).value()};
}

/// Windows of an image with enough contrast to be compared.
Index HeightSweep::textured_windows(const MaskedGrey& image) {
  Quadratic itself;
  itself.coeff[0][1] = itself.coeff[1][2] = 1;
  const Tensor same =
      window_correlation(image, image, itself, {0, 0, image.width(), image.height()}, 0);
  return std::count_if(same.data(), same.data() + same.count(), [](float c) { return c > -1; });
}

HeightSweep::HeightSweep(const Scene& scene, const rpc::HeightRange& searched)
    : scene_(scene), searched_(searched) {
  Index largest = 0;
  for (const View& v : scene.views) largest = std::max({largest, v.height(), v.width()});
  factor_ = std::max<Index>(1, (largest + kCoarse - 1) / kCoarse);
  for (const View& v : scene.views) {
    images_.push_back(coarse_of(v, factor_));
    if (const Index n = textured_windows(images_.back()); n < kFewestTextured)
      throw Error(v.label() + ": " + std::to_string(n) + " windows with texture, expected " +
                  std::to_string(kFewestTextured) + " or more to compare with the other images");
  }
  double parallax = 0;  // coarse px per m, the largest of all views
  const View& first = scene.views[0];
  const double f = static_cast<double>(factor_);
  for (Index j = 1; j < views(); ++j) {
    const auto jac =
        transfer(0, j).jacobian(static_cast<double>(first.rgb.dim(2)) / 2 / f,
                                static_cast<double>(first.rgb.dim(1)) / 2 / f, searched.middle());
    parallax = std::max(parallax, std::hypot(jac[0][2], jac[1][2]));
  }
  steps_ = std::clamp<Index>(floored(searched.span() * parallax / kStepPx) + 1, 8, 2000);
  peak_ = static_cast<float>(3 * searched.span() / static_cast<double>(steps_));
}

const Quadratic& HeightSweep::transfer(Index from, Index to) const {
  const auto [entry, is_new] = transfers_.try_emplace({from, to});
  if (!is_new) return entry->second;
  const View& view = scene_.views[static_cast<std::size_t>(from)];
  const rpc::Window window{0, 0, static_cast<double>(view.rgb.dim(2)),
                           static_cast<double>(view.rgb.dim(1))};
  const double f = static_cast<double>(factor_);
  return entry->second = rescale_pixels(
             rpc::fit_transfer(view.rpc, scene_.views[static_cast<std::size_t>(to)].rpc,
                               scene_.frame, window, searched_),
             f, f);
}

bool HeightSweep::sees(Index view, const std::array<double, 2>& place) const {
  const Index x = floored(place[0] + 0.5), y = floored(place[1] + 0.5);
  return x >= kRadius && y >= kRadius && x + kRadius < width(view) && y + kRadius < height(view) &&
         image(view).valid[y * width(view) + x] >= 1;
}

std::vector<BestHeights> HeightSweep::tried(Index view, const std::vector<Index>& others,
                                            const PixelBox& box,
                                            const std::function<void()>& poll) const {
  const Index P = box.height() * box.width();
  for (const Index other : others) transfer(view, other);  // not in the loop below
  std::vector<BestHeights> found;                          // one for each of `scores_of`
  for (std::size_t s = 0; s < std::min<std::size_t>(others.size(), 2); ++s) found.emplace_back(P);
  // Pieces of rows would need the box sums' neighbours: correlations are parallel over heights,
  // which each pixel then sees in their order.
  constexpr Index kBatch = 16;
  for (Index first = 0; first < steps_; first += kBatch) {
    if (poll) poll();
    const Index batch = std::min(kBatch, steps_ - first);
    std::vector<std::vector<Tensor>> scores(static_cast<std::size_t>(batch));
    const auto height = [&](Index k) {
      return searched_.low + searched_.span() * (static_cast<double>(first + k) + 0.5) /
                                 static_cast<double>(steps_);
    };
    for_each_index(batch, [&](Index k) {
      std::vector<Tensor> correlations;
      for (const Index other : others)
        correlations.push_back(window_correlation(image(view), image(other),
                                                  transfers_.at({view, other}), box, height(k)));
      scores[static_cast<std::size_t>(k)] = scores_of(std::move(correlations));
    });
    for_range(P, kGrain, [&](Index begin, Index end) {
      for (Index k = 0; k < batch; ++k)
        for (std::size_t s = 0; s < found.size(); ++s)
          add(found[s], scores[static_cast<std::size_t>(k)][s], static_cast<float>(height(k)),
              peak_, begin, end);
    });
  }
  return found;
}

std::vector<FoundPatch> HeightSweep::patches(Index view, const Tensor& where,
                                             std::vector<char> counted) const {
  const Index H = height(view), W = width(view);
  std::vector<FoundPatch> found;
  std::vector<Index> patch;
  for (Index start = 0; start < H * W; ++start) {
    if (!counted[static_cast<std::size_t>(start)]) continue;
    patch.assign(1, start);
    counted[static_cast<std::size_t>(start)] = 0;
    for (std::size_t k = 0; k < patch.size(); ++k) {
      const Index i = patch[k], y = i / W, x = i % W;
      for (Index v = std::max<Index>(0, y - 1); v <= std::min(H - 1, y + 1); ++v)
        for (Index u = std::max<Index>(0, x - 1); u <= std::min(W - 1, x + 1); ++u) {
          const Index j = v * W + u;
          if (!counted[static_cast<std::size_t>(j)] || std::abs(where[j] - where[i]) > peak_)
            continue;
          counted[static_cast<std::size_t>(j)] = 0;
          patch.push_back(j);
        }
    }
    if (static_cast<Index>(patch.size()) < kPatch) continue;
    FoundPatch& kept = found.emplace_back();
    kept.pixels = patch;
    for (const Index i : patch) kept.heights.push_back(where[i]);
  }
  return found;
}

}  // namespace satsurf::scene
