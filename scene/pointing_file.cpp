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
// What no pointing is off by, and no image is as large as.
constexpr double kMostShift = 100000, kMostSlope = 1000, kFarthest = 10000000;  // px

Json residual_json(const PairResidual& pair) {
  return {{"across", pair.ties > 0 ? Json(pair.across) : Json()},
          {"along", pair.along ? Json(*pair.along) : Json()}};
}

/// Whether it is a number from -most to most.
bool within(const nlohmann::json& value, double most) {
  return value.is_number() && std::abs(value.get<double>()) <= most;
}

std::string limits(double most) {
  const std::string end = std::to_string(static_cast<long>(most));
  return " from -" + end + " to " + end;
}

double number_of(const nlohmann::json& image, const char* key, double most,
                 const std::string& where) {
  const auto at = image.find(key);
  if (at == image.end() || !within(*at, most))
    throw IoError(where + ": expected a number " + key + limits(most));
  return at->get<double>();
}

/// Two numbers, 0 where there are none of the name.
std::array<double, 2> two_of(const nlohmann::json& image, const char* key, double most,
                             const std::string& where) {
  const auto at = image.find(key);
  if (at == image.end()) return {};
  if (!at->is_array() || at->size() != 2 || !within((*at)[0], most) || !within((*at)[1], most))
    throw IoError(where + ": expected two numbers " + key + limits(most));
  return {(*at)[0].get<double>(), (*at)[1].get<double>()};
}

}  // namespace

void write_pointing(const std::filesystem::path& path, const Pointing& pointing) {
  Json images = Json::array(), pairs = Json::array();
  for (std::size_t i = 0; i < pointing.names.size(); ++i) {
    Json& image = images.emplace_back(Json{{"name", pointing.names[i]},
                                           {"shift_x", pointing.shifts[i].x},
                                           {"shift_y", pointing.shifts[i].y}});
    if (!pointing.marks.empty()) image["camera"] = pointing.marks[i];
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
  // Names of files may be no UTF-8.
  atomic_write(path, json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n");
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
    KnownShift known{
        {number_of(image, "shift_x", kMostShift, of), number_of(image, "shift_y", kMostShift, of)}};
    if (const auto mark = image.find("camera"); mark != image.end()) {
      if (!mark->is_string()) throw IoError(of + ": expected a text camera");
      known.mark = mark->get<std::string>();
    }
    const auto at = two_of(image, "at", kFarthest, of),
               x = two_of(image, "slope_x", kMostSlope, of),
               y = two_of(image, "slope_y", kMostSlope, of);
    known.slope = {{at[0], at[1]}, {{{x[0] / kPer, x[1] / kPer}, {y[0] / kPer, y[1] / kPer}}}};
    if (!out.emplace(name, known).second)
      throw IoError(where + ": " + name + " comes twice, expected every image once");
  }
  return out;
}

}  // namespace satsurf::scene
