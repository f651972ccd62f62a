// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/report.h"

#include <string>

namespace satsurf::app {

// The figures of a report, each as HTML that stands on its own.

constexpr double kChartWidth = 440;  ///< of a chart, px, as on a phone

/// Heights, hillshade, ortho, confidence, expected errors and coverage as pictures with legends.
std::string map_figures(const Report& report);
/// How many cells have which height.
std::string histogram_figure(const Report& report);
/// Shares of the cells by the number of images that see them.
std::string coverage_figure(const Report& report);
/// Where the images and the surface lie.
std::string footprint_figure(const Report& report);
/// Where satellites and suns stood; those at one place have one mark.
std::string sky_figure(const Report& report);
/// The grid of the surface to turn, as the page's script reads it: JSON with the numbers of columns
/// and rows, extent in m, lowest and highest height, and 16-bit shares of that range, rows from
/// north, 65535 for unknown, in base64.
std::string grid_json(const Report& report);
/// The colour of an image, by its place in the list.
const char* image_colour(std::size_t number);
/// What is legible on it.
const char* image_ink(std::size_t number);

}  // namespace satsurf::app
