// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/surface_view.h"

#include "satsurf/core/parallel.h"
#include "satsurf/nn/model.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/scene/raycast.h"
#include "satsurf/splat/view.h"

#include <cmath>
#include <limits>

namespace satsurf::reconstruct {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr double kMargin = 1;  // m; a flat surface still needs a span to fit a camera over

rpc::Window whole(Index width, Index height) {
  return {0, 0, static_cast<double>(width), static_cast<double>(height)};
}
rpc::HeightRange widened(const rpc::LocalFrame& frame, double z_low, double z_high) {
  return {frame.h0 + z_low - kMargin, frame.h0 + z_high + kMargin};
}

/// Both cameras of a view, no heights yet.
mesh::HeightView empty_view(const scene::View& view, const scene::Scene& scene) {
  const Index H = view.rgb.dim(1), W = view.rgb.dim(2);
  mesh::HeightView out;
  out.pixel_from_local = image_camera(view.rpc, scene.frame, W, H, scene.z_low, scene.z_high);
  out.local_from_pixel = image_localisation(view.rpc, scene.frame, W, H, scene.z_low, scene.z_high);
  return out;
}

}  // namespace

Quadratic image_camera(const rpc::Rpc& rpc, const rpc::LocalFrame& frame, Index width, Index height,
                       double z_low, double z_high) {
  return rpc::fit_projection(rpc, frame, whole(width, height), widened(frame, z_low, z_high));
}

Quadratic image_localisation(const rpc::Rpc& rpc, const rpc::LocalFrame& frame, Index width,
                             Index height, double z_low, double z_high) {
  return rpc::fit_localisation(rpc, frame, whole(width, height), widened(frame, z_low, z_high));
}

SurfaceView rendered_view(const splat::Surfels& surfels, const scene::View& view,
                          const scene::Scene& scene) {
  const Index H = view.rgb.dim(1), W = view.rgb.dim(2);
  SurfaceView out{{}, empty_view(view, scene)};
  const auto render = splat::render_view(surfels, out.heights.pixel_from_local, H, W, 1);
  out.colour = render.colour.value();
  out.heights.height = splat::surface_heights(render);
  // confidence by what stops the light there: thin surfaces are doubtful ones
  out.heights.confidence = render.aux.value().reshaped({H, W});
  out.heights.rgb = view.rgb.clone();
  for (Index p = 0; p < H * W; ++p)
    for (Index c = 0; c < 3; ++c)
      if (!(view.valid[p] > 0)) out.heights.rgb[c * H * W + p] = kNan;
  return out;
}

mesh::HeightView true_view(const scene::HeightField& truth, const scene::View& view,
                           const scene::Scene& scene) {
  mesh::HeightView out = empty_view(view, scene);
  out.height =
      scene::heights_in_view(truth, out.local_from_pixel, view.rgb.dim(1), view.rgb.dim(2));
  return out;
}

void keep_inside(mesh::HeightView& view, const scene::HeightField& field, const Tensor& mask) {
  const Index H = view.height.dim(0), W = view.height.dim(1);
  for_each_index(H, [&](Index y) {
    for (Index x = 0; x < W; ++x) {
      float& z = view.height[y * W + x];
      if (!std::isfinite(z)) continue;
      const auto p = view.local_from_pixel(static_cast<double>(x), static_cast<double>(y),
                                           static_cast<double>(z));
      const double row = std::floor((field.y0 - p[1]) / field.step),
                   col = std::floor((p[0] - field.x0) / field.step);
      const bool inside = row >= 0 && col >= 0 && row < static_cast<double>(mask.dim(0)) &&
                          col < static_cast<double>(mask.dim(1));
      if (!inside || !(mask[static_cast<Index>(row) * mask.dim(1) + static_cast<Index>(col)] > 0))
        z = kNan;
    }
  });
}

}  // namespace satsurf::reconstruct
