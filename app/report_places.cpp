// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/labels.h"
#include "satsurf/app/report_figures.h"
#include "satsurf/app/svg.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <fmt/format.h>

namespace satsurf::app {
namespace {

constexpr double kCell = 20;            // px, side of a number's square
constexpr std::size_t kMostInARow = 5;  // squares
using Place = std::array<double, 2>;    // px

/// What stands at one place of a figure, with the numbers of its images.
struct Mark {
  Place at;
  std::vector<std::size_t> images;  ///< counted from 0
  bool filled = true;               ///< or only its rim
};

/// The label of a mark, at its place.
Box label_of(const Mark& mark) {
  const std::size_t n = mark.images.size(), columns = std::min(n, kMostInARow),
                    rows = (n + kMostInARow - 1) / kMostInARow;
  return {mark.at[0], mark.at[1], kCell * static_cast<double>(columns),
          kCell * static_cast<double>(rows)};
}

/// The numbers of a mark's images, each in its colour.
std::string numbers(const Mark& mark, const Box& label) {
  std::string out;
  for (std::size_t k = 0; k < mark.images.size(); ++k) {
    const std::size_t n = mark.images[k];
    const double x = label.x - label.width / 2 + kCell * static_cast<double>(k % kMostInARow),
                 y = label.y - label.height / 2 + kCell * static_cast<double>(k / kMostInARow);
    const std::string look =
        mark.filled
            ? fmt::format("fill=\"{}\"", image_colour(n))
            : fmt::format("class=\"rim\" stroke=\"{}\" stroke-width=\"2\"", image_colour(n));
    out += fmt::format(
        "<rect x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\" rx=\"6\" {}/>\n", x + 1,
        y + 1, kCell - 2, kCell - 2, look);
    out += text_at(x + kCell / 2, y + kCell / 2 + 4.5, "middle", std::to_string(n + 1),
                   mark.filled ? fmt::format("style=\"fill:{};font-weight:bold\"", image_ink(n))
                               : std::string());
  }
  return out;
}

/// Labels of marks where there is room for them, lines to where they belong below.
std::string labelled(const std::vector<Mark>& marks, const std::vector<Box>& taken,
                     const Box& within, double nearest) {
  std::vector<Box> wanted;
  for (const Mark& mark : marks) wanted.push_back(label_of(mark));
  const std::vector<Box> labels = spread(wanted, taken, within, nearest);
  std::string lines, above;
  for (std::size_t k = 0; k < marks.size(); ++k) {
    const Mark& mark = marks[k];
    if (labels[k].x != mark.at[0] || labels[k].y != mark.at[1])
      lines += line(mark.at[0], mark.at[1], labels[k].x, labels[k].y,
                    image_colour(mark.images.front()), 1.5);
    above += numbers(mark, labels[k]);
  }
  return lines + above;
}

/// Adds an image to the mark at a place, or makes one there.
void add(std::vector<Mark>& marks, const Place& at, std::size_t image, bool filled) {
  constexpr double kSame = 3;  // px; marks of less distance cannot be told apart
  const auto found = std::ranges::find_if(marks, [&](const Mark& mark) {
    return mark.filled == filled && std::hypot(mark.at[0] - at[0], mark.at[1] - at[1]) < kSame;
  });
  if (found != marks.end())
    found->images.push_back(image);
  else
    marks.push_back({at, {image}, filled});
}

std::string satellite(const Mark& mark) {
  return fmt::format("<circle class=\"edge\" cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"5\" fill=\"{}\"/>\n",
                     mark.at[0], mark.at[1], image_colour(mark.images.front()));
}

std::string sun(const Mark& mark) {
  const auto [x, y] = mark.at;
  const char* const colour = image_colour(mark.images.front());
  std::string out;
  for (int ray = 0; ray < 8; ++ray) {
    const double c = std::cos(ray * M_PI / 4), s = std::sin(ray * M_PI / 4);
    out += line(x + 7 * c, y + 7 * s, x + 11 * c, y + 11 * s, colour, 2);
  }
  return out + fmt::format(
                   "<circle class=\"rim\" cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"5\" "
                   "stroke=\"{}\" stroke-width=\"2\"/>\n",
                   x, y, colour);
}

}  // namespace

const char* image_colour(std::size_t number) {
  // Okabe and Ito 2008, told apart by most people; the black one left out
  constexpr std::array<const char*, 7> kColours{"#0072b2", "#e69f00", "#009e73", "#d55e00",
                                                "#cc79a7", "#56b4e9", "#b8a800"};
  return kColours[number % kColours.size()];
}

const char* image_ink(std::size_t number) {
  constexpr std::array<bool, 7> kDark{true, false, false, false, false, false, false};
  return kDark[number % kDark.size()] ? "#ffffff" : "#000000";
}

std::string footprint_figure(const Report& report) {
  constexpr double kMargin = 16;
  const double east = report.dsm.x0 + report.frame.easting0,
               north = report.dsm.y0 + report.frame.northing0,
               width = report.dsm.step * static_cast<double>(report.dsm.z.dim(1)),
               height = report.dsm.step * static_cast<double>(report.dsm.z.dim(0));
  double x0 = east, x1 = east + width, y0 = north - height, y1 = north;
  for (const ReportImage& image : report.images)
    for (const auto& [x, y] : image.footprint)
      x0 = std::min(x0, x), x1 = std::max(x1, x), y0 = std::min(y0, y), y1 = std::max(y1, y);
  const double scale = (kChartWidth - 2 * kMargin) / std::max(x1 - x0, y1 - y0),
               drawn = (y1 - y0) * scale;
  const auto at_x = [&](double x) { return kChartWidth / 2 + (x - (x0 + x1) / 2) * scale; };
  const auto at_y = [&](double y) { return kMargin + (y1 - y) * scale; };
  std::string out = fmt::format(
      "<rect class=\"extent\" x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\"/>\n",
      at_x(east), at_y(north), width * scale, height * scale);
  std::vector<Mark> marks;
  for (std::size_t n = 0; n < report.images.size(); ++n) {
    const scene::Polygon& ground = report.images[n].footprint;
    if (ground.empty()) continue;
    std::string points;
    for (const auto& [x, y] : ground) points += fmt::format("{:.1f},{:.1f} ", at_x(x), at_y(y));
    out += fmt::format("<polygon points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"2\"/>\n",
                       points, image_colour(n));
    // numbers stand at corners of their own, for footprints lie on one another
    const auto& corner = ground[n % ground.size()];
    marks.push_back({{at_x(corner[0]), at_y(corner[1])}, {n}});
  }
  const double below = kMargin + drawn + 26, length = round_length(0.6 * (x1 - x0)),
               px = length * scale;
  out += labelled(marks, {},
                  {kChartWidth / 2, kMargin + drawn / 2, kChartWidth, drawn + 2 * kMargin - 4}, 0);
  out += line(kMargin, below, kMargin + px, below, "none", 3, "class=\"axis\"");
  out += text_at(kMargin + px / 2, below - 7, "middle", length_text(length));
  const double nx = kChartWidth - kMargin - 8;
  out += fmt::format("<path class=\"filled\" d=\"M{0:.1f} {1:.1f} l6 17 l-6 -4 l-6 4 Z\"/>\n", nx,
                     below - 18);
  out += text_at(nx - 12, below, "end", "N");
  return captioned("Footprints",
                   fmt::format("at the middle height of the surface, UTM EPSG:{}; filled: the "
                               "surface; numbers as in the table, at a corner of theirs",
                               report.frame.zone.epsg()),
                   chart(kChartWidth, below + 10, "Footprints of the images", out));
}

std::string sky_figure(const Report& report) {
  constexpr double kRadius = 165, kX = kChartWidth / 2, kY = kRadius + 24;
  const auto place = [&](double from_zenith_deg, double azimuth_deg) -> Place {
    const double r = kRadius * from_zenith_deg / 90, a = azimuth_deg * M_PI / 180;
    return {kX + r * std::sin(a), kY - r * std::cos(a)};
  };
  std::string out;
  std::vector<Box> taken;
  for (const int ring : {30, 60, 90}) {
    const double x = kX - kRadius * ring / 90;  // in the west, where no sun stands at noon
    out += fmt::format(
        "<circle class=\"rule\" cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"{:.1f}\" fill=\"none\"/>\n", kX, kY,
        kRadius * ring / 90);
    out += text_at(x + 4, kY - 5, "start", fmt::format("{}°", ring), "class=\"soft\"");
    taken.push_back({x + 16, kY - 9, 26, 14});
  }
  out += line(kX - kRadius, kY, kX + kRadius, kY, "none", 1, "class=\"rule\"");
  out += line(kX, kY - kRadius, kX, kY + kRadius, "none", 1, "class=\"rule\"");
  out +=
      text_at(kX, kY - kRadius - 7, "middle", "N") + text_at(kX, kY + kRadius + 17, "middle", "S");
  out += text_at(kX + kRadius + 7, kY + 5, "start", "E") +
         text_at(kX - kRadius - 7, kY + 5, "end", "W");
  for (const double side : {-1.0, 1.0}) {
    taken.push_back({kX, kY + side * (kRadius + 12), 14, 16});
    taken.push_back({kX + side * (kRadius + 13), kY, 16, 16});
  }
  std::vector<Mark> marks;
  for (std::size_t n = 0; n < report.images.size(); ++n) {
    const ReportImage& image = report.images[n];
    if (image.sun_deg) add(marks, place(90 - (*image.sun_deg)[0], (*image.sun_deg)[1]), n, false);
    add(marks, place(image.off_nadir_deg, image.azimuth_deg), n, true);
  }
  for (const Mark& mark : marks) {
    out += mark.filled ? satellite(mark) : sun(mark);
    const double size = mark.filled ? 10 : 22;
    taken.push_back({mark.at[0], mark.at[1], size, size});
  }
  constexpr double kHeight = kY + kRadius + 24;
  out += labelled(marks, taken, {kX, kHeight / 2, kChartWidth, kHeight}, 18);
  return captioned("Satellites and suns",
                   "as the ground sees them, the zenith in the middle; dots and filled numbers: "
                   "satellites, rays and open numbers: suns",
                   chart(kChartWidth, kHeight, "Satellites and suns", out));
}

}  // namespace satsurf::app
