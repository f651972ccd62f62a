// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/evaluate/evaluate.h"
#include "satsurf/mesh/compare.h"

#include <vector>

#include <nlohmann/json.hpp>

namespace satsurf::app {

/// The scores by name; null for a number that does not exist.
nlohmann::ordered_json scores_json(const evaluate::HeightScores& scores);
/// Of whole surfaces, and under `without_walls` of their parts that are none.
nlohmann::ordered_json scores_json(const mesh::MeshComparison& comparison);
/// Scores before and after registration, and the shift.
nlohmann::ordered_json scores_json(const evaluate::DsmComparison& comparison);

/// {"scenes": [...], "mean": {...}, "mean_scenes": {...}, "lpips_backbone"}: the mean is taken over
/// scenes, not over cells, and leaves out scenes for which a number does not exist, which may
/// favour a method that fails; its names are those of `scores_csv`. "mean_scenes" says over how
/// many scenes a mean is, where that is fewer than all.
nlohmann::ordered_json scores_json(const std::vector<evaluate::SceneScores>& scores);
/// The same and "confidence": {"mvs_source", "dsm"}, see `confidence_json`.
nlohmann::ordered_json scores_json(const evaluate::DataScores& scores);
/// {"pixels", "equal_width": [{"low", "high", "confidence", "pixels", "mae", ...}], "equal_count",
/// "monotone"}; null for a number that does not exist.
nlohmann::ordered_json confidence_json(const evaluate::ConfidenceErrors& errors);

}  // namespace satsurf::app
