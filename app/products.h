// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/plan.h"
#include "satsurf/rpc/frame.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/raycast.h"

#include <array>
#include <filesystem>
#include <string>
#include <vector>

namespace satsurf::app {

/// The frame of a surfel or mesh file, as comment lines of its header.
std::vector<std::string> frame_comments(const rpc::LocalFrame& frame);
/// The same for any reference system.
/// crs      "EPSG:32617"
/// origin   easting, northing and height, m
/// heights  what they are above, e.g. "the WGS84 ellipsoid"; empty if nobody knows
std::vector<std::string> place_comments(const std::string& crs, const std::array<double, 3>& origin,
                                        const std::string& heights);
/// The inverse of `frame_comments`.
/// where   begins the error text
/// throws  IoError if the lines do not name a frame
rpc::LocalFrame frame_from_comments(const std::vector<std::string>& comments,
                                    const std::string& where);

/// Where the grid of a local field lies.
rpc::GeoGrid geo_grid(const scene::HeightField& grid, const rpc::LocalFrame& frame);
/// The same of the rows of a surface's grid from y0 on.
rpc::GeoGrid geo_grid(const reconstruct::Grid& grid, const rpc::LocalFrame& frame, Index y0 = 0);

/// Tags that name the program as the one that made the values.
rpc::GeoTags signed_tags(rpc::GeoTags tags);

/// Writes a GeoTIFF of what is known on the grid of a local field.
/// values  [H W] or [C H W], NaN where unknown
/// offset  added to every value: the frame's `h0` makes local heights ellipsoidal
/// tags    the software is added
/// throws  IoError
void write_field(const std::filesystem::path& path, const Tensor& values,
                 const scene::HeightField& grid, const rpc::LocalFrame& frame, double offset,
                 const rpc::GeoTags& tags);

}  // namespace satsurf::app
