// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/warp.h"

#include "satsurf/rpc/gdal.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <exception>
#include <limits>
#include <memory>
#include <vector>

#include <gdalwarper.h>
#include <ogr_spatialref.h>

namespace satsurf::rpc {
namespace {

namespace fs = std::filesystem;

OGRSpatialReference system_from(const std::string& wkt) {
  OGRSpatialReference crs;
  if (crs.importFromWkt(wkt.c_str()) != OGRERR_NONE)
    throw Error("warp: a reference system of unreadable WKT, expected that of a projected one");
  crs.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  return crs;
}

/// A system without its heights: what becomes of these is not the warp's business.
OGRSpatialReference ground_of(const OGRSpatialReference& crs) {
  OGRSpatialReference out(crs);
  if (out.IsCompound()) out.StripVertical();
  out.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  return out;
}

/// A projected system with the heights of another.
OGRSpatialReference with_heights(const OGRSpatialReference& ground,
                                 const OGRSpatialReference& other) {
  const char* code = other.IsCompound() ? other.GetAuthorityCode("VERT_CS") : nullptr;
  OGRSpatialReference up, both;
  if (code == nullptr || up.importFromEPSG(std::atoi(code)) != OGRERR_NONE) return ground;
  const std::string name = std::string(ground.GetName()) + " + " + up.GetName();
  if (both.SetCompoundCS(name.c_str(), &ground, &up) != OGRERR_NONE)
    throw Error(name + ": cannot be made (" + gdal_error() +
                "), expected systems that go together");
  both.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  return both;
}

using TransformPtr = std::unique_ptr<OGRCoordinateTransformation>;
/// throws  Error where PROJ could only guess
TransformPtr transform_between(const OGRSpatialReference& from, const OGRSpatialReference& to) {
  OGRCoordinateTransformationOptions options;
  options.SetBallparkAllowed(false);
  TransformPtr out(OGRCreateCoordinateTransformation(&from, &to, options));
  if (!out)
    throw Error(std::string("PROJ knows no way from ") + from.GetName() + " to " + to.GetName() +
                " (" + gdal_error() + "), expected systems of known datums");
  return out;
}

struct TransformerDeleter {
  void operator()(void* t) const { GDALDestroyTransformer(t); }
};
using TransformerPtr = std::unique_ptr<void, TransformerDeleter>;

/// From the cells of one raster to those of another, to a hundredth of a cell.
TransformerPtr transformer_between(GDALDataset& from, const OGRSpatialReference& from_ground,
                                   GDALDataset& to, const OGRSpatialReference& to_ground) {
  constexpr double kExact = 0.01;  // cells
  CPLStringList options;
  options.SetNameValue("SRC_SRS", wkt_of(from_ground, "WKT2_2019").c_str());
  options.SetNameValue("DST_SRS", wkt_of(to_ground, "WKT2_2019").c_str());
  options.SetNameValue("ALLOW_BALLPARK", "NO");
  void* exact = GDALCreateGenImgProjTransformer2(&from, &to, options.List());
  if (exact == nullptr)
    throw Error(std::string("no way from ") + from_ground.GetName() + " to " + to_ground.GetName() +
                " (" + gdal_error() + "), expected systems of known datums");
  void* fast = GDALCreateApproxTransformer(GDALGenImgProjTransform, exact, kExact);
  GDALApproxTransformerOwnsSubtransformer(fast, TRUE);
  return TransformerPtr(fast);
}

/// What a caller's progress has thrown waits here while GDAL's frames are left.
struct Watched {
  const std::function<void(double)>& progress;
  std::exception_ptr thrown;
};
int CPL_STDCALL watch(double share, const char*, void* to) {
  auto& watched = *static_cast<Watched*>(to);
  try {
    if (watched.progress) watched.progress(share);
  } catch (...) {
    watched.thrown = std::current_exception();
    return FALSE;
  }
  return TRUE;
}

/// Fills a raster from another.
/// nodata  of the target
void warp(GDALDataset& from, const OGRSpatialReference& from_ground, GDALDataset& to,
          const OGRSpatialReference& to_ground, GDALResampleAlg how, double nodata,
          const std::function<void(double)>& progress) {
  const TransformerPtr transformer = transformer_between(from, from_ground, to, to_ground);
  const std::unique_ptr<GDALWarpOptions, decltype(&GDALDestroyWarpOptions)> options(
      GDALCreateWarpOptions(), &GDALDestroyWarpOptions);
  const int bands = to.GetRasterCount();
  options->hSrcDS = &from, options->hDstDS = &to;
  options->eResampleAlg = how;
  options->dfWarpMemoryLimit = 64e6;
  options->nBandCount = bands;
  const auto list = [&](auto value) {
    using T = decltype(value);
    T* made = static_cast<T*>(CPLMalloc(sizeof(T) * static_cast<std::size_t>(bands)));
    std::fill_n(made, bands, value);
    return made;
  };
  options->panSrcBands = list(0), options->panDstBands = list(0);
  for (int b = 0; b < bands; ++b) options->panSrcBands[b] = options->panDstBands[b] = b + 1;
  int has_nodata = 0;
  const double says_nothing = from.GetRasterBand(1)->GetNoDataValue(&has_nodata);
  if (has_nodata) {
    options->padfSrcNoDataReal = list(says_nothing);
    options->papszWarpOptions =
        CSLSetNameValue(options->papszWarpOptions, "UNIFIED_SRC_NODATA", "YES");
  }
  options->padfDstNoDataReal = list(nodata);
  options->papszWarpOptions = CSLSetNameValue(options->papszWarpOptions, "INIT_DEST", "NO_DATA");
  options->pfnTransformer = GDALApproxTransform;
  options->pTransformerArg = transformer.get();
  Watched watched{progress, nullptr};
  options->pfnProgress = watch, options->pProgressArg = &watched;
  GDALWarpOperation operation;
  const bool done =
      operation.Initialize(options.get()) == CE_None &&
      operation.ChunkAndWarpImage(0, 0, to.GetRasterXSize(), to.GetRasterYSize()) == CE_None;
  if (watched.thrown) std::rethrow_exception(watched.thrown);
  if (!done) throw Error("the values cannot be brought onto another grid; " + gdal_error());
}

}  // namespace

Tensor first_band_on(GDALDataset& d, const OGRSpatialReference& crs, const GeoGrid& grid,
                     Index height, Index width, Sampled how) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  OGRSpatialReference wanted;
  if (wanted.importFromEPSG(grid.epsg) != OGRERR_NONE)
    throw Error("EPSG:" + std::to_string(grid.epsg) + ": not known to GDAL, expected UTM");
  wanted.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  GDALDriver* memory = GetGDALDriverManager()->GetDriverByName("MEM");
  const DatasetPtr made(memory == nullptr
                            ? nullptr
                            : memory->Create("", static_cast<int>(width), static_cast<int>(height),
                                             1, GDT_Float32, nullptr));
  if (!made) throw Error("a grid in memory cannot be made; " + gdal_error());
  std::array<double, 6> place{grid.x0, grid.step, 0, grid.y0, 0, -grid.step};
  made->SetGeoTransform(place.data());
  const GDALResampleAlg algorithm = how == Sampled::lowest    ? GRA_Min
                                    : how == Sampled::highest ? GRA_Max
                                                              : GRA_NearestNeighbour;
  warp(d, ground_of(crs), *made, wanted, algorithm, static_cast<double>(kNan), {});
  auto out = Tensor::uninitialised({height, width});
  if (made->GetRasterBand(1)->RasterIO(
          GF_Read, 0, 0, static_cast<int>(width), static_cast<int>(height), out.data(),
          static_cast<int>(width), static_cast<int>(height), GDT_Float32, 0, 0, nullptr) != CE_None)
    throw Error("a grid in memory cannot be read; " + gdal_error());
  return out;
}

ProjectedGrid covering_grid(const GeoGrid& grid, Index height, Index width,
                            const ProjectedCrs& crs) {
  constexpr int kParts = 32;  // of a side; in between the outline bends less than a cell
  const GdalScope scope;
  OGRSpatialReference from;
  if (from.importFromEPSG(grid.epsg) != OGRERR_NONE)
    throw Error("EPSG:" + std::to_string(grid.epsg) + ": not known to GDAL, expected UTM");
  from.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  const TransformPtr transform = transform_between(from, system_from(crs.wkt));
  std::vector<double> x, y;
  for (int i = 0; i <= kParts; ++i)
    for (int j = 0; j <= kParts; ++j) {
      if (i != 0 && i != kParts && j != 0 && j != kParts) continue;
      x.push_back(grid.x0 + static_cast<double>(width) * grid.step * j / kParts);
      y.push_back(grid.y0 - static_cast<double>(height) * grid.step * i / kParts);
    }
  std::vector<int> done(x.size(), 0);
  const bool all = transform->Transform(static_cast<int>(x.size()), x.data(), y.data(), nullptr,
                                        nullptr, done.data()) != 0;
  if (!all || !std::ranges::all_of(x, [](double v) { return std::isfinite(v); }) ||
      !std::ranges::all_of(y, [](double v) { return std::isfinite(v); }))
    throw Error("the ground cannot be brought into " + crs.label + " (" + gdal_error() +
                "), expected a system that is made for it");
  const auto [west, east] = std::ranges::minmax_element(x);
  const auto [south, north] = std::ranges::minmax_element(y);
  ProjectedGrid out{crs,
                    std::floor(*west / grid.step) * grid.step,
                    std::ceil(*north / grid.step) * grid.step,
                    grid.step,
                    0,
                    0};
  out.width = std::max<Index>(1, static_cast<Index>(std::ceil((*east - out.x0) / out.step)));
  out.height = std::max<Index>(1, static_cast<Index>(std::ceil((out.y0 - *south) / out.step)));
  constexpr double kMost = 100;  // times the cells there were
  if (static_cast<double>(out.width) * static_cast<double>(out.height) >
      kMost * static_cast<double>(width + 100) * static_cast<double>(height + 100))
    throw Error(crs.label + " draws the ground out to " + std::to_string(out.width) + " x " +
                std::to_string(out.height) + " cells, expected a system that is made for it");
  return out;
}

void warp_raster(const fs::path& path, const ProjectedGrid& grid, Resampling how,
                 const std::function<void(double)>& progress) {
  const GdalScope scope;
  DatasetPtr from = open_raster(path);
  const OGRSpatialReference* was = from->GetSpatialRef();
  if (was == nullptr)
    throw IoError(path.string() + ": names no reference system, expected a zone of UTM");
  const OGRSpatialReference from_ground = ground_of(*was), ground = system_from(grid.crs.wkt);
  const OGRSpatialReference crs = with_heights(ground, *was);
  const TemporaryFile rows(path.string() + ".rows");
  GDALRasterBand* first = from->GetRasterBand(1);
  const int bands = from->GetRasterCount();
  DatasetPtr to =
      bare_raster(path, rows.path(), bands, grid.height, grid.width, first->GetRasterDataType());
  const auto check = [&](bool done) {
    if (!done) throw IoError(path.string() + ": the GeoTIFF cannot be made; " + gdal_error());
  };
  check(to->SetSpatialRef(&crs) == CE_None);
  std::array<double, 6> place{grid.x0, grid.step, 0, grid.y0, 0, -grid.step};
  check(to->SetGeoTransform(place.data()) == CE_None);
  check(to->SetMetadata(from->GetMetadata()) == CE_None);
  int has_nodata = 0;
  const double nodata = first->GetNoDataValue(&has_nodata);
  if (!has_nodata) throw IoError(path.string() + ": declares no nodata, expected it");
  for (int b = 1; b <= bands; ++b) {
    GDALRasterBand &of = *from->GetRasterBand(b), &band = *to->GetRasterBand(b);
    check(band.SetNoDataValue(nodata) == CE_None);
    check(band.SetUnitType(of.GetUnitType()) == CE_None);
    band.SetDescription(of.GetDescription());
    if (bands == 3) check(band.SetColorInterpretation(of.GetColorInterpretation()) == CE_None);
  }
  warp(*from, from_ground, *to, ground,
       how == Resampling::bilinear ? GRA_Bilinear : GRA_NearestNeighbour, nodata, progress);
  from.reset();
  write_cog(path, *to, how == Resampling::bilinear);
}

}  // namespace satsurf::rpc
