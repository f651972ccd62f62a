// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/tile_store.h"

#include "satsurf/app/log.h"
#include "satsurf/core/atomic_file.h"
#include "satsurf/core/error.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/core/files.h"
#include "satsurf/core/safetensors.h"
#include "satsurf/rpc/camera_check.h"
#include "satsurf/splat/ply.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>
#include <system_error>
#include <vector>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

constexpr const char* kPlan = "plan.json";
constexpr const char* kLock = "lock";

/// The first place where two values differ, and how; empty where they do not.
std::string difference(const nlohmann::json& was, const nlohmann::json& is,
                       const std::string& where) {
  if (was == is) return "";
  if (was.is_object() && is.is_object()) {
    for (const auto& [key, value] : is.items())
      if (const std::string text =
              difference(was.value(key, nlohmann::json()), value, where + "/" + key);
          !text.empty())
        return text;
    for (const auto& [key, value] : was.items())
      if (!is.contains(key))
        return where + "/" + key + " was " + json_text(value) + " and is missing";
  }
  if (was.is_array() && is.is_array() && was.size() == is.size())
    for (std::size_t i = 0; i < is.size(); ++i)
      if (const std::string text = difference(was[i], is[i], where + "/" + std::to_string(i));
          !text.empty())
        return text;
  return where + " was " + json_text(was).substr(0, 200) + " and is " +
         json_text(is).substr(0, 200);
}

fs::path folder_beside(const fs::path& out) {
  std::error_code error;
  fs::path path = fs::weakly_canonical(fs::absolute(out, error), error);
  if (error) throw IoError("--out: " + out.string() + " cannot be found (" + error.message() + ")");
  if (!path.has_filename()) path = path.parent_path();
  path += ".tiles";
  return path;
}

/// Numbers of a tile's record.
class Record {
 public:
  explicit Record(const fs::path& file) : file_(file.string()), json_(load_json_file(file)) {}

  std::string text(const char* key) const {
    const nlohmann::json& value = at(key);
    if (!value.is_string()) refuse(key, value, "a text");
    return value.get<std::string>();
  }
  double number(const char* key) const { return number(key, at(key)); }
  Index count(const char* key) const {
    const nlohmann::json& value = at(key);
    constexpr std::uint64_t kMost = std::uint64_t{1} << 53;
    if (!value.is_number_unsigned() || value.get<std::uint64_t>() > kMost)
      refuse(key, value, "a count");
    return value.get<Index>();
  }
  rpc::HeightRange range(const char* key) const {
    const nlohmann::json& value = at(key);
    if (!value.is_array() || value.size() != 2) refuse(key, value, "two numbers");
    return {number(key, value[0]), number(key, value[1])};
  }
  std::vector<std::string> texts(const char* key) const {
    const nlohmann::json& value = at(key);
    if (!value.is_array() || !std::all_of(value.begin(), value.end(),
                                          [](const nlohmann::json& v) { return v.is_string(); }))
      refuse(key, value, "texts");
    return value.get<std::vector<std::string>>();
  }
  /// A number within bounds.
  double number(const char* key, double least, double most) const {
    const double value = number(key);
    if (!(value >= least && value <= most))
      refuse(key, value, fmt::format("{:g} to {:g}", least, most));
    return value;
  }
  Index count(const char* key, Index least, Index most) const {
    const Index value = count(key);
    if (value < least || value > most) refuse(key, value, fmt::format("{} to {}", least, most));
    return value;
  }
  [[noreturn]] void refuse(const char* key, const nlohmann::json& came,
                           const std::string& wanted) const {
    throw IoError(file_ + ": " + key + " is " + json_text(came).substr(0, 200) + ", expected " +
                  wanted + "; not the record of a tile?");
  }

 private:
  const nlohmann::json& at(const char* key) const {
    const auto found = json_.is_object() ? json_.find(key) : json_.end();
    if (!json_.is_object() || found == json_.end())
      throw IoError(file_ + ": no " + key + ", expected the record of a tile");
    return *found;
  }
  double number(const char* key, const nlohmann::json& value) const {
    if (!value.is_number()) refuse(key, value, "a number");
    return value.get<double>();
  }

  std::string file_;
  nlohmann::json json_;
};

/// throws  IoError for a value of a tile's raster that is out of bounds; NaN is unknown
void check_values(const fs::path& path, const char* name, const Tensor& values, double least,
                  double most) {
  for (const float v : values.values())
    if (!std::isnan(v) && !(static_cast<double>(v) >= least && static_cast<double>(v) <= most))
      throw IoError(fmt::format("{}: {} holds {:g}, expected {:g} to {:g} or NaN", path.string(),
                                name, v, least, most));
}

/// Removes everything but the file that says whose folder it is.
/// returns  whether there was anything
bool empty_store(const fs::path& folder) {
  bool any = false;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error))
    if (entry.path().filename() != kLock && fs::remove(entry.path(), error)) any = true;
  return any;
}

/// Removes the folder, that file last: whoever is killed on the way leaves what the next run knows.
void remove_store(const fs::path& folder) {
  empty_store(folder);
  std::error_code error;
  fs::remove_all(folder, error);
}

void tell_removed(const fs::path& left) {
  log_line(LogLevel::info, left.string() + " removed, left by a stopped run");
}

}  // namespace

TileStore::TileStore(const fs::path& out, bool resume, bool overwrite)
    : folder_(folder_beside(out)) {
  const bool there = is_file(folder_ / kPlan);
  if (path_exists(folder_) && !there && !(is_folder(folder_) && fs::is_empty(folder_)) &&
      !is_file(folder_ / kLock))
    throw IoError("--out: " + folder_.string() +
                  " is in the way, expected nothing or the tiles of a stopped run there");
  if (there && !resume && !overwrite)
    throw IoError("--out: " + folder_.string() +
                  " holds the tiles of a stopped run, expected --resume to go on with them or "
                  "--overwrite to begin anew");
  std::error_code error;
  fs::create_directories(folder_, error);
  lock_ = ::open((folder_ / kLock).c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (lock_ < 0) throw IoError("--out: " + folder_.string() + " cannot be written");
  if (::flock(lock_, LOCK_EX | LOCK_NB) != 0) {
    ::close(lock_);
    throw IoError("--out: " + folder_.string() +
                  " is being worked on by another process, expected to have it alone");
  }
  if ((!there || !resume) && empty_store(folder_)) tell_removed(folder_);
}

TileStore::~TileStore() {
  if (lock_ < 0) return;
  if (!any()) remove_store(folder_);
  ::close(lock_);
}

void TileStore::begin(const nlohmann::json& plan) {
  const fs::path file = folder_ / kPlan;
  if (!is_file(file)) return atomic_write(file, json_text(plan, 1) + '\n');
  // as it was written, so that numbers compare as they were stored
  const std::string text =
      difference(load_json_file(file), parse_json(json_text(plan), "plan"), "");
  if (!text.empty())
    throw ConfigError("resume: " + folder_.string() + " holds the tiles of another run: " + text +
                      ", expected the same; --overwrite without --resume begins anew");
  for (const fs::path& left : remove_partial_files(folder_)) tell_removed(left);
}

bool TileStore::any() const {
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder_, error))
    if (entry.path().filename().string().starts_with("tile_")) return true;
  return false;
}

fs::path TileStore::file_of(const reconstruct::Tile& tile) const {
  return folder_ / fmt::format("tile_{:04}_{:04}.safetensors", tile.row, tile.column);
}

fs::path TileStore::surfels_of(const reconstruct::Tile& tile) const {
  return folder_ / fmt::format("tile_{:04}_{:04}.ply", tile.row, tile.column);
}

void TileStore::check_surfels(const reconstruct::Tile& tile, const TileRecord& record,
                              Index counted) const {
  if (counted != record.surfels)
    throw IoError(fmt::format("{}: {} surfels, expected {} as {} says", surfels_of(tile).string(),
                              counted, record.surfels, record_of(tile).filename().string()));
}

fs::path TileStore::record_of(const reconstruct::Tile& tile) const {
  return fs::path(file_of(tile)).replace_extension(".json");
}

std::optional<TileRecord> TileStore::find(const reconstruct::Tile& tile) const {
  const fs::path file = record_of(tile);
  if (!is_file(file)) return std::nullopt;
  const Record record(file);
  TileRecord out;
  out.status = record.text("status");
  // A tile that failed is not put down.
  if (out.status != "done" && out.status != "empty")
    record.refuse("status", out.status, "done or empty");
  const bool done = out.status == "done";
  constexpr double kLongest = 1e9;                               // s
  constexpr double kMostPixels = 1e6;                            // of a fitted camera's error
  constexpr Index kLargest = 1 << 20, kMostSurfels = INT32_MAX;  // px a side; as many as are drawn
  const Index cells = tile.core.height() * tile.core.width();
  out.seconds = record.number("seconds", 0, kLongest);
  out.expected = record.count("expected", 0, cells);  // what is found is among them
  out.found = record.count("found", 0, out.expected);
  constexpr Index kMostCompared = kMostSurfels * 16 * 16;  // each image's with each other image's
  out.compared = record.count("compared", 0, kMostCompared);
  out.agreed = record.count("agreed", 0, out.compared);
  out.levelled = record.count("levelled", 0, tile.all.height() * tile.all.width());
  out.evened = record.count("evened", 0, tile.all.height() * tile.all.width());
  const Index least = done ? 1 : 0;
  out.window = {record.count("window_height", least, kLargest),
                record.count("window_width", least, kLargest)};
  out.surfels = record.count("surfels", 0, done ? kMostSurfels : 0);
  out.z_range = record.range("z_range");
  if (done && !(out.z_range.has_span() && rpc::on_earth(out.z_range)))
    record.refuse("z_range", {out.z_range.low, out.z_range.high},
                  "lowest and highest, at most 1000 km either way");
  out.camera_fit_max_px = record.number("camera_fit_max_px", 0, kMostPixels);
  out.views = record.texts("views");
  if (done && out.views.size() < 2)
    record.refuse("views", out.views, "names of two images or more");
  if (done != is_file(file_of(tile)))
    record.refuse("status", out.status, done ? "rasters beside it" : "no rasters beside it");
  if ((out.surfels > 0) != is_file(surfels_of(tile)))
    record.refuse("surfels", out.surfels, "as many as the file beside it holds");
  return out;
}

void TileStore::save(const reconstruct::Tile& tile, const TileRecord& record,
                     const reconstruct::TileSurface& surface) {
  if (record.surfels > 0) splat::write_ply(surfels_of(tile), surface.surfels, {});
  if (!surface.empty) {
    TensorFile file;
    file.tensors = {
        {"heights", surface.heights}, {"confidence", surface.confidence}, {"views", surface.views}};
    if (!surface.sigma.empty()) file.tensors["sigma"] = surface.sigma;
    if (!surface.ortho.empty()) file.tensors["ortho"] = surface.ortho;
    save_safetensors(file_of(tile), file);
  }
  // The record comes last: with it the tile is finished.
  const nlohmann::json j{{"status", record.status},
                         {"seconds", record.seconds},
                         {"found", record.found},
                         {"expected", record.expected},
                         {"compared", record.compared},
                         {"agreed", record.agreed},
                         {"levelled", record.levelled},
                         {"evened", record.evened},
                         {"window_height", record.window.height},
                         {"window_width", record.window.width},
                         {"surfels", record.surfels},
                         {"z_range", {record.z_range.low, record.z_range.high}},
                         {"camera_fit_max_px", record.camera_fit_max_px},
                         {"views", record.views}};
  atomic_write(record_of(tile), json_text(j) + '\n');
}

reconstruct::TileSurface TileStore::load(const reconstruct::Tile& tile) const {
  const fs::path path = file_of(tile);
  TensorFile file = load_safetensors(path);
  reconstruct::TileSurface out;
  out.empty = false;
  const auto take = [&](const char* name, bool needed) {
    const auto found = file.tensors.find(name);
    if (found != file.tensors.end()) return found->second;
    if (needed) throw IoError(path.string() + ": no " + name + ", expected those of a tile");
    return Tensor();
  };
  out.heights = take("heights", true), out.confidence = take("confidence", true);
  out.views = take("views", true), out.sigma = take("sigma", false);
  out.ortho = take("ortho", false);
  const auto check = [&](const char* name, const Tensor& t, const reconstruct::CellRect& cells) {
    const Index rank = t.rank();
    const bool planes = t.rank() == 3 && std::string_view(name) == "ortho";
    if ((planes || rank == 2) && t.dim(rank - 2) == cells.height() &&
        t.dim(rank - 1) == cells.width())
      return;
    throw IoError(path.string() + ": " + name + " has shape " + t.shape().str() + ", expected " +
                  Shape{cells.height(), cells.width()}.str() + " of this tile");
  };
  check("heights", out.heights, tile.all), check("confidence", out.confidence, tile.all);
  check("views", out.views, tile.all);
  if (!out.sigma.empty()) check("sigma", out.sigma, tile.all);
  if (!out.ortho.empty()) check("ortho", out.ortho, tile.all);
  constexpr double kMostHeight = 1e6, kMostImages = 1e6, kRounding = 1e-3;  // m
  check_values(path, "heights", out.heights, -kMostHeight, kMostHeight);
  check_values(path, "confidence", out.confidence, 0, 1 + kRounding);
  check_values(path, "views", out.views, 0, kMostImages);
  check_values(path, "sigma", out.sigma, 0, kMostHeight);
  constexpr double kMostFloat = std::numeric_limits<float>::max();
  check_values(path, "ortho", out.ortho, -kMostFloat, kMostFloat);
  return out;
}

void TileStore::remove() {
  remove_store(folder_);
  ::close(lock_);
  lock_ = -1;
}

}  // namespace satsurf::app
