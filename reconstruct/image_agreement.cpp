// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/image_agreement.h"

#include "satsurf/core/parallel.h"
#include "satsurf/reconstruct/shown_place.h"
#include "satsurf/scene/sight_lines.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

namespace satsurf::reconstruct {
namespace {

constexpr Index kSide = 8;                                // points along a square
constexpr double kSpacing = 3;                            // px between them
constexpr double kLeastSquares = 20, kLeastShare = 0.01;  // to judge an image by

using Points = std::array<float, kSide * kSide>;  ///< brightness, NaN where not seen

/// What was found in some squares.
struct Found {
  double correlations = 0;  ///< summed over the pairs
  Index pairs = 0;
  /// For each image the squares in which it was judged, and those in which nobody confirmed it.
  std::vector<Index> judged, alone;
  Index points = 0, in_two = 0;  ///< of the surface, and of them those in fewer than three images

  explicit Found(std::size_t images) : judged(images), alone(images) {}
  void add(const Found& other) {
    correlations += other.correlations, pairs += other.pairs;
    points += other.points, in_two += other.in_two;
    for (std::size_t i = 0; i < judged.size(); ++i)
      judged[i] += other.judged[i], alone[i] += other.alone[i];
  }
};

/// Looks at one square, of which every image shows some points.
void judge(const std::vector<Points>& shown, Found& found) {
  const std::size_t n = shown.size();
  std::vector<double> best(n, -2);  // with any other; -2 for none to compare with
  std::vector<bool> confirmed(n * n);
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < i; ++j)
      if (const auto c = correlation(shown[i], shown[j])) {
        found.correlations += *c, ++found.pairs;
        best[i] = std::max(best[i], *c), best[j] = std::max(best[j], *c);
        confirmed[i * n + j] = *c >= kConfirmed;
      }
  for (std::size_t k = 0; k < n; ++k) {
    if (best[k] < -1) continue;
    bool others = false;
    for (std::size_t i = 0; i < n; ++i)
      for (std::size_t j = 0; j < i; ++j) others |= i != k && j != k && confirmed[i * n + j];
    if (!others) continue;
    ++found.judged[k];
    found.alone[k] += best[k] < kUnlike;
  }
}

double middle_of(const Tensor& heights) {
  double low = INFINITY, high = -INFINITY;
  for (const float v : heights.values())
    if (std::isfinite(v))
      low = std::min(low, static_cast<double>(v)), high = std::max(high, static_cast<double>(v));
  return low <= high ? 0.5 * (low + high) : 0;
}

}  // namespace

std::optional<double> correlation(std::span<const float> a, std::span<const float> b) {
  constexpr double kLeastDeviation = 0.004;  // of the brightness: one grey level
  double n = 0, sa = 0, sb = 0, saa = 0, sbb = 0, sab = 0;
  for (std::size_t k = 0; k < a.size(); ++k) {
    const auto p = static_cast<double>(a[k]), q = static_cast<double>(b[k]);
    if (!(std::isfinite(p) && std::isfinite(q))) continue;
    n += 1, sa += p, sb += q, saa += p * p, sbb += q * q, sab += p * q;
  }
  if (2 * n < static_cast<double>(a.size())) return std::nullopt;
  const double va = saa / n - sa * sa / (n * n), vb = sbb / n - sb * sb / (n * n);
  constexpr double kLeast = kLeastDeviation * kLeastDeviation;
  if (va < kLeast || vb < kLeast) return 0;
  return (sab / n - sa * sb / (n * n)) / std::sqrt(va * vb);
}

ImageAgreement image_agreement(const scene::HeightField& surface,
                               const std::vector<nn::PosedImage>& images) {
  ImageAgreement out{.unconfirmed = std::vector<double>(images.size(), 0)};
  std::vector<scene::LitView> views;
  for (const nn::PosedImage& image : images) views.push_back({image});
  const scene::SightLines lines(surface, views);
  if (lines.empty() || images.size() < 2) return out;

  const Index H = surface.z.dim(0), W = surface.z.dim(1);
  const double spacing =  // cells
      kSpacing * mean_footprint(images, middle_of(surface.z)) / surface.step;
  const auto squares = [&](Index cells) {
    return static_cast<Index>(static_cast<double>(cells) / (spacing * static_cast<double>(kSide)));
  };
  const auto cell = [&](Index square, Index point) {
    return static_cast<Index>(spacing * (static_cast<double>(square * kSide + point) + 0.5));
  };
  const Index rows = squares(H), columns = squares(W);
  std::vector<Found> in_rows(static_cast<std::size_t>(rows), Found(images.size()));
  for_each_index(rows, [&](Index r) {
    Found& found = in_rows[static_cast<std::size_t>(r)];
    std::vector<Points> shown(images.size());
    for (Index c = 0; c < columns; ++c) {
      for (Points& points : shown) points.fill(NAN);
      for (Index k = 0; k < kSide * kSide; ++k) {
        const Index i = cell(r, k / kSide), j = cell(c, k % kSide);
        const auto z = static_cast<double>(surface.z[i * W + j]);
        if (!std::isfinite(z)) continue;
        const double x = surface.x0 + (static_cast<double>(j) + 0.5) * surface.step,
                     y = surface.y0 - (static_cast<double>(i) + 0.5) * surface.step;
        Index holding = 0;
        for (std::size_t v = 0; v < images.size(); ++v) {
          const auto pixel = images[v].pixel_from_local(x, y, z);
          holding += nn::shown_pixel(images[v], pixel) >= 0;
          if (lines.sees(v, i, j))
            shown[v][static_cast<std::size_t>(k)] = shown_brightness(images[v], pixel);
        }
        ++found.points, found.in_two += holding < 3;
      }
      judge(shown, found);
    }
  });
  Found all(images.size());
  for (const Found& row : in_rows) all.add(row);
  if (all.pairs > 0) out.correlation = all.correlations / static_cast<double>(all.pairs);
  if (all.points > 0 && images.size() > 2)
    out.in_two = static_cast<double>(all.in_two) / static_cast<double>(all.points);
  const double least = std::max(kLeastSquares, kLeastShare * static_cast<double>(rows * columns));
  for (std::size_t v = 0; v < images.size(); ++v)
    if (const auto judged = static_cast<double>(all.judged[v]); judged >= least)
      out.unconfirmed[v] = static_cast<double>(all.alone[v]) / judged;
  return out;
}

}  // namespace satsurf::reconstruct
