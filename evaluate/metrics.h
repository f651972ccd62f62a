// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"
#include "satsurf/scene/raycast.h"

#include <array>
#include <optional>

namespace satsurf::evaluate {

/// Peak signal-to-noise ratio: values clipped to [0, 1], -10 log10 of the mean squared difference
/// over all channels and the pixels that count.
/// image, reference  [C H W]
/// mask              [H W], zero where a pixel does not count; empty for all
/// returns           dB; infinite for equal images, NaN where nothing is compared
double psnr(const Tensor& image, const Tensor& reference, const Tensor& mask = {});

/// The picture after the affine map of its colours that brings it nearest to another: least squares
/// over the pixels that count, every channel of the reference from all of the picture's and a
/// constant. Takes out what two dates' light and sensor differ in as a whole.
/// image, reference  [C H W]
/// mask              [H W], zero where a pixel does not count; empty for all
/// returns           [C H W]; the picture itself where no pixel counts
/// throws            ShapeError
Tensor fit_colours(const Tensor& image, const Tensor& reference, const Tensor& mask = {});

/// How far predicted heights are from true ones. "Compared" cells have both; "truth" cells have a
/// true height and are not masked out. PAG_t is the share of cells with |error| < t, strictly.
struct HeightScores {
  Index truth = 0;                          ///< truth cells
  Index compared = 0;                       ///< of them with a prediction
  double completeness = 0;                  ///< compared / truth
  double mae = 0, rmse = 0;                 ///< over compared cells, m
  double median = 0;                        ///< of the signed errors (prediction - truth), m
  double nmad = 0;                          ///< 1.4826 times the median of |error - median|, m
  double pag1 = 0, pag2_5 = 0, pag7_5 = 0;  ///< over truth cells: a missing prediction is a failure
  double pag1_compared = 0, pag2_5_compared = 0, pag7_5_compared = 0;  ///< over compared cells only
};

/// Scores without any registration. Means over nothing are NaN.
/// prediction, truth  [H W] m, NaN where unknown
/// mask               [H W], zero where a cell does not count; empty for all
HeightScores score_heights(const Tensor& prediction, const Tensor& truth, const Tensor& mask = {});

/// The field at the cell centres of another grid: bilinear where all four neighbours are known,
/// else the nearest cell. NaN stays NaN.
Tensor resample(const scene::HeightField& field, const scene::HeightField& grid);

/// Whether heights that differ nearly everywhere are likely above an ellipsoid here and a geoid there.
/// offset        of all heights, m
/// geoid_height  of the geoid above the ellipsoid, m; nothing where it is not known
bool like_geoid(double offset, const std::optional<double>& geoid_height);

/// What may be taken out of a prediction before it is scored: nothing, one height offset (the
/// median of the errors), or also a horizontal shift.
enum class Registration { none, z, xyz };

}  // namespace satsurf::evaluate

template <>
struct satsurf::EnumNames<satsurf::evaluate::Registration> {
  static constexpr std::array names{"none", "z", "xyz"};
};

namespace satsurf::evaluate {

/// A DSM against the truth, on the truth's grid.
struct DsmComparison {
  HeightScores raw;
  HeightScores registered;
  std::array<double, 3> shift{0, 0, 0};  ///< added to the prediction: east, north, up, m
  /// East and north, m, of a shift that was found and not taken.
  std::optional<std::array<double, 2>> refused_shift;
  Tensor surface;  ///< [H W] registered prediction, NaN where unknown
  Tensor error;    ///< [H W] registered prediction - truth, NaN where not compared
};

/// Farthest east and north that a registration moves a surface, m: without ground control cameras of
/// satellites are off by some 5 m, and a surface further off has other faults.
inline constexpr double kFarthestShift = 15;

/// Resamples the prediction to the truth's grid, registers it as asked and scores it before and
/// after.
///   z    the median difference of all cells that count: none is clipped or left out as an outlier,
///        neither here nor in the scores
///   xyz  first a horizontal shift by whole truth cells that maximises the normalised correlation
///        of the heights, searched coarse to fine (halved until a side is below 100 cells, 5 cells
///        around the best of the level above) up to `kFarthestShift`, of cells larger than that by
///        one of them; then the median difference. Where the shift does not lower the mean distance
///        of the errors from their median, over the cells known with it and without, it is refused:
///        it is never worse than z
/// prediction, truth  in one local frame
/// registration       what is taken out
/// mask               [H W] on the truth's grid, zero where a cell does not count; empty for all
/// must_meet          false: surfaces without a common cell are scored too, and all cells are
///                    missing: completeness and PAG are 0, the errors NaN
/// throws             Error if they have none and must
DsmComparison compare_dsm(const scene::HeightField& prediction, const scene::HeightField& truth,
                          Registration registration, const Tensor& mask = {},
                          bool must_meet = true);

}  // namespace satsurf::evaluate
