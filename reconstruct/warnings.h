// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/image_agreement.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/scene/user_images.h"

#include <string>
#include <utility>
#include <vector>

namespace satsurf::reconstruct {

/// A reason to look twice at a surface.
struct Warning {
  std::string code;  ///< for programs; see `warning_codes`
  std::string text;  ///< in words, one line, with the numbers
};

/// What the images let fear before anything is computed: parallax too small or too large, suns or
/// dates far apart, a ground size unlike anything the weights were trained on.
std::vector<Warning> scene_warnings(const scene::Scene& scene);

/// What the cameras let fear: pointing that could not be measured or not for all images, that the tie
/// points determine in part only, after whose correction images still disagree, or so far off that
/// all heights together may be.
/// scene  whose cameras these are
std::vector<Warning> pointing_warnings(const scene::Pointing& pointing, const scene::Scene& scene);

/// What the heights to look at let fear: a range found far below all tie points, as where one of the
/// images shows something else than the others.
std::vector<Warning> range_warnings(const scene::UserScene& user);

/// What the surface lets fear: heights piled up at an end of the range that was searched, low
/// confidence, large gaps, cameras that their quadratics do not follow.
std::vector<Warning> surface_warnings(const Reconstruction& made);

/// What the images let fear once there is a surface: one that shows something else than the others, or
/// much ground that only two of them show.
/// views  whose images these are
std::vector<Warning> image_warnings(const ImageAgreement& agreement,
                                    const std::vector<scene::View>& views);

/// Every code with what it stands for and from which number on.
std::vector<std::pair<std::string, std::string>> warning_codes();

}  // namespace satsurf::reconstruct
