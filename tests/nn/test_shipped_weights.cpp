// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/nn/shipped_weights.h"
#include "satsurf/nn/weights_file.h"

#include <cstdlib>

#include "tests/paths.h"
#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::nn;
using namespace satsurf::test;

TEST_CASE("the shipped weights are found among the sources and are the networks they say") {
  ::unsetenv("SATSURF_WEIGHTS");
  const auto shipped = tests_folder().parent_path() / "nn/weights";
  REQUIRE(std::filesystem::equivalent(shipped_weights().parent_path(), shipped));
  CHECK(load_model(shipped_weights()).config().mono == MonoBranch::own);
  CHECK(load_mono(shipped_weights(ShippedNetwork::mono)).config() == MonoConfig{});
}

TEST_CASE("SATSURF_WEIGHTS names the cascade's weights alone") {
  ::setenv("SATSURF_WEIGHTS", "own.safetensors", 1);
  CHECK(shipped_weights() == "own.safetensors");
  CHECK(shipped_weights(ShippedNetwork::mono).filename() == "mono12.safetensors");
  ::setenv("SATSURF_WEIGHTS", "", 1);
  CHECK(shipped_weights().filename() == "wide8.safetensors");
  ::unsetenv("SATSURF_WEIGHTS");
}
