// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

namespace satsurf {

/// Letters to put in, take out or change to make one text of the other.
/// Source: Levenshtein 1966.
std::size_t edit_distance(const std::string& a, const std::string& b);

/// What was probably meant by a name that is not known: the nearest one, of equally near ones the
/// first; nothing where none is within two letters or a third of the name. The last part of a
/// dotted name is one slip away: `base` for `model.base`.
std::optional<std::string> nearest(const std::string& name, const std::vector<std::string>& known);

}  // namespace satsurf
