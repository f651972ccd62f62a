// SPDX-License-Identifier: Apache-2.0
#include "satsurf/evaluate/evaluate.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/var.h"
#include "satsurf/evaluate/fill.h"
#include "satsurf/mesh/surface.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/reconstruct/rendered_view.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/crop.h"
#include "satsurf/scene/dataset.h"
#include "satsurf/splat/view.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <string>

namespace satsurf::evaluate {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kWaterClass = 9;  // of DFC2019

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

/// The DSM by every registration, as it is and with its holes filled.
void score_dsm(const reconstruct::Reconstruction& made, const scene::HeightField& truth,
               const Tensor& mask, Registration asked, SceneScores& out,
               ConfidenceScores* confidence) {
  for (const Registration r : {Registration::none, Registration::z, Registration::xyz}) {
    const DsmComparison c = compare_dsm(made.dsm, truth, r, mask, false);
    RegisteredScores& scores = out.registered[static_cast<std::size_t>(r)];
    scores = {c.registered, score_heights(filled(c.surface), truth.z, mask), c.shift};
    if (r == asked) out.dsm = c;
  }
  if (confidence != nullptr) {
    const scene::HeightField sure{made.confidence, made.dsm.x0 + out.dsm.shift[0],
                                  made.dsm.y0 + out.dsm.shift[1], made.dsm.step};
    confidence->dsm.add(resample(sure, truth), out.dsm.error);
  }
  out.dsm.surface = out.dsm.error = {};  // scores are kept for all scenes
}

/// Cells of the truth that are scored.
/// views   the sources
/// throws  IoError if there are none
Tensor scored_cells(const scene::Scene& scene, const std::vector<scene::View>& views,
                    bool mask_water) {
  std::vector<ImageCamera> cameras;
  for (const scene::View& v : views) cameras.push_back({v.rpc, v.width(), v.height()});
  Tensor mask = seen_by_two(*scene.truth, scene.frame, cameras);
  if (mask_water && !scene.classes.empty()) {
    Dims("evaluate").match("truth", mask, "H W").match("classes", scene.classes, "H W");
    const Tensor dry = not_water(scene.classes);
    for (Index i = 0; i < mask.count(); ++i) mask[i] *= dry[i];
  }
  if (std::none_of(mask.values().begin(), mask.values().end(), [](float v) { return v > 0; }))
    throw IoError(scene.truth_file.string() +
                  ": no height that counts, expected some that two of " + "the first " +
                  std::to_string(views.size()) + " images of " + scene.name + " see" +
                  (mask_water ? " and that are no water" : ""));
  return mask;
}

/// Heights and colours in the source views and the rendered target, in a window around the middle
/// of the truth.
void score_views(const nn::Model& model, const scene::Scene& scene, const EvaluateOptions& options,
                 const std::vector<Index>& sources, SceneScores& out,
                 ConfidenceScores* confidence) {
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
                            .size = side,
                            .z_range = scene.z_range,
                            .with_truth = true};
  if (has_target) window.target = static_cast<Index>(sources.size());
  const scene::Crop crop = scene::make_crop(scene, window);
  const auto stages = model.forward(crop.input);
  const Tensor sure = nn::effective_confidence(model.config(), stages[2]);
  std::vector<Tensor> found, known;
  double rmse = 0, scored = 0;
  for (std::size_t i = 0; i < sources.size(); ++i) {
    found.push_back(stages[2].height.value().slice0(static_cast<Index>(i)));
    known.push_back(crop.source_truth[2][i].clone());
    for (Index p = 0; p < known[i].count(); ++p)
      if (crop.input.sources[i].valid[p] <= 0) known[i][p] = kNan;  // no image, nothing to find
    const double of_view = score_heights(found[i], known[i]).rmse;
    if (std::isfinite(of_view)) rmse += of_view, scored += 1;
    if (confidence != nullptr)
      confidence->mvs_source.add(sure.slice0(static_cast<Index>(i)),
                                 difference(found[i], known[i]));
  }
  out.mvs_source = score_heights(stacked(found), stacked(known));
  out.mvs_source_rmse_per_view = scored > 0 ? rmse / scored : std::nan("");
  if (!has_target) return;

  const auto render =
      splat::render_view(stages[2].surfels, crop.target->pixel_from_local, side, side, 1);
  Tensor height = render.height.value().clone(), mask = crop.target->valid.clone();
  for (Index p = 0; p < height.count(); ++p)
    if (!covers(render.alpha.value()[p])) height[p] = kNan, mask[p] = 0;
  out.target_covered = covered_share(render.alpha.value(), crop.target->valid);
  out.render_target = score_heights(height, crop.target_truth, crop.target->valid);
  out.target = score_images(render.colour.value(), crop.target->rgb, mask, options.lpips);
}

}  // namespace

Tensor not_water(const Tensor& classes) {
  Tensor mask = classes.clone();
  for (float& v : mask.values()) v = v == kWaterClass ? 0.f : 1.f;
  return mask;
}

Tensor seen_by_two(const scene::HeightField& truth, const rpc::LocalFrame& frame,
                   const std::vector<ImageCamera>& images) {
  const Index H = truth.z.dim(0), W = truth.z.dim(1);
  Tensor mask({H, W});
  for_each_index(H, [&](Index i) {
    for (Index j = 0; j < W; ++j) {
      const float z = truth.z[i * W + j];
      if (!std::isfinite(z)) continue;
      const rpc::Geodetic p = frame.geodetic_from_local(
          {truth.x0 + (static_cast<double>(j) + 0.5) * truth.step,
           truth.y0 - (static_cast<double>(i) + 0.5) * truth.step, static_cast<double>(z)});
      int seen = 0;
      for (const ImageCamera& image : images)
        seen += rpc::inside_image(image.rpc.project(p), image.width, image.height);
      mask[i * W + j] = seen >= 2 ? 1.f : 0.f;
    }
  });
  return mask;
}

double covered_share(const Tensor& alpha, const Tensor& valid) {
  Dims("covered_share").match("alpha", alpha, "H W").match("valid", valid, "H W");
  Index all = 0, covered = 0;
  for (Index p = 0; p < valid.count(); ++p)
    if (valid[p] > 0) all += 1, covered += covers(alpha[p]);
  return all > 0 ? static_cast<double>(covered) / static_cast<double>(all) : std::nan("");
}

std::optional<mesh::MeshComparison> compare_surfaces(const splat::Surfels& surfels,
                                                     const scene::HeightField& truth,
                                                     const std::vector<nn::PosedImage>& images,
                                                     const Tensor& mask,
                                                     const std::array<double, 3>& shift,
                                                     double voxel) {
  // the truth's grid where the surfels see it before they are shifted
  scene::HeightField grid = truth;
  grid.x0 -= shift[0], grid.y0 -= shift[1];
  std::vector<mesh::HeightImage> found, known;
  for (const nn::PosedImage& image : images) {
    found.push_back(reconstruct::rendered_view(surfels, image).heights);
    found.back().rgb = {};
    reconstruct::keep_inside(found.back(), grid, mask);
    known.push_back(reconstruct::true_view(truth, image));
    reconstruct::keep_inside(known.back(), truth, mask);
  }
  mesh::FusionOptions how;
  how.voxel = voxel;
  auto surface = mesh::shape_from_views(found, how);
  if (!surface) return std::nullopt;
  const auto reference = mesh::shape_from_views(known, how);
  if (!reference) return std::nullopt;
  for (auto& v : surface->vertices)
    for (std::size_t a = 0; a < 3; ++a)
      v[a] = static_cast<float>(static_cast<double>(v[a]) + shift[a]);
  return mesh::compare_meshes(*surface, *reference);
}

DsmPair load_dsm_pair(const std::filesystem::path& prediction, const std::filesystem::path& truth) {
  const rpc::GeoRaster found = rpc::read_geo_raster(prediction),
                       known = rpc::read_geo_raster(truth);
  const int a = found.grid.epsg, b = known.grid.epsg;
  if (a != 0 && b != 0 && a != b) {
    std::string text = "evaluate: " + prediction.string() + " is in EPSG:";
    text += std::to_string(a) + " and " + truth.string() + " in EPSG:" + std::to_string(b);
    throw IoError(text + ", expected one system for both; gdalwarp brings one into the other");
  }
  const double east = std::round(known.grid.x0), north = std::round(known.grid.y0);
  const auto field = [&](const rpc::GeoRaster& r) {
    const Tensor z = r.values.rank() == 3 ? r.values.slice0(0) : r.values;
    return scene::HeightField{z, r.grid.x0 - east, r.grid.y0 - north, r.grid.step};
  };
  DsmPair pair{field(found), field(known), std::nullopt};
  const int epsg = b != 0 ? b : a, number = epsg % 100;
  if ((epsg / 100 == 326 || epsg / 100 == 327) && number >= 1 && number <= 60)
    pair.frame = rpc::LocalFrame{{number, epsg / 100 == 326}, east, north, 0};
  return pair;
}

SceneScores evaluate_scene(const nn::Model& model, const scene::Scene& scene,
                           const EvaluateOptions& options, ConfidenceScores* confidence) {
  if (static_cast<Index>(scene.views.size()) < options.views)
    throw IoError(scene.images.string() + ": " + std::to_string(scene.views.size()) +
                  " images of " + scene.name + ", expected " + std::to_string(options.views) +
                  " or more");
  if (!scene.truth)
    throw IoError(scene.truth_file.string() +
                  ": no such file, expected the truth to score against");
  const NoGrad no_grad;
  std::vector<Index> sources;
  for (Index i = 0; i < options.views; ++i) sources.push_back(i);
  scene::Scene seen = scene;
  seen.views.resize(static_cast<std::size_t>(options.views));
  const Tensor mask = scored_cells(scene, seen.views, options.mask_water);

  SceneScores out;
  out.name = scene.name;
  const auto start = std::chrono::steady_clock::now();
  reconstruct::ReconstructOptions how;
  how.resolution = scene.truth->step;
  if (options.meshes) how.mesh = 0;
  how.progress = options.progress;
  const reconstruct::Reconstruction made = reconstruct::reconstruct(model, seen, how);
  out.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  score_dsm(made, *scene.truth, mask, options.registration, out, confidence);
  if (options.meshes) {
    std::vector<nn::PosedImage> images = made.images;
    for (std::size_t i = images.size(); i < scene.views.size(); ++i)
      images.push_back(scene::posed_image(scene.views[i], scene.frame, scene.z_range));
    out.mesh =
        compare_surfaces(made.surfels, *scene.truth, images, mask, out.dsm.shift, made.voxel);
  }
  out.render_target = score_heights(Tensor({1, 1}, kNan), Tensor({1, 1}, kNan));  // none so far
  out.target.psnr = out.target.psnr_fitted = std::nan("");
  out.target.ssim = out.target.ssim_conv = out.target_covered = std::nan("");
  score_views(model, scene, options, sources, out, confidence);
  return out;
}

DataScores evaluate_data(const nn::Model& model, const std::filesystem::path& folder,
                         const EvaluateOptions& options) {
  const std::vector<std::string> names = scene::list_scenes(folder);
  DataScores out;
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (options.progress)
      options.progress("evaluate " + names[i],
                       static_cast<double>(i) / static_cast<double>(names.size()));
    EvaluateOptions inner = options;
    if (options.progress)  // a scene's own progress is a share of the whole
      inner.progress = [&](const std::string&, double f) {
        options.progress("evaluate " + names[i],
                         (static_cast<double>(i) + f) / static_cast<double>(names.size()));
      };
    try {
      out.scenes.push_back(
          evaluate_scene(model, scene::load_scene(folder, names[i]), inner, &out.confidence));
    } catch (const IoError&) {
      throw;  // names its file
    } catch (const Error& e) {
      throw Error(folder.string() + ": " + names[i] + ": " + e.what());
    }
  }
  return out;
}

}  // namespace satsurf::evaluate
