// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/input.h"
#include "satsurf/scene/raycast.h"

#include <cstddef>
#include <vector>

namespace satsurf::scene {
class SightLines;
}

namespace satsurf::reconstruct {

/// How bright every two images are on the ground that both show: what they have in common says which
/// brightness of the one is which of the other, whatever their light and stretch.
struct Exposures {
  struct Level {
    double middle = 0;  ///< median brightness, that of black 0 and of white 1
    double spread = 0;  ///< median distance from it; 0 where they share too little to tell
  };
  std::size_t images = 0;
  std::vector<Level> levels;  ///< [images images] of the first one where the second sees as well

  bool empty() const { return images == 0; }
  const Level& level(std::size_t image, std::size_t other) const {
    return levels[image * images + other];
  }
  /// Those of some of the images, by their numbers.
  Exposures among(const std::vector<std::size_t>& chosen) const;
};

/// Measures them at points spread over the ground; nothing of fewer than three images, of which none is
/// outvoted.
/// images  whole, or reduced copies of whole ones
/// z       of the ground, local m
Exposures exposures_of(const std::vector<nn::PosedImage>& images, double z);

/// Where an image shows something else than the others: a cloud, its shadow, snow, what was built in
/// between. Squares of 8 px of ground decide, each with those around it. In one of them an image
///   differs  in brightness, (b - median) / spread by its exposure with each other one, from every
///            other image by more than 1, and two of these from each other by less than half of that
///   is alone if no other image confirms its structure though two of these confirm each other
///            (`image_agreement`)
/// It is outvoted in spots of 36 such squares that differ or more, grown from those in whose
/// surroundings it is alone, as far as the others do not confirm it; in a rim of 6 squares that
/// differ by half as much, and 2 squares beyond. Where all have other brightness, as at other
/// seasons, structure decides; small things, as cars are, and water under a cloud stay as they are.
class Outvoted {
 public:
  /// By nobody.
  Outvoted() = default;
  /// surface    in the local frame; its corner decides nothing, so that parts of a surface agree
  /// lines      from it to the images
  /// exposures  of the images; none for nobody
  /// cost       a ray per image and 4 px of ground
  Outvoted(const scene::HeightField& surface, const std::vector<nn::PosedImage>& images,
           const scene::SightLines& lines, const Exposures& exposures);

  /// Whether others outvote an image in a cell of the surface.
  bool operator()(std::size_t image, Index row, Index col) const {
    if (squares_.empty()) return false;
    const Index r = (row + shift_row_) / side_, c = (col + shift_col_) / side_;
    return squares_[(static_cast<Index>(image) * rows_ + r) * columns_ + c] > 0;
  }

 private:
  Index side_ = 1, shift_row_ = 0, shift_col_ = 0;  ///< cells
  Index rows_ = 0, columns_ = 0;
  Tensor squares_;  ///< [N rows columns] 1 where an image is outvoted; empty where none is
};

}  // namespace satsurf::reconstruct
