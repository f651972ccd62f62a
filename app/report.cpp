// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/report.h"

#include "satsurf/app/report_figures.h"
#include "satsurf/app/report_page.h"
#include "satsurf/app/svg.h"
#include "satsurf/core/dims.h"
#include "satsurf/core/error.h"

#include <algorithm>
#include <map>
#include <optional>
#include <string_view>

#include <fmt/format.h>

namespace satsurf::app {
namespace {

/// Puts values, which are HTML, into the slots of a page: `{{name}}`. What comes in is not looked
/// at again.
/// throws  Error for a slot without a value
std::string filled(std::string_view page, const std::map<std::string, std::string>& values) {
  std::string out;
  for (;;) {
    const std::size_t begin = page.find("{{"), end = page.find("}}", begin);
    if (begin == std::string_view::npos || end == std::string_view::npos) return out.append(page);
    const auto value = values.find(std::string(page.substr(begin + 2, end - begin - 2)));
    if (value == values.end())
      throw Error("report: slot " + std::string(page.substr(begin, end + 2 - begin)) +
                  " of the page, expected one that is filled");
    out.append(page.substr(0, begin)).append(value->second);
    page.remove_prefix(end + 2);
  }
}

/// Whether a cell has a word, such as a hash, that may have to be cut to fit.
/// cell  HTML
bool has_long_word(const std::string& cell) {
  constexpr int kLong = 24;
  int length = 0;
  bool in_tag = false;
  for (const char c : cell) {
    in_tag = c == '<' || (in_tag && c != '>');
    if (in_tag || c == '>') continue;
    length = c == ' ' ? 0 : length + 1;
    if (length > kLong) return true;
  }
  return false;
}

/// A table that becomes cards on a phone.
/// escape  false where the cells are HTML already
std::string table_html(const ReportTable& table, bool escape = true) {
  std::string out = "<div class=\"scroll\"><table class=\"wide\">\n<thead><tr>";
  for (const std::string& title : table.head) out += "<th>" + escaped(title) + "</th>";
  out += "</tr></thead>\n<tbody>\n";
  for (const auto& row : table.rows) {
    out += "<tr>";
    for (std::size_t k = 0; k < row.size(); ++k) {
      const std::string cell = unbroken(escape ? escaped(row[k]) : row[k]);
      out += std::string("<td") + (has_long_word(cell) ? " class=\"long\"" : "") +
             " data-label=\"" + (k < table.head.size() ? escaped(table.head[k]) : "") + "\">" +
             cell + "</td>";
    }
    out += "</tr>\n";
  }
  return out + "</tbody></table></div>\n";
}

std::string place_text(const Report& report) {
  const Index H = report.dsm.z.dim(0), W = report.dsm.z.dim(1);
  const double width = static_cast<double>(W) * report.dsm.step,
               height = static_cast<double>(H) * report.dsm.step;
  const rpc::Geodetic centre =
      report.frame.geodetic_from_local({report.dsm.x0 + width / 2, report.dsm.y0 - height / 2, 0});
  const double east = report.dsm.x0 + report.frame.easting0,
               north = report.dsm.y0 + report.frame.northing0;
  return fmt::format(
      "{:.5f}&deg; {}, {:.5f}&deg; {} &middot; {:.0f} m &times; {:.0f} m &middot; EPSG:{}, east "
      "{:.1f} to {:.1f}, north {:.1f} to {:.1f} &middot; {} &times; {} cells of {:g} m &middot; "
      "heights above the WGS84 ellipsoid",
      std::abs(centre.lat), centre.lat < 0 ? "S" : "N", std::abs(centre.lon),
      centre.lon < 0 ? "W" : "E", width, height, report.frame.zone.epsg(), east, east + width,
      north - height, north, W, H, report.dsm.step);
}

std::string facts_html(const Report& report) {
  std::string out;
  for (const auto& [number, what] : report.facts)
    out += "<div class=\"fact\"><b>" + unbroken(escaped(number)) + "</b><span>" + escaped(what) +
           "</span></div>\n";
  return out;
}

std::string warnings_html(const Report& report) {
  if (report.warnings.empty())
    return "<p class=\"good\">No warnings: nothing of what is checked looks wrong.</p>";
  std::string out = "<aside class=\"warnings\"><h2>Look twice</h2><ul>\n";
  for (const reconstruct::Warning& warning : report.warnings)
    out += "<li>" + unbroken(escaped(warning.text)) + "</li>\n";
  return out + "</ul></aside>";
}

std::string images_html(const Report& report) {
  ReportTable table{{"Image", "Date", "Size", "Pixel", "Satellite", "Sun", "Shift"}, {}};
  for (std::size_t n = 0; n < report.images.size(); ++n) {
    const ReportImage& i = report.images[n];
    table.rows.push_back(
        {fmt::format("<span><span class=\"swatch\" style=\"background:{}\"></span>{} {}</span>",
                     image_colour(n), n + 1, escaped(i.name)),
         i.date.empty() ? "unknown" : escaped(i.date),
         fmt::format("{}&nbsp;&times;&nbsp;{} px, {}&nbsp;&times;&nbsp;{}", i.width, i.height,
                     i.bands, escaped(i.type)),
         fmt::format("{:.2f} m", i.gsd),
         fmt::format("{:.1f}&deg; off nadir, azimuth {:.0f}&deg;", i.off_nadir_deg, i.azimuth_deg),
         i.sun_deg ? fmt::format("{:.1f}&deg; high, azimuth {:.0f}&deg;", (*i.sun_deg)[0],
                                 (*i.sun_deg)[1])
                   : "unknown",
         i.shift ? fmt::format("x&nbsp;{:+.2f}, y&nbsp;{:+.2f} px", i.shift->x, i.shift->y)
                 : "none"});
  }
  std::string out = table_html(table, false);
  if (report.left_out.empty()) return out;
  out += "<p>Left out:</p>\n<ul>\n";
  for (const auto& [image, why] : report.left_out)
    out += "<li>" + escaped(image) + ": " + escaped(why) + "</li>\n";
  return out + "</ul>\n";
}

/// Whether every pair has a residual of its own along the epipolar direction. A point in three images
/// has one, for its height takes the rest up; its pairs share it by where the satellites stand. With
/// one halfway between the others, those two get none of it, whatever their cameras say.
bool along_by_pairs(const Report& report) { return report.images.size() > 3; }

/// How three images agree along the epipolar directions; empty for others.
std::string along_of_three(const Report& report) {
  std::optional<double> most;
  for (const ReportPair& p : report.pairs)
    if (p.along) most = std::max(most.value_or(0), *p.along);
  if (!most || along_by_pairs(report)) return {};
  return unbroken(
      fmt::format(" Along it three images tell one number, not one for each pair: the height that "
                  "they have in common leaves {:.2f} px at most.",
                  *most));
}

std::string pointing_html(const Report& report) {
  std::string out = "<p>" + unbroken(escaped(report.pointing)) + "</p>\n";
  if (report.pairs.empty()) return out;
  const bool along = along_by_pairs(report);
  ReportTable table{{"Pair", "Tie points", "Before", "After"}, {}};
  if (along) table.head.emplace_back("Along");
  for (const ReportPair& p : report.pairs) {
    const auto px = [](double v) { return fmt::format("{:.2f} px", v); };
    table.rows.push_back({p.a + " + " + p.b, std::to_string(p.ties),
                          p.ties > 0 ? px(p.before) : "none", p.after ? px(*p.after) : "none"});
    if (along) table.rows.back().push_back(p.along ? px(*p.along) : "none");
  }
  out +=
      "<p>Medians of how far the rays of the two images miss each other across the epipolar "
      "direction, before and after shifts";
  out += along ? "; along it, against the height that all images which show a point give it and "
                 "which takes a part of it up."
               : "." + along_of_three(report);
  return out + "</p>\n" + table_html(table);
}

/// A command that is broken between its words only, not within a flag.
std::string whole_words(const std::string& command) {
  std::string out = "<span>";
  for (const char c : escaped(command)) out += c == ' ' ? "</span> <span>" : std::string(1, c);
  return out + "</span>";
}

std::string repeat_html(const Report& report) {
  std::string out =
      "<p>In the folder of this page, with the files that were read where they were:</p>\n<pre>" +
      whole_words(report.command) + "</pre>\n";
  out +=
      "<details><summary>Settings</summary><pre>" + escaped(report.settings) + "</pre></details>\n";
  if (!report.files.rows.empty())
    out += "<details open><summary>Files that were read</summary>" + table_html(report.files) +
           "</details>\n";
  return out;
}

}  // namespace

std::string report_html(const Report& report) {
  Dims dim("report");
  dim.match("dsm", report.dsm.z, "H W");
  for (const auto& [name, values] : {std::pair{"confidence", &report.confidence},
                                     {"sigma", &report.sigma},
                                     {"views", &report.views}})
    if (!values->empty()) dim.match(name, *values, "H W");
  if (!report.ortho.empty()) dim.match("ortho", report.ortho, "3 H W");
  const std::string histogram = histogram_figure(report);  // refuses a surface without heights
  const std::string tiles =
      report.tiles.rows.empty()
          ? std::string()
          : "<section>\n<h2>Tiles</h2>\n" + table_html(report.tiles) + "</section>\n";
  return filled(
      kReportHtml,
      {{"title", escaped(report.title)},
       {"program", escaped(report.program)},
       {"style", kReportCss},
       {"script", kReportScript},
       {"place", unbroken(place_text(report))},
       {"facts", facts_html(report)},
       {"warnings", warnings_html(report)},
       {"grid_note", "What is drawn is a coarse copy of the surface; dsm.tif has all of it."},
       {"grid", grid_json(report)},
       {"maps", map_figures(report)},
       {"histogram", histogram},
       {"coverage", coverage_figure(report)},
       {"footprints", footprint_figure(report)},
       {"sky", sky_figure(report)},
       {"images", images_html(report)},
       {"pointing", pointing_html(report)},
       {"tiles", tiles},
       {"repeat", repeat_html(report)},
       {"made", escaped(report.made)}});
}

}  // namespace satsurf::app
