// SPDX-License-Identifier: Apache-2.0
// The tiles that a stopped run has left: plan, record and rasters.
#include "satsurf/app/tile_store.h"

#include <cmath>
#include <iterator>

#include "tests/fuzz/fuzz.h"

namespace satsurf::fuzz {

constexpr const char* kNames[] = {"plan.json", "tile_0001_0002.json", "tile_0001_0002.safetensors"};

void run(std::string_view bytes) {
  Bytes in(bytes);
  const char* name = kNames[in.take<std::uint8_t>() % std::size(kNames)];
  const auto tiles = folder().path() / "out.tiles";
  std::filesystem::create_directories(tiles);
  folder().put("out.tiles/plan.json", "{\"a\": 1.5}");
  folder().put(std::string("out.tiles/") + name, in.rest());
  const reconstruct::Tile tile{1, 2, {10, 20, 14, 23}, {8, 18, 16, 25}};
  {
    app::TileStore store(folder().path() / "out", true, false);
    only<IoError, ConfigError>([&] { store.begin({{"a", 1.5}}); });
    only<IoError>([&] {
      if (const auto record = store.find(tile))
        require(std::isfinite(record->z_range.low) && std::isfinite(record->z_range.high) &&
                    record->surfels >= 0 && record->found <= record->expected,
                "a record holds numbers of a tile");
    });
    only<IoError>([&] {
      const reconstruct::TileSurface surface = store.load(tile);
      const Shape all{7, 8};
      require(surface.heights.shape() == all && surface.confidence.shape() == all &&
                  (surface.sigma.empty() || surface.sigma.shape() == all) &&
                  surface.views.shape() == all &&
                  (surface.ortho.empty() ||
                   (surface.ortho.rank() == 3 && surface.ortho.slice0(0).shape() == all)),
              "rasters have the cells of their tile");
      for (const float h : surface.heights.values())
        require(!(std::abs(h) > 1e6F), "heights are on the Earth");
    });
  }
  std::error_code ignored;
  for (const char* each : kNames) std::filesystem::remove(tiles / each, ignored);
}

}  // namespace satsurf::fuzz
