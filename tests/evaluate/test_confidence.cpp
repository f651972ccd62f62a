// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/confidence_figure.h"
#include "satsurf/app/scores_json.h"
#include "satsurf/core/rng.h"
#include "satsurf/evaluate/confidence.h"
#include "satsurf/evaluate/table.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::app;
using namespace satsurf::evaluate;

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

/// n pixels of evenly spaced confidences; the error at confidence c is error(c).
template <class F>
ConfidenceErrors spread(Index n, const F& error) {
  Tensor c({1, n}), e({1, n});
  for (Index k = 0; k < n; ++k) {
    // shuffled: the order of pixels must not matter
    c[k] = (static_cast<float>(7 * k % n) + 0.5f) / static_cast<float>(n);
    e[k] = error(c[k]);
  }
  ConfidenceErrors out;
  out.add(c, e);
  return out;
}

Index count(const std::string& text, const std::string& what) {
  Index n = 0;
  for (std::size_t at = text.find(what); at != std::string::npos; at = text.find(what, at + 1)) ++n;
  return n;
}

}  // namespace

TEST_CASE("confidence bins of equal width") {
  ConfidenceErrors errors;
  errors.add(Tensor::from({2, 4}, {0.05f, 0.07f, 0.55f, 1, 1.5f, kNan, 0.2f, -0.1f}),
             Tensor::from({2, 4}, {1, -3, 0.5f, 8, 2, 1, kNan, -2}));
  CHECK(errors.pixels() == 6);
  const auto bins = errors.equal_width();
  REQUIRE(bins.size() == 10);
  for (std::size_t k = 0; k < 10; ++k) {
    CHECK(bins[k].low == doctest::Approx(0.1 * static_cast<double>(k)));
    CHECK(bins[k].high == doctest::Approx(0.1 * static_cast<double>(k + 1)));
  }
  CHECK(bins[0].pixels == 3);  // -0.1 counts as 0
  CHECK(bins[0].confidence == doctest::Approx(0.04));
  CHECK(bins[0].mae == doctest::Approx(2));
  CHECK(bins[0].rmse == doctest::Approx(std::sqrt((1 + 9 + 4) / 3.0)));
  CHECK(bins[0].pag1 == 0);  // 1 is not below 1
  CHECK(bins[0].pag2_5 == doctest::Approx(2.0 / 3));
  CHECK(bins[0].pag7_5 == 1);
  CHECK(bins[2].pixels == 0);  // its error is unknown
  CHECK(std::isnan(bins[2].mae));
  CHECK(bins[5].pixels == 1);
  CHECK(bins[5].pag1 == 1);
  CHECK(bins[9].pixels == 2);  // 1 and what lies above
  CHECK(bins[9].confidence == doctest::Approx(1));
  CHECK(bins[9].mae == doctest::Approx(5));
  CHECK(bins[9].pag7_5 == doctest::Approx(0.5));
}

TEST_CASE("confidence bins of equal count") {
  SUBCASE("as many as can be") {
    for (const Index n : {10, 20, 23, 97}) {
      CAPTURE(n);
      const auto bins = spread(n, [](float c) { return 2 - c; }).equal_count();
      REQUIRE(bins.size() == 10);
      Index total = 0;
      for (std::size_t k = 0; k < 10; ++k) {
        total += bins[k].pixels;
        CHECK(std::abs(static_cast<double>(bins[k].pixels) - static_cast<double>(n) / 10) < 1);
        CHECK(bins[k].mae == doctest::Approx(2 - bins[k].confidence));
        CHECK(bins[k].low <= bins[k].confidence);
        CHECK(bins[k].confidence < bins[k].high);
        if (k > 0) CHECK(bins[k].low == bins[k - 1].high);
      }
      CHECK(total == n);
    }
  }
  SUBCASE("by hand") {
    const auto bins = spread(20, [](float c) { return c < 0.05f ? -4.f : 1.f; }).equal_count();
    REQUIRE(bins.size() == 10);
    CHECK(bins[0].pixels == 2);  // confidences 0.025 and 0.075
    CHECK(bins[0].low == doctest::Approx(0.025).epsilon(1e-3));
    CHECK(bins[0].confidence == doctest::Approx(0.05));
    CHECK(bins[0].mae == doctest::Approx(2.5));
    CHECK(bins[0].rmse == doctest::Approx(std::sqrt(17.0 / 2)));
    CHECK(bins[0].pag2_5 == doctest::Approx(0.5));
    CHECK(bins[1].mae == doctest::Approx(1));
  }
  SUBCASE("pixels of one confidence stay together") {
    ConfidenceErrors errors;
    errors.add(Tensor({4, 25}, 0.5f), Tensor({4, 25}, 1.f));
    REQUIRE(errors.equal_count().size() == 1);
    CHECK(errors.equal_count()[0].pixels == 100);
    CHECK_FALSE(errors.monotone());  // nothing to compare
    errors.add(Tensor({4, 25}, 0.75f), Tensor({4, 25}, 0.5f));
    REQUIRE(errors.equal_count().size() == 2);
    CHECK(errors.equal_count()[1].mae == 0.5);
    CHECK_FALSE(errors.monotone());  // two bins are no trend
    errors.add(Tensor({4, 25}, 0.875f), Tensor({4, 25}, 0.25f));
    REQUIRE(errors.equal_count().size() == 3);
    CHECK(errors.monotone());
    errors.add(Tensor({4, 25}, 1.f), Tensor({4, 25}, 0.25f));
    REQUIRE(errors.equal_count().size() == 4);
    CHECK_FALSE(errors.monotone());
  }
  SUBCASE("of nothing") {
    const ConfidenceErrors none;
    CHECK(none.pixels() == 0);
    CHECK(none.equal_count().empty());
    CHECK_FALSE(none.monotone());
  }
}

TEST_CASE("errors that fall with confidence") {
  CHECK(spread(100, [](float c) { return 3 - 2 * c; }).monotone());
  CHECK(spread(100, [](float c) { return 2 * c - 3; }).monotone());  // signs do not matter
  CHECK_FALSE(spread(100, [](float c) { return 1 + c; }).monotone());
  CHECK_FALSE(spread(100, [](float c) { return 3 - c + (c > 0.9f ? 0.2f : 0.f); }).monotone());
  CHECK_FALSE(spread(100, [](float) { return 1.f; }).monotone());
}

TEST_CASE("scene by scene is all at once") {
  Rng rng(4);
  Tensor c({6, 5}), e({6, 5});
  for (float& v : c.values()) v = static_cast<float>(rng.uniform());
  for (float& v : e.values()) v = std::round(static_cast<float>(rng.uniform()) * 64) / 8;
  ConfidenceErrors whole, parts;
  whole.add(c, e);
  for (Index i = 0; i < 6; ++i)
    parts.add(c.slice0(i).reshaped({1, 5}), e.slice0(i).reshaped({1, 5}));
  CHECK(confidence_json(whole).dump() == confidence_json(parts).dump());
  CHECK_THROWS_WITH_AS(parts.add(c, e.reshaped({5, 6})),
                       "ConfidenceErrors: error has shape [5,6], expected [H W] with H=6 from "
                       "confidence, W=5 from confidence",
                       ShapeError);
}

TEST_CASE("confidence as JSON, CSV and a figure") {
  const ConfidenceErrors falling = spread(20, [](float c) { return 3 - 2 * c; });
  ConfidenceErrors few;
  few.add(Tensor::from({1, 2}, {0.25f, 0.75f}), Tensor::from({1, 2}, {1, 4}));
  const ConfidenceErrors none;
  const auto j = confidence_json(few);
  CHECK(j["pixels"] == 2);
  CHECK(j["monotone"] == false);
  CHECK(j["equal_width"][2]["mae"] == 1);
  CHECK(j["equal_width"][3]["mae"].is_null());
  CHECK(j["equal_count"].size() == 2);
  for (const char* key :
       {"low", "high", "confidence", "pixels", "mae", "rmse", "pag1", "pag2.5", "pag7.5"})
    CHECK(j["equal_count"][1].contains(key));
  CHECK(confidence_json(falling)["monotone"] == true);

  const std::string csv = confidence_csv({{"a", "A", &few}, {"b", "B", &falling}});
  CHECK(
      csv.starts_with("of,bins,low,high,confidence,pixels,share,mae,rmse,pag1,pag2.5,pag7.5\n"
                      "a,equal_width,0,0.1,,0,0,,,,,\n"));
  CHECK(csv.find("\na,equal_width,0.7,0.8,0.75,1,0.5,4,4,0,0,1\n") != std::string::npos);
  CHECK(count(csv, "\n") == 1 + 12 + 20);
  CHECK(csv.find("nan") == std::string::npos);

  const std::string svg =
      confidence_svg({{"a", "Few <& far>", &few}, {"b", "Many", &falling}, {"c", "None", &none}});
  CHECK(svg.starts_with("<svg "));
  CHECK(svg.ends_with("</svg>\n"));
  CHECK(count(svg, "<text ") == count(svg, "</text>"));
  // background, legend, then a bar of errors and three of shares for each bin
  CHECK(count(svg, "<rect ") == 1 + 4 + 4 * (2 + 2) + 4 * (10 + 10));
  CHECK(svg.find(">2.5 m<") != std::string::npos);
  CHECK(svg.find(">share of a bin&#39;s pixels with |error| &lt;<") != std::string::npos);
  CHECK(
      svg.find(">2 pixels; 2 bins of equal count, too few to tell whether the mean error falls<") !=
      std::string::npos);
  CHECK(svg.find(">20 pixels; the mean error falls over 10 bins of equal count<") !=
        std::string::npos);
  CHECK(
      svg.find(">0 pixels; 0 bins of equal count, too few to tell whether the mean error falls<") !=
      std::string::npos);
  CHECK(svg.find("Few &lt;&amp; far&gt;") != std::string::npos);
  for (const char* bad : {"nan", "inf", "-0.0"}) CHECK(svg.find(bad) == std::string::npos);

  // a bar of a share of one is as high as its chart, that of a half is half as high
  ConfidenceErrors half;
  half.add(Tensor::from({1, 2}, {0.5f, 0.5f}), Tensor::from({1, 2}, {0.5f, 2}));
  const std::string bars = confidence_svg({{"a", "A", &half}});
  CHECK(count(bars, "height=\"110.0\" fill=\"#c4dfc6\"") == 2);
  CHECK(count(bars, "height=\"110.0\" fill=\"#7fb885\"") == 2);
  CHECK(count(bars, "height=\"55.0\" fill=\"#35783f\"") == 2);
}
