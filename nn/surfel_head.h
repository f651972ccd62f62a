// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/blocks.h"
#include "satsurf/nn/choices.h"
#include "satsurf/nn/input.h"
#include "satsurf/splat/rasterize.h"

#include <array>
#include <vector>

namespace satsurf::nn {

/// What the head needs to know of one view's camera at a stage's resolution.
struct PixelGeometry {
  Quadratic local_from_pixel;              ///< stage pixel (x, y), z -> local (x, y)
  std::array<double, 4> quat{1, 0, 0, 0};  ///< camera-to-world rotation, w x y z
  double footprint = 1;                    ///< across-ray ground size of a stage pixel, m
};

/// From a view's camera.
/// view    its camera in image pixels
/// z       local height at which the camera is looked at, m
/// stride  image pixels per stage pixel
/// throws  Error for a mirrored image
PixelGeometry pixel_geometry(const PosedImage& view, double z, Index stride);

/// 2D network from image, features and height distribution to raw surfel attributes:
///   3x3 -> width, GroupNorm, GELU; two residual 3x3; 1x1 -> 10
/// The last layer's weights start at zero and its biases give an opaque disc of 0.6 pixels that
/// faces the camera and has the image's colour.
template <class T>
class SurfelHead {
 public:
  static constexpr Index kOutputs = 10;  // scale 2, rotation 4, opacity 1, colour 3
  SurfelHead(ParameterSet<T>& p, const std::string& name, Index channels, Index width);
  /// x        [N C H W]
  /// returns  [N 10 H W]
  /// throws   ShapeError
  BasicVar<T> operator()(const BasicVar<T>& x) const;

 private:
  ConvNorm2d<T> first_, residual1_, residual2_;
  BasicVar<T> weight_, bias_;
};

/// What surfels are made from, at one stage's resolution.
template <class T>
struct SurfelMaps {
  BasicVar<T> raw;         ///< [N 10 H W] of the head
  BasicVar<T> height;      ///< [N H W] m
  BasicTensor<T> image;    ///< [N 3 H W]
  BasicVar<T> confidence;  ///< [N H W], becomes auxiliary channel 0
};

/// One surfel per pixel from raw attributes and heights:
///   mu      = localisation(pixel centre, H)
///   scale   = footprint (0.1 + 2.9 sigmoid(r0..1))
///   q       = q_view (x) (1 + r2, r3, r4, r5), or q_view alone, or that of the frame of dmu/dx and
///             dmu/dy, orthogonal from dmu/dx on
///   opacity = sigmoid(r6)
///   colour  = image + r7..9
/// dL/dH = v . dL/dmu with v the ground displacement along the ray per metre (v_z = 1).
/// geometry  N cameras at this resolution
/// rotation  where q comes from
/// returns   N*H*W surfels in the local frame
/// throws    ShapeError
template <class T>
splat::BasicSurfels<T> surfels_from_maps(const SurfelMaps<T>& maps,
                                         const std::vector<PixelGeometry>& geometry,
                                         Rotation rotation);

/// Surfels that need no head: discs of 0.6 pixels that face the camera, in the image's colours, of
/// opacity 0.32, since every place has those of several views.
/// height, image, confidence  as in `SurfelMaps`
/// geometry                   N cameras at this resolution
/// returns                    N*H*W surfels in the local frame
/// throws                     ShapeError
template <class T>
splat::BasicSurfels<T> discs_from_maps(const BasicVar<T>& height, const BasicTensor<T>& image,
                                       const BasicVar<T>& confidence,
                                       const std::vector<PixelGeometry>& geometry);

}  // namespace satsurf::nn
