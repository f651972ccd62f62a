// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/tile.h"

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace satsurf::app {

/// What is known of a tile besides its surface.
struct TileRecord {
  std::string status = "empty";  ///< done, empty or failed, which is not put down
  double seconds = 0;
  Index found = 0, expected = 0, surfels = 0;
  Index compared = 0, agreed = 0;  ///< see Reconstruction
  Index levelled = 0, evened = 0;  ///< see TileSurface
  scene::WindowSize window;        ///< px
  rpc::HeightRange z_range;        ///< that was searched, local m
  double camera_fit_max_px = 0;
  std::vector<std::string> views;  ///< names of the images that it is made of
  std::string error;               ///< of a failed one
};

/// The finished tiles of a run, in a folder beside its output, OUT.tiles: it outlives a run that was
/// stopped or killed, and the same run finds them again. Each tile appears whole or not at all.
class TileStore {
 public:
  /// resume     go on with the tiles that are there; without, they are in the way
  /// overwrite  remove them instead
  /// throws     IoError where tiles are in the way, or another process works on them
  TileStore(const std::filesystem::path& out, bool resume, bool overwrite);
  /// Removes the folder if it holds no tile.
  ~TileStore();
  TileStore(const TileStore&) = delete;
  TileStore& operator=(const TileStore&) = delete;

  /// Notes what the tiles depend on, or checks that those that are there depend on the same and then
  /// removes what else a killed run left with them.
  /// throws  ConfigError naming the first thing that differs
  void begin(const nlohmann::json& plan);
  /// Whether any tile is finished.
  bool any() const;
  /// What became of a tile; nothing while it is not finished.
  /// throws  IoError for a record that says what no tile can be
  std::optional<TileRecord> find(const reconstruct::Tile& tile) const;
  /// Puts a finished tile down; the surfels go into a file of their own.
  /// throws  IoError
  void save(const reconstruct::Tile& tile, const TileRecord& record,
            const reconstruct::TileSurface& surface);
  /// The rasters of a tile that is done.
  /// throws  IoError, also for other cells than the tile's and for values that are none of a surface
  reconstruct::TileSurface load(const reconstruct::Tile& tile) const;
  /// The file of its surfels.
  std::filesystem::path surfels_of(const reconstruct::Tile& tile) const;
  /// counted  surfels of that file
  /// throws   IoError unless they are as many as its record says
  void check_surfels(const reconstruct::Tile& tile, const TileRecord& record, Index counted) const;
  /// Removes everything: the tiles have become a surface.
  void remove();

  const std::filesystem::path& path() const { return folder_; }

 private:
  std::filesystem::path file_of(const reconstruct::Tile& tile) const;
  std::filesystem::path record_of(const reconstruct::Tile& tile) const;

  std::filesystem::path folder_;
  int lock_ = -1;
};

}  // namespace satsurf::app
