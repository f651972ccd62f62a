// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/output_folder.h"
#include "satsurf/app/products.h"
#include "satsurf/app/program.h"
#include "satsurf/core/error.h"
#include "satsurf/mesh/glb.h"
#include "satsurf/mesh/ply.h"
#include "satsurf/mesh/simplify.h"
#include "satsurf/rpc/raster.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <fmt/format.h>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

struct ExportOptions {
  fs::path mesh, dsm, ortho, to;
  Index max_faces = 0;
  bool overwrite = false;

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("mesh", s.mesh, Field{.help = "mesh.ply of a reconstruction"});
    v("dsm", s.dsm, Field{.help = "raster of heights, instead of a mesh"});
    v("ortho", s.ortho, Field{.help = "raster of colours on the grid of --dsm"});
    v("to", s.to, Field{.help = "file to write, .glb (required)"});
    v("max_faces", s.max_faces,
      Field{.help = "most triangles that the file may have; vertices near each other become one",
            .min = 1,
            .automatic = "all",
            .flag = "--max-faces"});
    v("overwrite", s.overwrite,
      Field{.help = "replace the file if it exists", .flag = "--overwrite"});
  }
};

/// Bands of a raster as colours: bytes by 255, others from their 1st to their 99th percentile.
Tensor colours_of(const rpc::GeoRaster& raster) {
  const Tensor& values = raster.values;
  const bool one = values.rank() == 2;
  const Index bands = one ? 1 : values.dim(0), H = values.dim(one ? 0 : 1),
              W = values.dim(one ? 1 : 2), P = H * W;
  std::vector<float> known;
  for (const float v : values.values())
    if (std::isfinite(v)) known.push_back(v);
  float low = 0, high = 255;
  if (!known.empty() && *std::ranges::max_element(known) > 255) {
    const auto at = [&](double share) {
      const auto nth = known.begin() +
                       static_cast<std::ptrdiff_t>(share * static_cast<double>(known.size() - 1));
      std::nth_element(known.begin(), nth, known.end());
      return *nth;
    };
    low = at(0.01), high = std::max(at(0.99), low + 1);
  }
  Tensor out({3, H, W});
  for (Index c = 0; c < 3; ++c)
    for (Index i = 0; i < P; ++i)
      out[c * P + i] = (values[(bands >= 3 ? c : 0) * P + i] - low) / (high - low);
  return out;
}

/// What is known of the frame, for whoever wants to place the file on the ground.
std::map<std::string, std::string> frame_extras(const rpc::LocalFrame& frame) {
  return {{"crs", "EPSG:" + std::to_string(frame.zone.epsg())},
          {"origin_easting_northing_height",
           fmt::format("{:.17g} {:.17g} {:.17g}", frame.easting0, frame.northing0, frame.h0)},
          {"axes", "x east, y up, -z north, m from the origin; heights above the WGS84 ellipsoid"}};
}

/// A raster of heights around an origin of its own, so that floats suffice.
mesh::Mesh mesh_of_dsm(const ExportOptions& options, std::map<std::string, std::string>& extras) {
  const rpc::GeoRaster dsm = rpc::read_geo_raster(options.dsm);
  if (dsm.values.rank() != 2)
    throw IoError(options.dsm.string() + ": " + std::to_string(dsm.values.dim(0)) +
                  " bands, expected one of heights");
  Tensor colour;
  if (!options.ortho.empty()) {
    const rpc::GeoRaster ortho = rpc::read_geo_raster(options.ortho);
    colour = colours_of(ortho);
    if (colour.dim(1) != dsm.values.dim(0) || colour.dim(2) != dsm.values.dim(1) ||
        ortho.grid != dsm.grid)
      throw IoError(options.ortho.string() + ": another grid, expected that of " +
                    options.dsm.string());
  }
  const Index H = dsm.values.dim(0), W = dsm.values.dim(1);
  double low = INFINITY;
  for (const float v : dsm.values.values())
    if (std::isfinite(v)) low = std::min(low, static_cast<double>(v));
  const double base = std::isfinite(low) ? std::floor(low) : 0;
  const double width = dsm.grid.step * static_cast<double>(W),
               height = dsm.grid.step * static_cast<double>(H);
  Tensor z = dsm.values.clone();
  for (float& v : z.values()) v -= static_cast<float>(base);
  extras = {{"crs", dsm.grid.epsg == 0 ? "unknown" : "EPSG:" + std::to_string(dsm.grid.epsg)},
            {"origin_easting_northing_height",
             fmt::format("{:.17g} {:.17g} {:.17g}", dsm.grid.x0 + width / 2,
                         dsm.grid.y0 - height / 2, base)},
            {"axes", "x east, y up, -z north, m from the origin"}};
  try {
    return mesh::mesh_from_heights(z, -width / 2, height / 2, dsm.grid.step, colour);
  } catch (const Error& e) {
    throw IoError(options.dsm.string() + ": " + e.what());
  }
}

mesh::Mesh mesh_of(const ExportOptions& options, std::map<std::string, std::string>& extras) {
  if (!options.dsm.empty()) return mesh_of_dsm(options, extras);
  mesh::PlyContent content = mesh::read_ply(options.mesh);
  extras = frame_extras(frame_from_comments(content.comments, options.mesh.string()));
  return std::move(content.mesh);
}

void run_export(const ExportOptions& options) {
  if (options.to.extension() != ".glb")
    throw ConfigError("--to: " + options.to.string() + ", expected a name ending in .glb");
  check_output_file("--to", options.to, options.overwrite,
                    {options.mesh, options.dsm, options.ortho});
  std::map<std::string, std::string> extras;
  mesh::Mesh surface = mesh_of(options, extras);
  const std::size_t before = surface.faces.size();
  if (options.max_faces > 0) surface = mesh::simplified(surface, options.max_faces);
  mesh::write_glb(options.to, surface, extras);
  std::printf("%zu of %zu faces, %zu vertices\n", surface.faces.size(), before,
              surface.vertices.size());
}

}  // namespace

void add_export(Program& program) {
  Command& command = program.add("export", "a surface for browsers and 3D programs: binary glTF");
  command.files = {{"--to *.glb",
                    "triangles with normals and colours, y up; asset.extras names the reference "
                    "system and the origin"}};
  const auto options = std::make_shared<ExportOptions>();
  Flags& flags = command.flags;
  flags.add(collect_fields(*options));
  CLI::App& app = flags.command();
  app.get_option("--mesh")->excludes(app.get_option("--dsm"));
  app.get_option("--ortho")->needs(app.get_option("--dsm"));
  program.when_called(command, [&flags, options]() -> std::function<void()> {
    flags.read(collect_fields(*options));
    if (options->mesh.empty() && options->dsm.empty()) throw CLI::RequiredError("--mesh or --dsm");
    Flags::require("--to", options->to);
    return [options] { run_export(*options); };
  });
}

}  // namespace satsurf::app
