// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/nearest.h"

#include <doctest/doctest.h>

using namespace satsurf;

TEST_CASE("edit_distance") {
  CHECK(edit_distance("", "abc") == 3);
  CHECK(edit_distance("kitten", "sitting") == 3);
  CHECK(edit_distance("same", "same") == 0);
}

TEST_CASE("nearest names what was meant, and nothing where that is a guess") {
  const std::vector<std::string> known{"steps", "model.base", "height_range"};
  CHECK(nearest("stepz", known) == "steps");
  CHECK(nearest("base", known) == "model.base");
  CHECK(nearest("heigth_range", known) == "height_range");
  CHECK(nearest("colour", known) == std::nullopt);
  CHECK(nearest("steps", {}) == std::nullopt);
}
