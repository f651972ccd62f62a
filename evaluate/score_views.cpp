// SPDX-License-Identifier: Apache-2.0
#include "satsurf/evaluate/score_views.h"

#include "satsurf/core/dims.h"
#include "satsurf/scene/crop.h"
#include "satsurf/splat/view.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

namespace satsurf::evaluate {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

/// Whether a pixel shows more surface than background.
bool covers(float alpha) { return !(alpha < 0.5f); }

/// Joins maps of one width below each other, so that several views are scored as one.
Tensor stacked(const std::vector<Tensor>& maps) {
  Index rows = 0;
  for (const Tensor& m : maps) rows += m.dim(0);
  auto out = Tensor::uninitialised({rows, maps[0].dim(1)});
  float* to = out.data();
  for (const Tensor& m : maps) to = std::copy_n(m.data(), m.count(), to);
  return out;
}

/// Local z of the truth in the middle of its grid, or of the height range where it is unknown
/// there.
double middle_height(const scene::Scene& scene) {
  const Tensor& z = scene.truth->z;
  const float v = z[z.dim(0) / 2 * z.dim(1) + z.dim(1) / 2];
  return std::isfinite(v) ? static_cast<double>(v) : scene.z_range.middle();
}

Tensor difference(const Tensor& a, const Tensor& b) {
  Tensor out = a.clone();
  for (Index i = 0; i < out.count(); ++i) out[i] -= b[i];
  return out;
}

/// The window around the middle of the truth: of the sources, and of the view after them as target.
/// throws  IoError if it is too small for LPIPS
scene::Crop middle_window(const nn::Model& model, const scene::Scene& scene,
                          const EvaluateOptions& options, const std::vector<Index>& sources) {
  const Index multiple = nn::size_multiple(model.config());
  Index side = options.window;
  for (const scene::View& v : scene.views) side = std::min({side, v.height(), v.width()});
  side = std::max(multiple, side / multiple * multiple);
  const bool has_target = scene.views.size() > sources.size();
  if (has_target && options.lpips != nullptr && side < options.lpips->smallest_side())
    throw IoError(scene.images.string() + ": a window of " + std::to_string(side) + " px in " +
                  scene.name + ", expected at least " +
                  std::to_string(options.lpips->smallest_side()) + " px for LPIPS (" +
                  nn::lpips_backbone_name(options.lpips->backbone()) + ")");
  const scene::HeightField& truth = *scene.truth;
  const double x = truth.x0 + truth.step * static_cast<double>(truth.z.dim(1)) / 2;
  const double y = truth.y0 - truth.step * static_cast<double>(truth.z.dim(0)) / 2;
  scene::CropOptions window{.sources = sources,
                            .centre = {x, y, middle_height(scene)},
                            .size = {side, side},
                            .z_range = scene.z_range,
                            .with_truth = true};
  if (has_target) window.target = static_cast<Index>(sources.size());
  return scene::make_crop(scene, window);
}

/// Heights in the sources and what the stages before the last have lost of them.
/// truth  see `scene::forget_unseen_truth`
void score_sources(const nn::ModelConfig& config,
                   const std::array<nn::StageOutput<float>, 3>& stages,
                   const std::vector<std::vector<Tensor>>& truth, SceneScores& out,
                   ConfidenceScores* confidence) {
  const Tensor sure = nn::effective_confidence(config, stages[2]);
  const std::vector<Tensor>& known = truth[2];
  std::vector<Tensor> found;
  double rmse = 0, scored = 0;
  for (std::size_t i = 0; i < known.size(); ++i) {
    found.push_back(stages[2].height.value().slice0(static_cast<Index>(i)));
    const double of_view = score_heights(found[i], known[i]).rmse;
    if (std::isfinite(of_view)) rmse += of_view, scored += 1;
    if (confidence != nullptr)
      confidence->mvs_source.add(sure.slice0(static_cast<Index>(i)),
                                 difference(found[i], known[i]));
  }
  out.mvs_source = score_heights(stacked(found), stacked(known));
  out.mvs_source_rmse_per_view = scored > 0 ? rmse / scored : std::nan("");
  out.lost = lost_by_stage(stages, truth);
}

/// Heights and colours that surfels show in the target view, if there is one.
void score_target(const splat::Surfels& surfels, const scene::Crop& crop, const nn::Lpips* lpips,
                  SceneScores& out) {
  if (!crop.target) {
    const Tensor none({1, 1}, kNan);
    out.render_target = score_heights(none, none);
    out.target.psnr = out.target.psnr_fitted = std::nan("");
    out.target.ssim = out.target.ssim_conv = out.target_covered = std::nan("");
    return;
  }
  const Tensor& valid = crop.target->valid;
  const auto render =
      splat::render_view(surfels, crop.target->pixel_from_local, valid.dim(0), valid.dim(1), 1);
  Tensor height = render.height.value().clone(), mask = valid.clone();
  for (Index p = 0; p < height.count(); ++p)
    if (!covers(render.alpha.value()[p])) height[p] = kNan, mask[p] = 0;
  out.target_covered = covered_share(render.alpha.value(), valid);
  out.render_target = score_heights(height, crop.target_truth, valid);
  out.target = score_images(splat::surface_colours(render), crop.target->rgb, mask, lpips);
}

}  // namespace

double covered_share(const Tensor& alpha, const Tensor& valid) {
  Dims("covered_share").match("alpha", alpha, "H W").match("valid", valid, "H W");
  Index all = 0, covered = 0;
  for (Index p = 0; p < valid.count(); ++p)
    if (valid[p] > 0) all += 1, covered += covers(alpha[p]);
  return all > 0 ? static_cast<double>(covered) / static_cast<double>(all) : std::nan("");
}

void score_views(const nn::Model& model, const scene::Scene& scene, const EvaluateOptions& options,
                 const std::vector<Index>& sources, const splat::Surfels& surfels, SceneScores& out,
                 ConfidenceScores* confidence) {
  scene::Crop crop = middle_window(model, scene, options, sources);
  scene::forget_unseen_truth(crop);
  const auto stages = model.forward(crop.input, {}, nullptr, nn::Wanted::heights);
  score_sources(model.config(), stages, crop.source_truth, out, confidence);
  score_target(surfels, crop, options.lpips, out);
}

}  // namespace satsurf::evaluate
