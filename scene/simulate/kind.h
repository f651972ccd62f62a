// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"

#include <array>

namespace satsurf::scene {

/// What a made-up place looks like.
enum class SceneKind { city, suburb, industrial, village, rural, rough };

}  // namespace satsurf::scene

template <>
struct satsurf::EnumNames<satsurf::scene::SceneKind> {
  static constexpr std::array names{"city", "suburb", "industrial", "village", "rural", "rough"};
};
