// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/evaluate_options.h"
#include "satsurf/app/interrupt.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/record.h"
#include "satsurf/core/atomic_file.h"
#include "satsurf/core/error.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/core/memory.h"
#include "satsurf/evaluate/image_metrics.h"
#include "satsurf/nn/lpips.h"
#include "satsurf/rpc/picture.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <optional>

#include <nlohmann/json.hpp>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

std::string size_of(const Tensor& picture) {
  return std::to_string(picture.dim(2)) + " x " + std::to_string(picture.dim(1)) + " px";
}

/// [H W], 1 where a pixel counts: where any channel of the mask is above 0. Empty for all.
Tensor read_mask(const EvaluateImageConfig& options, const Tensor& image) {
  if (options.mask.empty()) return {};
  const Tensor picture = rpc::read_picture(options.mask);
  if (picture.dim(1) != image.dim(1) || picture.dim(2) != image.dim(2))
    throw IoError(options.mask.string() + ": " + size_of(picture) + ", expected " + size_of(image) +
                  " as " + options.image.string());
  Tensor mask({picture.dim(1), picture.dim(2)});
  bool any = false;
  for (Index i = 0; i < picture.count(); ++i)
    if (picture[i] > 0) mask[i % mask.count()] = 1, any = true;
  if (!any) throw IoError(options.mask.string() + ": 0 everywhere, expected a pixel that counts");
  return mask;
}

/// throws IoError for a NaN or an infinity where a pixel counts
void check_finite(const fs::path& file, const Tensor& picture, const Tensor& mask) {
  const Index W = picture.dim(2), P = picture.dim(1) * W;
  for (Index i = 0; i < picture.count(); ++i)
    if (!std::isfinite(picture[i]) && (mask.empty() || mask[i % P] != 0))
      throw IoError(file.string() + ": " + std::to_string(picture[i]) + " in column " +
                    std::to_string(i % P % W) + ", row " + std::to_string(i % P / W) +
                    ", expected finite numbers; --mask leaves pixels out");
}

void print(const char* name, double value, const char* note) {
  std::printf("%-10s %10.5f%s\n", name, value, note);
}
/// For a number that does not exist.
void print_none(const char* name, const char* instead, const char* why) {
  std::printf("%-10s %10s    %s\n", name, instead, why);
}

}  // namespace

void run_evaluate_image(const EvaluateImageConfig& options, const EvaluateOutput& output) {
  std::vector<fs::path> inputs{options.image, options.reference};
  if (!options.mask.empty()) inputs.push_back(options.mask);
  if (!options.lpips_weights.empty()) inputs.push_back(options.lpips_weights);
  check_output_file("--json", output.json, output.overwrite, inputs);
  RunRecord record("evaluate", recorded_config(options), 0);

  std::optional<EndsAtSignal> stops(std::in_place);
  const Tensor image = rpc::read_picture(options.image),
               reference = rpc::read_picture(options.reference);
  if (image.shape() != reference.shape())
    throw IoError(options.image.string() + " and " + options.reference.string() + ": " +
                  size_of(image) + (image.dim(0) == 1 ? " grey" : " in colour") + " and " +
                  size_of(reference) + (reference.dim(0) == 1 ? " grey" : " in colour") +
                  ", expected pictures of one size and kind");
  const Tensor mask = read_mask(options, image);
  check_finite(options.image, image, mask);
  check_finite(options.reference, reference, mask);
  std::optional<nn::Lpips> lpips;
  if (!options.lpips_weights.empty()) {
    lpips.emplace(nn::Lpips::load(options.lpips_weights));
    if (std::min(image.dim(1), image.dim(2)) < lpips->smallest_side())
      throw IoError(options.image.string() + ": " + size_of(image) + ", expected at least " +
                    std::to_string(lpips->smallest_side()) + " px a side for LPIPS (" +
                    nn::lpips_backbone_name(lpips->backbone()) + ")");
  }
  // Beside both pictures: one with the colours fitted, the mask as double, two in colour for LPIPS.
  const double pixels = static_cast<double>(image.dim(1)) * static_cast<double>(image.dim(2));
  check_memory(
      options.image.string() + ": comparing " + size_of(image) + " needs",
      pixels * (4 * static_cast<double>(image.dim(0)) + (mask.empty() ? 0 : 8) + (lpips ? 24 : 0)),
      "cut it");
  const evaluate::ImageScores s =
      evaluate::score_images(image, reference, mask, lpips ? &*lpips : nullptr);
  stops.reset();

  if (!output.json.empty()) {
    for (const fs::path& file : inputs) record.add_input(file);
    nlohmann::ordered_json j{{"psnr", json_number(s.psnr)},
                             {"psnr_infinite", std::isinf(s.psnr)},
                             {"psnr_fitted", json_number(s.psnr_fitted)},
                             {"ssim", json_number(s.ssim)},
                             {"ssim_conv", json_number(s.ssim_conv)},
                             {"lpips", s.lpips ? json_number(*s.lpips) : nullptr},
                             {"lpips_backbone", nullptr}};
    if (s.lpips) j["lpips_backbone"] = s.lpips_backbone;
    nlohmann::ordered_json run = record.json();
    run.erase("results");  // they are at the top
    j.update(run);
    atomic_write(output.json,
                 j.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + '\n');
  }

  std::printf("%s against %s, %s\n", options.image.c_str(), options.reference.c_str(),
              size_of(image).c_str());
  if (std::isinf(s.psnr))
    print_none("PSNR", "infinite", "no pixel differs");
  else
    print("PSNR", s.psnr, " dB");
  if (std::isfinite(s.psnr_fitted)) print("PSNR fitted", s.psnr_fitted, " dB, colours matched");
  if (std::isnan(s.ssim))
    print_none("SSIM", "-", "no pixel counts 5 px or more off the borders");
  else
    print("SSIM", s.ssim, "");
  print("SSIM conv", s.ssim_conv, "");
  if (s.lpips)
    print("LPIPS", *s.lpips, (" " + s.lpips_backbone).c_str());
  else
    print_none("LPIPS", "-", "no --lpips-weights given");
}

}  // namespace satsurf::app
