// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"
#include "satsurf/nn/forward_memory.h"
#include "satsurf/nn/stage.h"
#include "satsurf/nn/surface_net.h"
#include "satsurf/scene/crop.h"
#include "satsurf/scene/ground.h"
#include "satsurf/scene/scene.h"

#include <array>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace satsurf::reconstruct {

/// How the surfels of all views become one surface.
enum class Surface {
  automatic,  ///< refined with a surface network, else splat
  refined,    ///< by the surface network
  plain,      ///< by what the views say of one another's surfels, the densest mode in each cell
  splat       ///< rendered from straight above
};

}  // namespace satsurf::reconstruct

template <>
struct satsurf::EnumNames<satsurf::reconstruct::Surface> {
  static constexpr std::array names{"automatic", "refined", "plain", "splat"};
};

namespace satsurf::reconstruct {

using scene::Ground;

/// The cells of a surface.
struct Grid {
  double east = 0, north = 0;  ///< upper-left corner, local m
  double step = 0;             ///< side of a cell, m
  Index height = 0, width = 0;

  Ground ground() const {
    return {east, north - static_cast<double>(height) * step,
            east + static_cast<double>(width) * step, north};
  }
  double cells() const { return static_cast<double>(height) * static_cast<double>(width); }
};

/// Where a window of the network is.
struct WindowPlace {
  Ground answers;                  ///< whose surfels it gives, if there are other windows
  std::array<double, 3> middle{};  ///< of the window, local m
};

/// Largest side of an image that goes through the network as a whole, px.
inline constexpr Index kWholeImage = 1280;

/// How a surface is made.
struct ReconstructOptions {
  Surface surface = Surface::automatic;
  const nn::SurfaceModel* network = nullptr;  ///< that refines; none for the other kinds
  double resolution =
      0;  ///< DSM cell, m; 0: the mean ground footprint of a source pixel, to 0.05 m
  /// Easting and northing from which the cells of the views' common ground are whole cells away, m.
  std::array<double, 2> cell_corner{};
  /// Window side, px; 0: the whole image up to 1280, else overlapping tiles of 768.
  Index tile = 0;
  /// The cells to make, in windows of this size; none: see ReconstructPlan::grid.
  std::optional<Grid> grid;
  scene::WindowSize window{};
  std::vector<WindowPlace> places;  ///< of those windows; none: one around the middle of the cells
  /// Says of cells, [H W], which lie on ground that is not wanted, by 1: they stay unknown, have no
  /// surfels, and their heights do not count where the range is narrowed. May be empty.
  std::function<Tensor(const Grid&)> unwanted;
  bool level_water = true;      ///< of a refined surface, see `level_water`
  bool even_untextured = true;  ///< alike, see `even_untextured`
  bool look = true;  ///< for a narrower range of heights, see `narrowed_range`, `range_left`
  /// Voxel of the mesh that will be made of it, m, 0 for two ground pixels; none without a mesh.
  std::optional<double> mesh;
  /// Bytes of the whole program beyond which no mesh will be made, 0 for any.
  double max_memory = 0;
  /// Is told how far each stage has come, often, and also before the first. May be empty. To
  /// cancel it throws: its own exception leaves `reconstruct` as it is, and nothing is kept.
  std::function<void(const std::string& stage, double fraction)> progress;
};

/// The kind that options come to.
/// throws  ConfigError for `refined` without a network
Surface surface_kind(const ReconstructOptions& options);

/// What the network is asked for. Surfels that are cast onto a refined surface are where no head saw
/// them: what it would have said of them no longer holds.
nn::Wanted wanted_of(Surface surface);

/// What `reconstruct` is going to do.
struct ReconstructPlan {
  rpc::HeightRange z_range;  ///< that is searched, local m
  Ground ground;             ///< that two views see
  /// Cells of the DSM. Where none are given, the DSM gets those of the ground that two views show at
  /// the heights that are found, which are some more at the rim, or fewer.
  Grid grid;
  double voxel = 0;                            ///< of the mesh, m; 0 without one
  double columns = 0;                          ///< of the mesh's voxels, 0 without one
  scene::WindowSize window;                    ///< of the network, px
  std::vector<Ground> tiles;                   ///< what each window answers for
  std::vector<std::array<double, 3>> middles;  ///< of each window, local m
  bool whole_images = false;                   ///< the one window of a view holds its whole image
  double memory_bytes = 0;                     ///< of the whole program, within an eighth
  double surface_bytes = 0;                    ///< of it before the mesh, which may fail alone
  /// Of it while the mesh is made, 0 without one. More than `memory_bytes` where `max_memory` forbids.
  double mesh_bytes = 0;
  /// Tensors of the network's parts, then of "surface", each within a tenth.
  std::vector<nn::PartMemory> memory;
  double megapixels = 0;  ///< that the network sees, of all views and windows together
};
/// What a reconstruction's memory depends on.
struct WorkSize {
  Index views = 0;           ///< images
  scene::WindowSize window;  ///< what the network sees of each, px
  double pixels = 0;         ///< of all images together
  double cells = 0;          ///< of the surface
  double columns = 0;        ///< of the mesh's voxels, 0 without one
  double parallax = 0;       ///< of the whole range of heights, px, see `mean_parallax`
};
/// What a reconstruction takes of the memory.
struct WorkMemory {
  double surface_bytes = 0;           ///< of the whole program at most, before the mesh
  double mesh_bytes = 0;              ///< of it while the mesh is made, 0 without one
  std::vector<nn::PartMemory> parts;  ///< see ReconstructPlan
};
WorkMemory work_memory(const nn::ModelConfig& model, const WorkSize& size, Surface surface);

/// Around what at least two views show at any of some heights, to a hundredth of the side of what all of
/// them show together; empty where there is no such ground.
/// heights  local m
scene::Polygon outline_of_two(const scene::Scene& scene, std::span<const double> heights);
/// That in the middle of the range of heights. Where no two images have valid pixels of one ground,
/// around what two images hold, valid or not.
/// throws  Error if there is no such ground
scene::Polygon common_outline(const scene::Scene& scene);
/// The bounds of that.
Ground common_ground(const scene::Scene& scene);
/// The cells of a ground: they start a whole multiple of their side away from a corner, by default the
/// zone's origin, so that runs over one place share them.
/// corner  easting and northing, m
/// throws  Error for 2^31 cells a side or more
Grid grid_of(const Ground& ground, const rpc::LocalFrame& frame, double step,
             const std::array<double, 2>& corner = {});
/// The side of a cell that suits pixels of this size on the ground, m, a multiple of 0.05.
double natural_step(double footprint);

/// Mean parallax over all ordered pairs of views, pixels per metre of height.
/// cameras  derivatives of the views, two or more
double mean_parallax(const std::vector<rpc::PixelJacobian>& cameras);

/// Heights, m, that the first stage's least number of hypotheses spans (nn::first_hypotheses).
/// cameras  derivatives of the views
double span_of_hypotheses(const nn::ModelConfig& config,
                          const std::vector<rpc::PixelJacobian>& cameras);

/// Ground size of the images' pixels, on average, m.
/// cameras  derivatives of the views, one or more
double mean_footprint(const std::vector<rpc::PixelJacobian>& cameras);

/// Sizes and memory of a reconstruction, before it begins.
/// throws  Error if fewer than two views see a common ground, or for more cells or tiles than there can be
ReconstructPlan plan_reconstruction(const nn::ModelConfig& model, const scene::Scene& scene,
                                    const ReconstructOptions& options);

/// throws  Error where the system has less memory than the plan needs for the surface
void check_memory(const ReconstructPlan& plan, const scene::Scene& scene);

/// Number of views on whose valid pixels a point of the scene falls, hidden or not.
/// p_in_local  m
Index views_showing(const scene::Scene& scene, const std::array<double, 3>& p_in_local);

}  // namespace satsurf::reconstruct
