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
  CHECK(page.find("1.25\u00a0px") != std::string::npos);
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

TEST_CASE("images of one place have one mark with all their numbers, others a label each") {
  Report report = slope();
  report.images[0].sun_deg = report.images[1].sun_deg = {45, 135};
  report.images.push_back(report.images[0]);
  report.images[2].sun_deg = {44.5, 136};  // 2 px beside
  report.images[2].off_nadir_deg = 30;
  const std::string sky = between(report_html(report), "<b>Satellites and suns</b>", "</figure>");
  CHECK(count(sky, "class=\"edge\"") == 2);     // satellites 1 and 2 stand in one place
  CHECK(count(sky, "r=\"5\" stroke=") == 1);    // one sun
  CHECK(count(sky, "class=\"rim\"") == 1 + 3);  // with three numbers
  for (const char* number : {"1", "2", "3"})
    CHECK(count(sky, std::string(">") + number + "</text>") == 2);
}

TEST_CASE("along the epipolar direction three images say one thing, four say one for each pair") {
  Report report = slope();
  report.images.push_back(report.images[0]);
  report.pairs = {
      {"a", "b", 30, 1, 0.25, 0.75}, {"a", "c", 30, 1, 0.25, 0.0}, {"b", "c", 0, 0, {}, {}}};
  std::string page = report_html(report);
  CHECK(page.find("<th>Along</th>") == std::string::npos);
  CHECK(page.find("leaves 0.75\u00a0px at most") != std::string::npos);
  CHECK(page.find("0.00\u00a0px") == std::string::npos);
  report.pairs[0].along = report.pairs[1].along = std::nullopt;
  CHECK(report_html(report).find("three images tell") == std::string::npos);
  report.images.push_back(report.images[0]);
  report.pairs[0].along = 0.5;
  page = report_html(report);
  CHECK(page.find("<th>Along</th>") != std::string::npos);
  CHECK(page.find("<td data-label=\"Along\">0.50\u00a0px</td>") != std::string::npos);
}

TEST_CASE("numbers are not parted from their units, long words may be cut") {
  CHECK(unbroken("77.8 to 335.4 m") == "77.8 to 335.4\u00a0m");
  CHECK(unbroken("2 % of 3 images, 5 px, 4 months") == "2\u00a0% of 3 images, 5\u00a0px, 4 months");
  Report report = slope();
  report.facts = {{"1 to 2 m", "heights"}};
  report.files = {{"File", "Bytes", "SHA-256"}, {{"a.tif", "5512638", std::string(64, 'e')}}};
  const std::string page = report_html(report);
  CHECK(page.find("<b>1 to 2\u00a0m</b>") != std::string::npos);
  CHECK(page.find("<td data-label=\"Bytes\">5512638</td>") != std::string::npos);
  CHECK(page.find("<td data-label=\"Image\"><span>") != std::string::npos);  // tags are no words
  CHECK(page.find("<td class=\"long\" data-label=\"SHA-256\">eee") != std::string::npos);
}

TEST_CASE("legends: counts are classes, ends that stand for more are pointed") {
  const std::string page = report_html(slope());
  const std::string coverage = between(page, "<b>Coverage</b><span>how many", "</figure>");
  CHECK(count(coverage, "<i style=\"background:rgb(") == 3);  // none, one or both images
  CHECK(coverage.find("linear-gradient") == std::string::npos);
  const std::string heights = between(page, "<b>Heights</b><span>m above", "</figure>");
  CHECK(count(heights, "class=\"end ") == 2);
  CHECK(heights.find("2\u00a0% of the cells lie below the scale, 2\u00a0% above it") !=
        std::string::npos);
  const std::string confidence = between(page, "<b>Confidence</b>", "</figure>");
  CHECK(count(confidence, "class=\"end ") == 0);
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
