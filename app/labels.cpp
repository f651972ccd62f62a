// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/labels.h"

#include <algorithm>
#include <cmath>

namespace satsurf::app {
namespace {

bool overlap(const Box& a, const Box& b) {
  return std::abs(a.x - b.x) < (a.width + b.width) / 2 &&
         std::abs(a.y - b.y) < (a.height + b.height) / 2;
}

bool inside(const Box& a, const Box& whole) {
  return std::abs(a.x - whole.x) <= (whole.width - a.width) / 2 &&
         std::abs(a.y - whole.y) <= (whole.height - a.height) / 2;
}

}  // namespace

std::vector<Box> spread(const std::vector<Box>& labels, const std::vector<Box>& taken,
                        const Box& within, double nearest) {
  constexpr double kRing = 6;  // px between the distances that are tried
  constexpr int kDirections = 24;
  double x = 0, y = 0;
  for (const Box& label : labels) x += label.x, y += label.y;
  const auto count = static_cast<double>(std::max<std::size_t>(labels.size(), 1));
  std::vector<Box> full = taken, out;
  for (const Box& label : labels) {
    const double away_x = label.x - x / count, away_y = label.y - y / count;
    const bool middle = std::hypot(away_x, away_y) < 1e-9;  // upwards from there
    const double outwards = middle ? -M_PI / 2 : std::atan2(away_y, away_x);
    const auto room_at = [&](double distance, int direction) -> bool {
      const int turn = direction % 2 == 0 ? direction / 2 : -(direction + 1) / 2;
      const double angle = outwards + turn * 2 * M_PI / kDirections;
      Box tried = label;
      tried.x += distance * std::cos(angle), tried.y += distance * std::sin(angle);
      if (!inside(tried, within) ||
          std::ranges::any_of(full, [&](const Box& other) { return overlap(tried, other); }))
        return false;
      out.push_back(tried);
      return true;
    };
    const auto find_room = [&] {
      for (double d = nearest; d < within.width + within.height; d += kRing)
        for (int direction = 0; direction < (d > 0 ? kDirections : 1); ++direction)
          if (room_at(d, direction)) return true;
      return false;
    };
    if (!find_room()) out.push_back(label);
    full.push_back(out.back());
  }
  return out;
}

}  // namespace satsurf::app
