// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"

#include <array>

// What a configuration of the network chooses between (nn/config.h).

namespace satsurf::nn {

/// What the 3D U-Nets are told beside variances.
enum class Context {
  none,
  reference  ///< the reference view's features
};

/// Which height a stage makes of its distribution.
enum class HeightOf {
  mean,  ///< the expectation, as published
  mode   ///< the expectation near the most probable height (ops/mode_height.h)
};

/// Around what a stage searches, from the coarser heights of the stage before.
enum class Centre {
  bilinear,  ///< between roof and ground at a wall
  nearest    ///< on one of both: the nearest one's, along its slope
};

/// Which way surfels face.
enum class Rotation {
  camera,    ///< all towards the camera
  residual,  ///< as the head turns them from there
  gradient   ///< along the surface: tangents are the neighbours' differences, without gradients
};

/// The branch that sees one image at a time.
enum class MonoBranch {
  none,
  own  ///< nn/mono.h
};

/// How monocular features join the matching features (nn/fusion.h).
enum class Fusion {
  none,
  naive,  ///< one 1 x 1 convolution of both
  cmmf    ///< weighed by the confidence of the stage before
};

/// What CMMF is before training (nn/fusion.h).
enum class FusionStart { paper, gated, additive };

/// How a stage is guided by the surface of the one before, rendered (nn/guidance.h).
enum class Guidance {
  none,
  csrg,        ///< by the difference of heights
  photometric  ///< by the difference of colours
};

/// How rendered heights and those of the next stage are made comparable.
enum class GuidanceNorm {
  robust,   ///< each map by its own median and MAD: tells shape, not offset
  interval  ///< their difference in hypothesis intervals
};

/// Whose surfels a stage hands on.
enum class Keep {
  last,  ///< its own
  all    ///< those of the stages before, too
};

/// The one confidence that fusion, guidance, surfel heads, loss routing and confidence maps read
/// (nn/confidence.h).
enum class Confidence {
  raw,    ///< C = max P, as published
  floor,  ///< (C - 1/D) / (1 - 1/D)
  joint   ///< probability that the surface is near, given all stages so far
};

}  // namespace satsurf::nn

namespace satsurf {

template <>
struct EnumNames<nn::Context> {
  static constexpr std::array names{"none", "reference"};
};
template <>
struct EnumNames<nn::HeightOf> {
  static constexpr std::array names{"mean", "mode"};
};
template <>
struct EnumNames<nn::Centre> {
  static constexpr std::array names{"bilinear", "nearest"};
};
template <>
struct EnumNames<nn::Rotation> {
  static constexpr std::array names{"camera", "camera+residual", "gradient"};
};
template <>
struct EnumNames<nn::MonoBranch> {
  static constexpr std::array names{"none", "own"};
};
template <>
struct EnumNames<nn::Fusion> {
  static constexpr std::array names{"none", "naive", "cmmf"};
};
template <>
struct EnumNames<nn::FusionStart> {
  static constexpr std::array names{"paper", "gated", "additive"};
};
template <>
struct EnumNames<nn::Guidance> {
  static constexpr std::array names{"none", "csrg", "photometric"};
};
template <>
struct EnumNames<nn::GuidanceNorm> {
  static constexpr std::array names{"robust", "interval"};
};
template <>
struct EnumNames<nn::Keep> {
  static constexpr std::array names{"last", "all"};
};
template <>
struct EnumNames<nn::Confidence> {
  static constexpr std::array names{"raw", "floor", "joint"};
};

}  // namespace satsurf
