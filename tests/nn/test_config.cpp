// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/nn/config.h"

#include <string>
#include <vector>

#include <doctest/doctest.h>

using namespace satsurf;
using nn::model_preset;
using nn::ModelConfig;

namespace {

ModelConfig matching_alone(ModelConfig c) {
  c.mono = nn::MonoBranch::none;
  c.fusion = nn::Fusion::none;
  c.guidance = nn::Guidance::none;
  c.context = nn::Context::none;
  return c;
}

}  // namespace

TEST_CASE("the defaults are the documented ones") {
  const ModelConfig c;
  CHECK(model_preset("base8") == c);
  CHECK(c.base == 8);
  CHECK(c.hypotheses == std::array<Index, 3>{64, 32, 8});
  CHECK(c.most_hypotheses == 256);
  CHECK(c.first_interval_px == 0.35);
  CHECK(c.variance_includes_reference);
  CHECK(c.context == nn::Context::reference);
  CHECK(c.rotation == nn::Rotation::residual);
  CHECK(c.mono == nn::MonoBranch::own);
  CHECK(c.fusion == nn::Fusion::cmmf);
  CHECK(c.fusion_start == nn::FusionStart::additive);
  CHECK(c.fusion_lambda == 1);
  CHECK(c.fusion_tau == 0.2);
  CHECK(c.guidance == nn::Guidance::csrg);
  CHECK(c.guidance_norm == nn::GuidanceNorm::robust);
  CHECK(c.keep == nn::Keep::last);
  CHECK(c.confidence == nn::Confidence::joint);
}

TEST_CASE("presets differ from base8 in what they say and in nothing else") {
  ModelConfig paper;
  paper.most_hypotheses = 64;
  paper.context = nn::Context::none;
  paper.rotation = nn::Rotation::camera;
  paper.fusion_start = nn::FusionStart::paper;
  paper.confidence = nn::Confidence::raw;
  CHECK(model_preset("paper") == paper);

  const ModelConfig cascade = matching_alone({});
  CHECK(model_preset("cascade8") == cascade);

  ModelConfig mvsplat = cascade;
  mvsplat.hypotheses = {128, 0, 0}, mvsplat.most_hypotheses = 128;
  CHECK(model_preset("mvsplat_like") == mvsplat);

  ModelConfig hisplat = cascade;
  hisplat.keep = nn::Keep::all, hisplat.most_hypotheses = 64;
  hisplat.guidance = nn::Guidance::photometric;
  CHECK(model_preset("hisplat_like") == hisplat);

  ModelConfig skysplat = cascade;
  skysplat.mono = nn::MonoBranch::own;
  skysplat.hypotheses = {64, 0, 0}, skysplat.most_hypotheses = 64;
  skysplat.rotation = nn::Rotation::camera;
  CHECK(model_preset("skysplat_like") == skysplat);

  ModelConfig wide;
  wide.base = wide.volume_base = 16;
  wide.head_width = {96, 64, 48};
  CHECK(model_preset("base16") == wide);

  ModelConfig around = model_preset("base8");
  around.best_pair = around.local_contrast = true;
  around.feature_levels = 2;
  around.height = nn::HeightOf::mode;
  around.centre = nn::Centre::nearest;
  CHECK(model_preset("wide8") == around);

  CHECK(model_preset("tiny") == matching_alone(model_preset("tiny_full")));
  CHECK_THROWS_AS(model_preset("base9"), ConfigError);
}

TEST_CASE("choices are spelled as weights files have them, and presets are listed once") {
  ModelConfig config;
  std::string ranges;
  for (const FieldInfo& row : describe(config))
    if (row.type == "text") ranges += row.name + " " + row.value + ": " + row.range + "\n";
  CHECK(ranges ==
        "height mean: mean | mode\n"
        "centre bilinear: bilinear | nearest\n"
        "context reference: none | reference\n"
        "rotation camera+residual: camera | camera+residual | gradient\n"
        "mono own: none | own\n"
        "fusion cmmf: none | naive | cmmf\n"
        "fusion_start additive: paper | gated | additive\n"
        "guidance csrg: none | csrg | photometric\n"
        "guidance_norm robust: robust | interval\n"
        "keep last: last | all\n"
        "confidence joint: raw | floor | joint\n");
  set_field(config, "rotation", "camera");
  CHECK(config.rotation == nn::Rotation::camera);

  const std::vector<std::string> names{"tiny",         "tiny_full",    "base8", "base16",
                                       "wide8",        "cascade8",     "paper", "mvsplat_like",
                                       "hisplat_like", "skysplat_like"};
  CHECK(nn::model_preset_names() == names);
  for (const std::string& name : names) CHECK_NOTHROW(model_preset(name));
}
