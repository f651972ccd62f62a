// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/evaluate/evaluate.h"

#include <array>
#include <cstddef>
#include <string>
#include <utility>
#include <vector>

namespace satsurf::evaluate {

/// The registrations by the names that tables use, in the order of `Registration`.
inline constexpr std::array<const char*, 3> kRegistrations{"none", "z", "xyz"};

/// Names and values of the numbers that go into tables.
using TableRow = std::vector<std::pair<std::string, double>>;
/// Those of one scene, NaN for a number that does not exist; the columns of `scores_csv`.
TableRow row_of(const SceneScores& scores);

/// Each number on average over the scenes for which it exists, else NaN.
struct TableMean {
  TableRow row;
  std::vector<std::size_t> scenes;  ///< how many these are, number by number
};
TableMean mean_of(const std::vector<SceneScores>& scores);

/// One CSV row per scene with every number, and a last row `mean`. Cells of numbers that do not
/// exist are empty; a name with a comma or a quote stands in quotes. Columns: GROUP_mae, _rmse,
/// _median, _nmad, _pag1, _pag2.5, _pag7.5, _completeness, _pag1_compared, _pag2.5_compared,
/// _pag7.5_compared, _truth_cells and _compared_cells (see HeightScores) for the groups
///   dsm, mvs_source, render_target       as in SceneScores
///   dsm_none, dsm_z, dsm_xyz             the DSM by each registration; then also _east, _north, _up
///   dsm_filled_none, .._z, .._xyz        the same with holes filled
/// then mesh_chamfer, mesh_to_reference, mesh_reference_to_mesh (m), mesh_f1_0.5, _f1_1, _f1_2.5,
/// the same as mesh_without_walls_*, mvs_source_rmse_per_view, render_target_psnr, _psnr_fitted,
/// _ssim, _ssim_conv, _lpips, _covered (SceneScores::target_covered), and seconds.
std::string scores_csv(const std::vector<SceneScores>& scores);

}  // namespace satsurf::evaluate
