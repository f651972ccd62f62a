// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

namespace satsurf {

// A parameter struct declares each field once, in a static function template
//
//   struct TrainConfig {
//     double lr = 1e-3;
//     Index steps = 1000;
//     template <class Self, class V>
//     static void fields(Self& s, V&& v) {
//       v("lr", s.lr, Field{.help = "peak learning rate", .unit = "", .min = 0, .max = 1});
//       v("steps", s.steps, Field{.help = "optimiser steps", .min = 1});
//     }
//   };
//
// and JSON, command-line flags, help and the saved record are all derived from it. Supported field types: bool,
// int, Index, std::uint64_t, float, double, std::string, std::vector and std::array of those, and nested structs.

struct Field {
  std::string help{};
  std::string unit{};
  double min = -1e300, max = 1e300;        ///< inclusive range of every number in the field
  std::vector<std::string> choices{};      ///< allowed strings, empty for any
};

}  // namespace satsurf
