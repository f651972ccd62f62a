// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/as_scene.h"

#include <utility>

namespace satsurf::scene {

Scene as_scene(SimulatedScene made, const std::string& name) {
  constexpr double kMargin = 5;  // m
  Scene scene;
  scene.name = name;
  scene.frame = made.frame;
  scene.z_range =
      made.frame.z_from_heights(rpc::HeightRange{made.h_min, made.h_max}.widened(kMargin));
  scene.truth = std::move(made.dsm);
  scene.classes = std::move(made.classes);
  for (std::size_t i = 0; i < made.views.size(); ++i) {
    SimulatedView& from = made.views[i];
    const std::string number = std::to_string(i + 1);
    View view;
    view.name = name + "_" + std::string(number.size() < 3 ? 3 - number.size() : 0, '0') + number;
    view.valid = Tensor({from.rgb.dim(1), from.rgb.dim(2)}, 1.f);
    view.rgb = std::move(from.rgb);
    view.rpc = std::move(from.rpc);
    view.sun_elevation_deg = from.sun_elevation_deg;
    view.sun_azimuth_deg = from.sun_azimuth_deg;
    view.date = std::move(from.date);
    scene.views.push_back(std::move(view));
  }
  return scene;
}

}  // namespace satsurf::scene
