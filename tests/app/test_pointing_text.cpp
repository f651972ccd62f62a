// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/pointing_text.h"

#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::app;

TEST_CASE("a correction that was only measured is needed, not made") {
  scene::Pointing pointing;
  pointing.applied = true, pointing.largest_shift = 5.237;
  pointing.verdict = "estimated from the images";
  CHECK(correction_line(pointing) ==
        "needed: satsurf reconstruct would shift cameras by up to 5.24 px");
  pointing.verdict += "; c.tif shares 3 tie points: its camera stays as it is";
  CHECK(correction_line(pointing) ==
        "needed: satsurf reconstruct would shift cameras by up to 5.24 px; c.tif shares 3 tie "
        "points: its camera stays as it is");
  pointing.applied = false, pointing.verdict = "not needed: the largest shift is 0.10 px";
  CHECK(correction_line(pointing) == pointing.verdict);
}
