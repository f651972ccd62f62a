// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/record.h"
#include "satsurf/app/report.h"
#include "satsurf/reconstruct/ortho.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/scene/user_images.h"

#include <array>
#include <filesystem>
#include <vector>

namespace satsurf::app {

/// The surface that a report is about.
struct ReportedSurface {
  const reconstruct::Reconstruction& made;  ///< or a reduced copy of one
  const scene::UserScene& user;
  /// Which images see a cell; nullptr leaves them and the orthophoto out.
  const reconstruct::Visibility* visibility = nullptr;
  /// Width and height of each image where the scene has reduced copies, px.
  std::vector<std::array<Index, 2>> sizes{};
  /// Without a visibility: how many images see a cell, and colours in [0, 1]; or empty.
  Tensor views{}, ortho{};
};

/// What the report of a reconstruction shows, the tiles of a large one with it.
/// record  with its results
Report report_of(const ReportedSurface& surface, const RunRecord& record);

/// Writes it, whole or not at all.
/// throws  Error
void write_report(const std::filesystem::path& file, const Report& report);

}  // namespace satsurf::app
