// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/surface_files.h"

#include "satsurf/app/beside.h"
#include "satsurf/app/products.h"
#include "satsurf/core/files.h"
#include "satsurf/core/parallel.h"
#include "satsurf/reconstruct/laid_surfels.h"
#include "satsurf/rpc/geoid.h"
#include "satsurf/rpc/read.h"
#include "satsurf/rpc/warp.h"
#include "satsurf/splat/ply.h"
#include "satsurf/splat/select.h"

#include <algorithm>
#include <array>
#include <functional>
#include <string>
#include <utility>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

/// Tags of a file about a surface, with the images it was made of.
rpc::GeoTags with_inputs(rpc::GeoTags tags, const scene::Scene& scene) {
  std::string names;
  for (const scene::View& view : scene.views)
    names += (names.empty() ? "" : " ") + view.file.filename().string();
  tags.metadata["INPUT_IMAGES"] = names;
  return tags;
}

/// How the values of all images can be kept as they are.
rpc::CellType type_for(const scene::Scene& scene) {
  bool bytes = true, whole = true;
  for (const scene::View& view : scene.views) {
    bytes = bytes && view.dtype == "uint8";
    whole = whole && (view.dtype == "uint8" || view.dtype == "uint16" || view.dtype == "int16");
  }
  if (bytes) return rpc::CellType::uint8;
  return whole ? rpc::CellType::uint16 : rpc::CellType::float32;
}

/// The channels of an image that are red, green and blue, or its first one.
Tensor chosen_channels(const rpc::Image& image, const rpc::RgbChoice& choice, bool colour) {
  const Index H = image.pixels.dim(1), W = image.pixels.dim(2), channels = colour ? 3 : 1;
  auto out = Tensor::uninitialised({channels, H, W});
  for (Index c = 0; c < channels; ++c)
    std::copy_n(image.pixels.data() + choice.channels[static_cast<std::size_t>(c)] * H * W, H * W,
                out.data() + c * H * W);
  return out;
}

}  // namespace

SurfaceTags surface_tags(const scene::Scene& scene, rpc::HeightDatum datum) {
  SurfaceTags tags;
  tags.heights = with_inputs(rpc::height_tags("Surface heights", datum), scene);
  tags.confidence.unit = "";
  tags.confidence.description = "Confidence of the surface, 0 to 1";
  tags.sigma.description = "Expected error of the heights, m";
  tags.views.unit = "", tags.views.description = "Number of images that see the cell";
  tags.views.type = rpc::CellType::uint8, tags.views.nodata = 255, tags.views.means = false;
  tags.ortho.unit = "";
  tags.ortho.description =
      "Orthophoto: each cell from the steepest image that sees it and is not outvoted";
  tags.ortho.type = type_for(scene);
  if (tags.ortho.type != rpc::CellType::float32)
    tags.ortho.nodata = 0;  // which most programs take for nothing anyway
  for (rpc::GeoTags* t : {&tags.confidence, &tags.sigma, &tags.views, &tags.ortho})
    *t = with_inputs(*t, scene);
  return tags;
}

void keep_off_nodata(Tensor& picture, const rpc::GeoTags& tags) {
  if (tags.type == rpc::CellType::float32) return;
  for (float& v : picture.values()) v = std::max(v, 1.0F);  // the darkest pixels become 1
}

void write_rasters(const fs::path& folder, const reconstruct::Reconstruction& made,
                   const scene::Scene& scene, const reconstruct::Visibility& visibility,
                   rpc::HeightDatum datum) {
  const rpc::LocalFrame& frame = scene.frame;
  const SurfaceTags tags = surface_tags(scene, datum);
  Tensor heights = made.dsm.z.clone();
  if (datum != rpc::HeightDatum::ellipsoid)
    rpc::refer_to_geoid(heights, geo_grid(made.dsm, frame), datum);
  const auto raster = [&](const char* name, const Tensor& values, double offset,
                          const rpc::GeoTags& of) {
    if (!values.empty()) write_field(folder / name, values, made.dsm, frame, offset, of);
  };
  // Each is packed by one thread; the longest comes first.
  const std::array<std::function<void()>, 4> files{
      [&] { raster("dsm.tif", heights, frame.h0, tags.heights); },
      [&] { raster("confidence.tif", made.confidence, 0, tags.confidence); },
      [&] { raster("height_sigma.tif", made.sigma, 0, tags.sigma); },
      [&] { raster("views.tif", visibility.views, 0, tags.views); }};
  for_each_index(static_cast<Index>(files.size()),
                 [&](Index i) { files[static_cast<std::size_t>(i)](); });
}

std::future<void> write_surfels(const fs::path& file, const reconstruct::Reconstruction& made,
                                const rpc::LocalFrame& frame, Index most_surfels) {
  return beside([&made, file, comments = frame_comments(frame), most_surfels] {
    const OnOneThread alone;
    const splat::Surfels laid = reconstruct::delivered_surfels(made);
    splat::write_ply(file, most_surfels > 0 ? splat::thinned(laid, most_surfels) : laid, comments);
  });
}

void write_ortho(const fs::path& file, const reconstruct::Reconstruction& made,
                 const scene::Scene& scene, const reconstruct::Visibility& visibility,
                 const std::vector<fs::path>& image_dirs) {
  const bool colour =
      std::ranges::any_of(scene.views, [](const scene::View& v) { return v.bands >= 3; });
  Tensor picture = reconstruct::orthophoto(made.dsm, made.images, visibility, [&](Index i) {
    const scene::View& view = scene.views[static_cast<std::size_t>(i)];
    return chosen_channels(rpc::open_view(view.file, image_dirs), view.colours, colour);
  });
  if (picture.empty())
    throw Error("ortho: no image sees a cell of the surface, expected images of it");
  const rpc::GeoTags tags = surface_tags(scene, rpc::HeightDatum::ellipsoid).ortho;
  keep_off_nodata(picture, tags);
  write_field(file, picture, made.dsm, scene.frame, 0, tags);
}

std::array<Index, 2> bring_into(const rpc::ProjectedCrs& crs, const fs::path& folder,
                                const rpc::GeoGrid& grid, Index height, Index width,
                                const std::function<void(double)>& progress) {
  using rpc::Resampling;
  const rpc::ProjectedGrid to = rpc::covering_grid(grid, height, width, crs);
  constexpr std::array<std::pair<const char*, Resampling>, 5> kRasters{
      {{"dsm.tif", Resampling::bilinear},
       {"confidence.tif", Resampling::bilinear},
       {"height_sigma.tif", Resampling::bilinear},
       {"ortho.tif", Resampling::bilinear},
       {"views.tif", Resampling::nearest}}};
  double done = 0;
  for (const auto& [name, how] : kRasters) {
    const auto share = [&](double part) {
      progress((done + part) / static_cast<double>(kRasters.size()));
    };
    if (is_file(folder / name)) rpc::warp_raster(folder / name, to, how, share);
    done += 1;
  }
  return {to.height, to.width};
}

}  // namespace satsurf::app
