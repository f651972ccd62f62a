// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/svg.h"

#include <cmath>
#include <regex>

#include <fmt/format.h>
#include <fmt/printf.h>

namespace satsurf::app {

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      case '\'':
        out += "&#39;";
        break;
      default:
        out += c;
    }
  return out;
}

std::string unbroken(const std::string& text) {
  static const std::regex kUnit("([0-9]) (m|km|px|s|min|h|%|kB|MB|GB|TB)(?![A-Za-z0-9])");
  return std::regex_replace(text, kUnit, "$1\u00a0$2");
}

std::string text_at(double x, double y, const char* anchor, const std::string& text,
                    const std::string& more) {
  return fmt::sprintf("<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\" ", x, y, anchor) + more +
         ">" + escaped(text) + "</text>\n";
}

std::string line(double x0, double y0, double x1, double y1, const char* colour, double width,
                 const std::string& more) {
  return fmt::sprintf(
             "<line x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\" stroke=\"%s\" "
             "stroke-width=\"%.1f\"",
             x0, y0, x1, y1, colour, width) +
         (more.empty() ? "" : " " + more) + "/>\n";
}

std::string box(double x, double y, double width, double height, const char* colour) {
  return fmt::sprintf("<rect x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"%.1f\" fill=\"%s\"/>\n",
                      x, y, width, height, colour);
}

std::string chart(double width, double height, const std::string& label,
                  const std::string& content) {
  return fmt::format(
      "<svg class=\"chart\" viewBox=\"0 0 {:.0f} {:.0f}\" font-size=\"13\" role=\"img\" "
      "aria-label=\"{}\">\n{}</svg>\n",
      width, height, escaped(label), content);
}

std::string captioned(const std::string& title, const std::string& about,
                      const std::string& content) {
  return "<figure>\n<figcaption><b>" + title + "</b><span>" + about + "</span></figcaption>\n" +
         content + "</figure>\n";
}

double tick_step(double high) {
  const double power = std::pow(10, std::floor(std::log10(high)));
  const double lead = high / power;
  return power * (lead < 2 ? 0.2 : lead < 4 ? 0.5 : lead < 8 ? 1 : 2);
}

double round_length(double most) {
  const double power = std::pow(10, std::floor(std::log10(most / 2)));
  const double lead = most / 2 / power;
  return power * (lead < 2 ? 1 : lead < 5 ? 2 : 5);
}

std::string length_text(double metres) {
  return metres < 1000 ? fmt::format("{:g} m", metres) : fmt::format("{:g} km", metres / 1000);
}

}  // namespace satsurf::app
