// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/ops/window_correlation.h"
#include "satsurf/scene/believable_span.h"
#include "satsurf/scene/scene.h"

#include <array>
#include <functional>
#include <map>
#include <utility>
#include <vector>

namespace satsurf::scene {

/// Of every pixel the height at which it is most like the other images.
struct BestHeights {
  Tensor best,  ///< [P] correlation at that height, -1 where nothing was compared
      rival,    ///< [P] the best that is no part of the same peak
      where;    ///< [P] the height, local m

  explicit BestHeights(Index pixels)
      : best({pixels}, -1.f), rival({pixels}, -1.f), where({pixels}, 0.f) {}

  /// Whether the images agree there, and nowhere else as much.
  bool sure(Index pixel) const;
};

/// Pixels side by side with heights of one surface.
struct FoundPatch {
  std::vector<Index> pixels;  ///< of the image
  Patch heights;              ///< of each
};

/// The images of a scene, coarse enough that a whole range of heights is soon tried: windows of one
/// are compared with the others by normalised correlation.
class HeightSweep {
 public:
  static constexpr Index kRadius = ComparedWindow::kRadius;  ///< px, half a window
  static constexpr Index kPatch = ComparedWindow::kPixels;   ///< px of a window

  /// scene     two views or more
  /// searched  heights that are tried, local m
  /// throws    Error naming an image without texture
  HeightSweep(const Scene& scene, const rpc::HeightRange& searched);

  Index factor() const { return factor_; }  ///< by which images are reduced
  Index views() const { return static_cast<Index>(images_.size()); }
  Index height(Index view) const { return image(view).grey.dim(0); }
  Index width(Index view) const { return image(view).grey.dim(1); }
  PixelBox whole(Index view) const { return {0, 0, width(view), height(view)}; }
  float peak() const { return peak_; }  ///< m; heights this close are of one peak

  /// Tries all heights for the pixels of a box; windows are cut at its border.
  /// others   views to compare with, one or more
  /// poll     called often, may throw to stop; may be empty
  /// returns  by the mean of all correlations, and, of two others or more, by that of the better half
  ///          of them, as one image may show something else (snow, another season)
  std::vector<BestHeights> tried(Index view, const std::vector<Index>& others, const PixelBox& box,
                                 const std::function<void()>& poll) const;

  /// Where pixels of one view are in another: (x, y, z) -> (x, y), coarse px and local m.
  const Quadratic& transfer(Index from, Index to) const;

  /// Whether a place in a view has a whole window around it and a valid pixel.
  bool sees(Index view, const std::array<double, 2>& place) const;

  /// Patches of pixels that are counted, whose neighbours differ by no more than a peak; those of
  /// kPatch or more. A chance match spreads over hardly more than the window it was found in.
  /// counted  [P] of the whole image
  std::vector<FoundPatch> patches(Index view, const Tensor& where, std::vector<char> counted) const;

 private:
  static MaskedGrey coarse_of(const View& view, Index factor);
  static Index textured_windows(const MaskedGrey& image);
  const MaskedGrey& image(Index view) const { return images_[static_cast<std::size_t>(view)]; }

  const Scene& scene_;
  rpc::HeightRange searched_;
  Index factor_ = 1, steps_ = 0;
  float peak_ = 0;
  std::vector<MaskedGrey> images_;
  mutable std::map<std::pair<Index, Index>, Quadratic> transfers_;  // as they are asked for
};

}  // namespace satsurf::scene
