// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/crop.h"

#include "satsurf/core/parallel.h"
#include "satsurf/nn/shown_pixel.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/scene/classes.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <utility>

namespace satsurf::scene {
namespace {

constexpr double kFarthest = 1e9;  // px

/// [a, b) of a window clipped to [0, n).
Tensor cut(const Tensor& image, Index x0, Index y0, const WindowSize& size) {
  const bool planes = image.rank() == 3;
  const Index C = planes ? image.dim(0) : 1, H = image.dim(planes ? 1 : 0),
              W = image.dim(planes ? 2 : 1);
  Tensor out(planes ? Shape{C, size.height, size.width} : Shape{size.height, size.width});
  const Index x_begin = std::max<Index>(0, -x0), x_end = std::min(size.width, W - x0);
  for (Index c = 0; c < C; ++c)
    for (Index y = std::max<Index>(0, -y0); y < std::min(size.height, H - y0); ++y)
      if (x_end > x_begin)
        std::copy_n(image.data() + (c * H + y0 + y) * W + x0 + x_begin, x_end - x_begin,
                    out.data() + (c * size.height + y) * size.width + x_begin);
  return out;
}

/// A window [H W] or [C H W], turned clockwise.
Tensor turned(Tensor window, int quarters) {
  for (; quarters > 0; --quarters) {
    const Index rank = window.rank(), H = window.dim(rank - 2), W = window.dim(rank - 1);
    auto out = Tensor::uninitialised(rank == 3 ? Shape{window.dim(0), W, H} : Shape{W, H});
    for (Index i = 0; i < out.count(); ++i) {
      const Index y = i / H % W, x = i % H;  // came from row H - 1 - x, column y
      out[i] = window[i / (H * W) * H * W + (H - 1 - x) * W + y];
    }
    window = std::move(out);
  }
  return window;
}

/// As an odd number of quarter turns leaves it.
WindowSize turned(const WindowSize& size, int quarters) {
  return quarters % 2 == 0 ? size : WindowSize{size.width, size.height};
}

}  // namespace

int quarters_to_north(const rpc::Rpc& camera, const rpc::Geodetic& where) {
  const auto [x, y] = camera.jacobian(where);
  const double right = x[1], down = y[1];  // where the image goes towards the north
  if (std::abs(down) >= std::abs(right)) return down > 0 ? 2 : 0;
  return right > 0 ? 3 : 1;
}

WindowSize rounded_up(const WindowSize& size, Index multiple) {
  const auto up = [&](Index n) { return (n + multiple - 1) / multiple * multiple; };
  return {up(size.height), up(size.width)};
}

WindowSize largest_image(const Scene& scene, const rpc::Geodetic& where) {
  WindowSize most;
  for (const View& view : scene.views) {
    const WindowSize size =
        turned(WindowSize{view.height(), view.width()}, quarters_to_north(view.rpc, where));
    most = {std::max(most.height, size.height), std::max(most.width, size.width)};
  }
  return most;
}

namespace {

/// What a view shows of some ground, px; nothing that is not the image's.
struct Shown {
  double left = INFINITY, right = -INFINITY, top = INFINITY, bottom = -INFINITY;
  bool any() const { return left < right && top < bottom; }
};

rpc::Pixel pixel_of(const View& view, const rpc::LocalFrame& frame,
                    const std::array<double, 3>& p) {
  return view.rpc.project(frame.geodetic_from_local(p));
}

/// At all heights of the scene's range.
Shown shown_by(const View& view, const Scene& scene, const Polygon& ground) {
  Shown out;
  for (const auto& [x, y] : ground)
    for (const double z : {scene.z_range.low, scene.z_range.high}) {
      const rpc::Pixel p = pixel_of(view, scene.frame, {x, y, z});
      out.left = std::min(out.left, p.x), out.right = std::max(out.right, p.x);
      out.top = std::min(out.top, p.y), out.bottom = std::max(out.bottom, p.y);
    }
  out.left = std::max(out.left, 0.0), out.top = std::max(out.top, 0.0);
  out.right = std::min(out.right, static_cast<double>(view.width() - 1));
  out.bottom = std::min(out.bottom, static_cast<double>(view.height() - 1));
  return out;
}

}  // namespace

WindowSize window_around(const Scene& scene, const Polygon& ground,
                         const std::array<double, 3>& middle, Index most, Index multiple) {
  constexpr double kRim = 2;  // px on every side, for interpolation
  WindowSize needed(1, 1);
  for (const View& view : scene.views) {
    const rpc::Pixel centre = pixel_of(view, scene.frame, middle);
    const Shown shown = shown_by(view, scene, ground);
    if (!shown.any()) continue;
    const double x = std::max({centre.x - shown.left, shown.right - centre.x, 0.0}),
                 y = std::max({centre.y - shown.top, shown.bottom - centre.y, 0.0});
    if (!(std::max(x, y) < kFarthest)) continue;
    const WindowSize size =
        turned({static_cast<Index>(std::ceil(2 * (y + kRim))),
                static_cast<Index>(std::ceil(2 * (x + kRim)))},
               quarters_to_north(view.rpc, scene.frame.geodetic_from_local(middle)));
    needed = {std::max(needed.height, size.height), std::max(needed.width, size.width)};
  }
  return rounded_up({std::min(most, needed.height), std::min(most, needed.width)}, multiple);
}

WindowSize window_around(const Scene& scene, const Ground& ground, Index most, Index multiple) {
  return window_around(
      scene, corners_of(ground),
      {0.5 * (ground.x0 + ground.x1), 0.5 * (ground.y0 + ground.y1), scene.z_range.middle()}, most,
      multiple);
}

GroundWindow least_window(const Scene& scene, const Polygon& ground, Index most, Index multiple) {
  const Ground box = bounds_of(ground);
  const double z = scene.z_range.middle();
  std::vector<std::array<double, 3>> middles{{0.5 * (box.x0 + box.x1), 0.5 * (box.y0 + box.y1), z}};
  for (const View& view : scene.views) {
    const Shown shown = shown_by(view, scene, ground);
    if (!shown.any()) continue;
    const auto p = scene.frame.local_from_geodetic(view.rpc.localize(
        {0.5 * (shown.left + shown.right), 0.5 * (shown.top + shown.bottom)}, z + scene.frame.h0));
    middles.push_back({p[0], p[1], z});
  }
  GroundWindow least;
  for (const auto& middle : middles) {
    const WindowSize size = window_around(scene, ground, middle, most, multiple);
    if (least.size.count() == 0 || size.count() < least.size.count()) least = {size, middle};
  }
  return least;
}

Crop make_crop(const Scene& scene, const CropOptions& options) {
  const rpc::Geodetic centre = scene.frame.geodetic_from_local(options.centre);
  const WindowSize& size = options.size;
  const rpc::Window window{0, 0, static_cast<double>(size.width), static_cast<double>(size.height)};

  std::vector<Index> chosen = options.sources;
  if (options.target) chosen.push_back(*options.target);
  const std::size_t N = options.sources.size(), all = chosen.size();
  std::vector<rpc::Rpc> cameras(all);
  std::vector<nn::PosedImage> views(all);
  std::vector<std::array<Index, 2>> origins(all);
  std::vector<int> quarters(all, 0);
  for_each_index(static_cast<Index>(all), [&](Index k) {
    const auto i = static_cast<std::size_t>(k);
    const View& from = scene.views[static_cast<std::size_t>(chosen[i])];
    const rpc::Pixel pixel = from.rpc.project(centre);
    if (i < N) quarters[i] = quarters_to_north(from.rpc, centre);
    const WindowSize as_stored = turned(size, quarters[i]);
    const double x0 = std::round(pixel.x - (static_cast<double>(as_stored.width) - 1) / 2),
                 y0 = std::round(pixel.y - (static_cast<double>(as_stored.height) - 1) / 2);
    if (!(std::abs(x0) <= kFarthest && std::abs(y0) <= kFarthest)) {
      std::ostringstream text;
      text << "make_crop: " << from.label() << " sees the middle at (" << pixel.x << ", " << pixel.y
           << ") px, expected at most 1e9 either way";
      throw Error(text.str());
    }
    origins[i] = {static_cast<Index>(x0), static_cast<Index>(y0)};
    cameras[i] = from.rpc.cropped(x0, y0).turned(quarters[i], as_stored.width, as_stored.height);
    views[i] = {turned(cut(from.rgb, origins[i][0], origins[i][1], as_stored), quarters[i]),
                turned(cut(from.valid, origins[i][0], origins[i][1], as_stored), quarters[i]),
                rpc::fit_localisation(cameras[i], scene.frame, window, options.z_range),
                rpc::fit_projection(cameras[i], scene.frame, window, options.z_range)};
  });

  Crop crop;
  crop.input.z_range = options.z_range;
  crop.input.transfer.assign(N, std::vector<Quadratic>(N));
  for_each_index(static_cast<Index>(N * N), [&](Index k) {
    const auto i = static_cast<std::size_t>(k) / N, j = static_cast<std::size_t>(k) % N;
    if (i != j)
      crop.input.transfer[i][j] =
          rpc::fit_transfer(cameras[i], cameras[j], scene.frame, window, options.z_range);
  });
  if (options.with_truth && scene.truth) {
    for (const Index stride : {Index{4}, Index{2}, Index{1}}) {
      auto& stage = crop.source_truth.emplace_back();
      for (std::size_t i = 0; i < N; ++i)
        stage.push_back(heights_in_view(
            *scene.truth, rescale_pixels(views[i].local_from_pixel, static_cast<double>(stride), 1),
            size.height / stride, size.width / stride));
    }
    if (options.target)
      crop.target_truth =
          heights_in_view(*scene.truth, views[N].local_from_pixel, size.height, size.width);
  }
  if (options.target) crop.target = std::move(views[N]);
  views.resize(N);
  origins.resize(N);
  crop.input.sources = std::move(views);
  crop.origins = std::move(origins);
  quarters.resize(N);
  crop.quarters = std::move(quarters);
  return crop;
}

namespace {

/// Whether water stands at a place, local m.
bool is_water(const Scene& scene, const std::array<double, 2>& ground) {
  if (scene.classes.empty()) return false;
  const Index cell = cell_at(*scene.truth, ground[0], ground[1]);
  return cell >= 0 && scene.classes[cell] == kWaterClass;
}

}  // namespace

void forget_untold_truth(Crop& crop, const Scene& scene) {
  const std::vector<nn::PosedImage>& images = crop.input.sources;
  for (std::vector<Tensor>& stage : crop.source_truth)
    for_each_index(std::ssize(images), [&](Index n) {
      const auto i = static_cast<std::size_t>(n);
      Tensor& z = stage[i];
      const Index W = z.dim(1);
      const double stride = static_cast<double>(images[i].valid.dim(1)) / static_cast<double>(W);
      for (Index p = 0; p < z.count(); ++p) {
        if (!std::isfinite(z[p])) continue;
        const double x = (static_cast<double>(p % W) + 0.5) * stride - 0.5,
                     y = (static_cast<double>(p / W) + 0.5) * stride - 0.5,
                     height = static_cast<double>(z[p]);
        bool told = false;
        for (std::size_t j = 0; j < images.size() && !told; ++j)
          told = j != i && nn::shown_pixel(images[j], crop.input.transfer[i][j](x, y, height)) >= 0;
        if (!told || is_water(scene, images[i].local_from_pixel(x, y, height)))
          z[p] = std::nanf("");
      }
    });
}

nn::PosedImage posed_image(const View& view, const rpc::LocalFrame& frame,
                           const rpc::HeightRange& z_range) {
  const rpc::Window whole{0, 0, static_cast<double>(view.width()),
                          static_cast<double>(view.height())};
  return {view.rgb, view.valid, rpc::fit_localisation(view.rpc, frame, whole, z_range),
          rpc::fit_projection(view.rpc, frame, whole, z_range)};
}

nn::PosedImage posed_image(const View& view, const nn::PosedImage& window,
                           const std::array<Index, 2>& origin) {
  const std::array<double, 2> image_corner{-static_cast<double>(origin[0]),
                                           -static_cast<double>(origin[1])};
  return {view.rgb, view.valid, shift_pixels(window.local_from_pixel, image_corner, {0, 0}),
          shift_pixels(window.pixel_from_local, {0, 0}, image_corner)};
}

double forget_unseen_truth(Crop& crop) {
  Index known = 0, all = 0;
  for (std::size_t i = 0; i < crop.input.sources.size(); ++i) {
    const Tensor& valid = crop.input.sources[i].valid;
    const Index W = valid.dim(1);
    for (std::vector<Tensor>& stage : crop.source_truth) {
      Tensor& z = stage[i];
      const Index stride = W / z.dim(1);
      for (Index p = 0; p < valid.count(); ++p)
        if (!(valid[p] > 0)) z[p / W / stride * z.dim(1) + p % W / stride] = std::nanf("");
    }
    for (const float z : crop.source_truth.back()[i].values()) known += std::isfinite(z) ? 1 : 0;
    all += valid.count();
  }
  return static_cast<double>(known) / static_cast<double>(all);
}

}  // namespace satsurf::scene
