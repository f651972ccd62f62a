// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/warnings.h"
#include "satsurf/rpc/frame.h"
#include "satsurf/scene/polygon.h"
#include "satsurf/scene/raycast.h"

#include <array>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace satsurf::app {

/// A table of text, one cell of every row for each heading.
struct ReportTable {
  std::vector<std::string> head;
  std::vector<std::vector<std::string>> rows;
};

/// An image that a surface was made of.
struct ReportImage {
  std::string name, date;                     ///< the date may be empty
  Index width = 0, height = 0, bands = 1;     ///< px, and channels
  std::string type;                           ///< of the values, e.g. uint16
  double gsd = 0;                             ///< ground size of a pixel across the ray, m
  double off_nadir_deg = 0, azimuth_deg = 0;  ///< where the satellite stands, seen from the ground
  std::optional<std::array<double, 2>> sun_deg;  ///< elevation and azimuth, if they are known
  scene::Polygon footprint;                      ///< easting and northing, m
  std::optional<rpc::Pixel> shift;               ///< that was added to what its camera says, px
};

/// How the cameras of two images agree, px; see scene::PairResidual.
struct ReportPair {
  std::string a, b;
  Index ties = 0;
  double before = 0;
  std::optional<double> after, along;
};

/// What is shown of a reconstruction. The rasters lie on one grid; those that are empty are left
/// out.
struct Report {
  std::string title;
  std::string program;                                     ///< and version, which made it
  std::string made;                                        ///< when, where and how fast, in words
  std::vector<std::pair<std::string, std::string>> facts;  ///< a number with its unit, what it is
  rpc::LocalFrame frame;
  scene::HeightField dsm;    ///< local z in m, NaN where unknown
  Tensor confidence, sigma;  ///< [H W], NaN where unknown; sigma in m
  Tensor views;              ///< [H W] how many images see a cell; NaN where it has no height
  Tensor ortho;              ///< [3 H W] in [0, 1], NaN where no image sees the cell
  std::vector<ReportImage> images;
  std::vector<std::pair<std::string, std::string>> left_out;  ///< images not used, and why
  std::string pointing;                                       ///< how the cameras agree, in words
  std::vector<ReportPair> pairs;
  std::vector<reconstruct::Warning> warnings;
  ReportTable tiles;     ///< the parts of a large run; without rows for none
  ReportTable files;     ///< that were read
  std::string command;   ///< that repeats it
  std::string settings;  ///< JSON
};

/// One page that holds everything it shows: text, pictures of at most 1200 px, charts, and the
/// surface as a grid of at most 255 x 255 heights to be turned. It opens from disk and asks for
/// nothing from elsewhere.
/// returns  HTML
/// throws   ShapeError for rasters that do not have the surface's grid, Error for one without
///          heights
std::string report_html(const Report& report);

}  // namespace satsurf::app
