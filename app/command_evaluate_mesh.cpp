// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/evaluate_options.h"
#include "satsurf/app/interrupt.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/products.h"
#include "satsurf/app/record.h"
#include "satsurf/app/scores_json.h"
#include "satsurf/core/atomic_file.h"
#include "satsurf/core/error.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/evaluate/evaluate.h"
#include "satsurf/mesh/compare.h"
#include "satsurf/mesh/ply.h"

#include <algorithm>
#include <cstdio>
#include <optional>

#include <nlohmann/json.hpp>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

/// The frame a mesh names; none if it names none at all.
std::optional<rpc::LocalFrame> frame_of(const mesh::PlyContent& content, const fs::path& file) {
  const bool names_one =
      std::any_of(content.comments.begin(), content.comments.end(), [](const std::string& line) {
        return line.starts_with("crs ") || line.starts_with("origin ");
      });
  if (!names_one) return std::nullopt;
  return frame_from_comments(content.comments, file.string());
}

/// Moves `mesh` from one frame's origin to another's.
void shift(mesh::Mesh& mesh, const rpc::LocalFrame& from, const rpc::LocalFrame& to) {
  const double by[3] = {from.easting0 - to.easting0, from.northing0 - to.northing0,
                        from.h0 - to.h0};
  for (auto& v : mesh.vertices)
    for (std::size_t a = 0; a < 3; ++a)
      v[a] = static_cast<float>(static_cast<double>(v[a]) + by[a]);
}

void print_scores(const char* title, const mesh::SurfaceScores& s) {
  std::printf("%-14s chamfer %7.3f m  mesh to reference %7.3f m  reference to mesh %7.3f m\n",
              title, s.chamfer, s.to_reference, s.to_mesh);
  for (const mesh::FScore& f : s.f)
    std::printf("%-14s within %3.1f m  F1 %.3f  precision %.3f  recall %.3f\n", "", f.threshold,
                f.f1, f.precision, f.recall);
}

}  // namespace

void run_evaluate_mesh(const EvaluateMeshConfig& options, const EvaluateOutput& output) {
  const std::vector<fs::path> inputs{options.mesh, options.reference_mesh};
  check_output_file("--json", output.json, output.overwrite, inputs);
  RunRecord record("evaluate", recorded_config(options), 0);
  std::optional<EndsAtSignal> stops(std::in_place);
  const mesh::PlyContent content = mesh::read_ply(options.mesh);
  mesh::PlyContent reference = mesh::read_ply(options.reference_mesh);
  const auto frame = frame_of(content, options.mesh),
             other = frame_of(reference, options.reference_mesh);
  const auto system = [](const std::optional<rpc::LocalFrame>& f) {
    return f ? "EPSG:" + std::to_string(f->zone.epsg()) : std::string("no system");
  };
  if (system(frame) != system(other))
    throw IoError(options.mesh.string() + " and " + options.reference_mesh.string() + ": " +
                  system(frame) + " and " + system(other) + ", expected one system");
  if (frame) shift(reference.mesh, *other, *frame);
  mesh::MeshComparison c;
  try {
    c = mesh::compare_meshes(content.mesh, reference.mesh);
  } catch (const Error& e) {
    throw Error(options.mesh.string() + " and " + options.reference_mesh.string() + ": " +
                e.what());
  }
  stops.reset();
  if (!output.json.empty()) {
    for (const fs::path& file : inputs) record.add_input(file);
    nlohmann::ordered_json j = scores_json(c);
    nlohmann::ordered_json run = record.json();
    run.erase("results");  // they are at the top
    j.update(run);
    atomic_write(output.json,
                 j.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + '\n');
  }
  std::printf("%zu and %zu faces, %td and %td samples\n", content.mesh.faces.size(),
              reference.mesh.faces.size(), c.all.mesh_samples, c.all.reference_samples);
  print_scores("surfaces", c.all);
  print_scores("without walls", c.without_walls);
}

}  // namespace satsurf::app
