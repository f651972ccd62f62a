// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/reconstruct.h"

#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"

#include <algorithm>
#include <cmath>

namespace satsurf::train {
namespace {

constexpr Index kWholeImage = 1280;  // px; larger images are cut into tiles
constexpr Index kTile = 768;         // px; keeps the largest volume near 0.3 GB
constexpr double kAgreement = 2.5;   // m, between the heights two views give one point

/// A rectangle of ground, local m.
struct Ground {
  double x0, y0, x1, y1;
  double width() const { return x1 - x0; }
  double height() const { return y1 - y0; }
};

bool inside(const SceneView& view, const rpc::Pixel& p) {
  return p.x >= -0.5 && p.y >= -0.5 && p.x <= static_cast<double>(view.rgb.dim(2)) - 0.5 &&
         p.y <= static_cast<double>(view.rgb.dim(1)) - 0.5;
}

Index views_seeing(const Scene& scene, double x, double y, double z) {
  const rpc::Geodetic p = scene.frame.geodetic_from_local({x, y, z});
  Index n = 0;
  for (const SceneView& v : scene.views) n += inside(v, v.rpc.project(p)) ? 1 : 0;
  return n;
}

/// What at least two views see at the middle height.
Ground common_ground(const Scene& scene, double z) {
  Ground all{INFINITY, INFINITY, -INFINITY, -INFINITY};
  for (const SceneView& v : scene.views)
    for (const double fx : {0.0, 0.5, 1.0})
      for (const double fy : {0.0, 0.5, 1.0}) {
        const rpc::Pixel corner{fx * static_cast<double>(v.rgb.dim(2)) - 0.5,
                                fy * static_cast<double>(v.rgb.dim(1)) - 0.5};
        const auto p = scene.frame.local_from_geodetic(v.rpc.localize(corner, z + scene.frame.h0));
        all = {std::min(all.x0, p[0]), std::min(all.y0, p[1]), std::max(all.x1, p[0]),
               std::max(all.y1, p[1])};
      }
  // fine enough to place tiles; the exact rim comes from the surfels themselves
  constexpr Index kGrid = 128;
  Ground common{INFINITY, INFINITY, -INFINITY, -INFINITY};
  const double dx = all.width() / kGrid, dy = all.height() / kGrid;
  for (Index i = 0; i < kGrid; ++i)
    for (Index j = 0; j < kGrid; ++j) {
      const double x = all.x0 + (static_cast<double>(j) + 0.5) * dx,
                   y = all.y0 + (static_cast<double>(i) + 0.5) * dy;
      if (views_seeing(scene, x, y, z) < 2) continue;
      common = {std::min(common.x0, x - dx / 2), std::min(common.y0, y - dy / 2),
                std::max(common.x1, x + dx / 2), std::max(common.y1, y + dy / 2)};
    }
  if (!(common.width() > 0))
    throw Error("reconstruct: no two images see the same ground, expected overlapping views");
  return common;
}

/// d(pixel)/d(local) of a view at a ground point.
std::array<std::array<double, 3>, 2> pixel_jacobian(const Scene& scene, const SceneView& view,
                                                    double x, double y, double z) {
  constexpr double kStep = 1;  // m; the map is linear to 1e-6 over this distance
  std::array<std::array<double, 3>, 2> j{};
  for (std::size_t a = 0; a < 3; ++a) {
    std::array<double, 3> low{x, y, z}, high{x, y, z};
    low[a] -= kStep;
    high[a] += kStep;
    const rpc::Pixel p0 = view.rpc.project(scene.frame.geodetic_from_local(low)),
                     p1 = view.rpc.project(scene.frame.geodetic_from_local(high));
    j[0][a] = (p1.x - p0.x) / (2 * kStep);
    j[1][a] = (p1.y - p0.y) / (2 * kStep);
  }
  return j;
}

/// Network windows and the ground each answers for.
struct Plan {
  Index window = 0;  ///< px
  std::vector<Ground> tiles;
};

Plan plan_tiles(const Scene& scene, const Ground& ground, double z, Index asked, Index multiple) {
  const auto round_up = [multiple](Index n) { return (n + multiple - 1) / multiple * multiple; };
  Index largest = 0;
  for (const SceneView& v : scene.views) largest = std::max({largest, v.rgb.dim(1), v.rgb.dim(2)});
  Plan plan;
  if (asked == 0 && largest <= kWholeImage) {
    plan.window = round_up(largest);
    plan.tiles = {ground};
    return plan;
  }
  plan.window = round_up(asked > 0 ? asked : kTile);
  // The largest ground square that every view's window holds for every height of the range.
  double side = INFINITY;
  const double S = static_cast<double>(plan.window), span = scene.z_high - scene.z_low;
  for (const SceneView& v : scene.views) {
    const auto j =
        pixel_jacobian(scene, v, 0.5 * (ground.x0 + ground.x1), 0.5 * (ground.y0 + ground.y1), z);
    for (const auto& row : j) {
      const double room = std::max(S - std::abs(row[2]) * span, 0.25 * S);
      side = std::min(side, room / (std::abs(row[0]) + std::abs(row[1])));
    }
  }
  const Index columns = std::max<Index>(1, static_cast<Index>(std::ceil(ground.width() / side))),
              rows = std::max<Index>(1, static_cast<Index>(std::ceil(ground.height() / side)));
  for (Index r = 0; r < rows; ++r)
    for (Index c = 0; c < columns; ++c) {
      const double w = ground.width() / static_cast<double>(columns),
                   h = ground.height() / static_cast<double>(rows);
      const double x = ground.x0 + static_cast<double>(c) * w,
                   y = ground.y0 + static_cast<double>(r) * h;
      plan.tiles.push_back({x, y, x + w, y + h});
    }
  return plan;
}

/// Rows of `t` ([P ...]) named by `keep`.
Tensor rows_of(const Tensor& t, const std::vector<Index>& keep) {
  const Index n = static_cast<Index>(keep.size()), width = t.dim(0) > 0 ? t.count() / t.dim(0) : 0;
  auto out = Tensor::uninitialised(t.shape().with(0, n));
  for (Index i = 0; i < n; ++i)
    std::copy_n(t.data() + keep[static_cast<std::size_t>(i)] * width, width,
                out.data() + i * width);
  return out;
}

splat::Surfels selected(const splat::Surfels& s, const std::vector<Index>& keep) {
  const auto take = [&](const Var& v) { return Var(rows_of(v.value(), keep)); };
  return {take(s.means),   take(s.quats),   take(s.scales),
          take(s.opacity), take(s.colours), take(s.aux)};
}

splat::Surfels joined(const std::vector<splat::Surfels>& parts) {
  if (parts.size() == 1) return parts[0];
  const auto join = [&](Var splat::Surfels::*member) {
    std::vector<Var> list;
    for (const auto& p : parts) list.push_back(p.*member);
    return concat(list, 0);
  };
  return {join(&splat::Surfels::means),   join(&splat::Surfels::quats),
          join(&splat::Surfels::scales),  join(&splat::Surfels::opacity),
          join(&splat::Surfels::colours), join(&splat::Surfels::aux)};
}

/// Which surfels of a window to keep.
class Sieve {
 public:
  Sieve(const nn::SceneInput& input, const nn::StageOutput<float>& stage)
      : input_(input),
        means_(stage.surfels.means.value()),
        heights_(stage.height.value()),
        H_(input.sources[0].rgb.dim(1)),
        W_(input.sources[0].rgb.dim(2)) {}

  /// Surfels of valid pixels whose point another view sees too and, if `tile` is given, lies in it.
  /// Where images end some heights can be compared and others cannot; a pixel whose true height
  /// is one of the latter gets a wrong one, so there another view has to agree.
  std::vector<Index> kept(const Ground* tile) const {
    const Index N = static_cast<Index>(input_.sources.size()), P = H_ * W_;
    std::vector<char> good(static_cast<std::size_t>(N * P), 0);
    for_each_index(N * H_, [&](Index row) {
      const auto i = static_cast<std::size_t>(row / H_);
      for (Index x = 0; x < W_; ++x) {
        const Index p = (row % H_) * W_ + x, k = static_cast<Index>(i) * P + p;
        const double mx = static_cast<double>(means_[3 * k]),
                     my = static_cast<double>(means_[3 * k + 1]);
        if (input_.sources[i].valid[p] <= 0) continue;
        if (tile && (mx < tile->x0 || mx >= tile->x1 || my < tile->y0 || my >= tile->y1)) continue;
        good[static_cast<std::size_t>(k)] = trusted(i, p, static_cast<double>(means_[3 * k + 2]));
      }
    });
    std::vector<Index> keep;
    for (Index k = 0; k < N * P; ++k)
      if (good[static_cast<std::size_t>(k)] != 0) keep.push_back(k);
    return keep;
  }

 private:
  bool trusted(std::size_t i, Index p, double z) const {
    bool seen = false, whole_range = false;
    for (std::size_t j = 0; j < input_.sources.size(); ++j) {
      if (j == i) continue;
      const Index there = landing(i, j, p, z);
      if (there < 0) continue;
      seen = true;
      const float other = heights_[static_cast<Index>(j) * H_ * W_ + there];
      if (std::abs(static_cast<double>(other) - z) < kAgreement) return true;
      // The path over all heights is nearly straight: both ends inside mean all of it is.
      whole_range = whole_range ||
                    (landing(i, j, p, input_.z_low) >= 0 && landing(i, j, p, input_.z_high) >= 0);
    }
    return seen && whole_range;
  }

  /// Pixel of view j nearest to where it sees pixel p of view i if that lies at height z; -1: none.
  Index landing(std::size_t i, std::size_t j, Index p, double z) const {
    const auto q =
        input_.transfer[i][j](static_cast<double>(p % W_), static_cast<double>(p / W_), z);
    const auto x = static_cast<Index>(std::lround(q[0])), y = static_cast<Index>(std::lround(q[1]));
    const bool inside =
        x >= 0 && y >= 0 && x < W_ && y < H_ && input_.sources[j].valid[y * W_ + x] > 0;
    return inside ? y * W_ + x : -1;
  }

  const nn::SceneInput& input_;
  const Tensor &means_, &heights_;
  Index H_, W_;
};

}  // namespace

Quadratic nadir_camera(double x0, double y0, double step) {
  Quadratic q;  // column = (x - x0) / step - 0.5, row = (y0 - y) / step - 0.5
  q.coeff[0] = {-x0 / step - 0.5, 1 / step};
  q.coeff[1] = {y0 / step - 0.5, 0, -1 / step};
  return q;
}

Tensor surface_heights(const splat::Render& render) {
  constexpr float kSeen = 0.05f;
  Tensor z = render.median_height.clone();
  for (Index i = 0; i < z.count(); ++i) {
    const float alpha = render.alpha.value()[i];
    if (!(alpha > 0.5f)) z[i] = alpha > kSeen ? render.height.value()[i] : std::nanf("");
  }
  return z;
}

Reconstruction reconstruct(const nn::Model& model, const Scene& scene,
                           const ReconstructOptions& options) {
  const NoGrad no_grad;
  const auto report = [&](const std::string& stage, double fraction) {
    if (options.progress) options.progress(stage, fraction);
  };
  const double z = 0.5 * (scene.z_low + scene.z_high);
  const Ground ground = common_ground(scene, z);
  const Plan plan = plan_tiles(scene, ground, z, options.tile, nn::size_multiple(model.config()));

  double footprint = 0;
  for (const SceneView& v : scene.views)
    footprint += rpc::view_geometry(pixel_jacobian(scene, v, 0.5 * (ground.x0 + ground.x1),
                                                   0.5 * (ground.y0 + ground.y1), z))
                     .footprint /
                 static_cast<double>(scene.views.size());

  std::vector<Index> sources(scene.views.size());
  for (std::size_t i = 0; i < sources.size(); ++i) sources[i] = static_cast<Index>(i);
  std::vector<splat::Surfels> parts;
  for (std::size_t t = 0; t < plan.tiles.size(); ++t) {
    report("network", static_cast<double>(t) / static_cast<double>(plan.tiles.size()));
    const Ground& tile = plan.tiles[t];
    const Crop crop =
        make_crop(scene, sources, std::nullopt, 0.5 * (tile.x0 + tile.x1),
                  0.5 * (tile.y0 + tile.y1), z, plan.window, scene.z_low, scene.z_high, false);
    const auto stages = model.forward(crop.input);
    parts.push_back(
        selected(stages[2].surfels,
                 Sieve(crop.input, stages[2]).kept(plan.tiles.size() > 1 ? &tile : nullptr)));
  }

  Reconstruction out;
  out.tiles = static_cast<Index>(plan.tiles.size());
  out.surfels = joined(parts);
  report("surface", 1);
  // The grid starts at a whole multiple of its step, so that runs over one place share their cells.
  const double step = options.resolution > 0 ? options.resolution : std::round(footprint * 20) / 20;
  const double east = std::floor((ground.x0 + scene.frame.easting0) / step) * step -
                      scene.frame.easting0,
               north = std::ceil((ground.y1 + scene.frame.northing0) / step) * step -
                       scene.frame.northing0;
  const Index W = std::max<Index>(1, static_cast<Index>(std::ceil((ground.x1 - east) / step))),
              H = std::max<Index>(1, static_cast<Index>(std::ceil((north - ground.y0) / step)));
  const auto render = nn::render_view(out.surfels, nadir_camera(east, north, step), H, W, 1);
  out.dsm = {surface_heights(render), east, north, step};
  out.confidence = Tensor({H, W}, std::nanf(""));
  Index seen = 0, expected = 0;
  for (Index i = 0; i < H * W; ++i) {
    if (std::isfinite(out.dsm.z[i])) {
      out.confidence[i] = render.aux.value()[i] / render.alpha.value()[i];
      ++seen;
      ++expected;
      continue;
    }
    const double x = east + (static_cast<double>(i % W) + 0.5) * step,
                 y = north - (static_cast<double>(i / W) + 0.5) * step;
    expected += views_seeing(scene, x, y, z) >= 2 ? 1 : 0;
  }
  out.completeness = expected > 0 ? static_cast<double>(seen) / static_cast<double>(expected) : 0;
  return out;
}

}  // namespace satsurf::train
