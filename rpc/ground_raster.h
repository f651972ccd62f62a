// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"
#include "satsurf/rpc/height_range.h"
#include "satsurf/rpc/raster.h"

#include <array>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

namespace satsurf::rpc {

/// Ground that is not wanted: the polygons of a vector file (see `read_area`), or the cells of a
/// raster that have one of some values, else those that are neither 0 nor nodata; water and clouds,
/// say. Of any reference system; a raster
/// of DFC2019, with its grid in a text file beside it, lies in the zone that is asked for.
class GroundMask {
 public:
  /// values  of a raster that are not wanted, e.g. of its classes; none for all but 0 and nodata
  /// throws  IoError for a file that is neither, names no reference system or has no place;
  ///         ConfigError for values of polygons
  explicit GroundMask(const std::filesystem::path& path, std::vector<double> values = {});
  ~GroundMask();
  GroundMask(const GroundMask&) = delete;
  GroundMask& operator=(const GroundMask&) = delete;

  /// grid           in a zone of UTM
  /// height, width  its cells
  /// returns        [height width] 1 where the middle of a cell is not wanted, else 0
  /// throws         IoError; Error where PROJ knows no way into the zone, or for a grid in no zone
  Tensor on(const GeoGrid& grid, Index height, Index width) const;
  const std::filesystem::path& path() const { return path_; }

 private:
  struct Polygons;
  bool covers(float value) const;

  std::filesystem::path path_;
  std::vector<double> values_;
  std::unique_ptr<Polygons> polygons_;  ///< nothing for a raster
};

/// What a model of the terrain says of some ground.
struct TerrainHeights {
  HeightRange heights;  ///< lowest and highest, m above the WGS84 ellipsoid
  double covered = 0;   ///< share of the ground that it knows; 0 leaves the heights unset
  bool either = false;  ///< it does not say what its heights are above, so that these hold both the
                        ///< ellipsoid's and those of EGM96
};

/// A model of the terrain: a raster of heights in m in any reference system. A compound system says
/// what they are above, as does one of three axes or what `write_geo_raster` notes of the datum. One of
/// DFC2019, with its grid in a text file beside it, lies in the zone that is asked for.
class Terrain {
 public:
  /// throws  IoError for a file that is no raster with a place, or whose heights are not in m
  explicit Terrain(const std::filesystem::path& path);

  /// zone    of the ground
  /// ground  least easting and northing, then the largest, m
  /// throws  IoError; Error where PROJ knows no way into the zone or has no grid of the heights' datum
  TerrainHeights over(const UtmZone& zone, const std::array<double, 4>& ground) const;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace satsurf::rpc
