// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/confidence_figure.h"

#include "satsurf/app/svg.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/printf.h>

namespace satsurf::app {
namespace {

// px
constexpr double kPanelWidth = 360, kErrorHeight = 170, kShareHeight = 110, kBetween = 20,
                 kLeft = 64, kRight = 24, kGap = 76, kTop = 100, kBelow = 62,
                 kRow = kErrorHeight + kBetween + kShareHeight + kBelow + 62;
constexpr double kWidth = kLeft + 2 * kPanelWidth + kGap + kRight;
constexpr const char *kBar = "#4a7ab5", *kMark = "#b2432f", *kInk = "#222222", *kGrid = "#dddddd";

/// A share of a bin's pixels that is drawn, widest bound first, so that each lies within the last.
struct Share {
  const char *bound, *colour;
  double evaluate::ConfidenceBin::*value;
};
constexpr std::array<Share, 3> kShares{{{"7.5 m", "#c4dfc6", &evaluate::ConfidenceBin::pag7_5},
                                        {"2.5 m", "#7fb885", &evaluate::ConfidenceBin::pag2_5},
                                        {"1 m", "#35783f", &evaluate::ConfidenceBin::pag1}}};

/// The largest number to be drawn.
double highest_of(const std::vector<evaluate::ConfidenceBin>& bins) {
  double highest = 0;
  for (const evaluate::ConfidenceBin& b : bins)
    if (b.pixels > 0) highest = std::max(highest, b.rmse);
  return highest;
}

/// The frame of a chart: lines across it at every `step` up to `top`, each with its number, and
/// what these are.
std::string axes(double x0, double y0, double height, double top, double step,
                 const std::string& title) {
  const double bottom = y0 + height;
  std::string out;
  for (int k = 0; k * step < top * (1 + 1e-9); ++k) {
    const double y = bottom - k * step / top * height;
    out += line(x0, y, x0 + kPanelWidth, y, kGrid, 1);
    out += text_at(x0 - 7, y + 4, "end", fmt::sprintf("%.6g", k * step));
  }
  const double x = x0 - 44, y = y0 + height / 2;
  return out +
         text_at(x, y, "middle", title, fmt::sprintf("transform=\"rotate(-90 %.1f %.1f)\"", x, y));
}

double slot_of(const std::vector<evaluate::ConfidenceBin>& bins) {
  return kPanelWidth / static_cast<double>(std::max<std::size_t>(bins.size(), 1));
}

/// Bars of the mean |error| and marks of the root of the mean square, bins next to each other.
/// highest  the least that the axis reaches to, m
std::string error_chart(double x0, double y0, const std::vector<evaluate::ConfidenceBin>& bins,
                        double highest) {
  const double step = tick_step(highest > 0 ? highest : 1),
               top = std::max(1.0, std::ceil(highest / step - 1e-9)) * step,
               bottom = y0 + kErrorHeight, slot = slot_of(bins);
  const auto y_of = [&](double v) { return bottom - v / top * kErrorHeight; };
  std::string out = axes(x0, y0, kErrorHeight, top, step, "height error, m");
  for (std::size_t k = 0; k < bins.size(); ++k) {
    const evaluate::ConfidenceBin& b = bins[k];
    if (b.pixels == 0) continue;
    const double x = x0 + slot * static_cast<double>(k);
    out += box(x + 0.1 * slot, y_of(b.mae), 0.8 * slot, bottom - y_of(b.mae), kBar);
    out += line(x + 0.1 * slot, y_of(b.rmse), x + 0.9 * slot, y_of(b.rmse), kMark, 2.5);
  }
  out += line(x0, y0, x0, bottom, kInk, 1);
  return out + line(x0, bottom, x0 + kPanelWidth, bottom, kInk, 1);
}

/// Bars of the shares within the bounds, in per cent of a bin's pixels.
std::string share_chart(double x0, double y0, const std::vector<evaluate::ConfidenceBin>& bins) {
  const double bottom = y0 + kShareHeight, slot = slot_of(bins);
  std::string out = axes(x0, y0, kShareHeight, 100, 25, "share within, %");
  for (std::size_t k = 0; k < bins.size(); ++k) {
    const evaluate::ConfidenceBin& b = bins[k];
    if (b.pixels == 0) continue;
    const double x = x0 + slot * static_cast<double>(k);
    for (const Share& s : kShares)
      out += box(x + 0.1 * slot, bottom - b.*s.value * kShareHeight, 0.8 * slot,
                 b.*s.value * kShareHeight, s.colour);
  }
  out += line(x0, y0, x0, bottom, kInk, 1);
  return out + line(x0, bottom, x0 + kPanelWidth, bottom, kInk, 1);
}

/// What stands below the charts of bins.
/// widths  true: edges of the confidence are named, and the share of pixels; false: the mean
///         confidence of each bin
std::string labels(double x0, double bottom, const std::vector<evaluate::ConfidenceBin>& bins,
                   bool widths) {
  double pixels = 0;
  for (const evaluate::ConfidenceBin& b : bins) pixels += static_cast<double>(b.pixels);
  const double slot = slot_of(bins);
  std::string out;
  for (std::size_t k = 0; k < bins.size(); ++k) {
    const evaluate::ConfidenceBin& b = bins[k];
    const double x = x0 + slot * static_cast<double>(k), middle = x + slot / 2;
    if (widths) {
      const double share = 100 * static_cast<double>(b.pixels) / pixels;
      out += text_at(middle, bottom + 30, "middle",
                     b.pixels == 0 ? std::string("–")
                     : share < 0.1 ? std::string("<0.1")
                                   : fmt::sprintf(share < 10 ? "%.1f" : "%.0f", share),
                     "fill=\"#777777\"");
      if (k == 0) out += text_at(x0, bottom + 15, "middle", fmt::sprintf("%.1f", b.low));
      out += text_at(x + slot, bottom + 15, "middle", fmt::sprintf("%.1f", b.high));
    } else {
      out += text_at(middle, bottom + 15, "middle", fmt::sprintf("%.2f", b.confidence));
    }
  }
  const double centre = x0 + kPanelWidth / 2;
  return out + (widths ? text_at(centre, bottom + 47, "middle",
                                 "confidence; below it the share of pixels, %")
                       : text_at(centre, bottom + 33, "middle",
                                 "mean confidence of bins of equally many pixels"));
}

/// Two charts, one above the other over one axis of confidence.
std::string panel(double x0, double y0, const std::vector<evaluate::ConfidenceBin>& bins,
                  double highest, bool widths) {
  const double shares = y0 + kErrorHeight + kBetween;
  return error_chart(x0, y0, bins, highest) + share_chart(x0, shares, bins) +
         labels(x0, shares + kShareHeight, bins, widths);
}

/// Whether the error falls with confidence, in words.
std::string trend(const evaluate::ConfidenceErrors& errors, std::size_t bins) {
  std::string text = std::to_string(errors.pixels()) + " pixels; ";
  const std::string number = std::to_string(bins);
  if (bins < evaluate::ConfidenceErrors::kFewest)
    return text + number + (bins == 1 ? " bin" : " bins") +
           " of equal count, too few to tell whether the mean error falls";
  return text + "the mean error " + (errors.monotone() ? "falls" : "does not always fall") +
         " over " + number + " bins of equal count";
}

/// What colours and marks mean, its right end at x.
std::string legend(double x) {
  std::string out = box(x - 252, 18, 18, 11, kBar);
  out += text_at(x - 227, 28, "start", "mean |error|");
  out += line(x - 133, 24, x - 115, 24, kMark, 2.5);
  out += text_at(x - 108, 28, "start", "root mean square");
  x -= 71 * static_cast<double>(kShares.size());
  out += text_at(x - 12, 50, "end", "share of a bin's pixels with |error| <");
  for (auto s = kShares.rbegin(); s != kShares.rend(); ++s, x += 71) {
    out += box(x, 40, 18, 11, s->colour);
    out += text_at(x + 25, 50, "start", s->bound);
  }
  return out;
}

}  // namespace

std::string confidence_svg(const std::vector<evaluate::NamedConfidence>& all) {
  const double height = kTop + kRow * static_cast<double>(all.size()) - 40;
  std::string out = fmt::sprintf(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%.0f\" height=\"%.0f\" viewBox=\"0 0 %.0f "
      "%.0f\" font-family=\"Helvetica, Arial, 'DejaVu Sans', sans-serif\" font-size=\"12\" "
      "fill=\"%s\">\n",
      kWidth, height, kWidth, height, kInk);
  out += "<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n";
  out += text_at(kLeft, 28, "start", "Height error by confidence",
                 "font-size=\"17\" font-weight=\"bold\"");
  out += legend(kWidth - kRight);
  for (std::size_t k = 0; k < all.size(); ++k) {
    const double y = kTop + kRow * static_cast<double>(k);
    const evaluate::ConfidenceErrors& e = *all[k].errors;
    const std::vector<evaluate::ConfidenceBin> width = e.equal_width(), count = e.equal_count();
    out += text_at(kLeft, y - 18, "start", all[k].title, "font-size=\"14\" font-weight=\"bold\"");
    out += text_at(kWidth - kRight, y - 18, "end", trend(e, count.size()));
    const double highest = std::max(highest_of(width), highest_of(count));  // one scale for both
    out += panel(kLeft, y, width, highest, true);
    out += panel(kLeft + kPanelWidth + kGap, y, count, highest, false);
  }
  return out + "</svg>\n";
}

}  // namespace satsurf::app
