// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"
#include "satsurf/nn/input.h"
#include "satsurf/nn/stage.h"
#include "satsurf/scene/lit_view.h"
#include "satsurf/scene/scene.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

namespace satsurf::evaluate {

/// What may make the height of a cell hard to find. A cell can have several causes, but for the
/// roofs, of which it has one, and for `open_ground` and `other`, which exclude what is said here.
///   hidden        a source view that contains the cell's true surface point does not see it
///   seen_by_one   no more than one of them sees it
///   shadow        it lies in cast shadow in one of them
///   roof_*        building, more than two cells from its rim: every cell of the 5 x 5 around is
///                 building too; by the area of the whole building (cells that share edges)
///   rim           a step of more than 2 m between two cells that share an edge runs along the cell
///                 or one cell further: it is one of the two cells on either side
///   tree, water   by class
///   open_ground   class ground, and none of hidden, shadow and rim
///   other         none of all these
enum class Cause {
  hidden,
  seen_by_one,
  shadow,
  roof_small,   ///< below 400 m^2
  roof_medium,  ///< 400 to 2000 m^2
  roof_large,   ///< above 2000 m^2
  rim,
  tree,
  open_ground,
  water,
  other
};
inline constexpr std::size_t kCauses = 11;

}  // namespace satsurf::evaluate

template <>
struct satsurf::EnumNames<satsurf::evaluate::Cause> {
  static constexpr std::array names{"hidden",      "seen_by_one", "shadow", "roof_small",
                                    "roof_medium", "roof_large",  "rim",    "tree",
                                    "open_ground", "water",       "other"};
};

namespace satsurf::evaluate {

/// Metres east and north towards the sun per metre of height, against the grid of `frame`.
/// returns  nothing where the view does not say where the sun stood (both angles 0), or says that it
///          was not up
std::optional<std::array<double, 2>> slope_to_sun(const scene::View& view,
                                                  const rpc::LocalFrame& frame);

/// A source view, in the frame of the truth, and its light as `slope_to_sun` says.
using scene::LitView;

/// The causes of every cell of a grid.
struct CauseFlags {
  Index height = 0, width = 0;
  std::vector<std::uint16_t> cells;   ///< [H W], bit k for the k-th Cause
  std::array<bool, kCauses> known{};  ///< false: what the cause needs is not known of the scene

  /// returns  [H W], 1 where a cell has the cause, else 0
  Tensor of(Cause cause) const;
};

/// Finds the causes by casting rays from every cell's centre to the cameras and the sun. Unknown
/// cells hide nothing and throw no shadow.
/// truth    in the local frame
/// classes  [H W] on the truth's grid; empty: roofs, trees, open ground and water are not known
/// views    the sources; shadow is not known unless one of them says where the sun stood
/// mask     [H W], zero where a cell does not count: it has no cause; empty for all
/// throws   ShapeError
/// cost     at most two rays per view of a cell that counts
CauseFlags find_causes(const scene::HeightField& truth, const Tensor& classes,
                       const std::vector<LitView>& views, const Tensor& mask = {});

/// The errors of the cells that have a cause. All NaN where the cause is not known.
struct CauseScore {
  static constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  double cells = kNone;        ///< that count and have the cause
  double share = kNone;        ///< of the cells that count
  double mae = kNone;          ///< mean absolute error, m
  double median = kNone;       ///< of the signed errors, m
  double pag2_5 = kNone;       ///< share of `cells` with |error| < 2.5 m
  double error_share = kNone;  ///< of the sum of all absolute errors
};
using CauseScores = std::array<CauseScore, kCauses>;

/// surface  [H W] m, without holes if it has any cell
/// truth    [H W] m, NaN where unknown
/// mask     [H W], zero where a cell does not count
/// throws   ShapeError
CauseScores score_causes(const Tensor& surface, const Tensor& truth, const Tensor& mask,
                         const CauseFlags& flags);

/// The best surface that could be chosen from a set of heights.
struct OracleScore {
  double share = CauseScore::kNone;  ///< of the cells that count: those in which a point lies
  double mae = CauseScore::kNone;    ///< mean absolute error, holes filled, m
};
/// In every cell the height nearest to the truth of all points whose centre lies in it. No fusion
/// that picks from these points does better there; where none lies it may.
/// means    [P 3] the points, m
/// shift    added to them: east, north, up, m
/// truth    in their frame
/// mask     [H W], zero where a cell does not count
/// returns  an error of NaN where no point lies on the grid
OracleScore score_oracle(const Tensor& means, const std::array<double, 3>& shift,
                         const scene::HeightField& truth, const Tensor& mask);

/// Share of the source pixels whose true height lies outside the window that the next searching
/// stage covers around them, half an interval beyond its first and last hypothesis. Whoever is lost
/// by the first stage counts for the second as well, unless it was found again.
/// stages   of a window of the sources
/// truth    [stage][view] -> [h w] true heights at the stage's resolution, m; NaN where a pixel does
///          not count
/// returns  of stages 1 and 2; NaN of one that does not search or that none follows, or without
///          pixels that count
/// throws   ShapeError
std::array<double, 2> lost_by_stage(const std::array<nn::StageOutput<float>, 3>& stages,
                                    const std::vector<std::vector<Tensor>>& truth);

}  // namespace satsurf::evaluate
