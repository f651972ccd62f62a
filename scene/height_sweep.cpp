// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/height_sweep.h"

#include "satsurf/core/parallel.h"
#include "satsurf/core/whole.h"
#include "satsurf/ops/resize.h"
#include "satsurf/rpc/fit.h"

#include <algorithm>
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
/// Valid pixels of a window that can be compared.
constexpr float kWhole = 0.9f * static_cast<float>(HeightSweep::kPatch);
constexpr float kTexture = 1e-5f;  // variance of a window that is not flat
constexpr Index kGrain = 1 << 12;  // pixels of one piece of work

/// Sums over (2 r + 1)^2 windows by running sums; windows are cut at the border.
Tensor box_sum(const Tensor& t) {
  constexpr Index r = HeightSweep::kRadius;
  const Index H = t.dim(0), W = t.dim(1);
  const Index stride = W + 1;
  std::vector<double> integral(static_cast<std::size_t>((H + 1) * stride), 0);
  for (Index y = 0; y < H; ++y) {
    const double* const above = integral.data() + y * stride;
    double* const row = integral.data() + (y + 1) * stride;
    for (Index x = 0; x < W; ++x)
      row[x + 1] = static_cast<double>(t[y * W + x]) + above[x + 1] + row[x] - above[x];
  }
  auto out = Tensor::uninitialised(t.shape());
  for (Index y = 0; y < H; ++y) {
    const double* const top = integral.data() + std::max<Index>(0, y - r) * stride;
    const double* const bottom = integral.data() + std::min(H, y + r + 1) * stride;
    for (Index x = 0; x < W; ++x) {
      const Index x0 = std::max<Index>(0, x - r), x1 = std::min(W, x + r + 1);
      out[y * W + x] = static_cast<float>(bottom[x1] - top[x1] - bottom[x0] + top[x0]);
    }
  }
  return out;
}

/// What the views say of one height together: the mean of their correlations, and that of the better
/// half of them. One alone says it once.
/// returns  one or two [P], -1 where none sees the pixel
std::vector<Tensor> scores_of(std::vector<Tensor> correlations) {
  if (correlations.size() == 1) return correlations;
  const Index P = correlations[0].count();
  Tensor all({P}, -1.f), better_half({P}, -1.f);
  std::vector<float> seen;
  for (Index i = 0; i < P; ++i) {
    if (correlations.size() == 2) {  // as most scenes have: sorting them takes longer
      const float a = correlations[0][i], b = correlations[1][i];
      better_half[i] = std::max(a, b);
      all[i] = std::min(a, b) > -1.f ? (a + b) / 2 : better_half[i];
      continue;
    }
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

/// One more height tried, for some pixels.
void add(BestHeights& heights, const Tensor& score, float z, float peak, Index begin, Index end) {
  for (Index i = begin; i < end; ++i) {
    const float s = score[i];
    const bool same_peak = std::abs(z - heights.where[i]) <= peak;
    if (s > heights.best[i]) {
      if (!same_peak) heights.rival[i] = heights.best[i];
      heights.best[i] = s;
      heights.where[i] = z;
    } else if (!same_peak && s > heights.rival[i]) {
      heights.rival[i] = s;
    }
  }
}

}  // namespace

bool BestHeights::sure(Index pixel) const {
  return best[pixel] >= kAgreement && best[pixel] - rival[pixel] >= kUnique;
}

HeightSweep::Coarse HeightSweep::coarse_of(const View& view, Index factor) {
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
Index HeightSweep::textured_windows(const Coarse& image) {
  Tensor product(image.grey.shape());
  for (Index i = 0; i < image.grey.count(); ++i) product[i] = image.grey[i] * image.grey[i];
  const Tensor sum = box_sum(image.grey), sum2 = box_sum(product), n = box_sum(image.valid);
  Index textured = 0;
  for (Index i = 0; i < image.grey.count(); ++i) {
    if (n[i] < kWhole) continue;
    const float mean = sum[i] / n[i];
    textured += sum2[i] / n[i] - mean * mean >= kTexture ? 1 : 0;
  }
  return textured;
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

/// Correlation of every window in a box with another image warped to it; -1 where that is not seen.
Tensor HeightSweep::correlation(Index view, Index other, const PixelBox& box, double z) const {
  const Coarse &a = image(view), &b = image(other);
  const Quadratic& b_from_a = transfers_.at({view, other});
  const Index H = box.height(), W = box.width(), h = b.grey.dim(0), w = b.grey.dim(1);
  Tensor n({H, W}), sa({H, W}), sb({H, W}), saa({H, W}), sbb({H, W}), sab({H, W});
  Index seen = 0;
  for (Index y = box.y0, i = 0; y < box.y1; ++y)
    for (Index x = box.x0; x < box.x1; ++x, ++i) {
      const Index from = y * a.grey.dim(1) + x;
      if (a.valid[from] < 1) continue;
      const auto q = b_from_a(static_cast<double>(x), static_cast<double>(y), z);
      const Index u = floored(q[0]), v = floored(q[1]);
      if (u < 0 || v < 0 || u + 1 >= w || v + 1 >= h || b.valid[v * w + u] < 1) continue;
      const float fu = static_cast<float>(q[0]) - static_cast<float>(u),
                  fv = static_cast<float>(q[1]) - static_cast<float>(v);
      ++seen;
      const float* p = b.grey.data() + v * w + u;
      const float vb = (1 - fv) * ((1 - fu) * p[0] + fu * p[1]) +
                       fv * ((1 - fu) * p[w] + fu * p[w + 1]),
                  va = a.grey[from];
      n[i] = 1;
      sa[i] = va;
      sb[i] = vb;
      saa[i] = va * va;
      sbb[i] = vb * vb;
      sab[i] = va * vb;
    }
  Tensor out({H, W}, -1.f);
  // Wide ranges move images apart at most of their heights.
  if (static_cast<float>(seen) < kWhole) return out;
  n = box_sum(n), sa = box_sum(sa), sb = box_sum(sb), saa = box_sum(saa), sbb = box_sum(sbb),
  sab = box_sum(sab);
  for (Index i = 0; i < H * W; ++i) {
    if (n[i] < kWhole) continue;
    const float ma = sa[i] / n[i], mb = sb[i] / n[i], va = saa[i] / n[i] - ma * ma,
                vb = sbb[i] / n[i] - mb * mb;
    if (va < kTexture || vb < kTexture) continue;
    out[i] = (sab[i] / n[i] - ma * mb) / std::sqrt(va * vb);
  }
  return out;
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
        correlations.push_back(correlation(view, other, box, height(k)));
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
