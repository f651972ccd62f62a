// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/evaluate_options.h"
#include "satsurf/app/legend.h"
#include "satsurf/app/log.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/preview.h"
#include "satsurf/app/products.h"
#include "satsurf/app/record.h"
#include "satsurf/app/scores_json.h"
#include "satsurf/core/error.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/evaluate/evaluate.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/rpc/read.h"

#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

void print_scores(const char* title, const evaluate::HeightScores& s) {
  std::printf("%-11s MAE %7.3f m  RMSE %7.3f m  median %+8.3f m  NMAD %7.3f m\n", title, s.mae,
              s.rmse, s.median, s.nmad);
  std::printf(
      "%-11s below 1 m %5.1f %%  below 2.5 m %5.1f %%  below 7.5 m %5.1f %%  of all true cells\n",
      "", 100 * s.pag1, 100 * s.pag2_5, 100 * s.pag7_5);
  std::printf(
      "%-11s below 1 m %5.1f %%  below 2.5 m %5.1f %%  below 7.5 m %5.1f %%  of the cells found\n",
      "", 100 * s.pag1_compared, 100 * s.pag2_5_compared, 100 * s.pag7_5_compared);
}

/// A median far larger than the spread is seldom an error of the surface.
void warn_of_datum(const evaluate::HeightScores& s) {
  // geoid heights are up to 107 m, biases of a reconstruction a few
  constexpr double kSuspicious = 8;
  if (std::abs(s.median) <= kSuspicious || s.nmad >= std::abs(s.median) / 3) return;
  log_line(LogLevel::warning,
           fmt::format("the heights differ by {:.1f} m nearly everywhere; is one of them above the "
                       "geoid?",
                       s.median));
}

/// The true cells that count; empty for all.
/// cameras  of the images of --seen-by
Tensor mask_of(const EvaluateDsmConfig& options, const evaluate::DsmPair& pair,
               const std::vector<evaluate::ImageCamera>& cameras) {
  Tensor mask;
  if (options.mask_water) {
    if (options.classes.empty())
      throw ConfigError("--mask-water: no --classes, expected the class raster as well");
    const rpc::GeoRaster classes = rpc::read_geo_raster(options.classes);
    if (classes.values.shape() != pair.truth.z.shape())
      throw IoError(options.classes.string() + ": shape " + classes.values.shape().str() +
                    ", expected the truth's " + pair.truth.z.shape().str());
    mask = evaluate::not_water(classes.values);
  }
  if (cameras.empty()) return mask;
  if (!pair.frame)
    throw IoError(options.dsm.string() + " and " + options.truth.string() +
                  ": no coordinate system, expected a UTM zone to place the images of --seen-by");
  Tensor seen = evaluate::seen_by_two(pair.truth, *pair.frame, cameras);
  for (Index i = 0; i < mask.count(); ++i) seen[i] *= mask[i];
  return seen;
}

}  // namespace

void run_evaluate_dsm(const EvaluateDsmCommand& options, const EvaluateOutput& output) {
  const evaluate::Registration registration = options.registration;
  std::vector<fs::path> inputs{options.dsm, options.truth};
  if (!options.classes.empty()) inputs.push_back(options.classes);
  std::vector<evaluate::ImageCamera> cameras;
  for (const fs::path& file : options.seen_by) {
    const rpc::RasterInfo info = rpc::view_info(file, options.image_dirs);
    cameras.push_back({*info.rpc, info.width, info.height});
    inputs.insert(inputs.end(), info.files.begin(), info.files.end());
  }
  if (!options.error_map.empty())
    for (const fs::path& file : map_files(options.error_map))
      check_output_file("--error-map", file, output.overwrite, inputs);
  check_output_file("--json", output.json, output.overwrite, inputs);
  check_distinct({options.error_map, output.json});
  const evaluate::DsmPair pair = evaluate::load_dsm_pair(options.dsm, options.truth);
  const Tensor mask = mask_of(options, pair, cameras);
  evaluate::DsmComparison c;
  try {
    c = evaluate::compare_dsm(pair.prediction, pair.truth, registration, mask);
  } catch (const Error& e) {
    throw Error(options.dsm.string() + " and " + options.truth.string() + ": " + e.what());
  }
  if (!options.error_map.empty()) {
    const ColourScale scale = error_scale();
    const scene::HeightField& truth = pair.truth;
    write_map(options.error_map, error_picture(c.error), &scale,
              pair.frame ? geo_grid(truth, *pair.frame)
                         : rpc::GeoGrid{0, truth.x0, truth.y0, truth.step});
  }
  if (!output.json.empty()) {
    RunRecord record("evaluate", to_json<EvaluateDsmConfig>(options), 0);
    for (const fs::path& file : inputs) record.add_input(file);
    record.results() = scores_json(c);
    record.save(output.json);
  }
  std::printf("%td of %td true cells have a predicted height (completeness %.1f %%)\n",
              c.raw.compared, c.raw.truth, 100 * c.raw.completeness);
  print_scores("raw", c.raw);
  if (registration != evaluate::Registration::none) {
    std::printf("registered by east %+.2f m, north %+.2f m, up %+.3f m\n", c.shift[0], c.shift[1],
                c.shift[2]);
    print_scores("registered", c.registered);
  }
  warn_of_datum(c.raw);
}

}  // namespace satsurf::app
