// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/input.h"
#include "satsurf/scene/polygon.h"
#include "satsurf/scene/scene.h"

#include <array>
#include <optional>
#include <vector>

namespace satsurf::scene {

/// Quarter turns clockwise after which north is up in an image, to within an eighth of a turn: a
/// network that learned from images of one orientation does not know the others, and vendors
/// deliver all of them.
/// where  a point that the image shows
/// returns  0 to 3
int quarters_to_north(const rpc::Rpc& camera, const rpc::Geodetic& where);

/// Rows and columns of pixels.
struct WindowSize {
  Index height = 0, width = 0;
  WindowSize() = default;
  WindowSize(Index rows, Index columns) : height(rows), width(columns) {}  // never one number
  Index count() const { return height * width; }
  friend bool operator==(const WindowSize&, const WindowSize&) = default;
};
/// Both rounded up to multiples.
WindowSize rounded_up(const WindowSize& size, Index multiple);
/// Of the images as `quarters_to_north` turns them, the most rows and the most columns.
/// where  a point that all of them show
WindowSize largest_image(const Scene& scene, const rpc::Geodetic& where);
/// The size, north up, of windows around a point in which every view shows what it has of some
/// ground, at all heights of the scene's range.
/// middle    in the middle of every window, local m
/// most      pixels a side; of a larger window a view shows the middle alone
/// multiple  that both sides are rounded up to, at least once
WindowSize window_around(const Scene& scene, const Polygon& ground,
                         const std::array<double, 3>& middle, Index most, Index multiple);
/// The same around the middle of a rectangle of ground and of the range.
WindowSize window_around(const Scene& scene, const Ground& ground, Index most, Index multiple);

/// The windows of a part of the ground.
struct GroundWindow {
  WindowSize size;                 ///< north up
  std::array<double, 3> middle{};  ///< that they are around, local m
};
/// The least of those around the middle of what each of the views shows of the ground.
/// most, multiple  as `window_around`
GroundWindow least_window(const Scene& scene, const Polygon& ground, Index most, Index multiple);

/// A window of every chosen view around one ground point, ready for the network: sources are
/// turned until north is up.
struct Crop {
  nn::NetworkInput input;
  std::optional<nn::PosedImage> target;  ///< the view to be rendered, not among the sources
  /// True heights of source views, [stage][view] -> [h w], local z in m, NaN where unknown.
  /// Empty without truth.
  std::vector<std::vector<Tensor>> source_truth;
  Tensor target_truth;  ///< [H W], or empty
  /// Column and row of each source's image at which its window begins; may lie outside.
  std::vector<std::array<Index, 2>> origins;
  std::vector<int> quarters;  ///< by which each source's window was then turned
};

/// Which windows are cut.
struct CropOptions {
  std::vector<Index> sources;      ///< views the network is given, by index
  std::optional<Index> target{};   ///< the view to be rendered, if there is one
  std::array<double, 3> centre{};  ///< ground point in the middle of every window, local m
  WindowSize size{};               ///< of the windows with north up, multiples of the network's
  rpc::HeightRange z_range{};      ///< that the network searches, local m
  bool with_truth = false;         ///< fill the true heights in, where the scene has them
};

/// Cuts windows of the views around one ground point, and fits every camera over its window and the heights, once.
/// Pixels outside an image are invalid. The target's window, which is not turned, has the same rows
/// and columns. Throws Error for a camera that sees the middle nowhere near its image.
Crop make_crop(const Scene& scene, const CropOptions& options);

/// Makes true heights of sources unknown where a pixel holds no image: there is nothing to find.
/// returns  the share of all source pixels that have an image and a known height
double forget_unseen_truth(Crop& crop);

/// Makes true heights of sources unknown that their images do not tell: of points that no other
/// source's window holds, and of water, which looks otherwise in each.
/// scene  that the windows are of, with the classes if they are known
void forget_untold_truth(Crop& crop, const Scene& scene);

/// A view as one window, with its camera fitted over the whole image.
/// frame    of the result
/// z_range  heights over which it is fitted, local m
nn::PosedImage posed_image(const View& view, const rpc::LocalFrame& frame,
                           const rpc::HeightRange& z_range);
/// The same with a camera that has been fitted already, over a window of the image.
/// window  of the view
/// origin  column and row of the image at which the window begins
nn::PosedImage posed_image(const View& view, const nn::PosedImage& window,
                           const std::array<Index, 2>& origin);

}  // namespace satsurf::scene
