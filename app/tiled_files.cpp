// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/tiled_files.h"

#include "satsurf/app/preview.h"
#include "satsurf/app/products.h"
#include "satsurf/app/surface_files.h"
#include "satsurf/core/files.h"
#include "satsurf/reconstruct/feather.h"
#include "satsurf/rpc/geoid.h"
#include "satsurf/rpc/read.h"
#include "satsurf/splat/ply.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <utility>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;
using reconstruct::Tile;
using reconstruct::Tiling;

constexpr Index kOverview = 4096;  // cells a side
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

/// Means of square blocks of cells that come row by row.
class Overview {
 public:
  Overview(Index height, Index width)
      : width_(width),
        block_(std::max<Index>(1, (std::max(height, width) + kOverview - 1) / kOverview)),
        columns_((width + block_ - 1) / block_),
        sum_(static_cast<std::size_t>((height + block_ - 1) / block_ * columns_)),
        count_(sum_.size()) {}

  void append(const Tensor& rows) {
    for (Index i = 0; i < rows.count(); ++i) {
      if (!std::isfinite(rows[i])) continue;
      const auto at =
          static_cast<std::size_t>((next_ + i / width_) / block_ * columns_ + i % width_ / block_);
      sum_[at] += static_cast<double>(rows[i]), ++count_[at];
    }
    next_ += rows.dim(0);
  }
  Index block() const { return block_; }
  Tensor means() const {
    Tensor out({static_cast<Index>(sum_.size()) / columns_, columns_}, kNan);
    for (std::size_t i = 0; i < sum_.size(); ++i)
      if (count_[i] > 0)
        out[static_cast<Index>(i)] = static_cast<float>(sum_[i] / static_cast<double>(count_[i]));
    return out;
  }

 private:
  Index width_, block_, columns_, next_ = 0;
  std::vector<double> sum_;
  std::vector<Index> count_;
};

/// Makes what lies outside of the polygons unknown.
/// values  [n W] or [C n W], from row y0 of the grid on
void leave_out(Tensor& values, Index y0, const reconstruct::Grid& grid,
               const rpc::LocalFrame& frame, const std::optional<rpc::Area>& polygons) {
  if (!polygons) return;
  const Tensor inside =
      polygons->cells(geo_grid(grid, frame, y0), values.dim(values.rank() - 2), grid.width);
  for (Index i = 0; i < values.count(); ++i)
    if (!(inside[i % inside.count()] > 0)) values[i] = kNan;
}

/// How many images see the cells of a tile, then what they show there, [1 + bands h w].
Tensor counts_and_colours_of(const reconstruct::TileSurface& tile, Index bands) {
  Tensor out({1 + bands, tile.views.dim(0), tile.views.dim(1)}, kNan);
  std::ranges::copy(tile.views.values(), out.data());
  if (!tile.ortho.empty()) std::ranges::copy(tile.ortho.values(), out.data() + tile.views.count());
  return out;
}

/// Some of the planes of [C H W].
Tensor planes_of(const Tensor& values, Index first, Index count) {
  const Index H = values.dim(1), W = values.dim(2);
  auto out = Tensor::uninitialised({count, H, W});
  std::copy_n(values.data() + first * H * W, out.count(), out.data());
  return out;
}

/// An orthophoto of stored values as colours: bytes as they are, wider ones between their first and
/// 99th percentile.
/// bytes  whether the file has bytes
Tensor as_colours(const Tensor& values, bool bytes) {
  const bool grey = values.rank() == 2;
  const Index P = grey ? values.count() : values.count() / values.dim(0),
              H = values.dim(grey ? 0 : 1), W = values.dim(grey ? 1 : 2);
  float low = 0, high = 255;
  if (!bytes) {
    std::vector<float> known;
    for (const float v : values.values())
      if (std::isfinite(v)) known.push_back(v);
    if (known.empty()) return Tensor({3, H, W}, kNan);
    const auto percentile = [&](std::size_t of_hundred) {
      const auto at = known.begin() + static_cast<std::ptrdiff_t>(known.size() * of_hundred / 100);
      std::nth_element(known.begin(), at, known.end());
      return *at;
    };
    low = percentile(1), high = std::max(percentile(99), low + 1e-6F);
  }
  Tensor out({3, H, W});
  for (Index c = 0; c < 3; ++c)
    for (Index i = 0; i < P; ++i) {
      const float v = values[(grey ? 0 : c) * P + i];
      out[c * P + i] = std::isfinite(v) ? std::clamp((v - low) / (high - low), 0.0F, 1.0F) : kNan;
    }
  return out;
}

}  // namespace

SurfaceOverview overview_of_files(const fs::path& folder, const TiledSurface& made, double step) {
  constexpr Index kMost = 2048;  // cells a side
  const Index H = made.dsm.z.dim(0), W = made.dsm.z.dim(1);
  const Index block = std::max<Index>(1, (std::max(H, W) + kMost - 1) / kMost);
  SurfaceOverview out;
  out.dsm = {block_means(made.dsm.z, block), made.dsm.x0, made.dsm.y0,
             made.dsm.step * static_cast<double>(block)};
  out.confidence = block_means(made.confidence, block);
  const auto factor = static_cast<Index>(std::lround(out.dsm.step / step));
  const auto reduced = [&](const char* name) {
    return rpc::read_reduced_raster(folder / name, factor).values;
  };
  out.views = reduced("views.tif");
  for (float& v : out.views.values()) v = std::round(v);
  if (is_file(folder / "height_sigma.tif")) out.sigma = reduced("height_sigma.tif");
  out.ortho =
      as_colours(reduced("ortho.tif"), rpc::read_info(folder / "ortho.tif").dtype == "uint8");
  return out;
}

TiledSurface write_tiled_surface(const fs::path& folder, const Tiling& tiling,
                                 const std::vector<TileRecord>& records, const TileStore& store,
                                 const scene::Scene& scene, bool colour, rpc::HeightDatum datum,
                                 const std::optional<rpc::Area>& polygons,
                                 const std::function<void(double)>& progress) {
  const rpc::LocalFrame& frame = scene.frame;
  const reconstruct::Grid& grid = tiling.grid;
  const SurfaceTags tags = surface_tags(scene, datum);
  const Index bands = colour ? 3 : 1;
  // Rasters of the surface that grow row by row.
  const auto growing = [&](const char* name, Index channels, const rpc::GeoTags& of) {
    return std::make_unique<rpc::GeoRasterRows>(folder / name, channels, grid.height, grid.width,
                                                geo_grid(grid, frame, 0), signed_tags(of));
  };
  const auto dsm = growing("dsm.tif", 1, tags.heights),
             confidence = growing("confidence.tif", 1, tags.confidence),
             views = growing("views.tif", 1, tags.views),
             ortho = growing("ortho.tif", bands, tags.ortho);
  std::unique_ptr<rpc::GeoRasterRows> sigma;
  reconstruct::FeatheredRows heights(tiling), sure(tiling), expected(tiling);
  reconstruct::OwnedRows seen(tiling, 1 + bands);
  Overview small(grid.height, grid.width), small_confidence(grid.height, grid.width);
  TiledSurface out;
  out.heights = {INFINITY, -INFINITY};
  double confidence_sum = 0, known = 0;
  Index done_rows = 0;
  std::vector<fs::path> surfels;
  bool has_sigma = false;
  for (std::size_t k = 0; k < records.size() && !has_sigma; ++k)
    if (records[k].status == "done") has_sigma = !store.load(tiling.tiles[k]).sigma.empty();
  if (has_sigma) sigma = growing("height_sigma.tif", 1, tags.sigma);

  // Writes the rows that no later tile reaches.
  const auto write_rows = [&](Index end) {
    const auto finished = [&](auto& rows) {
      Tensor t = rows.finished(end);
      leave_out(t, done_rows, grid, frame, polygons);
      return t;
    };
    const Tensor counts_and_colours = finished(seen);
    views->append(planes_of(counts_and_colours, 0, 1));
    Tensor picture = planes_of(counts_and_colours, 1, bands);
    keep_off_nodata(picture, tags.ortho);
    ortho->append(picture);
    Tensor z = finished(heights);
    const Tensor s = finished(sure);
    small.append(z), small_confidence.append(s);
    for (Index i = 0; i < z.count(); ++i) {
      if (!std::isfinite(z[i])) continue;
      confidence_sum += static_cast<double>(s[i]), known += 1;
      const double h = static_cast<double>(z[i]) + frame.h0;
      out.heights = {std::min(out.heights.low, h), std::max(out.heights.high, h)};
    }
    if (datum != rpc::HeightDatum::ellipsoid)
      rpc::refer_to_geoid(z, geo_grid(grid, frame, done_rows), datum);
    for (float& h : z.values()) h = static_cast<float>(static_cast<double>(h) + frame.h0);
    dsm->append(z), confidence->append(s);
    if (has_sigma) sigma->append(finished(expected));
    done_rows = end;
  };
  const std::vector<std::size_t> order = reconstruct::assembly_order(tiling);
  for (std::size_t n = 0; n < order.size(); ++n) {
    progress(static_cast<double>(n) / static_cast<double>(records.size() + 1));
    const Tile& tile = tiling.tiles[order[n]];
    const TileRecord& record = records[order[n]];
    if (tile.all.y0 > done_rows) write_rows(tile.all.y0);
    if (record.status != "done") continue;
    const reconstruct::TileSurface part = store.load(tile);
    if (part.sigma.empty() == has_sigma || (!part.ortho.empty() && part.ortho.dim(0) != bands))
      throw IoError(store.path().string() + ": tile " + std::to_string(tile.row) + " " +
                    std::to_string(tile.column) +
                    " has other rasters than the others, expected the tiles of one run");
    heights.add(tile, part.heights);
    sure.add(tile, part.confidence);
    if (has_sigma) expected.add(tile, part.sigma);
    seen.add(tile, counts_and_colours_of(part, bands));
    if (record.surfels > 0) surfels.push_back(store.surfels_of(tile));
  }
  if (done_rows < grid.height) write_rows(grid.height);
  for (rpc::GeoRasterRows* raster : {dsm.get(), confidence.get(), views.get(), ortho.get()}) {
    progress(static_cast<double>(records.size()) / static_cast<double>(records.size() + 1));
    raster->finish();
  }
  if (sigma) sigma->finish();
  const std::vector<Index> counted =
      splat::join_ply(folder / "surfels.ply", surfels, frame_comments(frame));
  for (std::size_t n = 0, k = 0; n < order.size(); ++n)
    if (const TileRecord& record = records[order[n]]; record.surfels > 0)
      store.check_surfels(tiling.tiles[order[n]], record, counted[k++]);
  out.dsm = {small.means(), grid.east, grid.north, grid.step * static_cast<double>(small.block())};
  out.confidence = small_confidence.means();
  out.mean_confidence = known > 0 ? confidence_sum / known : 0;
  return out;
}

}  // namespace satsurf::app
