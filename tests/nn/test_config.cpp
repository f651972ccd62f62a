// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/nn/config.h"

#include <doctest/doctest.h>

using namespace satsurf;
using nn::model_preset;
using nn::ModelConfig;

TEST_CASE("the defaults are the documented ones") {
  const ModelConfig c;
  CHECK(model_preset("base8") == c);
  CHECK(c.base == 8);
  CHECK(c.hypotheses == std::array<Index, 3>{64, 32, 8});
  CHECK(c.variance_includes_reference);
  CHECK(c.context == "reference");
  CHECK(c.rotation == "camera+residual");
  CHECK(c.mono == "own");
  CHECK(c.fusion == "cmmf");
  CHECK(c.fusion_start == "additive");
  CHECK(c.fusion_lambda == 1);
  CHECK(c.fusion_tau == 0.2);
  CHECK(c.guidance == "csrg");
  CHECK(c.guidance_norm == "robust");
  CHECK(c.keep == "last");
  CHECK(c.confidence == "joint");
}

TEST_CASE("presets differ from base8 in what they say and in nothing else") {
  ModelConfig paper;
  paper.context = "none";
  paper.rotation = "camera";
  paper.fusion_start = "paper";
  paper.confidence = "raw";
  CHECK(model_preset("paper") == paper);

  ModelConfig cascade;
  cascade.mono = cascade.fusion = cascade.guidance = cascade.context = "none";
  CHECK(model_preset("cascade8") == cascade);

  ModelConfig mvsplat = cascade;
  mvsplat.hypotheses = {128, 0, 0};
  CHECK(model_preset("mvsplat_like") == mvsplat);

  ModelConfig hisplat = cascade;
  hisplat.keep = "all";
  hisplat.guidance = "photometric";
  CHECK(model_preset("hisplat_like") == hisplat);

  ModelConfig skysplat = cascade;
  skysplat.mono = "own";
  skysplat.hypotheses = {64, 0, 0};
  skysplat.rotation = "camera";
  CHECK(model_preset("skysplat_like") == skysplat);

  ModelConfig wide;
  wide.base = wide.volume_base = 16;
  wide.head_width = {96, 64, 48};
  CHECK(model_preset("base16") == wide);

  ModelConfig tiny = model_preset("tiny_full");
  tiny.mono = tiny.fusion = tiny.guidance = tiny.context = "none";
  CHECK(model_preset("tiny") == tiny);
  CHECK_THROWS_AS(model_preset("base9"), ConfigError);
}
