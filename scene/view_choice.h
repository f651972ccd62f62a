// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/view_pair.h"

#include <functional>
#include <string>
#include <vector>

namespace satsurf::scene {

/// How much two views tell of heights, from 0 to 1:
///   share of common ground * base * suns * dates
/// with a base-to-height ratio that is best from 0.1 to 0.5 (less is rough, more hides walls), suns
/// and dates that count half where they are 40 degrees and a year apart.
/// Source: Facciolo, de Franchis and Meinhardt-Llopis 2017 rank pairs by the same quantities.
double pair_quality(const ViewPair& pair);

/// How views that were chosen have to go together.
enum class Together {
  all,       ///< every two see common ground: they are looked at at once
  connected  ///< each sees common ground with one of the others: parts of the ground have their own
};

/// A view that is not used, and why.
struct LeftOut {
  std::string label;  ///< see View::label
  std::string why;    ///< in words
};

/// Which views of many are used.
struct ViewChoice {
  std::vector<Index> kept;  ///< ascending; those with common ground see it from two directions
  std::vector<LeftOut> left_out;
};

/// Begins with the best pair and adds, as long as there are any, the view that goes best with all
/// that were taken. Left out are views from the direction of another, views without the common ground
/// that `together` asks for, and those beyond the most that are wanted.
/// height_of  of the ground in a view, m above the ellipsoid
/// most       that are kept, 2 or more
/// together   connected takes views that see no ground of some of the others, too
/// returns    nothing kept where no two views go together
/// throws     Error
ViewChoice choose_views(const std::vector<View>& views,
                        const std::function<double(const View&)>& height_of, Index most,
                        Together together = Together::all);

/// The views for a part of the ground, of those that see something of it. A point is worth q / (q +
/// 1/4) by the sum q of the qualities of all pairs that see it: pairs beyond the first count less and
/// less, so that ground that few see is not given up for a further view of the rest. Views are
/// taken one by one or in pairs, those first that add most for each, as long as they add anything;
/// none from the direction of another that was taken.
/// shows   [view][point] whether a view shows a point of that ground
/// height  of the ground, m above the ellipsoid
/// most    that are kept, 2 or more
/// returns their numbers, ascending; empty where no two see one point from two directions
/// throws  Error
std::vector<Index> choose_for_ground(const std::vector<View>& views,
                                     const std::vector<std::vector<char>>& shows, double height,
                                     Index most);

}  // namespace satsurf::scene
