// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/surface_input.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/nn/squeezed.h"
#include "satsurf/reconstruct/cell_mode.h"
#include "satsurf/reconstruct/cell_surfels.h"
#include "satsurf/reconstruct/horizon.h"
#include "satsurf/reconstruct/quantile.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

namespace satsurf::reconstruct {
namespace {

using nn::kSurfaceCandidates;
using nn::SurfaceCandidate;
using nn::SurfacePlane;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

Index at(SurfaceCandidate c) { return static_cast<Index>(c); }
Index at(SurfacePlane p) { return static_cast<Index>(p); }

/// Heights in square blocks of cells.
struct Blocks {
  Index side, rows, columns;
  Tensor median, low;  ///< [rows columns] of the cells' heights, NaN where none is known
};

Blocks blocks_of(const float* heights, const FusionGrid& grid) {
  constexpr double kSide = 2.5, kLow = 0.2;  // m, share
  Blocks out;
  out.side = std::max<Index>(1, static_cast<Index>(std::lround(kSide / grid.step)));
  out.rows = (grid.height + out.side - 1) / out.side;
  out.columns = (grid.width + out.side - 1) / out.side;
  out.median = Tensor({out.rows, out.columns}, kNan);
  out.low = Tensor({out.rows, out.columns}, kNan);
  for_each_index(out.rows, [&](Index r) {
    std::vector<float> known;
    for (Index c = 0; c < out.columns; ++c) {
      known.clear();
      for (Index i = r * out.side; i < std::min((r + 1) * out.side, grid.height); ++i)
        for (Index j = c * out.side; j < std::min((c + 1) * out.side, grid.width); ++j)
          if (const float z = heights[i * grid.width + j]; std::isfinite(z)) known.push_back(z);
      if (known.empty()) continue;
      out.median[r * out.columns + c] = quantile(known, 0.5);
      out.low[r * out.columns + c] = quantile(known, kLow);
    }
  });
  return out;
}

/// For every block a number made of the known ones within `reach` blocks of it; NaN without any.
template <class Of>
Tensor of_neighbours(const Tensor& blocks, Index reach, const Of& of) {
  const Index R = blocks.dim(0), C = blocks.dim(1);
  Tensor out({R, C}, kNan);
  for_each_index(R, [&](Index r) {
    std::vector<float> known;
    for (Index c = 0; c < C; ++c) {
      known.clear();
      for (Index i = std::max<Index>(0, r - reach); i <= std::min(R - 1, r + reach); ++i)
        for (Index j = std::max<Index>(0, c - reach); j <= std::min(C - 1, c + reach); ++j)
          if (const float z = blocks[i * C + j]; std::isfinite(z)) known.push_back(z);
      if (!known.empty()) out[r * C + c] = of(known, blocks[r * C + c]);
    }
  });
  return out;
}

/// The unknown ones next to known ones take their mean, again and again.
Tensor grown(Tensor blocks, int times) {
  for (int n = 0; n < times; ++n)
    blocks = of_neighbours(blocks, 1, [](const std::vector<float>& known, float own) {
      if (std::isfinite(own)) return own;
      double sum = 0;
      for (const float z : known) sum += static_cast<double>(z);
      return static_cast<float>(sum / static_cast<double>(known.size()));
    });
  return blocks;
}

/// Bilinear between the middles of the blocks, of those that are known.
void spread_over_cells(const Tensor& blocks, Index side, const FusionGrid& grid, float* cells) {
  const Index R = blocks.dim(0), C = blocks.dim(1);
  for_each_index(grid.height, [&](Index i) {
    const double v = (static_cast<double>(i) + 0.5) / static_cast<double>(side) - 0.5,
                 r0 = std::floor(v);
    for (Index j = 0; j < grid.width; ++j) {
      const double u = (static_cast<double>(j) + 0.5) / static_cast<double>(side) - 0.5,
                   c0 = std::floor(u);
      double sum = 0, weight = 0;
      for (const double dr : {0.0, 1.0})
        for (const double dc : {0.0, 1.0}) {
          const Index r = std::clamp<Index>(static_cast<Index>(r0 + dr), 0, R - 1),
                      c = std::clamp<Index>(static_cast<Index>(c0 + dc), 0, C - 1);
          const float z = blocks[r * C + c];
          const double w = (1 - std::abs(v - r0 - dr)) * (1 - std::abs(u - c0 - dc));
          if (std::isfinite(z)) sum += w * static_cast<double>(z), weight += w;
        }
      cells[i * grid.width + j] = weight > 1e-3 ? static_cast<float>(sum / weight) : kNan;
    }
  });
}

constexpr std::size_t kMostImages = 16;  ///< that are looked at in one place

/// One image at one point.
struct Look {
  double local;                  ///< brightness as `nn::locally_normalised` makes it
  std::array<double, 3> colour;  ///< standardised
};

/// What the images show.
class Appearance {
 public:
  /// Keeps a reference to the images.
  explicit Appearance(const std::vector<nn::PosedImage>& images) : images_(images) {
    for (const nn::PosedImage& image : images) {
      local_.push_back(nn::locally_normalised<float>(image));
      colour_.push_back(nn::standardised<float>(image));
    }
  }
  std::size_t count() const { return local_.size(); }

  /// Where image i shows the points above a local place.
  QuadraticLine line(std::size_t i, double x, double y) const {
    return images_[i].pixel_from_local.along_z(x, y);
  }

  /// Image i at pixel (u, v); whether it shows something there.
  bool look(std::size_t i, double u, double v, bool colours, Look& out) const {
    const Tensor& valid = images_[i].valid;
    const Index H = valid.dim(0), W = valid.dim(1), P = H * W;
    if (W < 2 || H < 2) return false;
    if (!(u >= 0 && v >= 0 && u <= static_cast<double>(W - 1) && v <= static_cast<double>(H - 1)))
      return false;
    const Index c = std::min(static_cast<Index>(u), W - 2),
                r = std::min(static_cast<Index>(v), H - 2), p = r * W + c;
    if (!(valid[p] > 0 && valid[p + W + 1] > 0)) return false;
    const double a = u - static_cast<double>(c), b = v - static_cast<double>(r);
    const auto read = [&](const float* m) {
      return (1 - b) * ((1 - a) * static_cast<double>(m[p]) + a * static_cast<double>(m[p + 1])) +
             b * ((1 - a) * static_cast<double>(m[p + W]) + a * static_cast<double>(m[p + W + 1]));
    };
    out.local = read(local_[i].data());
    if (colours)
      for (std::size_t k = 0; k < 3; ++k)
        out.colour[k] = read(colour_[i].data() + static_cast<Index>(k) * P);
    return true;
  }

 private:
  const std::vector<nn::PosedImage>& images_;
  std::vector<Tensor> local_, colour_;
};

/// Ground towards the satellite of an image (east, north) per metre of height, at the middle of a grid.
std::array<double, 2> toward_satellite(const nn::PosedImage& image, const FusionGrid& grid,
                                       double z) {
  constexpr double kUp = 10;  // m
  const double x = grid.east + 0.5 * static_cast<double>(grid.width) * grid.step,
               y = grid.north - 0.5 * static_cast<double>(grid.height) * grid.step;
  const auto [u, v] = image.pixel_from_local(x, y, z);
  const auto low = image.local_from_pixel(u, v, z), high = image.local_from_pixel(u, v, z + kUp);
  return {(high[0] - low[0]) / kUp, (high[1] - low[1]) / kUp};
}

/// Of every image the heights up to which the modes hide the cells from it, each [H W].
/// candidates  [K H W]
std::vector<Tensor> horizons_of(const Tensor& candidates, const FusionGrid& grid,
                                const std::vector<nn::PosedImage>& images) {
  const Index P = grid.height * grid.width;
  Tensor surface({grid.height, grid.width}, kNan);
  double sum = 0, known = 0;
  for (Index i = 0; i < P; ++i) {
    const float mode = candidates[at(SurfaceCandidate::mode) * P + i];
    surface[i] = std::isfinite(mode) ? mode : candidates[at(SurfaceCandidate::around) * P + i];
    if (std::isfinite(surface[i])) sum += static_cast<double>(surface[i]), known += 1;
  }
  std::vector<Tensor> out(images.size());
  for_each_index(std::ssize(images), [&](Index n) {
    const auto i = static_cast<std::size_t>(n);
    out[i] = sight_horizon(surface, grid.step,
                           toward_satellite(images[i], grid, known > 0 ? sum / known : 0));
  });
  return out;
}

/// How much the images that show a point differ there.
struct Disagreement {
  double mean = 1, best = 1;
};

Disagreement disagreement_of(const std::array<Look, kMostImages>& looks, std::size_t n) {
  if (n < 2) return {};
  double sum = 0, best = INFINITY;
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < i; ++j) {
      const double d = std::abs(looks[i].local - looks[j].local);
      sum += d;
      best = std::min(best, d);
    }
  return {sum / static_cast<double>(n * (n - 1)), best};
}

}  // namespace

nn::SurfaceInput surface_input(const Tensor& means, const Tensor& confidence,
                               const SurfelEvidence& evidence, const FusionGrid& grid,
                               const std::vector<nn::PosedImage>& images) {
  Dims dim("surface_input");
  dim.match("means", means, "P 3").match("confidence", confidence, "P");
  dim.match("weight", evidence.weight, "P").match("rays", evidence.rays, "P 2");
  const Index H = grid.height, W = grid.width, P = H * W;
  nn::SurfaceInput out{Tensor({kSurfaceCandidates, H, W}, kNan), Tensor({nn::kSurfacePlanes, H, W}),
                       grid.interval};
  float *candidate = out.candidates.data(), *plane = out.planes.data();
  const auto put = [&](SurfacePlane p, Index cell, double value) {
    plane[at(p) * P + cell] = static_cast<float>(value);
  };

  const SurfelCells cells(means, confidence, evidence, grid);
  const CellReach gather(cells, grid);
  const double bandwidth = gather.bandwidth(), area = grid.step * grid.step;
  for_each_index(H, [&](Index i) {
    std::vector<CellCandidate> reaching;
    for (Index j = 0; j < W; ++j) {
      gather(i, j, reaching);
      const CellSummary s = summary_of(reaching, bandwidth);
      const Index cell = i * W + j;
      const auto height = [&](SurfaceCandidate c, double z) {
        candidate[at(c) * P + cell] = static_cast<float>(z);
      };
      height(SurfaceCandidate::mode, s.mode.height);
      height(SurfaceCandidate::second, s.second);
      height(SurfaceCandidate::low, s.low);
      height(SurfaceCandidate::high, s.high);
      put(SurfacePlane::mode_share, cell, s.mode_share);
      put(SurfacePlane::second_share, cell, s.second_share);
      put(SurfacePlane::weight, cell, 0.5 * std::log1p(s.weight / area));
      put(SurfacePlane::confidence, cell, s.confidence);
      put(SurfacePlane::spread, cell, nn::squeezed(s.spread / grid.interval));
      put(SurfacePlane::cell, cell, std::log(grid.step / grid.footprint));
    }
  });

  const Blocks blocks = blocks_of(candidate + at(SurfaceCandidate::mode) * P, grid);
  constexpr int kGrow = 4;
  constexpr Index kNear = 4;  // blocks
  spread_over_cells(grown(blocks.median, kGrow), blocks.side, grid,
                    candidate + at(SurfaceCandidate::around) * P);
  spread_over_cells(
      of_neighbours(blocks.low, kNear,
                    [](std::vector<float>& known, float) { return quantile(known, 0.1); }),
      blocks.side, grid, candidate + at(SurfaceCandidate::ground) * P);

  const Appearance appearance(images);
  const std::vector<Tensor> horizons = horizons_of(out.candidates, grid, images);
  for_each_index(H, [&](Index i) {
    std::array<Look, kMostImages> looks{}, seen{};
    std::vector<QuadraticLine> lines(appearance.count());
    const double y = grid.north - (static_cast<double>(i) + 0.5) * grid.step;
    for (Index j = 0; j < W; ++j) {
      const double x = grid.east + (static_cast<double>(j) + 0.5) * grid.step;
      const Index cell = i * W + j;
      const bool known = std::isfinite(candidate[at(SurfaceCandidate::mode) * P + cell]);
      const Index shown = at(known ? SurfaceCandidate::mode : SurfaceCandidate::around);
      for (std::size_t v = 0; v < lines.size(); ++v) lines[v] = appearance.line(v, x, y);
      for (Index k = 0; k < kSurfaceCandidates; ++k) {
        const auto z = static_cast<double>(candidate[k * P + cell]);
        std::size_t n = 0, open = 0;
        double bright = 0;
        if (std::isfinite(z))
          for (std::size_t v = 0; v < appearance.count() && n < kMostImages; ++v) {
            const auto [column, row] = lines[v](z);
            if (!appearance.look(v, column, row, k == shown, looks[n])) continue;
            // as much higher as one pixel of parallax may well be the cell's own surface
            if (z > static_cast<double>(horizons[v][cell]) - grid.interval) {
              bright += looks[n].local;
              seen[open++] = looks[n];
            }
            ++n;
          }
        const Disagreement d = disagreement_of(looks, n);
        const auto of_candidate = [&](SurfacePlane p, double value) {
          plane[(at(p) + k) * P + cell] = static_cast<float>(value);
        };
        of_candidate(SurfacePlane::disagreement, d.mean);
        of_candidate(SurfacePlane::best_pair, d.best);
        of_candidate(SurfacePlane::seen, 0.25 * static_cast<double>(open));
        of_candidate(SurfacePlane::seen_disagreement, disagreement_of(seen, open).mean);
        of_candidate(SurfacePlane::brightness, open > 0 ? bright / static_cast<double>(open) : 0);
        if (k != shown || n == 0) continue;
        std::array<double, 3> mean{};
        double darkest = INFINITY, brightest = -INFINITY;
        for (std::size_t v = 0; v < n; ++v) {
          const auto& c = looks[v].colour;
          const double brightness = (c[0] + c[1] + c[2]) / 3;
          darkest = std::min(darkest, brightness), brightest = std::max(brightest, brightness);
          for (std::size_t b = 0; b < 3; ++b) mean[b] += c[b] / static_cast<double>(n);
        }
        put(SurfacePlane::views, cell, 0.25 * static_cast<double>(n));
        for (Index b = 0; b < 3; ++b)
          plane[(at(SurfacePlane::red) + b) * P + cell] =
              static_cast<float>(mean[static_cast<std::size_t>(b)]);
        put(SurfacePlane::darkest, cell, darkest);
        put(SurfacePlane::range, cell, brightest - darkest);
      }
    }
  });
  return out;
}

}  // namespace satsurf::reconstruct
