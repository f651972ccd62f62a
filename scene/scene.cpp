// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/scene.h"

#include <algorithm>
#include <cmath>

namespace satsurf::scene {

bool View::shows(const rpc::Geodetic& p) const {
  const rpc::Pixel pixel = rpc.project(p);
  if (!rpc::inside_image(pixel, width(), height())) return false;
  const Index x = std::clamp<Index>(std::lround(pixel.x), 0, width() - 1),
              y = std::clamp<Index>(std::lround(pixel.y), 0, height() - 1);
  return valid[y * width() + x] > 0;
}

View view_of(const rpc::Image& image, const std::filesystem::path& file) {
  View view;
  view.name = image.info.path.stem().string();
  view.rgb = rpc::to_rgb(image);
  view.valid = image.valid;
  view.rpc = *image.info.rpc;
  view.sun_elevation_deg = image.info.sun_elevation_deg.value_or(0);
  view.sun_azimuth_deg = image.info.sun_azimuth_deg.value_or(0);
  view.date = image.info.acquisition_date.value_or("");
  view.file = file;
  view.files = image.info.files;
  view.bands = image.info.bands;
  view.dtype = image.info.dtype;
  view.colours = rpc::rgb_choice(image);
  return view;
}

}  // namespace satsurf::scene
