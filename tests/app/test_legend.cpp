// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/legend.h"

#include <algorithm>
#include <string>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::app;

namespace {

/// Share of a window of a picture that is black.
double ink(const Tensor& picture, Index x, Index y, Index width, Index height) {
  double black = 0;
  for (Index i = y; i < y + height; ++i)
    for (Index j = x; j < x + width; ++j) black += picture[i * picture.dim(2) + j] == 0.F;
  return black / static_cast<double>(width * height);
}

}  // namespace

TEST_CASE("a legend leaves the map as and where it is") {
  Tensor map({3, 40, 700});
  for (Index i = 0; i < map.count(); ++i) map[i] = static_cast<float>(i % 97) / 97;
  const ColourScale scale = error_scale();
  for (const ColourScale* with : {&scale, static_cast<const ColourScale*>(nullptr)}) {
    const Tensor out = with_legend(map, with, 0.5);
    CHECK(out.dim(2) == 700);
    CHECK(out.dim(1) > 60);
    bool same = true;
    for (Index c = 0; c < 3; ++c)
      for (Index i = 0; i < 40; ++i)
        same =
            same && std::equal(map.data() + (c * 40 + i) * 700, map.data() + (c * 40 + i + 1) * 700,
                               out.data() + (c * out.dim(1) + i) * 700);
    CHECK(same);
  }
  CHECK(with_legend(map, &scale, 0.5).dim(1) > with_legend(map, nullptr, 0.5).dim(1));
  const Tensor small = with_legend(Tensor({3, 20, 20}, 0.3F), &scale, 0.5);
  CHECK(small.dim(2) >= 170);  // the text needs room
  CHECK(small[19 * small.dim(2) + 19] == 0.3F);
  CHECK(small[19 * small.dim(2) + 20] == 1.F);
}

TEST_CASE("ends of a scale that stand for what lies beyond are pointed and have its colour") {
  ColourScale scale{"m", 0, 1, true, false, {{1.F, 0.F, 0.F}, {0.F, 0.F, 1.F}}};
  const auto coloured_at =
      [&](Index x) {  // cells of the strip's column that are neither ink nor paper
        const Tensor out = with_legend(Tensor({3, 10, 200}, 0.5F), &scale, 0.5);
        Index cells = 0;
        for (Index i = 10; i < out.dim(1); ++i) {
          const float red = out[i * out.dim(2) + x], green = out[(out.dim(1) + i) * out.dim(2) + x];
          cells += green == 0.F && red > 0.9F;
        }
        return cells;
      };
  CHECK(coloured_at(6) == 8);  // the scale
  CHECK(coloured_at(5) == 8);
  CHECK(coloured_at(3) < 8);
  CHECK(coloured_at(3) > 0);
  CHECK(coloured_at(0) == 0);
  scale.below = false;
  CHECK(coloured_at(5) == 0);
}

TEST_CASE("the scale bar is as long as it says") {
  const Tensor out =
      with_legend(Tensor({3, 10, 600}, 0.5F), nullptr, 0.5);  // 300 m: 50 m is a third
  const Index W = out.dim(2);
  Index longest = 0;
  for (Index i = 10; i < out.dim(1); ++i) {
    Index run = 0;
    for (Index j = 0; j < W; ++j) {
      run = out[i * W + j] == 0.F ? run + 1 : 0;
      longest = std::max(longest, run);
    }
  }
  CHECK(longest == 100);
}

TEST_CASE("text is drawn in dots, and cut where the picture ends") {
  Tensor picture({3, 8, 30}, 1.F);
  draw_text(picture, 0, 0, 1, "1");
  CHECK(ink(picture, 2, 0, 1, 7) == 1);  // the stem
  CHECK(ink(picture, 6, 0, 24, 8) == 0);
  CHECK(text_width("12", 2) == 22);
  CHECK(text_width("", 2) == 0);
  draw_text(picture, 24, 4, 2, "W\xc3");
  CHECK(ink(picture, 24, 4, 6, 4) > 0);
  Tensor first({3, 8, 6}, 1.F), second({3, 8, 6}, 1.F);
  draw_text(first, 0, 0, 1, "~"), draw_text(second, 0, 0, 1, "?");
  CHECK(std::equal(first.data(), first.data() + first.count(), second.data()));
}

TEST_CASE("a map lies beside its world file and its reference system") {
  const test::TempFolder folder("legend");
  write_map(folder / "map.png", Tensor({3, 4, 6}, 0.5F), nullptr, {32617, 400000, 3000000, 0.5});
  CHECK(test::read_bytes(folder / "map.pgw") == "0.5\n0\n0\n-0.5\n400000.25\n2999999.75\n");
  const std::string crs = test::read_bytes(folder / "map.png.aux.xml");
  CHECK(crs.starts_with("<PAMDataset>\n  <SRS>PROJCS[&quot;WGS 84 / UTM zone 17N&quot;"));
  for (const char* name : {"nowhere.png", "map.png"}) {  // of which none has a system afterwards
    write_map(folder / name, Tensor({3, 4, 6}, 0.5F), nullptr, {0, 0, 0, 1});
    CHECK(!std::filesystem::exists(folder / (std::string(name) + ".aux.xml")));
  }
}
