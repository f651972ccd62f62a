// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/input.h"
#include "satsurf/scene/raycast.h"

#include <optional>
#include <span>
#include <vector>

namespace satsurf::reconstruct {

/// What images that show a surface say of it and of one another.
struct ImageAgreement {
  /// Mean correlation of the brightness of every two images, -1 to 1; 0 where no two show any of it.
  /// Wrong cameras and wrong heights lower it. Between two good surfaces of the same images it does
  /// not decide: one that follows every crown and shadow may have a little more than a truer one.
  double correlation = 0;
  /// For each image the share of the ground that no other image confirms although two others
  /// confirm each other there: clouds and their shadows, snow, harvested fields, what was built in
  /// between. It takes three images: of two that differ neither is right. 0 where there is less to
  /// judge by than a hundredth of the surface or 20 squares.
  std::vector<double> unconfirmed;
  /// Share of the surface that lies in fewer than three of three images or more, hidden there or not.
  double in_two = 0;
};

/// Correlation, from which on two pieces of images show the same, and below which they do not.
inline constexpr double kConfirmed = 0.6, kUnlike = 0.2;
/// Pearson's, of the brightness that two images have at the same points; 0 for what has no texture,
/// nothing where fewer than half of the points are known in both.
/// a, b  alike long, NaN where not known
std::optional<double> correlation(std::span<const float> a, std::span<const float> b);

/// Compares the images in squares of 24 px of ground, where they see the surface.
/// surface  in the local frame
/// images   whole, in the same frame
/// cost     a ray per image and 9 px of ground
ImageAgreement image_agreement(const scene::HeightField& surface,
                               const std::vector<nn::PosedImage>& images);

}  // namespace satsurf::reconstruct
