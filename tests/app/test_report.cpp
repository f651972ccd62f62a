// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/report.h"
#include "satsurf/app/svg.h"
#include "satsurf/core/error.h"

#include <cmath>
#include <limits>
#include <string>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::app;
using test::error_of;

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

/// A slope of 40 x 60 cells with a hole.
Report slope() {
  Report report;
  report.title = "A <slope> & \"more\"";
  report.program = "satsurf 1";
  report.frame = {{17, true}, 400000, 3000000, 100};
  report.dsm = {Tensor({40, 60}), -15, 10, 0.5};
  report.views = Tensor({40, 60}, 2.F);
  report.confidence = Tensor({40, 60}, 0.75F);
  for (Index i = 0; i < 40 * 60; ++i) report.dsm.z[i] = static_cast<float>(i % 60) / 10;
  report.dsm.z[7] = report.views[7] = report.confidence[7] = kNan;
  for (const char* name : {"one.tif", "</script>two.tif"}) {
    ReportImage image;
    image.name = name;
    image.width = 600, image.height = 400, image.type = "uint8";
    image.footprint = {{399980, 2999980}, {400020, 2999980}, {400020, 3000020}, {399980, 3000020}};
    report.images.push_back(image);
  }
  report.images[0].sun_deg = {45, 135};
  report.left_out = {{"three.tif", "sees <nothing>"}};
  report.pointing = "cameras agree";
  report.pairs = {{"one.tif", "</script>two.tif", 33, 1.25, 0.5, std::nullopt}};
  report.warnings = {{"low_confidence", "confidence < 0.4"}};
  report.settings = "{\"a\": 1}";
  report.command = "satsurf reconstruct --config run.json --out again";
  return report;
}

std::size_t count(const std::string& text, const std::string& what) {
  std::size_t n = 0;
  for (std::size_t at = text.find(what); at != std::string::npos; at = text.find(what, at + 1)) ++n;
  return n;
}

/// The text between two marks.
std::string between(const std::string& text, const std::string& from, const std::string& to) {
  const std::size_t begin = text.find(from);
  if (begin == std::string::npos) return {};
  const std::size_t end = text.find(to, begin + from.size());
  return text.substr(begin + from.size(), end - begin - from.size());
}

}  // namespace

TEST_CASE("a report holds everything and asks for nothing") {
  const std::string page = report_html(slope());
  CHECK(page.starts_with("<!DOCTYPE html>"));
  CHECK(page.ends_with("</html>\n"));
  CHECK(page.find("{{") == std::string::npos);
  CHECK(page.find("http") == page.find("http-equiv"));  // nowhere a name of another place
  CHECK(count(page, "http") == 1);
  CHECK(count(page, "src=\"") == count(page, "src=\"data:image/"));
  CHECK(count(page, "<img ") ==
        4);  // heights, hillshade, confidence, coverage: no others are there
  CHECK(page.find("confidence &lt; 0.4") != std::string::npos);
  CHECK(page.find("<h2>Tiles</h2>") == std::string::npos);
  CHECK(page.find("1.25 px") != std::string::npos);
  CHECK(page.find("<li>three.tif: sees &lt;nothing&gt;</li>") != std::string::npos);
}

TEST_CASE("what comes into a report is text and no HTML") {
  const std::string page = report_html(slope());
  CHECK(page.find("<h1>A &lt;slope&gt; &amp; &quot;more&quot;</h1>") != std::string::npos);
  CHECK(page.find("&lt;/script&gt;two.tif") != std::string::npos);
  CHECK(page.find("</script>two") == std::string::npos);
  Report sly = slope();
  sly.title = "{{grid}}";
  CHECK(report_html(sly).find("<h1>{{grid}}</h1>") != std::string::npos);
}

TEST_CASE("tiles are shown where there are some") {
  Report report = slope();
  report.tiles = {{"Tile", "Seconds"}, {{"3 of 4", "12"}}};
  const std::string page = report_html(report);
  CHECK(page.find("<h2>Tiles</h2>") != std::string::npos);
  CHECK(page.find("<td data-label=\"Tile\">3 of 4</td>") != std::string::npos);
}

TEST_CASE("the grid to turn has the heights above the ellipsoid, coarser where there are many") {
  const std::string grid = between(report_html(slope()), "id=\"grid\">", "</script>");
  CHECK(
      grid.starts_with("{\"width\":60,\"height\":40,\"east\":30.000,\"north\":20.000,"
                       "\"low\":100.000,\"high\":105.900,\"heights\":\""));
  // 0, then 1/59 of the range as 16 bits, lower byte first: 00 00 57 04
  CHECK(between(grid, "\"heights\":\"", "\"").starts_with("AABXB"));
  Report large = slope();
  large.dsm.z = Tensor({300, 1000}, 5.F);
  large.views = large.confidence = Tensor();
  const std::string coarse = between(report_html(large), "id=\"grid\">", "</script>");
  CHECK(coarse.starts_with("{\"width\":250,\"height\":75,"));
  CHECK(report_html(large).size() < 300'000);
}

TEST_CASE("a report of nothing, or of rasters that do not fit, is refused") {
  Report empty = slope();
  empty.dsm.z = Tensor({40, 60}, kNan);
  CHECK(error_of<Error>([&] { report_html(empty); }) ==
        "report: no cell of the surface has a height, expected some to show");
  Report other = slope();
  other.views = Tensor({40, 61});
  CHECK(error_of<ShapeError>([&] { report_html(other); }).starts_with("report: views has shape"));
}

TEST_CASE("round lengths and steps") {
  CHECK(round_length(100) == 50);
  CHECK(round_length(99) == 20);
  CHECK(round_length(430) == 200);
  CHECK(round_length(7) == 2);
  CHECK(length_text(500) == "500 m");
  CHECK(length_text(2000) == "2 km");
  CHECK(tick_step(10) == doctest::Approx(2));
  CHECK(tick_step(0.35) == doctest::Approx(0.05));
}
