// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/user_images.h"

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <variant>
#include <vector>

namespace satsurf::scene {

/// An image that the caller holds in memory; it is copied and not kept.
struct ImageInMemory {
  std::string name;  ///< what messages call it; numbered where two are the same
  rpc::Rpc rpc;      ///< pixel (0, 0) is the centre of the first one
  Index width = 0, height = 0, channels = 0;
  /// Values as the sensor delivers them, width * height * channels of them, row by row. Of
  /// uint8 the full range is used; others are stretched from their 1st to their 99th percentile.
  std::variant<std::span<const std::uint8_t>, std::span<const std::uint16_t>,
               std::span<const float>>
      pixels;
  bool interleaved = false;  ///< [height width channels] instead of [channels height width]
  /// [height width], 0 where a pixel says nothing; empty where all do. NaN is never valid.
  std::span<const std::uint8_t> valid{};
  /// Red, green and blue among the channels; with one or two channels the first is grey.
  std::array<Index, 3> rgb_channels{0, 1, 2};
  std::optional<rpc::HeightRange>
      height_range{};  ///< of the ground if known, m above the ellipsoid
};

/// As `scene_from_views`, from images in memory: the same values and cameras give the same scene.
/// images         two or more
/// height_range   m above the ellipsoid; else what the images name, else it is searched for
/// poll           called often, may throw to stop
/// rules          what of every image does not count, and what becomes of the cameras
/// throws         Error for images without overlap or parallax, or whose sizes, values, heights or
///                cameras are none; ConfigError for a range that is not the cameras'
UserScene scene_from_images(const std::vector<ImageInMemory>& images,
                            const std::optional<rpc::HeightRange>& height_range = {},
                            const std::function<void()>& poll = {}, const ViewRules& rules = {});

}  // namespace satsurf::scene
