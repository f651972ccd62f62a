// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/raster.h"
#include "satsurf/scene/scene.h"

#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <vector>

// The layout of the second version of WHU-TLC ("open_dataset"): of the views V = 0, 1, ... there are
//   image/V/NAME.png   rpc/V/NAME.rpc   height/V/NAME.pfm
// where NAME is one place, and heights are those of every pixel of that view. There is no surface
// model: one is made of the heights.

namespace satsurf::scene {

/// Whether a folder has this layout.
bool is_whu(const std::filesystem::path& folder);
/// The places of a data set, by name: those of which there is an image in any view.
/// throws  IoError for fewer than two views, and where there is no image
std::set<std::string> whu_scenes(const std::filesystem::path& folder);
/// The views of a place, called NAME_0, NAME_1 and so on.
/// throws  IoError naming the image or camera that is missing
std::vector<View> whu_views(const std::filesystem::path& folder, const std::string& name);

/// The surface that the heights of a view show.
struct WhuTruth {
  std::filesystem::path file;  ///< the heights, or what was looked for
  /// m above the ellipsoid, NaN where unknown; none where no view comes with heights
  std::optional<rpc::GeoRaster> surface;
};
/// Of the view with heights that looks down most steeply, in cells of the size of its pixels.
/// views   as `whu_views` gives them
/// zone    of the surface
/// throws  IoError
WhuTruth whu_truth(const std::filesystem::path& folder, const std::string& name,
                   const std::vector<View>& views, const rpc::UtmZone& zone);

/// The surface that the pixels of a view show, in cells of the size of a pixel. The height z of a
/// cell is where
///   z = heights(project(x, y, z)),
/// found by putting z in again and again, from the median height on. Cells are unknown that this
/// finds no height for, as for ground that the view does not see, that fall outside the image, and
/// whose height lies between pixels of which one is unknown.
/// heights  [H W] m above the ellipsoid, of the view's pixels; NaN where unknown, but not everywhere
/// zone     of the surface
/// throws   Error for a camera that is none of such heights
rpc::GeoRaster surface_of_view(const Tensor& heights, const rpc::Rpc& camera,
                               const rpc::UtmZone& zone);

/// A PFM file of one channel, in either byte order, whose rows go from the bottom up. The size of its
/// scale says nothing.
/// height, width  expected
/// returns        [height width], the first row on top
/// throws         IoError
Tensor read_pfm(const std::filesystem::path& path, Index height, Index width);

}  // namespace satsurf::scene
