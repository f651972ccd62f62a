// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/pointing_file.h"

#include "satsurf/core/atomic_file.h"
#include "satsurf/core/error.h"
#include "satsurf/core/fields_json.h"

#include <array>
#include <cmath>
#include <string>
#include <utility>

#include <nlohmann/json.hpp>

namespace satsurf::scene {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kMeaning =
    "shift is added to where the camera of an image sees a point (SAMP_OFF, LINE_OFF); with slopes "
    "it is that in pixel at, and changes by so many px for 1000 px to the right and down; the mean "
    "displacement of the ground that the shifts mean is zero, and what tie points cannot tell from "
    "a ground that lies elsewhere is zero too";

constexpr double kPer = 1000;  // px that slopes are for

Json residual_json(const PairResidual& pair) {
  return {{"across", pair.across}, {"along", pair.along ? Json(*pair.along) : Json()}};
}

double number_of(const nlohmann::json& image, const char* key, const std::string& where) {
  const auto at = image.find(key);
  if (at == image.end() || !at->is_number() || !std::isfinite(at->get<double>()))
    throw IoError(where + ": expected a number " + key);
  return at->get<double>();
}

/// Two numbers, 0 where there are none of the name.
std::array<double, 2> two_of(const nlohmann::json& image, const char* key,
                             const std::string& where) {
  const auto at = image.find(key);
  if (at == image.end()) return {};
  std::array<double, 2> out{};
  bool good = at->is_array() && at->size() == out.size();
  for (std::size_t k = 0; good && k < out.size(); ++k) {
    good = (*at)[k].is_number();
    if (good) out[k] = (*at)[k].get<double>();
    good = good && std::isfinite(out[k]);
  }
  if (!good) throw IoError(where + ": expected two numbers " + key);
  return out;
}

}  // namespace

void write_pointing(const std::filesystem::path& path, const Pointing& pointing) {
  Json images = Json::array(), pairs = Json::array();
  for (std::size_t i = 0; i < pointing.names.size(); ++i) {
    Json& image = images.emplace_back(Json{{"name", pointing.names[i]},
                                           {"shift_x", pointing.shifts[i].x},
                                           {"shift_y", pointing.shifts[i].y}});
    if (pointing.slopes.empty()) continue;
    const auto& [at, per_pixel] = pointing.slopes[i];
    image["at"] = {at.x, at.y};
    image["slope_x"] = {kPer * per_pixel[0][0], kPer * per_pixel[0][1]};
    image["slope_y"] = {kPer * per_pixel[1][0], kPer * per_pixel[1][1]};
  }
  for (std::size_t k = 0; k < pointing.before.size(); ++k) {
    const PairResidual& before = pointing.before[k];
    pairs.push_back(
        {{"images", {pointing.names[before.a], pointing.names[before.b]}},
         {"ties", before.ties},
         {"before", residual_json(before)},
         {"after", pointing.after.empty() ? Json() : residual_json(pointing.after[k])}});
  }
  const Json json{{"unit", "px"},
                  {"meaning", kMeaning},
                  {"applied", pointing.applied},
                  {"verdict", pointing.verdict},
                  {"observable", pointing.observable},
                  {"images", std::move(images)},
                  {"pairs", std::move(pairs)}};
  atomic_write(path, json.dump(2) + "\n");
}

NamedShifts read_pointing(const std::filesystem::path& path) {
  const nlohmann::json json = load_json_file(path);
  const std::string where = path.string();
  if (!json.is_object() || !json.contains("images") || !json["images"].is_array())
    throw IoError(where + ": no list `images`, expected one with name, shift_x and shift_y each");
  NamedShifts out;
  for (const nlohmann::json& image : json["images"]) {
    if (!image.is_object() || !image.contains("name") || !image["name"].is_string())
      throw IoError(where + ": an image without a name, expected name, shift_x and shift_y");
    const std::string name = image["name"].get<std::string>();
    const std::string of = where + ": " + name;
    KnownShift known{{number_of(image, "shift_x", of), number_of(image, "shift_y", of)}};
    const auto at = two_of(image, "at", of), x = two_of(image, "slope_x", of),
               y = two_of(image, "slope_y", of);
    known.slope = {{at[0], at[1]}, {{{x[0] / kPer, x[1] / kPer}, {y[0] / kPer, y[1] / kPer}}}};
    if (!out.emplace(name, known).second)
      throw IoError(where + ": " + name + " comes twice, expected every image once");
  }
  return out;
}

}  // namespace satsurf::scene
