// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/preview.h"
#include "satsurf/rpc/raster.h"

#include <filesystem>
#include <string>
#include <vector>

namespace satsurf::app {

/// A map with a strip below: what its colours stand for, a scale bar, and where north is. The map's
/// own pixels stay as and where they are, so that a world file holds for them.
/// picture  [3 H W] in [0, 1], row 0 north
/// scale    of its colours; nullptr for none
/// step     side of a pixel, m
/// returns  [3 H' W'] with H' > H and W' >= W
Tensor with_legend(const Tensor& picture, const ColourScale* scale, double step);

/// Draws a line of text in letters of 5 x 7 dots, black, as far as it fits. Other bytes than
/// printable ASCII become question marks.
/// picture  [3 H W]
/// x, y     upper-left corner, px
/// size     side of a dot, px
void draw_text(Tensor& picture, Index x, Index y, Index size, const std::string& text);
/// Width of such a text, px.
Index text_width(const std::string& text, Index size);

/// The files of a picture that has a place: itself, a world file (.pgw), and the reference system
/// (.png.aux.xml, as GDAL has it).
std::vector<std::filesystem::path> map_files(const std::filesystem::path& picture);
/// Writes what other programs place a picture with: a world file, and the reference system where one is
/// known.
/// path    of the picture
/// grid    of its pixels
/// throws  IoError
void write_world_files(const std::filesystem::path& path, const rpc::GeoGrid& grid);
/// Writes a map with its legend as PNG, and its world files.
/// grid    of the picture
/// throws  IoError
void write_map(const std::filesystem::path& path, const Tensor& picture, const ColourScale* scale,
               const rpc::GeoGrid& grid);

}  // namespace satsurf::app
