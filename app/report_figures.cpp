// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/report_figures.h"

#include "satsurf/app/preview.h"
#include "satsurf/app/svg.h"
#include "satsurf/core/error.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include <fmt/format.h>
#include <openssl/evp.h>

namespace satsurf::app {
namespace {

constexpr Index kMostPixels = 1200, kMostVertices = 255;  // 255 x 255 fit into 16-bit numbers
constexpr const char* kNorth =
    "<svg class=\"north\" viewBox=\"0 0 24 36\" aria-label=\"North is up\"><path d=\"M12 1 19 21 "
    "12 "
    "17 5 21Z\"/><text x=\"12\" y=\"35\">N</text></svg>";

std::string base64(const std::string& bytes) {
  std::string out(4 * ((bytes.size() + 2) / 3) + 1, '\0');
  const int length = EVP_EncodeBlock(reinterpret_cast<unsigned char*>(out.data()),
                                     reinterpret_cast<const unsigned char*>(bytes.data()),
                                     static_cast<int>(bytes.size()));
  out.resize(static_cast<std::size_t>(length));
  return out;
}

/// How many cells become one so that no side has more than `most`.
Index coarseness(const Report& report, Index most) {
  return (std::max(report.dsm.z.dim(0), report.dsm.z.dim(1)) + most - 1) / most;
}

std::vector<float> known_heights(const Report& report) {
  std::vector<float> known;
  for (const float v : report.dsm.z.values())
    if (std::isfinite(v)) known.push_back(v);
  if (known.empty())
    throw Error("report: no cell of the surface has a height, expected some to show");
  return known;
}

std::string css_colour(const std::array<float, 3>& c) {
  return fmt::format("rgb({:.0f} {:.0f} {:.0f})", 255 * c[0], 255 * c[1], 255 * c[2]);
}

/// The colours of a scale with numbers below; ends that stand for what lies beyond are pointed.
std::string legend(const ColourScale& scale) {
  std::string out = "<div class=\"legend\">", stops;
  const auto end = [&](const char* side, const std::array<float, 3>& colour) {
    out += fmt::format("<div class=\"end {}\" style=\"background:{}\"></div>", side,
                       css_colour(colour));
  };
  if (scale.below) end("below", scale.colours.front());
  if (scale.above) end("above", scale.colours.back());
  for (const auto& c : scale.colours) stops += (stops.empty() ? "" : ",") + css_colour(c);
  out += "<div class=\"bar\" style=\"background:linear-gradient(to right," + stops +
         ")\"></div>\n<div class=\"ticks\">";
  const double span = scale.high - scale.low, step = tick_step(1.6 * span);
  for (double v = std::ceil(scale.low / step - 1e-6) * step; v <= scale.high + 1e-6 * step;
       v += step) {
    const double at = 100 * (v - scale.low) / span;
    out += fmt::format("<span style=\"left:{:.2f}%\"{}>{:.6g}</span>", at,
                       at < 4    ? " class=\"first\""
                       : at > 96 ? " class=\"last\""
                                 : "",
                       std::abs(v) < 1e-9 * step ? 0.0 : v);
  }
  return out + "</div></div>\n";
}

/// A box of its colour for each count, from none on, with its number below.
std::string count_legend(const std::vector<std::array<float, 3>>& colours) {
  std::string out = "<div class=\"counts\">";
  for (std::size_t n = 0; n < colours.size(); ++n)
    out += fmt::format("<div><i style=\"background:{}\"></i>{}</div>", css_colour(colours[n]), n);
  return out + "</div>\n";
}

/// A map: its picture with a scale bar and north.
struct Map {
  std::string id, title, about;  ///< `id` names it to the script
  bool drape = true;             ///< whether the surface to turn may wear it
  bool exact = false;            ///< whether it shows whole numbers, whose colours stay as they are
};
/// key  what its colours mean
std::string figure(const Map& map, const Tensor& picture, double metres_per_pixel,
                   const std::string& key = {}) {
  const Index H = picture.dim(1), W = picture.dim(2);
  const double extent = metres_per_pixel * static_cast<double>(W),
               length = round_length(0.6 * extent);
  const std::string data = map.exact ? "png;base64," + base64(png_bytes(picture))
                                     : "jpeg;base64," + base64(jpeg_bytes(picture));
  std::string out = fmt::format("<figure>\n<figcaption><b>{}</b><span>{}</span></figcaption>\n",
                                map.title, unbroken(map.about));
  out += fmt::format(
      "<div class=\"map\"><img id=\"map-{}\"{} alt=\"{}\" width=\"{}\" height=\"{}\" "
      "src=\"data:image/{}\">{}",
      map.id, map.drape ? " data-drape=\"" + map.title + "\"" : "", map.title, W, H, data, kNorth);
  out += fmt::format("<div class=\"scale\" style=\"width:{:.3f}%\">{}</div></div>\n",
                     100 * length / extent, length_text(length));
  return out + key + "</figure>\n";
}

}  // namespace

std::string map_figures(const Report& report) {
  const Index k = coarseness(report, kMostPixels);
  const double step = report.dsm.step * static_cast<double>(k);
  const Tensor z = block_means(report.dsm.z, k);
  std::string out;
  if (!report.ortho.empty())
    out +=
        figure({"ortho", "Orthophoto",
                "each cell from the steepest image that sees it; stretched until 1 % of the values "
                "are black and 1 % white"},
               stretched_picture(block_means(report.ortho, k)), step);
  out += figure({"heights", "Heights",
                 "m above the ellipsoid; 2 % of the cells lie below the scale, 2 % above it, and "
                 "have the colours of its ends"},
                height_picture(z), step, legend(height_scale(z, report.frame.h0)));
  out += figure({"hillshade", "Hillshade", "lit from the north-west, 45&deg; high"},
                hillshade_picture(z, step), step);
  if (!report.confidence.empty())
    out += figure({"confidence", "Confidence",
                   "the probability that the surface is there, within half a pixel of parallax"},
                  confidence_picture(block_means(report.confidence, k)), step,
                  legend(confidence_scale()));
  if (!report.sigma.empty()) {
    const Tensor sigma = block_means(report.sigma, k);
    out += figure({"sigma", "Expected error",
                   "m; more than nine heights in ten are within twice as much; 2 % of the cells "
                   "lie above the "
                   "scale"},
                  sigma_picture(sigma), step, legend(sigma_scale(sigma)));
  }
  if (!report.views.empty()) {
    const auto most = static_cast<Index>(report.images.size());
    Tensor views = block_means(report.views, k);
    for (float& v : views.values()) v = std::round(v);
    out +=
        figure({"views", "Coverage", "how many images see the cell; grey: no height", true, true},
               count_picture(views, most), step, count_legend(count_colours(most)));
  }
  return out;
}

std::string histogram_figure(const Report& report) {
  constexpr std::size_t kBins = 48;
  constexpr double kLeft = 44, kTop = 12, kHeight = 190, kBelow = 46,
                   kWidth = kChartWidth - kLeft - 12;
  const std::vector<float> known = known_heights(report);
  const auto [least, most] = std::ranges::minmax(known);
  const double low = static_cast<double>(least),
               span = std::max(static_cast<double>(most) - low, 1e-3);
  std::array<double, kBins> share{};
  for (const float v : known) {
    const auto bin = static_cast<std::size_t>((static_cast<double>(v) - low) / span * kBins);
    share[std::min(bin, kBins - 1)] += 100 / static_cast<double>(known.size());
  }
  const double highest = *std::ranges::max_element(share), step = tick_step(highest),
               top = std::ceil(highest / step - 1e-9) * step, bottom = kTop + kHeight;
  std::string out;
  for (int n = 0; n * step < top * (1 + 1e-9); ++n) {
    const double y = bottom - n * step / top * kHeight;
    out += line(kLeft, y, kLeft + kWidth, y, "none", 1, "class=\"rule\"");
    out += text_at(kLeft - 6, y + 4, "end", fmt::format("{:g}", n * step));
  }
  for (std::size_t n = 0; n < kBins; ++n)
    out += fmt::format(
        "<rect class=\"filled\" x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\"/>\n",
        kLeft + kWidth * static_cast<double>(n) / kBins + 0.5, bottom - share[n] / top * kHeight,
        kWidth / kBins - 1, share[n] / top * kHeight);
  const double every = tick_step(1.25 * span), first = low + report.frame.h0;
  for (double v = std::ceil(first / every) * every; v <= first + span; v += every)
    out += text_at(kLeft + (v - first) / span * kWidth, bottom + 18, "middle",
                   fmt::format("{:.6g}", v));
  out += line(kLeft, bottom, kLeft + kWidth, bottom, "none", 1, "class=\"axis\"");
  out +=
      text_at(kLeft + kWidth / 2, bottom + 38, "middle", "m above the ellipsoid", "class=\"soft\"");
  return captioned("Heights", "share of the cells, %",
                   chart(kChartWidth, kTop + kHeight + kBelow, "Histogram of the heights", out));
}

std::string coverage_figure(const Report& report) {
  constexpr double kRow = 30, kLeft = 92, kWidth = kChartWidth - kLeft - 62;
  if (report.views.empty()) return {};
  std::vector<double> cells(report.images.size() + 1);
  double without = 0;
  for (const float v : report.views.values())
    if (std::isfinite(v))
      cells[std::min(static_cast<std::size_t>(std::max(v, 0.F)), cells.size() - 1)] += 1;
    else
      without += 1;
  const auto all = static_cast<double>(report.views.count());
  std::string out;
  double y = 4;
  const auto row = [&](const std::string& name, double count) {
    const double share = count / all;
    out += text_at(kLeft - 8, y + 18, "end", name);
    out += fmt::format(
        "<rect class=\"filled\" x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"20\"/>\n",
        kLeft, y + 3, share * kWidth);
    out += text_at(kLeft + share * kWidth + 6, y + 18, "start",
                   count > 0 && share < 0.0005 ? "< 0.1 %" : fmt::format("{:.1f} %", 100 * share));
    y += kRow;
  };
  for (std::size_t n = cells.size(); n-- > 0;)
    row(n == 1 ? "1 image" : fmt::format("{} images", n), cells[n]);
  row("no height", without);
  return captioned("Coverage", "share of the grid by the number of images that see a cell",
                   chart(kChartWidth, y + 4, "Coverage", out));
}

std::string grid_json(const Report& report) {
  const Index k = coarseness(report, kMostVertices);
  const Tensor z = block_means(report.dsm.z, k);
  const Index H = z.dim(0), W = z.dim(1);
  double low = INFINITY, high = -INFINITY;
  for (const float v : z.values())
    if (std::isfinite(v))
      low = std::min(low, static_cast<double>(v)), high = std::max(high, static_cast<double>(v));
  const double span = std::max(high - low, 1e-3), step = report.dsm.step * static_cast<double>(k);
  std::string bytes;
  for (const float v : z.values()) {
    const auto q = std::isfinite(v)
                       ? static_cast<std::uint16_t>(std::lround(
                             65534 * std::clamp((static_cast<double>(v) - low) / span, 0.0, 1.0)))
                       : std::uint16_t{65535};
    bytes += static_cast<char>(q & 255), bytes += static_cast<char>(q >> 8);
  }
  return fmt::format(
      "{{\"width\":{},\"height\":{},\"east\":{:.3f},\"north\":{:.3f},\"low\":{:.3f},\"high\":{:.3f}"
      ","
      "\"heights\":\"{}\"}}",
      W, H, step * static_cast<double>(W), step * static_cast<double>(H), low + report.frame.h0,
      low + span + report.frame.h0, base64(bytes));
}

}  // namespace satsurf::app
