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
/// Valid pixels of a window that can be compared.
constexpr float kWhole = 0.9f * static_cast<float>(HeightSweep::kPatch);
constexpr float kTexture = 1e-5f;  // variance of a window that is not flat
constexpr Index kGrain = 1 << 12;  // pixels of one piece of work

/// Sums over the windows around the pixels of one row, of several maps at once.
class WindowSums {
 public:
  /// Keeps a reference to the maps.
  /// maps  [C H W]
  explicit WindowSums(const Tensor& maps)
      : maps_(maps),
        sums_({maps.dim(0), maps.dim(2)}),
        none_(static_cast<std::size_t>(maps.dim(2)), 0.f),
        columns_(static_cast<std::size_t>(maps.dim(2) + 2 * kReach), 0.f) {}

  /// Those of one row, [C W]; windows are cut at the border.
  const Tensor& row(Index y) {
    const Index C = maps_.dim(0), H = maps_.dim(1), W = maps_.dim(2);
    for (Index c = 0; c < C; ++c) {
      std::array<const float*, kSide> rows;
      for (Index k = 0; k < kSide; ++k) {
        const Index at = y + k - kReach;
        rows[static_cast<std::size_t>(k)] =
            at < 0 || at >= H ? none_.data() : maps_.data() + (c * H + at) * W;
      }
      add_up(rows, W, columns_.data() + kReach);
      std::array<const float*, kSide> shifted;
      for (std::size_t k = 0; k < shifted.size(); ++k) shifted[k] = columns_.data() + k;
      add_up(shifted, W, sums_.data() + c * W);
    }
    return sums_;
  }

 private:
  static constexpr Index kReach = HeightSweep::kRadius, kSide = 2 * kReach + 1;

  static void add_up(const std::array<const float*, kSide>& terms, Index n,
                     float* __restrict__ out) {
    static_assert(kSide == 7);
    const auto [a, b, c, d, e, f, g] = terms;
    for (Index i = 0; i < n; ++i) out[i] = ((a[i] + b[i]) + (c[i] + d[i])) + ((e[i] + f[i]) + g[i]);
  }

  const Tensor& maps_;
  Tensor sums_;
  std::vector<float> none_, columns_;  ///< columns have kReach zeros on either side
};

/// Correlations of W windows from their sums of 1, a, b, a a, b b and a b, each [W]; -1 where little
/// was seen or nothing stands out. Without a branch, so that it works on several windows at once.
void correlate(const float* sums, Index W, float* __restrict__ out) {
  const float *seen = sums, *a = sums + W, *b = sums + 2 * W, *aa = sums + 3 * W,
              *bb = sums + 4 * W, *ab = sums + 5 * W;
  for (Index x = 0; x < W; ++x) {
    const float n = seen[x] > 1 ? seen[x] : 1.f, ma = a[x] / n, mb = b[x] / n,
                va = aa[x] / n - ma * ma, vb = bb[x] / n - mb * mb,
                da = va > kTexture ? va : kTexture, db = vb > kTexture ? vb : kTexture,
                r = (ab[x] / n - ma * mb) / std::sqrt(da * db);
    const float least = va < vb ? va : vb, known = least < kTexture ? -1.f : r;
    out[x] = n < kWhole ? -1.f : known;
  }
}

/// A map of three coordinates along a row of the first.
class AlongRow {
 public:
  AlongRow(const Quadratic& map, double y, double z)
      : offset_(map.offset[0]), scale_(map.scale[0]) {
    const double v = (y - map.offset[1]) / map.scale[1], w = (z - map.offset[2]) / map.scale[2];
    for (std::size_t k = 0; k < 2; ++k) {
      const auto& c = map.coeff[k];
      terms_[k] = {c[0] + c[2] * v + c[3] * w + c[7] * v * v + c[8] * v * w + c[9] * w * w,
                   c[1] + c[5] * v + c[6] * w, c[4]};
    }
  }
  std::array<double, 2> operator()(double x) const {
    const double u = (x - offset_) / scale_;
    return {terms_[0][0] + u * (terms_[0][1] + u * terms_[0][2]),
            terms_[1][0] + u * (terms_[1][1] + u * terms_[1][2])};
  }

 private:
  double offset_, scale_;
  std::array<std::array<double, 3>, 2> terms_{};  ///< constant, linear, quadratic
};

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
  const Index H = image.grey.dim(0), W = image.grey.dim(1), P = H * W;
  auto maps = Tensor::uninitialised({3, H, W});
  for (Index i = 0; i < P; ++i) {
    maps[i] = image.valid[i];
    maps[P + i] = image.grey[i];
    maps[2 * P + i] = image.grey[i] * image.grey[i];
  }
  WindowSums sums(maps);
  Index textured = 0;
  for (Index y = 0; y < H; ++y) {
    const Tensor& s = sums.row(y);
    for (Index x = 0; x < W; ++x) {
      const float n = s[x];
      if (n < kWhole) continue;
      const float mean = s[W + x] / n;
      textured += s[2 * W + x] / n - mean * mean >= kTexture ? 1 : 0;
    }
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
  const Index H = box.height(), W = box.width(), P = H * W, h = b.grey.dim(0), w = b.grey.dim(1);
  Tensor maps({6, H, W});  // 1, a, b, a a, b b, a b where both are seen
  const auto right = static_cast<double>(w - 1), bottom = static_cast<double>(h - 1);
  Index seen = 0;
  for (Index y = box.y0, i = 0; y < box.y1; ++y) {
    const AlongRow place(b_from_a, static_cast<double>(y), z);
    for (Index x = box.x0; x < box.x1; ++x, ++i) {
      const Index from = y * a.grey.dim(1) + x;
      if (a.valid[from] < 1) continue;
      const auto q = place(static_cast<double>(x));
      if (!(q[0] >= 0 && q[1] >= 0 && q[0] < right && q[1] < bottom)) continue;
      const auto u = static_cast<Index>(q[0]), v = static_cast<Index>(q[1]);
      if (b.valid[v * w + u] < 1) continue;
      const float fu = static_cast<float>(q[0]) - static_cast<float>(u),
                  fv = static_cast<float>(q[1]) - static_cast<float>(v);
      ++seen;
      const float* p = b.grey.data() + v * w + u;
      const float vb = (1 - fv) * ((1 - fu) * p[0] + fu * p[1]) +
                       fv * ((1 - fu) * p[w] + fu * p[w + 1]),
                  va = a.grey[from];
      maps[i] = 1;
      maps[P + i] = va;
      maps[2 * P + i] = vb;
      maps[3 * P + i] = va * va;
      maps[4 * P + i] = vb * vb;
      maps[5 * P + i] = va * vb;
    }
  }
  // Wide ranges move images apart at most of their heights.
  if (static_cast<float>(seen) < kWhole) return Tensor({H, W}, -1.f);
  auto out = Tensor::uninitialised({H, W});
  WindowSums sums(maps);
  for (Index y = 0; y < H; ++y) correlate(sums.row(y).data(), W, out.data() + y * W);
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
