// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/rng.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/rpc/read.h"

#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "tests/ref/rpc_data.h"
#include "tests/temp_folder.h"
#include <cpl_conv.h>
#include <doctest/doctest.h>
#include <gdal_priv.h>
#include <sys/syscall.h>
#include <unistd.h>

using namespace satsurf;
using namespace satsurf::rpc;

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

Tensor heights(const Shape& shape, std::uint64_t seed) {
  Rng rng(seed);
  return uniform_tensor<float>(shape, rng, -30, 200);
}

bool same(const Tensor& a, const Tensor& b) {
  if (!(a.shape() == b.shape())) return false;
  for (Index i = 0; i < a.count(); ++i)
    if (!(a[i] == b[i] || (std::isnan(a[i]) && std::isnan(b[i])))) return false;
  return true;
}

std::vector<std::string>* flushed = nullptr;  ///< names of what `fsync` was called for, if wanted

/// What a plain GDAL user writes, with the given placement.
void plain_tiff(const std::filesystem::path& path, std::array<double, 6> transform, int epsg) {
  GDALAllRegister();
  auto* driver = GetGDALDriverManager()->GetDriverByName("GTiff");
  std::unique_ptr<GDALDataset> d(driver->Create(path.c_str(), 4, 3, 1, GDT_Float32, nullptr));
  REQUIRE(d);
  d->SetGeoTransform(transform.data());
  if (epsg != 0) {
    OGRSpatialReference crs;
    crs.importFromEPSG(epsg);
    d->SetSpatialRef(&crs);
  }
}

}  // namespace

/// Stands for the C library's in this program.
extern "C" int fsync(int file) {
  if (flushed != nullptr)
    flushed->push_back(
        std::filesystem::read_symlink("/proc/self/fd/" + std::to_string(file)).string());
  return static_cast<int>(::syscall(SYS_fsync, file));
}

TEST_CASE("a raster is on the disk before it takes its place, and its name after that") {
  const test::TempFolder scratch("flushed");
  const std::string folder = std::filesystem::canonical(scratch.path()).string();
  const GeoGrid grid{32617, 500000, 3350000, 0.5};
  GeoRasterRows rows(scratch / "rows.tif", 1, 4, 3, grid, ellipsoidal_height("x"));
  rows.append(heights({4, 3}, 1));
  std::vector<std::string> seen;
  flushed = &seen;
  try {
    rows.finish();
  } catch (...) {
    flushed = nullptr;
    throw;
  }
  flushed = nullptr;
  CHECK(seen == std::vector<std::string>{folder + "/rows.tif.part", folder});
  CHECK(std::filesystem::exists(scratch / "rows.tif"));
}

TEST_CASE("rasters on one grid, and on another") {
  const auto raster = [](Index rows, Index columns, const GeoGrid& grid) {
    return GeoRaster{Tensor({rows, columns}), grid, {}};
  };
  const GeoGrid grid{32617, 435000, 3354000, 0.5};
  const GeoRaster known = raster(4, 6, grid);
  const auto says = [&](const GeoRaster& other) {
    return test::error_of<IoError>([&] { require_same_grid("a.tif", other, "b.tif", known); });
  };
  CHECK(says(raster(4, 6, grid)) == "no exception");
  CHECK(says(raster(4, 6, {0, grid.x0, grid.y0, grid.step})) == "no exception");
  CHECK(says(raster(4, 6, {32617, grid.x0 + 0.25, grid.y0 - 0.25, grid.step})) == "no exception");
  const std::string expected =
      ", expected the grid of b.tif, 6 x 4 cells of 0.5 m from 435000, 3354000 in EPSG:32617";
  CHECK(says(raster(4, 5, grid)) ==
        "a.tif: 5 x 4 cells of 0.5 m from 435000, 3354000 in EPSG:32617" + expected);
  CHECK(says(raster(4, 6, {0, 435000.5, 3354000, 0.5})) ==
        "a.tif: 6 x 4 cells of 0.5 m from 435000.5, 3354000" + expected);
  CHECK(says(raster(4, 6, {32617, 435000, 3354000, 0.6})) ==
        "a.tif: 6 x 4 cells of 0.6 m from 435000, 3354000 in EPSG:32617" + expected);
  CHECK(says(raster(4, 6, {32618, 435000, 3354000, 0.5})) ==
        "a.tif: 6 x 4 cells of 0.5 m from 435000, 3354000 in EPSG:32618" + expected);
  CHECK(says({Tensor({3, 4, 6}), grid, {}}) ==
        "a.tif: 6 x 4 cells of 0.5 m from 435000, 3354000 in EPSG:32617, 3 bands" + expected);
}

TEST_CASE("a system of no place on the Earth names none") {
  const test::TempFolder scratch("local");
  const auto path = scratch / "x.tif";
  plain_tiff(path, {435000, 0.5, 0, 3354000, 0, -0.5}, 0);
  {
    const std::unique_ptr<GDALDataset> d(GDALDataset::Open(path.c_str(), GDAL_OF_UPDATE));
    OGRSpatialReference crs;
    REQUIRE(crs.SetLocalCS("a drawing") == OGRERR_NONE);
    crs.SetLinearUnits("metre", 1);
    REQUIRE(d->SetSpatialRef(&crs) == CE_None);
  }
  CHECK_FALSE(read_info(path).local_crs.empty());
  CHECK(read_geo_raster(path, UtmZone{17, true}).grid.epsg == 32617);
  CHECK(read_geo_raster(path).grid.epsg == 0);
}

TEST_CASE("a reduced raster has the means of blocks, and of the last ones what there is") {
  const test::TempFolder folder("reduced");
  Tensor values({5, 7});
  for (Index i = 0; i < 35; ++i) values[i] = static_cast<float>(i);
  values[0] = std::nanf("");
  for (const Index i : {4, 5, 11, 12}) values[i] = std::nanf("");  // all of a block
  write_geo_raster(folder / "a.tif", values, {32631, 500000, 4000000, 2});
  const GeoRaster small = read_reduced_raster(folder / "a.tif", 2);
  REQUIRE(small.values.shape() == Shape{3, 4});
  CHECK(small.grid == GeoGrid{32631, 500000, 4000000, 4});
  CHECK(small.values[0] == doctest::Approx((1 + 7 + 8) / 3.0));
  CHECK(std::isnan(small.values[2]));
  CHECK(small.values[3] == doctest::Approx((6 + 13) / 2.0));
  CHECK(small.values[11] == 34);
  CHECK(read_reduced_raster(folder / "a.tif", 1).values[34] == 34);
  CHECK_THROWS_AS(read_reduced_raster(folder / "a.tif", 0), Error);
}

TEST_CASE("a DSM survives the round trip with system, nodata, unit and datum") {
  const test::TempFolder scratch("raster");
  Tensor z = heights({37, 301}, 1);  // more than one tile wide, ragged
  z[0] = z[5000] = kNan;
  z[7] = std::numeric_limits<float>::infinity();
  const GeoGrid grid{UtmZone{17, true}.epsg(), 435000.25, 3358000.75, 0.3};
  GeoTags tags = ellipsoidal_height("surface model");
  tags.band_names = {"height"};
  write_geo_raster(scratch / "dsm.tif", z, grid, tags);

  const GeoRaster back = read_geo_raster(scratch / "dsm.tif");
  z[7] = kNan;
  CHECK(same(back.values, z));
  CHECK(back.grid == grid);
  CHECK(back.tags.unit == "m");
  CHECK(back.tags.description == "surface model");
  CHECK(back.tags.band_names == std::vector<std::string>{"height"});
  CHECK(back.tags.metadata.at("VERTICAL_DATUM") == "WGS84 ellipsoid");
  CHECK(back.tags.metadata.at("AREA_OR_POINT") == "Area");

  // As another program sees it.
  const std::unique_ptr<GDALDataset> d(GDALDataset::Open((scratch / "dsm.tif").c_str()));
  REQUIRE(d);
  CHECK(d->GetRasterBand(1)->GetNoDataValue() == -9999);
  CHECK(std::string(d->GetRasterBand(1)->GetUnitType()) == "m");
  CHECK(std::string(d->GetMetadataItem("COMPRESSION", "IMAGE_STRUCTURE")) == "DEFLATE");
  CHECK(std::string(d->GetMetadataItem("PREDICTOR", "IMAGE_STRUCTURE")) == "3");
  int bx = 0, by = 0;
  d->GetRasterBand(1)->GetBlockSize(&bx, &by);
  CHECK(bx == 512);
  CHECK(by == 512);
  CHECK(std::string(d->GetMetadataItem("LAYOUT", "IMAGE_STRUCTURE")) == "COG");
  REQUIRE(d->GetSpatialRef());
  CHECK(std::string(d->GetSpatialRef()->GetAuthorityCode(nullptr)) == "32617");
  // Only the file itself is left in the folder.
  CHECK(std::distance(std::filesystem::directory_iterator(scratch.path()), {}) == 1);
}

TEST_CASE("heights above a geoid are a compound system, and come back as such") {
  const test::TempFolder scratch("raster");
  const Tensor z = heights({4, 3}, 7);
  for (const auto& [datum, code] :
       {std::pair{HeightDatum::egm96, "5773"}, {HeightDatum::egm2008, "3855"}}) {
    write_geo_raster(scratch / "a.tif", z, {32740, 1, 2, 3}, height_tags("x", datum));
    const GeoRaster back = read_geo_raster(scratch / "a.tif");
    CHECK(back.grid.epsg == 32740);
    CHECK(back.tags.heights == datum);
    CHECK(back.tags.metadata.at("VERTICAL_DATUM") == datum_text(datum));
    const std::unique_ptr<GDALDataset> d(GDALDataset::Open((scratch / "a.tif").c_str()));
    REQUIRE(d->GetSpatialRef());
    CHECK(d->GetSpatialRef()->IsCompound());
    CHECK(std::string(d->GetSpatialRef()->GetAuthorityCode("VERT_CS")) == code);
    CHECK(std::string(d->GetSpatialRef()->GetAuthorityCode("PROJCS")) == "32740");
  }
  write_geo_raster(scratch / "b.tif", z, {32740, 1, 2, 3}, ellipsoidal_height("x"));
  CHECK(read_geo_raster(scratch / "b.tif").tags.heights == HeightDatum::ellipsoid);
  write_geo_raster(scratch / "c.tif", z, {32740, 1, 2, 3});
  CHECK(read_geo_raster(scratch / "c.tif").tags.heights == HeightDatum::none);
}

TEST_CASE("overviews are means of the known cells, or one of the values") {
  const test::TempFolder scratch("raster");
  Tensor z({700, 1100}, 3.0F);
  for (Index i = 0; i < z.count(); ++i) z[i] = i % 2 == 0 ? 8.0F : kNan;
  write_geo_raster(scratch / "mean.tif", z, {32740, 1, 2, 3}, GeoTags{.software = "me 1.2"});
  CHECK(read_geo_raster(scratch / "mean.tif").tags.software == "me 1.2");
  for (Index i = 0; i < z.count(); ++i) z[i] = i % 2 == 0 ? 1.0F : 7.0F;
  write_geo_raster(scratch / "one.tif", z, {32740, 1, 2, 3},
                   GeoTags{.type = CellType::uint8, .nodata = 255, .means = false});
  const auto overview = [&](const char* name) {
    const std::unique_ptr<GDALDataset> d(GDALDataset::Open((scratch / name).c_str()));
    REQUIRE(d->GetRasterBand(1)->GetOverviewCount() >= 1);
    GDALRasterBand* band = d->GetRasterBand(1)->GetOverview(0);
    CHECK(band->GetXSize() == 550);
    float v = 0;
    REQUIRE(band->RasterIO(GF_Read, 200, 100, 1, 1, &v, 1, 1, GDT_Float32, 0, 0, nullptr) ==
            CE_None);
    return v;
  };
  CHECK(overview("mean.tif") == 8);
  const float one = overview("one.tif");
  CHECK((one == 1 || one == 7));
}

TEST_CASE("whole numbers are rounded and clipped, and three bands of them are a picture") {
  const test::TempFolder scratch("raster");
  Tensor v = Tensor::from({3, 1, 2}, {1.6F, kNan, -4, 300, 254.4F, 70000});
  write_geo_raster(scratch / "a.tif", v, {32740, 1, 2, 3},
                   GeoTags{.unit = "", .type = CellType::uint8, .nodata = 0});
  CHECK(same(read_geo_raster(scratch / "a.tif").values,
             Tensor::from({3, 1, 2}, {2, kNan, kNan, 255, 254, 255})));
  write_geo_raster(scratch / "b.tif", v, {32740, 1, 2, 3},
                   GeoTags{.unit = "", .type = CellType::uint16, .nodata = 0});
  CHECK(same(read_geo_raster(scratch / "b.tif").values,
             Tensor::from({3, 1, 2}, {2, kNan, kNan, 300, 254, 65535})));
  const std::unique_ptr<GDALDataset> d(GDALDataset::Open((scratch / "b.tif").c_str()));
  CHECK(d->GetRasterBand(1)->GetRasterDataType() == GDT_UInt16);
  CHECK(d->GetRasterBand(1)->GetColorInterpretation() == GCI_RedBand);
  CHECK(d->GetRasterBand(3)->GetColorInterpretation() == GCI_BlueBand);
}

TEST_CASE("several bands, a southern zone, no system") {
  const test::TempFolder scratch("raster");
  const Tensor z = heights({3, 5, 7}, 2);
  write_geo_raster(scratch / "a.tif", z, {UtmZone{40, false}.epsg(), 1, 2, 3});
  GeoRaster back = read_geo_raster(scratch / "a.tif");
  CHECK(same(back.values, z));
  CHECK(back.grid.epsg == 32740);
  write_geo_raster(scratch / "b.tif", z, {0, 1, 2, 3}, GeoTags{.unit = ""});
  back = read_geo_raster(scratch / "b.tif");
  CHECK(back.grid.epsg == 0);
  CHECK(back.tags.unit.empty());
  CHECK(back.tags.band_names.empty());
  CHECK(read_geo_raster(scratch / "b.tif", UtmZone{5, true}).grid.epsg == 32605);
}

TEST_CASE("one pixel is a raster") {
  const test::TempFolder scratch("raster");
  const Tensor z = heights({1, 1}, 3);
  write_geo_raster(scratch / "one.tif", z, {32631, 500000, 5000000, 0.5});
  CHECK(same(read_geo_raster(scratch / "one.tif").values, z));
}

TEST_CASE("the same values give the same bytes, over an older file too") {
  const test::TempFolder scratch("raster");
  const Tensor z = heights({65, 33}, 4);
  const GeoGrid grid{32617, 1, 2, 0.5};
  test::write_bytes(scratch / "a.tif", "what stood here before");
  write_geo_raster(scratch / "a.tif", z, grid, ellipsoidal_height("x"));
  write_geo_raster(scratch / "b.tif", z, grid, ellipsoidal_height("x"));
  const std::string a = test::read_bytes(scratch / "a.tif");
  CHECK(a.size() > 1000);
  CHECK(a == test::read_bytes(scratch / "b.tif"));
  const Tensor rgb = heights({3, 9, 11}, 5);
  write_rpc_geotiff(scratch / "c.tif", rgb, PixelType::uint8, test::synthetic_rpc());
  write_rpc_geotiff(scratch / "d.tif", rgb, PixelType::uint8, test::synthetic_rpc());
  CHECK(test::read_bytes(scratch / "c.tif") == test::read_bytes(scratch / "d.tif"));
}

TEST_CASE("what cannot be written is refused, and nothing is left behind") {
  const test::TempFolder scratch("raster");
  const auto path = scratch / "x.tif";
  CHECK_THROWS_WITH_AS(write_geo_raster(path, Tensor({4}), {32617, 0, 0, 1}),
                       "write_geo_raster: values [4], expected [H W] or [C H W]", ShapeError);
  CHECK_THROWS_WITH_AS(write_geo_raster(path, Tensor({4, 3}), {32617, 0, 0, 0}),
                       "write_geo_raster: cells of 0 m, expected a positive size", Error);
  CHECK_THROWS_WITH_AS(write_geo_raster(path, Tensor({4, 3}), {99999, 0, 0, 1}),
                       "EPSG:99999: not a known reference system, expected a projected one", Error);
  CHECK_THROWS_WITH_AS(
      write_geo_raster(path, Tensor({4, 3}), {32617, 0, 0, 1}, GeoTags{.band_names = {"a", "b"}}),
      "write_geo_raster: 2 band names, expected 1", Error);
  CHECK_THROWS_WITH_AS(write_rpc_geotiff(path, Tensor({4, 3}), PixelType::uint8, {}),
                       "write_rpc_geotiff: values [4,3], expected [C H W]", ShapeError);
  CHECK(std::filesystem::is_empty(scratch.path()));
  test::write_bytes(scratch / "file", "");
  CHECK_THROWS_AS(write_geo_raster(scratch / "file/x.tif", Tensor({4, 3}), {32617, 0, 0, 1}),
                  IoError);
}

TEST_CASE("rasters that are no grid of the ground are refused") {
  const test::TempFolder scratch("raster");
  const std::string p = (scratch / "x.tif").string();
  plain_tiff(p, {10, 0.5, 0.1, 20, 0.1, -0.5}, 32617);
  CHECK_THROWS_WITH_AS(
      read_geo_raster(p),
      (p + ": cells of (0.5, 0.1; 0.1, -0.5), expected square ones with north up; warp it first "
           "(gdalwarp)")
          .c_str(),
      IoError);
  plain_tiff(p, {10, 0.5, 0, 20, 0, -0.25}, 32617);
  CHECK_THROWS_AS(read_geo_raster(p), IoError);
  plain_tiff(p, {10, 0.5, 0, 20, 0, 0.5}, 32617);
  CHECK_THROWS_AS(read_geo_raster(p), IoError);
  plain_tiff(p, {10, 0.5, 0, 20, 0, -0.5}, 4326);
  CHECK_THROWS_WITH_AS(
      read_geo_raster(p),
      (p +
       ": coordinates in degrees, expected a projected system in metres; warp it first (gdalwarp)")
          .c_str(),
      IoError);
  plain_tiff(p, {0, 1, 0, 0, 0, 1}, 0);
  CHECK_THROWS_WITH_AS(
      read_geo_raster(p),
      (p + ": no georeference, expected one in the file or in " + (scratch / "x.txt").string())
          .c_str(),
      IoError);
  CHECK_THROWS_WITH_AS(
      read_geo_raster(scratch / "none.tif"),
      ((scratch / "none.tif").string() + ": no such file, expected a raster").c_str(), IoError);
}

TEST_CASE("rasters that lie nowhere are refused") {
  const test::TempFolder scratch("raster");
  const std::string p = (scratch / "x.tif").string();
  const double nan = std::nan("");
  for (const auto& place : {std::array{nan, 20.0}, {10.0, nan}, {1e300, 20.0}}) {
    plain_tiff(p, {place[0], 0.5, 0, place[1], 0, -0.5}, 32617);
    const std::string text = test::error_of<IoError>([&] { read_geo_raster(p); });
    CAPTURE(text);
    CHECK(text.starts_with(p + ": a grid at ("));
  }
}

TEST_CASE("rasters of cells that no sensor has are refused") {
  const test::TempFolder scratch("raster");
  const std::string p = (scratch / "x.tif").string();
  plain_tiff(p, {10, 1e-300, 0, 20, 0, -1e-300}, 32617);
  CHECK(
      test::error_of<IoError>([&] { read_geo_raster(p); }) ==
      p + ": a grid at (10, 20) of cells of 1e-300 m, expected finite numbers of at most 1e8 m and "
          "cells of 0.001 m or more");
  plain_tiff(p, {10, 0.001, 0, 20, 0, -0.001}, 32617);
  CHECK(test::error_of<IoError>([&] { read_geo_raster(p); }) == "no exception");
}

TEST_CASE("heights that are on no Earth are refused by the cell") {
  Tensor z({2, 3}, 1e6F);
  z[1] = std::nanf("");
  require_heights("x.tif", z);
  z[5] = -1e38F;
  CHECK(
      test::error_of<IoError>([&] { require_heights("x.tif", z); }) ==
      "x.tif: a height of -1e+38 m in column 2, row 1, expected at most 1000 km either way; nodata "
      "that the file does not declare?");
}

TEST_CASE("rasters that their files cannot hold are refused before they take memory") {
  const test::TempFolder scratch("raster");
  const std::string p = (scratch / "x.tif").string();
  const auto sparse = [&](int side) {
    GDALAllRegister();
    auto* driver = GetGDALDriverManager()->GetDriverByName("GTiff");
    const char* options[] = {"SPARSE_OK=TRUE", "COMPRESS=DEFLATE", "BLOCKYSIZE=16384", nullptr};
    std::unique_ptr<GDALDataset> d(
        driver->Create(p.c_str(), side, side, 1, GDT_Float32, const_cast<char**>(options)));
    REQUIRE(d);
    std::array<double, 6> transform{435000, 0.5, 0, 3358000, 0, -0.5};
    d->SetGeoTransform(transform.data());
    d.reset();
    REQUIRE(std::filesystem::file_size(p) < 4096);
    return test::error_of<IoError>([&] { read_geo_raster(p); });
  };
  CHECK(sparse(100) == "no exception");
  CHECK(sparse(65536 + 1) ==
        p + ": 65537 x 65537 cells of 1 band, expected at most 4294967296 values; cut out a part "
            "(gdal_translate -projwin)");
  const std::string text = sparse(20000);
  CAPTURE(text);
  CHECK(text.starts_with(p + ": 20000 x 20000 px of 1 band, "));
  CHECK(text.ends_with(", expected at least a byte for every 20000; empty or damaged?"));
  CHECK(sparse(2000) == "no exception");  // 16 MB
  CHECK(sparse(8100).starts_with(p + ": 8100 x 8100 px of 1 band, "));
  CHECK(test::error_of<IoError>([&] { rpc::read_image(p); }).ends_with("empty or damaged?"));

  // Few pixels in blocks that are not few: GDAL reads a block whole.
  auto* driver = GetGDALDriverManager()->GetDriverByName("GTiff");
  const auto in_blocks = [&](int side, int bands) {
    const std::string width = "BLOCKXSIZE=" + std::to_string(side),
                      height = "BLOCKYSIZE=" + std::to_string(side);
    const char* options[] = {"SPARSE_OK=TRUE", "TILED=YES",        width.c_str(),
                             height.c_str(),   "INTERLEAVE=PIXEL", nullptr};
    delete driver->Create(p.c_str(), 8, 8, bands, GDT_Float32, const_cast<char**>(options));
    REQUIRE(std::filesystem::file_size(p) < 4096);
    return test::error_of<IoError>([&] { rpc::read_image(p); });
  };
  CHECK(in_blocks(2048, 3) == "no exception");  // 50 MB
  const std::string blocks = in_blocks(4096, 16);
  CAPTURE(blocks);
  CHECK(blocks.starts_with(p + ": 8 x 8 px of 16 bands in blocks of 1"));
  CHECK(blocks.ends_with("expected at most 64 MB; empty or damaged?"));
  CHECK(
      in_blocks(4096, 1).starts_with(p + ": 8 x 8 px of 1 band in blocks of 67 MB, in a file of "));
}

TEST_CASE("the contest's layout: a bare raster and its grid in a text file") {
  const test::TempFolder scratch("raster");
  const Tensor z = heights({1, 6, 6}, 6);
  write_rpc_geotiff(scratch / "S_DSM.tif", z, PixelType::uint16, test::synthetic_rpc());
  write_rpc_geotiff(scratch / "S_CLS.tif", z, PixelType::uint8, test::synthetic_rpc());
  const GeoGrid grid{UtmZone{17, true}.epsg(), 435000.5, 3358100, 0.5};
  write_dfc_grid(scratch / "S_DSM.txt", grid, 6);
  CHECK(test::read_bytes(scratch / "S_DSM.txt") ==
        "435000.500000\n3358097.000000\n6.000000\n0.500000\n");
  CHECK(read_geo_raster(scratch / "S_DSM.tif", UtmZone{17, true}).grid == grid);
  CHECK(read_geo_raster(scratch / "S_CLS.tif", UtmZone{17, true}).grid == grid);
  CHECK(read_geo_raster(scratch / "S_DSM.tif").grid.epsg == 0);

  const std::string text = (scratch / "S_DSM.txt").string();
  write_dfc_grid(text, grid, 7);
  CHECK_THROWS_WITH_AS(
      read_geo_raster(scratch / "S_DSM.tif"),
      (text + ": 7 cells per side of 0.5 m, but " + (scratch / "S_DSM.tif").string() + " has 6 x 6")
          .c_str(),
      IoError);
  test::write_bytes(text, "1\n2\nsix\n0.5\n");
  CHECK_THROWS_WITH_AS(read_geo_raster(scratch / "S_DSM.tif"),
                       (text + ": 'six', expected a number").c_str(), IoError);
  test::write_bytes(text, "1\n2\n6\n");
  CHECK_THROWS_AS(read_geo_raster(scratch / "S_DSM.tif"), IoError);
}

TEST_CASE("real truth: DFC2019 surface models land in their place") {
  const auto data = test::data_folder();
  if (data.empty()) return;
  const GeoRaster dsm = read_geo_raster(data / "dfc_truth/JAX_004_DSM.tif", UtmZone{17, true});
  CHECK(dsm.values.shape() == Shape{512, 512});
  CHECK(dsm.grid.epsg == 32617);
  CHECK(dsm.grid.step == 0.5);
  const auto [lon, lat] = geodetic_from_utm({17, true}, dsm.grid.x0 + 128, dsm.grid.y0 - 128);
  CHECK(std::abs(lon + 81.7) < 0.1);
  CHECK(std::abs(lat - 30.35) < 0.1);
  const GeoRaster classes = read_geo_raster(data / "dfc_truth/JAX_004_CLS.tif", UtmZone{17, true});
  CHECK(classes.grid == dsm.grid);
  const GeoRaster reference = read_geo_raster(data / "pleiades_pair/reference_dsm.tif");
  CHECK(reference.grid == GeoGrid{32740, 359746, 7651923, 0.5});
  CHECK(reference.values.shape() == Shape{739, 721});
  Index holes = 0;
  for (const float v : reference.values.values()) holes += std::isnan(v);
  CHECK(holes > 0);
}

TEST_CASE("an image with its camera in the tag comes back the same") {
  const test::TempFolder scratch("raster");
  const Rpc rpc = test::synthetic_rpc();
  Tensor pixels = Tensor::from({2, 1, 3}, {0, 1.4F, 254.6F, -5, 300, kNan});
  write_rpc_geotiff(scratch / "a.tif", pixels, PixelType::uint8, rpc,
                    {{"SUN_ELEVATION", "42.5"},
                     {"SUN_AZIMUTH", "150"},
                     {"ACQUISITION_DATE", "20150215161208"},
                     {"MIN_ALT", "-27"},
                     {"MAX_ALT", "30.5"}});
  const Image back = read_image(scratch / "a.tif");
  CHECK(same(back.pixels, Tensor::from({2, 1, 3}, {0, 1, 255, 0, 255, 0})));
  REQUIRE(back.info.rpc);
  // GDAL hands the tag's doubles out with 15 digits.
  for (const Geodetic& p : {Geodetic{12.31, 45.08, 30}, Geodetic{12.28, 45.13, 400}}) {
    const Pixel a = rpc.project(p), b = back.info.rpc->project(p);
    CHECK(std::hypot(a.x - b.x, a.y - b.y) < 1e-6);
  }
  CHECK(back.info.rpc_source == "TIFF tag");
  CHECK(back.info.dtype == "uint8");
  CHECK(back.info.bands == 2);
  CHECK(back.info.sun_elevation_deg == 42.5);
  CHECK(back.info.sun_azimuth_deg == 150);
  CHECK(back.info.acquisition_date == "20150215161208");
  REQUIRE(back.info.height_range);
  CHECK(back.info.height_range->low == -27);
  CHECK(back.info.height_range->high == 30.5);
  CHECK(!back.info.geotransform);

  const Tensor wide = Tensor::from({1, 2, 2}, {0, 255.5F, 40000, 70000});
  write_rpc_geotiff(scratch / "b.tif", wide, PixelType::uint16, rpc);
  CHECK(
      same(read_image(scratch / "b.tif").pixels, Tensor::from({1, 2, 2}, {0, 256, 40000, 65535})));
  CHECK(read_info(scratch / "b.tif").dtype == "uint16");
  CHECK(std::distance(std::filesystem::directory_iterator(scratch.path()), {}) == 2);
}
