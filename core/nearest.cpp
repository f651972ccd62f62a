// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/nearest.h"

#include <algorithm>
#include <limits>

namespace satsurf {

std::size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t change = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({change, row[j] + 1, row[j - 1] + 1});
    }
  }
  return row.back();
}

std::optional<std::string> nearest(const std::string& name, const std::vector<std::string>& known) {
  const auto last_part = [](const std::string& dotted) {
    return dotted.substr(dotted.rfind('.') + 1);
  };
  std::optional<std::string> out;
  std::size_t best = std::numeric_limits<std::size_t>::max();
  for (const std::string& k : known) {
    const std::size_t d = last_part(k) == name ? 1 : edit_distance(name, k);
    if (d < best) best = d, out = k;
  }
  return best <= std::max<std::size_t>(2, name.size() / 3) ? out : std::nullopt;
}

}  // namespace satsurf
