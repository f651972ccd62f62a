// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/confidence.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace satsurf::train {
namespace {

// px
constexpr double kPanelWidth = 360, kPanelHeight = 190, kLeft = 64, kGap = 76, kTop = 92,
                 kBelow = 62, kRow = kPanelHeight + kBelow + 62;
constexpr double kWidth = kLeft + 2 * kPanelWidth + kGap + 24;
constexpr const char *kBar = "#4a7ab5", *kMark = "#b2432f", *kInk = "#222222", *kGrid = "#dddddd";

/// printf to a string.
template <class... Args>
std::string formatted(const char* format, Args... args) {
  char text[512];
  std::snprintf(text, sizeof text, format, args...);
  return text;
}

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text)
    out += c == '&' ? "&amp;" : c == '<' ? "&lt;" : c == '>' ? "&gt;" : std::string(1, c);
  return out;
}

/// anchor  start, middle or end of the text lies at x
/// more    further attributes
std::string text_at(double x, double y, const char* anchor, const std::string& text,
                    const std::string& more = {}) {
  return formatted("<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\" ", x, y, anchor) + more + ">" +
         escaped(text) + "</text>\n";
}

std::string line(double x0, double y0, double x1, double y1, const char* colour, double width) {
  return formatted(
      "<line x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\" stroke=\"%s\" "
      "stroke-width=\"%.1f\"/>\n",
      x0, y0, x1, y1, colour, width);
}

/// A step of 1, 2 or 5 times a power of ten that cuts [0, high] into four to ten.
double tick_step(double high) {
  const double power = std::pow(10, std::floor(std::log10(high)));
  const double lead = high / power;
  return power * (lead < 2 ? 0.2 : lead < 4 ? 0.5 : lead < 8 ? 1 : 2);
}

/// The largest number to be drawn.
double highest_of(const std::vector<ConfidenceBin>& bins) {
  double highest = 0;
  for (const ConfidenceBin& b : bins)
    if (b.pixels > 0) highest = std::max(highest, b.rmse);
  return highest;
}

/// A bar chart of bins that stand next to each other.
/// highest the least that the axis of errors reaches to, m
/// widths  true: edges of the confidence are named, and the share of pixels; false: the mean
///         confidence of each bin
std::string panel(double x0, double y0, const std::vector<ConfidenceBin>& bins, double highest,
                  bool widths) {
  double pixels = 0;
  for (const ConfidenceBin& b : bins) pixels += static_cast<double>(b.pixels);
  const double bottom = y0 + kPanelHeight, step = tick_step(highest > 0 ? highest : 1),
               top = std::max(1.0, std::ceil(highest / step - 1e-9)) * step;
  const auto y_of = [&](double v) { return bottom - v / top * kPanelHeight; };
  const double slot = kPanelWidth / static_cast<double>(std::max<std::size_t>(bins.size(), 1));

  std::string out;
  for (int k = 0; k * step < top * (1 + 1e-9); ++k) {
    const double y = y_of(k * step);
    out += line(x0, y, x0 + kPanelWidth, y, kGrid, 1);
    out += text_at(x0 - 7, y + 4, "end", formatted("%.6g", k * step));
  }
  for (std::size_t k = 0; k < bins.size(); ++k) {
    const ConfidenceBin& b = bins[k];
    const double x = x0 + slot * static_cast<double>(k), middle = x + slot / 2;
    if (b.pixels > 0) {
      out += formatted("<rect x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"%.1f\" fill=\"%s\"/>\n",
                       x + 0.1 * slot, y_of(b.mae), 0.8 * slot, bottom - y_of(b.mae), kBar);
      out += line(x + 0.1 * slot, y_of(b.rmse), x + 0.9 * slot, y_of(b.rmse), kMark, 2.5);
    }
    if (widths) {
      const double share = 100 * static_cast<double>(b.pixels) / pixels;
      out += text_at(middle, bottom + 30, "middle",
                     b.pixels == 0 ? std::string("–")
                     : share < 0.1 ? std::string("<0.1")
                                   : formatted(share < 10 ? "%.1f" : "%.0f", share),
                     "fill=\"#777777\"");
      if (k == 0) out += text_at(x0, bottom + 15, "middle", formatted("%.1f", b.low));
      out += text_at(x + slot, bottom + 15, "middle", formatted("%.1f", b.high));
    } else {
      out += text_at(middle, bottom + 15, "middle", formatted("%.2f", b.confidence));
    }
  }
  out += line(x0, y0, x0, bottom, kInk, 1);
  out += line(x0, bottom, x0 + kPanelWidth, bottom, kInk, 1);
  const double centre = x0 + kPanelWidth / 2;
  if (widths) {
    out += text_at(centre, bottom + 47, "middle", "confidence; below it the share of pixels, %");
  } else {
    out += text_at(centre, bottom + 33, "middle", "mean confidence of bins of equally many pixels");
  }
  const double x = x0 - 44, y = y0 + kPanelHeight / 2;
  out += text_at(x, y, "middle", "height error, m",
                 formatted("transform=\"rotate(-90 %.1f %.1f)\"", x, y));
  return out;
}

}  // namespace

std::string confidence_svg(const std::vector<NamedConfidence>& all) {
  const double height = kTop + kRow * static_cast<double>(all.size()) - 40;
  std::string out = formatted(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%.0f\" height=\"%.0f\" viewBox=\"0 0 %.0f "
      "%.0f\" font-family=\"Helvetica, Arial, 'DejaVu Sans', sans-serif\" font-size=\"12\" "
      "fill=\"%s\">\n",
      kWidth, height, kWidth, height, kInk);
  out += "<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n";
  out += text_at(kLeft, 28, "start", "Height error by confidence",
                 "font-size=\"17\" font-weight=\"bold\"");
  double x = kWidth - 264;
  out += formatted("<rect x=\"%.1f\" y=\"18\" width=\"18\" height=\"11\" fill=\"%s\"/>\n", x, kBar);
  out += text_at(x + 25, 28, "start", "mean |error|");
  x += 118;
  out += line(x, 24, x + 18, 24, kMark, 2.5);
  out += text_at(x + 25, 28, "start", "root mean square");
  for (std::size_t k = 0; k < all.size(); ++k) {
    const double y = kTop + kRow * static_cast<double>(k);
    const ConfidenceErrors& e = *all[k].errors;
    out += text_at(kLeft, y - 18, "start", all[k].title, "font-size=\"14\" font-weight=\"bold\"");
    out += text_at(kWidth - 24, y - 18, "end",
                   std::to_string(e.pixels()) + " pixels; the error " +
                       (e.monotone() ? "falls" : "does not fall") + " from each tenth to the next");
    const std::vector<ConfidenceBin> width = e.equal_width(), tenths = e.equal_count();
    const double highest = std::max(highest_of(width), highest_of(tenths));  // one scale for both
    out += panel(kLeft, y, width, highest, true);
    out += panel(kLeft + kPanelWidth + kGap, y, tenths, highest, false);
  }
  return out + "</svg>\n";
}

}  // namespace satsurf::train
