// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/height_range.h"

#include "satsurf/core/parallel.h"
#include "satsurf/core/whole.h"
#include "satsurf/ops/resize.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/scene/believable_span.h"

#include <algorithm>
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

constexpr Index kCoarse = 256;       // px, side of the images of the sweep
constexpr Index kRadius = 3;         // px, half a correlation window
constexpr double kAgreement = 0.75;  // correlation from which a match counts
constexpr double kUnique = 0.1;      // by which the best height must beat every other peak
constexpr Index kPatch = (2 * kRadius + 1) * (2 * kRadius + 1);  // px, the least that is believed
/// Added at both ends, m: roofs and gullies smaller than a coarse window.
constexpr double kMargin = 15;
/// Added above besides, of the span: the higher a city, the higher may a single tower rise above
/// all that is found.
constexpr double kTower = 0.25;
/// Valid pixels of a window that can be compared.
constexpr float kWhole = 0.9f * static_cast<float>(kPatch);
constexpr float kTexture = 1e-5f;  // variance of a window that is not flat
constexpr Index kGrain = 1 << 12;  // pixels of one piece of work
constexpr Index kFewest = 100;     // matches that make a range believable

/// Luminance at coarse resolution.
struct Coarse {
  Tensor grey, valid;  // [h w]
  Index factor = 1;
};

Coarse coarse_of(const View& view, Index factor) {
  const Index h = view.rgb.dim(1) / factor * factor, w = view.rgb.dim(2) / factor * factor;
  Tensor grey({h, w}), valid({h, w});
  const Index P = view.valid.count(), W = view.rgb.dim(2);
  for (Index y = 0; y < h; ++y)
    for (Index x = 0; x < w; ++x) {
      const Index i = y * W + x;
      grey[y * w + x] = (view.rgb[i] + view.rgb[P + i] + view.rgb[2 * P + i]) / 3;
      valid[y * w + x] = view.valid[i];
    }
  return {area_downsample(Var(grey), factor).value(), area_downsample(Var(valid), factor).value(),
          factor};
}

/// Sums over (2 r + 1)^2 windows by running sums; windows are cut at the border.
Tensor box_sum(const Tensor& t) {
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
    const double* const top = integral.data() + std::max<Index>(0, y - kRadius) * stride;
    const double* const bottom = integral.data() + std::min(H, y + kRadius + 1) * stride;
    for (Index x = 0; x < W; ++x) {
      const Index x0 = std::max<Index>(0, x - kRadius), x1 = std::min(W, x + kRadius + 1);
      out[y * W + x] = static_cast<float>(bottom[x1] - top[x1] - bottom[x0] + top[x0]);
    }
  }
  return out;
}

/// Correlation of every window of `a` with `b` warped to it; -1 where `b` is not seen.
Tensor correlation(const Coarse& a, const Coarse& b, const Quadratic& b_from_a, double z) {
  const Index H = a.grey.dim(0), W = a.grey.dim(1), h = b.grey.dim(0), w = b.grey.dim(1);
  Tensor n({H, W}), sa({H, W}), sb({H, W}), saa({H, W}), sbb({H, W}), sab({H, W});
  Index seen = 0;
  for (Index i = 0; i < H * W; ++i) {
    if (a.valid[i] < 1) continue;
    const auto q = b_from_a(static_cast<double>(i % W), static_cast<double>(i / W), z);
    const Index x = floored(q[0]), y = floored(q[1]);
    if (x < 0 || y < 0 || x + 1 >= w || y + 1 >= h || b.valid[y * w + x] < 1) continue;
    const float fx = static_cast<float>(q[0]) - static_cast<float>(x),
                fy = static_cast<float>(q[1]) - static_cast<float>(y);
    ++seen;
    const float* p = b.grey.data() + y * w + x;
    const float vb = (1 - fy) * ((1 - fx) * p[0] + fx * p[1]) +
                     fy * ((1 - fx) * p[w] + fx * p[w + 1]),
                va = a.grey[i];
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

/// Heights of the believed pixels, in patches whose neighbours differ by at most `step`; those of
/// kPatch or more. A chance match spreads over hardly more than the window it was found in.
std::vector<Patch> patches_of(const Tensor& where, std::vector<char> believed, Index H, Index W,
                              float step) {
  std::vector<Patch> patches;
  std::vector<Index> patch;
  for (Index start = 0; start < H * W; ++start) {
    if (!believed[static_cast<std::size_t>(start)]) continue;
    patch.assign(1, start);
    believed[static_cast<std::size_t>(start)] = 0;
    for (std::size_t k = 0; k < patch.size(); ++k) {
      const Index i = patch[k], y = i / W, x = i % W;
      for (Index v = std::max<Index>(0, y - 1); v <= std::min(H - 1, y + 1); ++v)
        for (Index u = std::max<Index>(0, x - 1); u <= std::min(W - 1, x + 1); ++u) {
          const Index j = v * W + u;
          if (!believed[static_cast<std::size_t>(j)] || std::abs(where[j] - where[i]) > step)
            continue;
          believed[static_cast<std::size_t>(j)] = 0;
          patch.push_back(j);
        }
    }
    if (static_cast<Index>(patch.size()) < kPatch) continue;
    Patch& heights = patches.emplace_back();
    for (const Index i : patch) heights.push_back(where[i]);
  }
  return patches;
}

/// The best height of every pixel among those tried so far, and what it has to beat.
struct Sweep {
  Tensor best, rival, where;  // [P]
  float peak;                 // heights this close belong to one peak

  Sweep(Index pixels, float peak_)
      : best({pixels}, -1.f), rival({pixels}, -1.f), where({pixels}, 0.f), peak(peak_) {}

  /// Of some pixels.
  void add(const Tensor& score, float z, Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const float s = score[i];
      const bool same_peak = std::abs(z - where[i]) <= peak;
      if (s > best[i]) {
        if (!same_peak) rival[i] = best[i];
        best[i] = s;
        where[i] = z;
      } else if (!same_peak && s > rival[i]) {
        rival[i] = s;
      }
    }
  }
};

/// What the views say of one height together: the mean of their correlations, and that of the better
/// half of them, as one image may show something else (snow, another season). One alone says it once.
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

std::string names_of(const Scene& scene) {
  std::string text;
  for (std::size_t i = 0; i < scene.views.size(); ++i)
    text += (i == 0 ? "" : i + 1 < scene.views.size() ? ", " : " and ") + scene.views[i].label();
  return text;
}

/// Windows of an image with enough contrast to be compared.
Index textured_windows(const Coarse& c) {
  Tensor product(c.grey.shape());
  for (Index i = 0; i < c.grey.count(); ++i) product[i] = c.grey[i] * c.grey[i];
  const Tensor sum = box_sum(c.grey), sum2 = box_sum(product), n = box_sum(c.valid);
  Index textured = 0;
  for (Index i = 0; i < c.grey.count(); ++i) {
    if (n[i] < kWhole) continue;
    const float mean = sum[i] / n[i];
    textured += sum2[i] / n[i] - mean * mean >= kTexture ? 1 : 0;
  }
  return textured;
}

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
  Index largest = 0;
  for (const View& v : scene.views) largest = std::max({largest, v.height(), v.width()});
  const Index factor = std::max<Index>(1, (largest + kCoarse - 1) / kCoarse);
  std::vector<Coarse> coarse;
  for (const View& v : scene.views) {
    coarse.push_back(coarse_of(v, factor));
    if (const Index n = textured_windows(coarse.back()); n < kFewest)
      throw Error(v.label() + ": " + std::to_string(n) + " windows with texture, expected " +
                  std::to_string(kFewest) + " or more to compare with the other images");
  }

  const View& reference = scene.views[0];
  const rpc::Window window{0, 0, static_cast<double>(reference.rgb.dim(2)),
                           static_cast<double>(reference.rgb.dim(1))};
  const double f = static_cast<double>(factor);
  std::vector<Quadratic> maps;
  double parallax = 0;  // coarse px per m, the largest of all views
  for (std::size_t j = 1; j < scene.views.size(); ++j) {
    maps.push_back(rescale_pixels(
        rpc::fit_transfer(reference.rpc, scene.views[j].rpc, scene.frame, window, searched), f, f));
    const auto jac =
        maps.back().jacobian(window.width / 2 / f, window.height / 2 / f, searched.middle());
    parallax = std::max(parallax, std::hypot(jac[0][2], jac[1][2]));
  }
  // disparity between tried heights; correlation survives half of it
  constexpr double kStepPx = 0.75;
  const double span = searched.span();
  const Index steps = std::clamp<Index>(floored(span * parallax / kStepPx) + 1, 8, 2000);

  const Index H = coarse[0].grey.dim(0), W = coarse[0].grey.dim(1);
  const auto peak = static_cast<float>(3 * span / static_cast<double>(steps));
  std::vector<Sweep> sweeps;  // one for each of `scores_of`
  for (std::size_t s = 0; s < std::min<std::size_t>(maps.size(), 2); ++s)
    sweeps.emplace_back(H * W, peak);
  // Pieces of rows would need the box sums' neighbours: correlations are parallel over heights,
  // which each pixel then sees in their order.
  constexpr Index kBatch = 16;
  for (Index first = 0; first < steps; first += kBatch) {
    if (poll) poll();
    const Index batch = std::min(kBatch, steps - first);
    std::vector<std::vector<Tensor>> scores(static_cast<std::size_t>(batch));
    const auto height = [&](Index k) {
      return searched.low +
             span * (static_cast<double>(first + k) + 0.5) / static_cast<double>(steps);
    };
    for_each_index(batch, [&](Index k) {
      std::vector<Tensor> correlations;
      for (std::size_t j = 0; j < maps.size(); ++j)
        correlations.push_back(correlation(coarse[0], coarse[j + 1], maps[j], height(k)));
      scores[static_cast<std::size_t>(k)] = scores_of(std::move(correlations));
    });
    for_range(H * W, kGrain, [&](Index begin, Index end) {
      for (Index k = 0; k < batch; ++k) {
        for (std::size_t s = 0; s < sweeps.size(); ++s)
          sweeps[s].add(scores[static_cast<std::size_t>(k)][s], static_cast<float>(height(k)),
                        begin, end);
      }
    });
  }

  Index agreeing = 0, masked = 0;  // of the sweep that finds more
  const auto span_of = [&](const Sweep& sweep) -> std::optional<rpc::HeightRange> {
    std::vector<char> believed(static_cast<std::size_t>(H * W));
    Index left_out = 0;
    for (Index i = 0; i < H * W; ++i) {
      if (sweep.best[i] < kAgreement || sweep.best[i] - sweep.rival[i] < kUnique) continue;
      believed[static_cast<std::size_t>(i)] = 1;
      if (!unwanted) continue;
      const rpc::Pixel pixel{(static_cast<double>(i % W) + 0.5) * f - 0.5,
                             (static_cast<double>(i / W) + 0.5) * f - 0.5};
      const auto p = scene.frame.local_from_geodetic(
          reference.rpc.localize(pixel, static_cast<double>(sweep.where[i]) + scene.frame.h0));
      if (unwanted(p[0], p[1])) believed[static_cast<std::size_t>(i)] = 0, ++left_out;
    }
    const auto patches = patches_of(sweep.where, std::move(believed), H, W, peak);
    Index count = 0;
    for (const Patch& patch : patches) count += static_cast<Index>(patch.size());
    agreeing = std::max(agreeing, count);
    masked = std::max(masked, left_out);
    if (count < kFewest) return {};
    return span_of_patches(patches, searched, 2 * kPatch);
  };
  std::optional<rpc::HeightRange> found = span_of(sweeps.front());
  if (sweeps.size() > 1) found = confirmed_span(found, span_of(sweeps.back()));
  if (!found) {
    char text[120];
    std::snprintf(text, sizeof text,
                  "%td windows agree at any height from %.0f to %.0f m, expected %td or more",
                  agreeing, scene.frame.heights_from_z(searched).low,
                  scene.frame.heights_from_z(searched).high, kFewest);
    const std::string why = masked >= kFewest ? ", " + std::to_string(masked) +
                                                    " more do under --mask; give a height range"
                                              : "; do the cameras belong to the images?";
    throw Error(names_of(scene) + ": " + text + why);
  }
  return {*found, {found->low - kMargin, found->high + kMargin + kTower * found->span()}};
}

}  // namespace satsurf::scene
