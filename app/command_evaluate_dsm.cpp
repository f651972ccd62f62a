// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/evaluate_options.h"
#include "satsurf/app/interrupt.h"
#include "satsurf/app/legend.h"
#include "satsurf/app/log.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/preview.h"
#include "satsurf/app/products.h"
#include "satsurf/app/record.h"
#include "satsurf/app/scores_json.h"
#include "satsurf/core/error.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/core/memory.h"
#include "satsurf/evaluate/evaluate.h"
#include "satsurf/rpc/geoid.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/rpc/read.h"

#include <cmath>
#include <cstdio>
#include <optional>
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

/// How high the geoid lies above the ellipsoid in the middle of the truth, m; none where it is not
/// known where that is, or no grid of the geoid is there.
std::optional<double> geoid_height_at(const evaluate::DsmPair& pair) {
  if (!pair.frame) return std::nullopt;
  const scene::HeightField& truth = pair.truth;
  const double half = truth.step / 2;
  const rpc::Geodetic middle =
      pair.frame->geodetic_from_local({truth.x0 + half * static_cast<double>(truth.z.dim(1)),
                                       truth.y0 - half * static_cast<double>(truth.z.dim(0)), 0});
  try {
    return rpc::geoid_heights(rpc::HeightDatum::egm96, {{{middle.lon, middle.lat}}}).front();
  } catch (const Error&) {
    return std::nullopt;
  }
}

/// A median far larger than the spread is seldom an error of the surface.
void warn_of_datum(const evaluate::HeightScores& s, const evaluate::DsmPair& pair) {
  constexpr double kSuspicious = 8;  // m; biases of a reconstruction are a few
  if (std::abs(s.median) <= kSuspicious || s.nmad >= std::abs(s.median) / 3) return;
  const std::optional<double> geoid_height = geoid_height_at(pair);
  std::string text = fmt::format("the heights differ by {:.1f} m nearly everywhere", s.median);
  if (evaluate::like_geoid(s.median, geoid_height)) text += "; is one of them above the geoid?";
  if (geoid_height)
    text += fmt::format(" (the geoid lies {:.1f} m {} the ellipsoid here)", std::abs(*geoid_height),
                        *geoid_height < 0 ? "below" : "above");
  log_line(LogLevel::warning, text);
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
    rpc::require_same_grid(options.classes, classes, options.truth,
                           {pair.truth.z, pair.geo_grid(pair.truth), {}});
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

/// throws  Error where the memory does not hold what a comparison needs beside both surfaces
void check_comparable(const EvaluateDsmCommand& options, const evaluate::DsmPair& pair) {
  // Of a true cell: the predicted height there, also where a shift moves it, its error (as double
  // while it is ranked), whether it counts, and a picture of the errors.
  constexpr double kBytes = 4 + 4 + 8 + 8, kPictureBytes = 12;
  const Tensor& truth = pair.truth.z;
  check_memory(options.dsm.string() + " and " + options.truth.string() + ": comparing " +
                   std::to_string(truth.dim(1)) + " x " + std::to_string(truth.dim(0)) +
                   " cells needs",
               (kBytes + (options.error_map.empty() ? 0 : kPictureBytes)) *
                   static_cast<double>(truth.count()),
               "cut out a part (gdal_translate -projwin)");
}

}  // namespace

void run_evaluate_dsm(const EvaluateDsmCommand& options, const EvaluateOutput& output) {
  if (!options.error_map.empty() && options.error_map.extension() != ".png")
    throw ConfigError("--error-map: " + options.error_map.string() +
                      ", expected a name ending in .png");
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
  evaluate::DsmPair pair;
  evaluate::DsmComparison c;
  {
    const EndsAtSignal stops;
    pair = evaluate::load_dsm_pair(options.dsm, options.truth);
    check_comparable(options, pair);
    const Tensor mask = mask_of(options, pair, cameras);
    try {
      c = evaluate::compare_dsm(pair.prediction, pair.truth, registration, mask);
    } catch (const Error& e) {
      throw Error(options.dsm.string() + " and " + options.truth.string() + ": " + e.what());
    }
  }
  if (!options.error_map.empty()) {
    const ColourScale scale = error_scale();
    write_map(options.error_map, error_picture(c.error), &scale, pair.geo_grid(pair.truth));
  }
  if (!output.json.empty()) {
    RunRecord record("evaluate", recorded_config<EvaluateDsmConfig>(options), 0);
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
    if (c.refused_shift)
      std::printf(
          "a shift by east %+.2f m, north %+.2f m correlates best, but leaves no smaller "
          "errors: not taken\n",
          (*c.refused_shift)[0], (*c.refused_shift)[1]);
    print_scores("registered", c.registered);
  }
  warn_of_datum(c.raw, pair);
}

}  // namespace satsurf::app
