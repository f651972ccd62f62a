// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/pointing_text.h"

#include <algorithm>

#include <fmt/format.h>

namespace satsurf::app {
namespace {

Index ties_of(const scene::Pointing& pointing) {
  Index ties = 0;
  for (const scene::PairResidual& pair : pointing.before) ties += pair.ties;
  return ties;
}

}  // namespace

std::string pair_line(const scene::PairResidual& pair) {
  if (pair.ties == 0) return "no tie points";
  std::string text =
      fmt::format("{} tie points, {:.2f} px across the epipolar direction", pair.ties, pair.across);
  if (pair.along) text += fmt::format(", {:.2f} px along", *pair.along);
  return text;
}

std::string pointing_line(const scene::Pointing& pointing) {
  if (pointing.after.empty()) return "pointing " + pointing.verdict;
  const double before = scene::mean_across(pointing.before).value_or(0);
  const std::string measured =
      fmt::format("{:.2f} px across the epipolar direction at {} ties", before, ties_of(pointing));
  if (!pointing.applied)
    return fmt::format("cameras agree to {}; pointing correction {}", measured, pointing.verdict);
  return fmt::format(
      "cameras disagreed by {}, {:.2f} px after shifts of up to {:.2f} px ({}; on the ground their "
      "mean is zero, so where the ground as a whole lies stays as the cameras have it)",
      measured, scene::mean_across(pointing.after).value_or(0), pointing.largest_shift,
      pointing.verdict);
}

std::string correction_line(const scene::Pointing& pointing) {
  if (!pointing.applied) return pointing.verdict;
  const std::size_t rest = std::min(pointing.verdict.find(';'), pointing.verdict.size());
  return fmt::format("needed: satsurf reconstruct would shift cameras by up to {:.2f} px",
                     pointing.largest_shift) +
         pointing.verdict.substr(rest);
}

nlohmann::ordered_json pointing_json(const scene::Pointing& pointing) {
  const auto across = [](const std::vector<scene::PairResidual>& pairs) {
    const std::optional<double> mean = scene::mean_across(pairs);
    return mean ? nlohmann::ordered_json(*mean) : nlohmann::ordered_json();
  };
  return {{"applied", pointing.applied},
          {"verdict", pointing.verdict},
          {"ties", ties_of(pointing)},
          {"across_before", across(pointing.before)},
          {"across_after", across(pointing.after)},
          {"largest_shift", pointing.largest_shift}};
}

}  // namespace satsurf::app
