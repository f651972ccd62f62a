// SPDX-License-Identifier: Apache-2.0
#include "satsurf/evaluate/evaluate.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/var.h"
#include "satsurf/evaluate/fill.h"
#include "satsurf/evaluate/score_views.h"
#include "satsurf/mesh/surface.h"
#include "satsurf/reconstruct/laid_surfels.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/reconstruct/rendered_view.h"
#include "satsurf/scene/classes.h"
#include "satsurf/scene/crop.h"
#include "satsurf/scene/dataset.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <string>

namespace satsurf::evaluate {
namespace {

/// The causes of the truth's cells that count.
/// images  the sources, whole, with the cameras that were fitted to them
CauseFlags causes_of(const scene::Scene& scene, const std::vector<nn::PosedImage>& images,
                     const Tensor& mask) {
  std::vector<LitView> views;
  for (std::size_t i = 0; i < images.size(); ++i)
    views.push_back({images[i], slope_to_sun(scene.views[i], scene.frame)});
  return find_causes(*scene.truth, scene.classes, views, mask);
}

/// The DSM by every registration, as it is and with its holes filled, and what its errors come from.
void score_dsm(const reconstruct::Reconstruction& made, const scene::HeightField& truth,
               const Tensor& mask, const CauseFlags& causes, Registration asked, SceneScores& out,
               ConfidenceScores* confidence) {
  for (const Registration r : {Registration::none, Registration::z, Registration::xyz}) {
    const DsmComparison c = compare_dsm(made.dsm, truth, r, mask, false);
    const Tensor whole = filled(c.surface);
    out.registered[static_cast<std::size_t>(r)] = {c.registered,
                                                   score_heights(whole, truth.z, mask), c.shift};
    if (r == asked) out.dsm = c, out.causes = score_causes(whole, truth.z, mask, causes);
  }
  if (!made.sigma.empty()) {
    const scene::HeightField sigma{made.sigma, made.dsm.x0 + out.dsm.shift[0],
                                   made.dsm.y0 + out.dsm.shift[1], made.dsm.step};
    out.sigma = score_sigma(resample(sigma, truth), out.dsm.error);
  }
  out.oracle = score_oracle(made.surfels.means.value(), out.dsm.shift, truth, mask);
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

}  // namespace

SigmaScore score_sigma(const Tensor& sigma, const Tensor& error) {
  Dims("score_sigma").match("sigma", sigma, "H W").match("error", error, "H W");
  double n = 0, one = 0, two = 0;
  for (Index i = 0; i < error.count(); ++i) {
    if (!std::isfinite(error[i]) || !std::isfinite(sigma[i])) continue;
    n += 1;
    one += std::abs(error[i]) <= sigma[i] ? 1 : 0;
    two += std::abs(error[i]) <= 2 * sigma[i] ? 1 : 0;
  }
  if (n == 0) return {};
  return {one / n, two / n};
}

Tensor not_water(const Tensor& classes) {
  Tensor mask = classes.clone();
  for (float& v : mask.values()) v = v == scene::kWaterClass ? 0.f : 1.f;
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
  const auto field = [&](const std::filesystem::path& file, const rpc::GeoRaster& r) {
    const Tensor z = r.values.rank() == 3 ? r.values.slice0(0) : r.values;
    rpc::require_heights(file, z);
    return scene::HeightField{z, r.grid.x0 - east, r.grid.y0 - north, r.grid.step};
  };
  DsmPair pair{.prediction = field(prediction, found),
               .truth = field(truth, known),
               .east = east,
               .north = north,
               .epsg = b != 0 ? b : a,
               .frame = std::nullopt};
  if (const auto zone = rpc::zone_of_epsg(pair.epsg))
    pair.frame = rpc::LocalFrame{*zone, east, north, 0};
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
  seen.z_range.high += options.range_above;
  const Tensor mask = scored_cells(scene, seen.views, options.mask_water);

  SceneScores out;
  out.name = scene.name;
  const auto start = std::chrono::steady_clock::now();
  reconstruct::ReconstructOptions how;
  how.resolution = scene.truth->step;
  // the truth's own cells: those that lie across them would be halfway between roof and ground at walls
  how.cell_corner = {scene.truth->x0 + scene.frame.easting0,
                     scene.truth->y0 + scene.frame.northing0};
  how.surface = options.surface;
  how.network = options.network;
  if (options.meshes) how.mesh = 0;
  how.progress = options.progress;
  const reconstruct::Reconstruction made = reconstruct::reconstruct(model, seen, how);
  out.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  score_dsm(made, *scene.truth, mask, causes_of(seen, made.images, mask), options.registration, out,
            confidence);
  if (options.meshes) {
    std::vector<nn::PosedImage> images = made.images;
    for (std::size_t i = images.size(); i < scene.views.size(); ++i)
      images.push_back(scene::posed_image(scene.views[i], scene.frame, scene.z_range));
    out.mesh =
        compare_surfaces(made.surfels, *scene.truth, images, mask, out.dsm.shift, made.voxel);
  }
  score_views(model, scene, options, sources, reconstruct::delivered_surfels(made), out,
              confidence);
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
