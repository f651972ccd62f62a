// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/hypotheses.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/resize.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace satsurf::nn {

double mean_parallax(const NetworkInput& scene) {
  const std::size_t N = scene.sources.size();
  const double x = (static_cast<double>(scene.sources[0].rgb.dim(2)) - 1) / 2,
               y = (static_cast<double>(scene.sources[0].rgb.dim(1)) - 1) / 2;
  double sum = 0;
  for (std::size_t i = 0; i < N; ++i)
    for (std::size_t j = 0; j < N; ++j) {
      if (i == j) continue;
      const auto jac = scene.transfer[i][j].jacobian(x, y, scene.z_range.middle());
      sum += std::hypot(jac[0][2], jac[1][2]);
    }
  return sum / static_cast<double>(N * (N - 1));
}

Index first_hypotheses(const ModelConfig& config, double parallax) {
  const Index least = config.hypotheses[0], most = std::max(least, config.most_hypotheses),
              multiple = Index{1} << config.volume_levels;
  const double apart = config.first_interval_px * static_cast<double>(kStrides[0]),
               steps = std::ceil((parallax / apart + 1) / static_cast<double>(multiple));
  if (!(steps * static_cast<double>(multiple) < static_cast<double>(most)))
    return most / multiple * multiple;
  return std::max(least, static_cast<Index>(steps) * multiple);
}

namespace {

/// Metres between the hypotheses of each stage.
/// parallax  image pixels per metre
/// first     hypotheses of the first stage
std::array<double, 3> intervals_of(const ModelConfig& config, const NetworkInput& scene,
                                   double parallax, Index first) {
  if (!scene.z_range.has_span())
    throw ConfigError("model: height range " + std::to_string(scene.z_range.low) + " to " +
                      std::to_string(scene.z_range.high) + ", expected a positive span");
  constexpr double kNoParallax = 1e-6;  // px per m; views from one direction carry no height
  const double last = std::clamp(config.interval_px / std::max(parallax, kNoParallax),
                                 config.interval_min, config.interval_max);
  return {scene.z_range.span() / static_cast<double>(first - 1), 2 * last, last};
}

}  // namespace

std::array<StageGrid, 3> stage_grids(const ModelConfig& config, const NetworkInput& scene,
                                     Wanted wanted) {
  const double parallax = mean_parallax(scene);
  std::array<Index, 3> hypotheses = config.hypotheses;
  if (wanted != Wanted::surfels)
    hypotheses[0] = first_hypotheses(config, parallax * scene.z_range.span());
  const auto intervals = intervals_of(config, scene, parallax, hypotheses[0]);
  const PosedImage& view = scene.sources[0];
  std::array<StageGrid, 3> grids;
  double next_reach = 0;
  for (std::size_t s = grids.size(); s-- > 0;) {
    grids[s] = {.views = static_cast<Index>(scene.sources.size()),
                .height = view.rgb.dim(1) / kStrides[s],
                .width = view.rgb.dim(2) / kStrides[s],
                .stride = kStrides[s],
                .hypotheses = hypotheses[s],
                .interval = intervals[s],
                .next_reach = next_reach};
    if (hypotheses[s] > 0) next_reach = 0.5 * static_cast<double>(hypotheses[s]) * intervals[s];
  }
  return grids;
}

template <class T>
BasicTensor<T> stage_hypotheses(const rpc::HeightRange& range, const StageGrid& grid,
                                const StageHeights<T>* previous, Centre centre) {
  if (grid.hypotheses == 0) return {};
  if (previous == nullptr) return uniform_hypotheses<T>(grid, range);
  const NoGrad no_grad;
  const BasicVar<T> coarse = previous->height.detach();
  const BasicTensor<T> middle = centre == Centre::bilinear
                                    ? resize_bilinear(coarse, grid.height, grid.width).value()
                                    : along_slopes(coarse.value(), grid.height, grid.width);
  // a surface at the very edge of the range stays inside the band
  const double margin = 2 * grid.interval;
  return narrowed_hypotheses(grid, middle, range.widened(margin));
}

template <class T>
BasicTensor<T> along_slopes(const BasicTensor<T>& coarse, Index height, Index width) {
  Dims dim("along_slopes");
  dim.match("coarse", coarse, "N h w");
  const Index N = dim["N"], h = dim["h"], w = dim["w"];
  const auto slope = [](double before, double after) {
    if (before * after <= 0) return 0.0;
    return std::abs(before) < std::abs(after) ? before : after;
  };
  auto out = BasicTensor<T>::uninitialised({N, height, width});
  for_each_index(N * height, [&](Index row) {
    const T* map = coarse.data() + row / height * h * w;
    const double v = (static_cast<double>(row % height) + 0.5) * static_cast<double>(h) /
                     static_cast<double>(height);
    const Index i = static_cast<Index>(v);
    for (Index j = 0; j < width; ++j) {
      const double u =
          (static_cast<double>(j) + 0.5) * static_cast<double>(w) / static_cast<double>(width);
      const Index k = static_cast<Index>(u);
      // beyond the border lies what is at the border, so that there is no slope across it
      const auto at = [&](Index r, Index c) {
        return static_cast<double>(
            map[std::clamp<Index>(r, 0, h - 1) * w + std::clamp<Index>(c, 0, w - 1)]);
      };
      const double z = at(i, k), down = slope(z - at(i - 1, k), at(i + 1, k) - z),
                   right = slope(z - at(i, k - 1), at(i, k + 1) - z);
      out[row * width + j] = static_cast<T>(z + down * (v - static_cast<double>(i) - 0.5) +
                                            right * (u - static_cast<double>(k) - 0.5));
    }
  });
  return out;
}

template <class T>
BasicTensor<T> uniform_hypotheses(const StageGrid& grid, const rpc::HeightRange& range) {
  const Index N = grid.views, D = grid.hypotheses, H = grid.height, W = grid.width;
  auto out = BasicTensor<T>::uninitialised({N, D, H, W});
  for_each_index(N * D, [&](Index nd) {
    const double t = static_cast<double>(nd % D) / static_cast<double>(D - 1);
    std::fill_n(out.data() + nd * H * W, H * W, static_cast<T>(range.low + t * range.span()));
  });
  return out;
}

template <class T>
BasicTensor<T> narrowed_hypotheses(const StageGrid& grid, const BasicTensor<T>& centre,
                                   const rpc::HeightRange& range) {
  const auto [low, high] = range;
  const Index N = grid.views, D = grid.hypotheses, H = grid.height, W = grid.width, P = H * W;
  if (centre.shape() != Shape{N, H, W})
    throw ShapeError("narrowed_hypotheses: centre has shape " + centre.shape().str() +
                     ", expected " + Shape{N, H, W}.str());
  auto out = BasicTensor<T>::uninitialised({N, D, H, W});
  const double half = 0.5 * grid.interval * static_cast<double>(D - 1);
  for_each_index(N, [&](Index n) {
    for (Index i = 0; i < P; ++i) {
      double c = static_cast<double>(centre[n * P + i]);
      // A range narrower than the window stays centred.
      c = low + half > high - half ? 0.5 * (low + high) : std::clamp(c, low + half, high - half);
      for (Index d = 0; d < D; ++d)
        out[(n * D + d) * P + i] =
            static_cast<T>(c - half + grid.interval * static_cast<double>(d));
    }
  });
  return out;
}

template Tensor stage_hypotheses(const rpc::HeightRange&, const StageGrid&,
                                 const StageHeights<float>*, Centre);
template BasicTensor<double> stage_hypotheses(const rpc::HeightRange&, const StageGrid&,
                                              const StageHeights<double>*, Centre);
template Tensor along_slopes(const Tensor&, Index, Index);
template BasicTensor<double> along_slopes(const BasicTensor<double>&, Index, Index);
template Tensor uniform_hypotheses(const StageGrid&, const rpc::HeightRange&);
template BasicTensor<double> uniform_hypotheses(const StageGrid&, const rpc::HeightRange&);
template Tensor narrowed_hypotheses(const StageGrid&, const Tensor&, const rpc::HeightRange&);
template BasicTensor<double> narrowed_hypotheses(const StageGrid&, const BasicTensor<double>&,
                                                 const rpc::HeightRange&);

}  // namespace satsurf::nn
