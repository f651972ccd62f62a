// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/evaluate/evaluate.h"

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

namespace satsurf::evaluate {

/// Names and values of the numbers that go into tables.
using TableRow = std::vector<std::pair<std::string, double>>;
/// Those of one scene, NaN for a number that does not exist; the columns of `scores_csv`.
TableRow row_of(const SceneScores& scores);

/// What a column of the table holds, for the manual.
struct TableColumn {
  std::string name;
  std::string group;   ///< what it is told of, e.g. `dsm`; empty for the scene
  std::string number;  ///< what is told, e.g. `mae`; the name is GROUP_NUMBER
  std::string unit, meaning;
};
/// All columns of `row_of`, in their order.
std::vector<TableColumn> table_columns();
/// The groups of columns and what each is of, in words.
const std::vector<std::pair<std::string, std::string>>& table_groups();

/// Each number on average over the scenes for which it exists, else NaN.
struct TableMean {
  TableRow row;
  std::vector<std::size_t> scenes;  ///< how many these are, number by number
};
TableMean mean_of(const std::vector<SceneScores>& scores);

/// One CSV row per scene with every number, and a last row `mean`. Cells of numbers that do not
/// exist are empty; a name with a comma or a quote stands in quotes. The columns are those of
/// `table_columns`.
std::string scores_csv(const std::vector<SceneScores>& scores);

}  // namespace satsurf::evaluate
