// SPDX-License-Identifier: Apache-2.0
// Three satellite images in memory with their RPC cameras become heights, confidence and surfels in
// memory, with progress and cancelling. Needs satsurf::satsurf.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <satsurf/satsurf.h>

using namespace satsurf;

namespace {

/// A place whose images and heights are made up, in place of a program's own images.
scene::SimulatedScene made_up() {
  scene::SimulateConfig config;
  config.pixels = 256;
  config.gsd = 0.5;
  config.views = 3;
  config.kinds = {scene::SceneKind::suburb};
  config.water = 0;
  return scene::simulate_scene(config, 2026, 0);
}

/// Median difference between the heights found and the true ones, m.
double median_error(const reconstruct::Reconstruction& found, const scene::SimulatedScene& made) {
  const scene::HeightField &dsm = found.dsm, &truth = made.dsm;
  std::vector<double> errors;
  for (Index i = 0; i < dsm.z.dim(0); ++i)
    for (Index j = 0; j < dsm.z.dim(1); ++j) {
      const double z = dsm.z[i * dsm.z.dim(1) + j];  // NaN where nothing was seen
      const double east = dsm.x0 + (static_cast<double>(j) + 0.5) * dsm.step + found.frame.easting0;
      const double north =
          dsm.y0 - (static_cast<double>(i) + 0.5) * dsm.step + found.frame.northing0;
      const auto row = static_cast<Index>((truth.y0 + made.frame.northing0 - north) / truth.step);
      const auto col = static_cast<Index>((east - truth.x0 - made.frame.easting0) / truth.step);
      if (!std::isfinite(z) || row < 0 || col < 0 || row >= truth.z.dim(0) || col >= truth.z.dim(1))
        continue;
      const double t = truth.z[row * truth.z.dim(1) + col];
      errors.push_back(std::abs(z + found.frame.h0 - t - made.frame.h0));
    }
  if (errors.empty()) return INFINITY;
  const auto middle = errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2);
  std::nth_element(errors.begin(), middle, errors.end());
  return *middle;
}

struct Cancelled {};

}  // namespace

int main() {
  const scene::SimulatedScene made = made_up();
  std::vector<std::vector<std::uint8_t>> pixels;  // [channels height width] of every image
  std::vector<scene::ImageInMemory> images;
  for (const scene::SimulatedView& view : made.views) {
    std::vector<std::uint8_t>& bytes = pixels.emplace_back();
    for (const float v : view.rgb.values())
      bytes.push_back(static_cast<std::uint8_t>(std::lround(255 * v)));
    images.push_back({.name = "image " + std::to_string(images.size() + 1),
                      .rpc = view.rpc,
                      .width = view.rgb.dim(2),
                      .height = view.rgb.dim(1),
                      .channels = 3,
                      .pixels = std::span<const std::uint8_t>(bytes)});
  }

  // From here on it is what any program does that holds such images.
  const scene::UserScene place = scene::scene_from_images(images);
  const nn::Model model = nn::load_model(nn::shipped_weights());
  const std::optional<nn::SurfaceModel> refiner = nn::load_surface(nn::shipped_weights());
  bool cancel = false;
  reconstruct::ReconstructOptions options;
  if (refiner) options.network = &*refiner;
  options.progress = [&](const std::string& stage, double fraction) {
    if (cancel) throw Cancelled{};  // leaves reconstruct(), from wherever it is
    static std::string last;
    const std::string now = stage + " " + std::to_string(25 * static_cast<int>(4 * fraction));
    if (now != last) std::printf("%s %%\n", now.c_str());
    last = now;
  };
  const reconstruct::Reconstruction found = reconstruct::reconstruct(model, place.scene, options);

  const Tensor& confidence = found.confidence;
  double sum = 0, cells = 0;
  for (const float c : confidence.values())
    if (std::isfinite(c)) sum += static_cast<double>(c), cells += 1;
  const double error = median_error(found, made);
  std::printf("%td x %td cells of %.2f m in EPSG:%d, %.0f %% with a height, mean confidence %.2f\n",
              found.dsm.z.dim(1), found.dsm.z.dim(0), found.dsm.step, found.frame.zone.epsg(),
              100 * found.completeness, sum / cells);
  std::printf("%td surfels; median error %.2f m\n", found.surfels.means.dim(0), error);

  bool stopped = false;
  cancel = true;
  try {
    reconstruct::reconstruct(model, place.scene, options);
  } catch (const Cancelled&) {
    stopped = true;
  }
  std::printf("a second run %s\n", stopped ? "was cancelled" : "could not be cancelled");
  return stopped && found.completeness > 0.8 && error < 1 && sum / cells > 0.3 ? 0 : 1;
}
