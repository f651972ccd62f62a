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

/// A view that is not used, and why.
struct LeftOut {
  std::string label;  ///< see View::label
  std::string why;    ///< in words
};

/// Which views of many are used.
struct ViewChoice {
  std::vector<Index> kept;  ///< ascending; every two see common ground from two directions
  std::vector<LeftOut> left_out;
};

/// Begins with the best pair and adds, as long as there are any, the view that goes best with all
/// that were taken. Left out are views from the direction of another, views that do not see ground
/// that all others see, and those beyond the most that are wanted.
/// height_of  of the ground in a view, m above the ellipsoid
/// most       that are kept, 2 or more
/// returns    nothing kept where no two views go together
/// throws     Error
ViewChoice choose_views(const std::vector<View>& views,
                        const std::function<double(const View&)>& height_of, Index most);

}  // namespace satsurf::scene
