// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/whole.h"

#include <limits>

#include <doctest/doctest.h>

using namespace satsurf;

TEST_CASE("floored: every number has a whole one, and those that no Index holds are far off") {
  CHECK(floored(2.9) == 2);
  CHECK(floored(-0.1) == -1);
  CHECK(floored(-3.0) == -3);
  CHECK(floored(1e15) == Index{1000000000000000});
  constexpr Index kMost = Index{1} << 53;
  CHECK(floored(1e300) == kMost);
  CHECK(floored(std::numeric_limits<double>::infinity()) == kMost);
  CHECK(floored(-1e300) == -kMost);
  CHECK(floored(std::numeric_limits<double>::quiet_NaN()) == -kMost);
}
