// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/progress.h"

#include <cmath>

#include <doctest/doctest.h>

using namespace satsurf::app;

TEST_CASE("progress_line") {
  CHECK(progress_line("read", 0, "", 9, 80) == "read [........................]   0 %");
  CHECK(progress_line("train", 0.25, "loss 2", 30, 80) ==
        "train [######..................]  25 %  loss 2  1:30 left");
  CHECK(progress_line("train", 0.001, "", 30, 80) ==
        "train [........................]   0 %  8:19:30 left");
  // what went on where it stopped: 25 % took 30 s
  CHECK(progress_line("train", 0.75, "", 30, 80, 0.5) ==
        "train [##################......]  75 %  0:30 left");
  CHECK(progress_line("train", 0.5, "", 30, 80, 0.5) == "train [############............]  50 %");
  CHECK(progress_line("done", 1, "", 30, 80) == "done [########################] 100 %");
  CHECK(progress_line("odd", std::nan(""), "", 30, 12) == "odd [.......");
}
