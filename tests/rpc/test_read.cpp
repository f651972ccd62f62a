// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/files.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/rng.h"
#include "satsurf/rpc/camera_check.h"
#include "satsurf/rpc/drivers.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/rpc/read.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iomanip>
#include <limits>
#include <memory>
#include <sstream>

#include "tests/ref/rpc_data.h"
#include "tests/ref/rpc_dialects.h"
#include "tests/rpc/quiet_server.h"
#include "tests/temp_folder.h"
#include <cpl_error.h>
#include <cpl_string.h>
#include <doctest/doctest.h>
#include <gdal_priv.h>
#include <ogr_spatialref.h>
#include <sys/stat.h>

using namespace satsurf;
using namespace satsurf::rpc;
using namespace satsurf::test::dialects;
using test::error_of;
using test::TempFolder;
using test::write_bytes;

namespace {

const float kNan = std::numeric_limits<float>::quiet_NaN();

/// A raster without a camera or place; band b holds b, b + 1, ...
void plain_tiff(const std::filesystem::path& path, int width, int height, int bands,
                GDALDataType type, const std::vector<float>& first_band = {},
                std::optional<double> nodata = {}, bool alpha = false) {
  GDALAllRegister();
  auto* driver = GetGDALDriverManager()->GetDriverByName("GTiff");
  std::unique_ptr<GDALDataset> d(driver->Create(path.c_str(), width, height, bands, type, nullptr));
  REQUIRE(d);
  for (int b = 1; b <= bands; ++b) {
    std::vector<float> v(static_cast<std::size_t>(width * height));
    for (std::size_t i = 0; i < v.size(); ++i) v[i] = static_cast<float>(b) + static_cast<float>(i);
    if (b == 1 && !first_band.empty()) v = first_band;
    if (alpha && b == bands)
      for (std::size_t i = 0; i < v.size(); ++i) v[i] = i == 0 ? 0 : 255;
    if (nodata) d->GetRasterBand(b)->SetNoDataValue(*nodata);
    if (alpha && b == bands) d->GetRasterBand(b)->SetColorInterpretation(GCI_AlphaBand);
    REQUIRE(d->GetRasterBand(b)->RasterIO(GF_Write, 0, 0, width, height, v.data(), width, height,
                                          GDT_Float32, 0, 0, nullptr) == CE_None);
  }
}

double worst_difference(const Rpc& a, const Rpc& b) {
  Rng rng(1);
  double worst = 0;
  for (int i = 0; i < 30; ++i) {
    const Geodetic p{a.lon_off + a.lon_scale * rng.uniform(-1, 1),
                     a.lat_off + a.lat_scale * rng.uniform(-1, 1),
                     a.height_off + a.height_scale * rng.uniform(-1, 1)};
    const Pixel u = a.project(p), v = b.project(p);
    worst = std::max(worst, std::hypot(u.x - v.x, u.y - v.y));
  }
  return worst;
}

/// GDAL's own reading of a camera file that stands beside an image the way the vendor delivers it.
Rpc gdal_reads(const std::filesystem::path& image) {
  const std::unique_ptr<GDALDataset> d(GDALDataset::Open(image.c_str()));
  REQUIRE(d);
  char** items = d->GetMetadata("RPC");
  REQUIRE(items != nullptr);
  GDALRPCInfoV2 g;
  REQUIRE(GDALExtractRPCInfoV2(items, &g));
  Rpc r;
  r.line_off = g.dfLINE_OFF, r.samp_off = g.dfSAMP_OFF, r.lat_off = g.dfLAT_OFF,
  r.lon_off = g.dfLONG_OFF;
  r.height_off = g.dfHEIGHT_OFF, r.line_scale = g.dfLINE_SCALE, r.samp_scale = g.dfSAMP_SCALE;
  r.lat_scale = g.dfLAT_SCALE, r.lon_scale = g.dfLONG_SCALE, r.height_scale = g.dfHEIGHT_SCALE;
  std::copy_n(g.adfLINE_NUM_COEFF, 20, r.line_num.begin());
  std::copy_n(g.adfLINE_DEN_COEFF, 20, r.line_den.begin());
  std::copy_n(g.adfSAMP_NUM_COEFF, 20, r.samp_num.begin());
  std::copy_n(g.adfSAMP_DEN_COEFF, 20, r.samp_den.begin());
  return r;
}

const std::string kDim =
    "<?xml version=\"1.0\"?>\n<Dimap_Document><Metadata_Identification><METADATA_FORMAT "
    "version=\"2.0\">DIMAP</METADATA_FORMAT></Metadata_Identification></Dimap_Document>\n";

}  // namespace

TEST_CASE("a camera from memory is checked as one from a file is") {
  Rpc camera = test::synthetic_rpc();
  check_camera(camera, "memory");
  const auto says = [&] { return error_of<IoError>([&] { check_camera(camera, "memory"); }); };
  camera.samp_den[3] = std::nan("");
  CHECK(says() == "memory: SAMP_DEN_COEFF holds nan, expected finite numbers");
  camera = test::synthetic_rpc();
  camera.height_scale = 1e300;
  CHECK(says() == "memory: HEIGHT_SCALE is 1e+300, expected at most 1000000 either way");
  camera.height_scale = std::nan("");
  CHECK(says() == "memory: HEIGHT_SCALE is nan, expected at most 1000000 either way");
}

TEST_CASE("every dialect of a camera file says the same camera") {
  const TempFolder folder("read");
  const Rpc rpc = test::synthetic_rpc();
  const std::vector<std::pair<std::string, std::string>> files{
      {"a_RPC.TXT", as_text(rpc)},
      {"a.RPB", as_rpb(rpc)},
      {"a.XML", as_maxar_xml(rpc)},
      {"RPC_a.XML", as_dimap(rpc)},
      {"a.rpc", as_whu(rpc)},
      {"a.json", as_satnerf(rpc, "a.tif", 8, 8).dump()},
      {"bare.json", as_rpcm(rpc).dump(1)}};
  for (const auto& [name, text] : files) {
    CAPTURE(name);
    write_bytes(folder / name, text);
    const Rpc read = read_rpc_file(folder / name);
    CHECK(read.line_off == doctest::Approx(rpc.line_off).epsilon(1e-14));
    CHECK(worst_difference(rpc, read) < 1e-8);
  }
}

TEST_CASE("a camera beside an image is found, and its source told") {
  const Rpc rpc = test::synthetic_rpc();
  const auto source = [&](const std::string& image,
                          const std::vector<std::pair<std::string, std::string>>& sidecars) {
    const TempFolder folder("sidecar");
    plain_tiff(folder / image, 8, 6, 1, GDT_UInt16);
    for (const auto& [name, text] : sidecars) write_bytes(folder / name, text);
    const RasterInfo info = view_info(folder / image);
    CHECK(worst_difference(rpc, *info.rpc) < 1e-6);
    CHECK(worst_difference(gdal_reads(folder / image), *info.rpc) == 0);
    if (info.rpc_source == "Maxar XML") {
      CHECK(info.sun_elevation_deg == 40.3);
      CHECK(info.sun_azimuth_deg == 162.1);
      CHECK(info.acquisition_date.has_value());
    }
    REQUIRE(info.files.size() >= 2);
    CHECK(info.files[0] == folder / image);
    for (const auto& [name, text] : sidecars)
      CHECK(std::count(info.files.begin(), info.files.end(), folder / name) == 1);
    return info.rpc_source;
  };
  CHECK(source("a.tif", {{"a.RPB", as_rpb(rpc)}}) == "RPB");
  CHECK(source("a.tif", {{"a_RPC.TXT", as_text(rpc)}}) == "_RPC.TXT");
  CHECK(source("a.tif", {{"a_rpc.txt", as_text(rpc)}}) == "_RPC.TXT");
  CHECK(source("a.tif", {{"a.XML", as_maxar_xml(rpc)}}) == "Maxar XML");
  CHECK(source("IMG_a_R1C1.TIF", {{"RPC_a.XML", as_dimap(rpc)}, {"DIM_a.XML", kDim}}) == "DIMAP");
}

TEST_CASE("a camera that GDAL leaves aside is found all the same") {
  const Rpc rpc = test::synthetic_rpc();
  const auto source = [&](const std::string& image, const std::string& sidecar,
                          const std::string& text) {
    const TempFolder folder("aside");
    plain_tiff(folder / "t.tif", 8, 6, 1, GDT_Byte);
    const std::unique_ptr<GDALDataset> from(GDALDataset::Open((folder / "t.tif").c_str()));
    auto* driver =
        GetGDALDriverManager()->GetDriverByName(image.ends_with(".png") ? "PNG" : "GTiff");
    REQUIRE(driver);
    const std::unique_ptr<GDALDataset> to(
        driver->CreateCopy((folder / image).c_str(), from.get(), FALSE, nullptr, nullptr, nullptr));
    REQUIRE(to);
    write_bytes(folder / sidecar, text);
    const RasterInfo info = view_info(folder / image);
    CHECK(worst_difference(rpc, *info.rpc) < 1e-8);
    CHECK(std::count(info.files.begin(), info.files.end(), folder / image) == 1);
    CHECK(std::count(info.files.begin(), info.files.end(), folder / sidecar) == 1);
    return info.rpc_source;
  };
  CHECK(source("a.png", "a_RPC.TXT", as_text(rpc)) == "_RPC.TXT");
  CHECK(source("a.png", "a.rpc", as_whu(rpc)) == ".rpc file");
  CHECK(source("a.tif", "a.rpc", as_whu(rpc)) == ".rpc file");
  CHECK(source("a.png", "a.RPB", as_rpb(rpc)) == "RPB");
  CHECK(source("a.png", "a.XML", as_maxar_xml(rpc)) == "Maxar XML");
  CHECK(source("IMG_a.tif", "RPC_a.XML", as_dimap(rpc)) == "DIMAP");
  CHECK(source("a.tif", "RPC_a.XML", as_dimap(rpc)) == "DIMAP");
  // An XML file about something else is no camera.
  CHECK(error_of<IoError>([&] {
          source("a.png", "a.XML", "<metadata/>");
        }).find(": no camera (RPC)") != std::string::npos);
}

TEST_CASE("a camera in the file of metadata that GDAL leaves beside an image") {
  const TempFolder folder("aux");
  const Rpc rpc = test::synthetic_rpc();
  write_rpc_geotiff(folder / "t.tif", Tensor({1, 6, 8}, 90.0F), PixelType::uint8, rpc);
  {
    const std::unique_ptr<GDALDataset> from(GDALDataset::Open((folder / "t.tif").c_str()));
    auto* png = GetGDALDriverManager()->GetDriverByName("PNG");
    REQUIRE(png);
    const std::unique_ptr<GDALDataset> to(
        png->CreateCopy((folder / "a.png").c_str(), from.get(), FALSE, nullptr, nullptr, nullptr));
    REQUIRE(to);
  }
  const auto aux = folder / "a.png.aux.xml";
  REQUIRE(std::filesystem::exists(aux));
  const RasterInfo info = view_info(folder / "a.png");
  REQUIRE(info.rpc);
  CHECK(info.rpc_source == ".aux.xml");
  CHECK(worst_difference(rpc, *info.rpc) < 1e-6);  // GDAL writes 15 digits
  CHECK(std::count(info.files.begin(), info.files.end(), aux) == 1);
  // one that holds statistics alone is no camera
  write_bytes(aux, "<PAMDataset><Metadata><MDI key=\"A\">1</MDI></Metadata></PAMDataset>");
  CHECK_THROWS_AS(view_info(folder / "a.png"), IoError);
}

TEST_CASE("NITF carries its camera in RPC00B") {
  const TempFolder folder("nitf");
  Rpc rpc = test::synthetic_rpc();
  rpc.line_off = 10000, rpc.samp_off = 10001,
  rpc.lon_scale = 0.064;  // as many digits as RPC00B has
  write_rpc_geotiff(folder / "a.tif", Tensor({1, 16, 16}, 7), PixelType::uint8, rpc);
  {
    const std::unique_ptr<GDALDataset> from(GDALDataset::Open((folder / "a.tif").c_str()));
    auto* driver = GetGDALDriverManager()->GetDriverByName("NITF");
    REQUIRE(driver);
    char** options = CSLAddString(nullptr, "RPC00B=YES");
    CPLPushErrorHandler(CPLQuietErrorHandler);  // the TRE has fewer digits than our numbers
    const std::unique_ptr<GDALDataset> to(driver->CreateCopy((folder / "a.ntf").c_str(), from.get(),
                                                             FALSE, options, nullptr, nullptr));
    CPLPopErrorHandler();
    CSLDestroy(options);
    REQUIRE(to);
  }
  std::filesystem::remove(folder / "a.ntf.aux.xml");
  const RasterInfo info = read_info(folder / "a.ntf");
  CHECK(info.rpc_source == "NITF");
  REQUIRE(info.rpc);
  CHECK(worst_difference(rpc, *info.rpc) <
        3);  // RPC00B rounds offsets to whole pixels and 1e-4 degrees
}

TEST_CASE("damaged camera files are refused by name") {
  const TempFolder folder("damaged");
  const std::string p = (folder / "c").string();
  const Rpc rpc = test::synthetic_rpc();
  const auto says = [&](const std::string& text) {
    write_bytes(p, text);
    return error_of<IoError>([&] { read_rpc_file(p); });
  };
  CHECK(error_of<IoError>([&] { read_rpc_file(p); }) ==
        p + ": no such file, expected a camera file");
  CHECK(says(" \n") == p + ": empty, expected a camera file");
  CHECK(says("hello: 5\n") == p + ": no camera in a known form, expected _RPC.TXT, RPB, Maxar or "
                                  "DIMAP XML, WHU-TLC or Sat-NeRF JSON");
  std::string text = as_text(rpc);
  text.erase(text.rfind("SAMP_DEN_COEFF_20"));
  CHECK(says(text) == p + ": key SAMP_DEN_COEFF_20 is missing");
  text = as_text(rpc);
  text.replace(text.find("LAT_SCALE: "), 12, "LAT_SCALE: x");
  CHECK(says(text).find(p + ": LAT_SCALE is '") == 0);
  CHECK(says("<a><b></a>").find(p + ": damaged XML; ") == 0);
  CHECK(says("<a/>") ==
        p + ": XML without a camera, expected an RPB (Maxar) or Global_RFM (DIMAP) element, or "
            "GDAL's metadata of the domain RPC");
  CHECK(says("<PAMDataset><Metadata domain=\"RPC\"/></PAMDataset>").find(p + ": ") == 0);
  CHECK(says("{\"row_offset\": ") ==
        p + ": line 1, column 16: syntax error while parsing value - unexpected end of input; "
            "expected '[', '{', or a literal");
  Rpc flat = rpc;
  flat.lon_scale = 0;
  CHECK(says(as_text(flat)) == p + ": LONG_SCALE is 0, expected another number");
  flat = rpc;
  flat.samp_den = {};
  CHECK(says(as_text(flat)) == p + ": all of SAMP_DEN_COEFF are 0, expected a polynomial");
  text = as_rpb(rpc);
  text.replace(text.find("lineDenCoef = (\n\t\t\t1,"), 20, "lineDenCoef = (");
  CHECK(says(text) == p + ": LINE_DEN_COEFF holds 19 numbers, expected 20");
  // A later line does not help a number that is none; a comma is no decimal point.
  text = as_text(rpc);
  text.replace(text.find("LINE_OFF: +9999.5"), 17, "LINE_OFF: +9999,5");
  CHECK(says(text) == p + ": LINE_OFF is ' +9999,5 units\\r', expected a number");
}

TEST_CASE("Sat-NeRF JSON: tolerant numbers, strict keys") {
  const TempFolder folder("json");
  const std::string p = (folder / "v.json").string();
  const Rpc rpc = test::synthetic_rpc();
  nlohmann::json j = as_satnerf(rpc, "v.tif", 9, 7);
  j["rpc"]["row_offset"] = "+9999.5";
  write_bytes(p, j.dump());
  const SatNerfJson read = read_satnerf_json(p);
  CHECK(read.image == "v.tif");
  CHECK(read.width == 9);
  CHECK(read.height == 7);
  CHECK(read.rpc == rpc);
  CHECK(read.min_alt == -27);
  CHECK(read.max_alt == 30.5);
  CHECK(read.sun_elevation_deg == 42.2);
  CHECK(read.sun_azimuth_deg == 150);
  CHECK(read.acquisition_date == "20150215161208");

  const auto says = [&](nlohmann::json changed) {
    write_bytes(p, changed.dump());
    return error_of<IoError>([&] { read_satnerf_json(p); });
  };
  for (const char* key : {"img", "width", "height", "rpc", "min_alt", "max_alt"}) {
    nlohmann::json without = j;
    without.erase(key);
    CHECK(says(without) == p + ": key \"" + key + "\" is missing");
  }
  nlohmann::json wrong = j;
  wrong["rpc"].erase("col_den");
  CHECK(says(wrong) == p + ": key \"col_den\" is missing");
  wrong = j;
  wrong["sun_elevation"] = "high";
  CHECK(says(wrong) == p + ": key \"sun_elevation\" is \"high\", expected a number");
  wrong = j;
  wrong["rpc"]["row_num"] = {1, 2, 3};
  CHECK(says(wrong) == p + ": key \"row_num\" is no list of 20 numbers");
  wrong = j;
  wrong["width"] = -3;
  CHECK(says(wrong) == p + ": key \"width\" is -3, expected pixels");
  wrong = j;
  wrong["max_alt"] = -30;
  CHECK(says(wrong) == p + ": key \"min_alt\" is not below \"max_alt\"");
  wrong = j;
  wrong["max_alt"] = 1e300;
  CHECK(says(wrong) ==
        p + ": keys \"min_alt\" and \"max_alt\" are -27 and 1e+300, expected at most 1000 km "
            "either way");
  CHECK(says(nlohmann::json::array({1})) == p + ": key \"img\" is missing");
}

TEST_CASE("numbers that no camera has are refused") {
  const TempFolder folder("numbers");
  const std::string p = (folder / "c").string();
  const auto says = [&](double Rpc::*member, double value) {
    Rpc rpc = test::synthetic_rpc();
    rpc.*member = value;
    write_bytes(p, as_text(rpc));
    return error_of<IoError>([&] { read_rpc_file(p); });
  };
  CHECK(says(&Rpc::lat_off, 91) == p + ": LAT_OFF is 91, expected at most 90 either way");
  CHECK(says(&Rpc::lon_off, -361) == p + ": LONG_OFF is -361, expected at most 360 either way");
  CHECK(says(&Rpc::line_scale, 1e300) ==
        p + ": LINE_SCALE is 1e+300, expected at most 1000000000 either way");
  CHECK(says(&Rpc::height_off, 1e9) ==
        p + ": HEIGHT_OFF is 1e+09, expected at most 1000000 either way");
  CHECK(says(&Rpc::samp_scale, -3) == p + ": SAMP_SCALE is -3, expected a positive number");
  CHECK(says(&Rpc::height_scale, 1e-300) == p + ": HEIGHT_SCALE is 1e-300, expected at least 1e-9");
  CHECK(says(&Rpc::lat_scale, -0.05) == "no exception");  // of Planet
  CHECK(says(&Rpc::lon_off, 359) == "no exception");
}

TEST_CASE("rasters are opened by known drivers, and nothing is asked of a network") {
  const TempFolder folder("drivers");
  const std::string ppm = (folder / "a.pgm").string(), vrt = (folder / "a.vrt").string();
  const std::string img = (folder / "a.img").string();
  write_bytes(img, "EHFA_HEADER_TAG" + std::string(100, '\0'));
  CHECK(error_of<IoError>([&] { read_info(img); }) ==
        img +
            ": of the format HFA, expected GeoTIFF, NITF or alike; SATSURF_GDAL_DRIVERS=HFA in the "
            "environment allows it");
  write_bytes(ppm, "P5 2 2 255\nabcd");
  CHECK(error_of<IoError>([&] { read_info(ppm); }) ==
        ppm +
            ": of the format PNM, expected GeoTIFF, NITF or alike; SATSURF_GDAL_DRIVERS=PNM in "
            "the environment allows it");
  const auto mosaic = [&](const std::string& source, bool relative, const std::string& more = "") {
    write_bytes(vrt, "<VRTDataset rasterXSize=\"4\" rasterYSize=\"4\">" + more +
                         "<VRTRasterBand dataType=\"Byte\" band=\"1\"><SimpleSource>"
                         "<SourceFilename relativeToVRT=\"" +
                         (relative ? "1" : "0") + "\">" + source +
                         "</SourceFilename><SourceBand>1</SourceBand></SimpleSource>"
                         "</VRTRasterBand></VRTDataset>");
    return error_of<IoError>([&] { read_image(vrt); });
  };
  plain_tiff(folder / "a.tif", 4, 4, 1, GDT_Byte);
  CHECK(mosaic("a.tif", true) == "no exception");
  CHECK(mosaic((folder / "a.tif").string(), false) == "no exception");
  CHECK(mosaic("a.pgm", true) ==
        vrt +
            ": its source \"a.pgm\" is of the format PNM, expected GeoTIFF, NITF or alike; "
            "SATSURF_GDAL_DRIVERS=PNM in the environment allows it");
  CHECK(mosaic("http://127.0.0.1:9/a.tif", false) ==
        vrt +
            ": its source \"http://127.0.0.1:9/a.tif\" is no file, expected a raster on this "
            "machine");
  CHECK(mosaic("/vsicurl/http://127.0.0.1:9/a.tif", false) ==
        vrt +
            ": its source \"/vsicurl/http://127.0.0.1:9/a.tif\" is no file, expected a raster on "
            "this machine");
  CHECK(mosaic("a.tif", true, "<Extra>/vsicurl/http://127.0.0.1:9/dem.tif</Extra>") ==
        vrt + ": names \"/vsicurl/http://127.0.0.1:9/dem.tif\", expected files on this machine");
  CHECK(mosaic("a.vrt", true) == vrt + ": a VRT of VRTs nested deeper than 8, expected files");
  // A server's description is a file as well.
  write_bytes(folder / "w.xml",
              "<GDAL_WMS><Service name=\"TMS\"><ServerUrl>http://127.0.0.1:9/${z}</ServerUrl>"
              "</Service></GDAL_WMS>");
  CHECK(mosaic("w.xml", true).find("its source \"w.xml\" is ") != std::string::npos);
  CHECK(error_of<IoError>([&] { read_info("/vsicurl/http://127.0.0.1:9/a.tif"); }) ==
        "/vsicurl/http://127.0.0.1:9/a.tif: a name of GDAL's virtual file systems, expected a file "
        "on this machine");

  ::setenv("SATSURF_GDAL_DRIVERS", "HDF5,PNM", 1);
  CHECK(error_of<IoError>([&] { read_info(ppm); }) == "no exception");
  ::unsetenv("SATSURF_GDAL_DRIVERS");
  CHECK(error_of<IoError>([&] { read_info(ppm); }) != "no exception");
  trust_drivers({"HDF5", "PNM"});
  CHECK(error_of<IoError>([&] { read_info(ppm); }) == "no exception");
  CHECK(mosaic("a.pgm", true) == "no exception");
  trust_drivers({});
}

/// A raster of PCIDSK of one channel.
static void plain_pcidsk(const std::filesystem::path& path) {
  auto* driver = GetGDALDriverManager()->GetDriverByName("PCIDSK");
  REQUIRE(driver != nullptr);
  GDALClose(driver->Create(path.c_str(), 4, 4, 1, GDT_Byte, nullptr));
}

TEST_CASE("whatever a raster names, no network is asked and no pipe waited for") {
  const TempFolder folder("names");
  const test::QuietServer server;
  plain_tiff(folder / "a.tif", 4, 4, 1, GDT_Byte);
  REQUIRE(::mkfifo((folder / "pipe.tif").c_str(), 0600) == 0);
  const auto says = [&](const char* name, const std::string& text) {
    const std::string path = (folder / name).string();
    write_bytes(path, text);
    const std::string error = error_of<IoError>([&] { read_image(path); });
    return error.starts_with(path + ": ") ? error.substr(path.size() + 2) : "no prefix: " + error;
  };
  const auto dimap = [&](const std::string& tile) {
    return says(
        "dim.xml",
        R"(<Dimap_Document><Metadata_Id><METADATA_FORMAT version="1.1">DIMAP</METADATA_FORMAT></Metadata_Id>)"
        R"(<Raster_Dimensions><NCOLS>4</NCOLS><NROWS>4</NROWS><NBANDS>1</NBANDS></Raster_Dimensions>)"
        R"(<Data_Access><Data_File><DATA_FILE_PATH href=")" +
            tile + R"("/></Data_File></Data_Access></Dimap_Document>)");
  };
  CHECK(dimap("a.tif") == "no prefix: no exception");
  for (const std::string& tile :
       {server.url(), "/vsicurl/" + server.url(), std::string("pipe.tif")}) {
    CAPTURE(tile);
    CHECK(dimap(tile).starts_with("not a raster that can be read"));
  }
  plain_pcidsk(folder / "plain.pix");
  const auto pcidsk = [&](std::string channel) {
    std::string bytes = test::read_bytes(folder / "plain.pix");
    const auto headers = static_cast<std::size_t>(std::stoi(bytes.substr(336, 16)) - 1) * 512;
    channel.resize(64, ' ');
    bytes.replace(headers + 64, 64, channel);
    return says("a.pix", bytes);
  };
  CHECK(pcidsk("") == "no prefix: no exception");
  for (const std::string& name : {server.url(), std::string("pipe.tif"), std::string("LNK=   1")}) {
    CAPTURE(name);
    CHECK(pcidsk(name) == "a channel lies in \"" + name +
                              "\", expected it in the file or in another on this machine");
  }
  const auto vrt = [&](const std::string& more) {
    return says("a.vrt", R"(<VRTDataset rasterXSize="4" rasterYSize="4">)" + more +
                             R"(<VRTRasterBand dataType="Byte" band="1"><SimpleSource>)"
                             R"(<SourceFilename relativeToVRT="1">a.tif</SourceFilename>)"
                             "</SimpleSource></VRTRasterBand></VRTDataset>");
  };
  const std::string refusal = "names \"" + server.url() + "\", expected files on this machine";
  for (const char* key : {"OVERVIEW_FILE", "X_DATASET", "Y_DATASET"})
    CHECK(vrt("<Metadata domain=\"OVERVIEWS\"><MDI key=\"" + std::string(key) + "\">" +
              server.url() + "</MDI></Metadata>") == refusal);
  CHECK(vrt("<DEMPath>" + server.url() + "</DEMPath>") == refusal);
  CHECK(vrt("<Metadata><MDI key=\"ABOUT\">" + server.url() + "</MDI></Metadata>") ==
        "no prefix: no exception");
  CHECK(server.visits() == 0);
}

TEST_CASE("VRTs that name each other are looked at once, and read no more than can be read") {
  const TempFolder folder("fan");
  plain_tiff(folder / "a.tif", 4, 4, 1, GDT_Byte);
  const auto write = [&](int number, const std::string& source, int times) {
    std::string text =
        R"(<VRTDataset rasterXSize="4" rasterYSize="4"><VRTRasterBand dataType="Byte" band="1">)";
    std::string spelled = source;  // the same file in many ways
    for (int i = 0; i < times; ++i, spelled.insert(0, "./"))
      text += "<SimpleSource><SourceFilename relativeToVRT=\"1\">" + spelled +
              "</SourceFilename><SourceBand>1</SourceBand></SimpleSource>";
    write_bytes(folder / ("v" + std::to_string(number) + ".vrt"),
                text + "</VRTRasterBand></VRTDataset>");
  };
  const std::string top = (folder / "v0.vrt").string();
  const auto says = [&](int times) {
    for (int i = 0; i < 8; ++i)
      write(i, i == 7 ? "a.tif" : "v" + std::to_string(i + 1) + ".vrt", times);
    return error_of<IoError>([&] { read_info(top); });
  };
  CHECK(says(1) == "no exception");
  CHECK(says(2) == "no exception");
  CHECK(says(8) == top +
                       ": a VRT that reads 1.67772e+07 rasters, counted as often as it names them, "
                       "expected at most 100000");
}

TEST_CASE("drivers that this GDAL has not are refused by name") {
  const std::string error = error_of<ConfigError>([] { trust_drivers({"HDF6"}); });
  trust_drivers({});
  CHECK(error.starts_with(
      "gdal_drivers: HDF6 is no driver of this GDAL, did you mean HDF4? expected some of "));
  CHECK(error.find(", PNM,") != std::string::npos);
}

TEST_CASE("a camera that sees no ground is refused with the name of its image") {
  const TempFolder folder("blind");
  const std::string image = (folder / "v.tif").string();
  plain_tiff(image, 64, 64, 1, GDT_Byte);
  const auto says = [&](double Rpc::*member, double value) {
    Rpc rpc = test::synthetic_rpc();
    rpc.*member = value;
    write_bytes(folder / "v_RPC.TXT", as_text(rpc));
    return error_of<IoError>([&] { open_view(image); });
  };
  CHECK(says(&Rpc::lat_off, test::synthetic_rpc().lat_off) == "no exception");
  CHECK(says(&Rpc::lat_off, 90)
            .starts_with(image + ": its camera sees no ground; Rpc::localize: latitude "));
  Rpc mirrored = test::synthetic_rpc();
  for (double& c : mirrored.samp_num) c = -c;
  write_bytes(folder / "v_RPC.TXT", as_text(mirrored));
  CHECK(error_of<IoError>([&] {
          view_info(image);
        }).starts_with(image + ": its camera sees no ground; view_geometry: "));
}

TEST_CASE("an image that is a link lies where the link does") {
  const TempFolder folder("links");
  std::filesystem::create_directories(folder / "store");
  std::filesystem::create_directories(folder / "set");
  plain_tiff(folder / "store/v.tif", 9, 7, 1, GDT_Byte);
  write_bytes(folder / "set/v.json", as_satnerf(test::synthetic_rpc(), "v.tif", 9, 7).dump());
  std::filesystem::create_symlink("../store/v.tif", folder / "set/v.tif");
  CHECK(open_view(folder / "set/v.json").info.width == 9);
}

TEST_CASE("JSON that is hostile is refused by name, wherever it is read") {
  const TempFolder folder("hostile");
  const std::string p = (folder / "v.json").string();
  const std::string deep =
      "{\"img\": " + std::string(70000, '[') + std::string(70000, ']') + ", \"rpc\": 1}";
  std::string huge = as_satnerf(test::synthetic_rpc(), "v.tif", 9, 7).dump();
  huge.insert(1, "\"x\": 1e999, ");
  for (const bool view : {true, false}) {
    CAPTURE(view);
    const auto says = [&](const std::string& text) {
      write_bytes(p, text);
      return error_of<IoError>([&] {
        if (view)
          view_info(p);
        else
          read_rpc_file(p);
      });
    };
    CHECK(says(deep) == p + ": nested deeper than 64 levels");
    CHECK(says(huge) == p + ": number overflow parsing '1e999'");
  }
  write_bytes(p, "{");
  std::filesystem::resize_file(p, kMostText + 1);  // sparse
  CHECK(error_of<IoError>([&] { view_info(p); }) ==
        p + ": larger than 64 MiB, expected a Sat-NeRF JSON");
}

TEST_CASE("names that the system does not take are refused as errors of ours") {
  const TempFolder folder("long-name");
  const std::string name(300, 'n');
  for (const char* end : {".tif", ".json"}) {
    const std::string p = (folder / (name + end)).string();
    CAPTURE(p);
    CHECK(error_of<IoError>([&] { view_info(p); }).starts_with(p + ": cannot be found ("));
  }
  CHECK(error_of<IoError>([&] { read_geo_raster(folder / name); }).find(name) != std::string::npos);
  CHECK(error_of<IoError>([&] { read_rpc_file(folder / name); }).find(name) != std::string::npos);
  const std::string p = (folder / "v.json").string();
  write_bytes(p, as_satnerf(test::synthetic_rpc(), name + ".tif", 9, 7).dump());
  CHECK(error_of<IoError>([&] { view_info(p); }).starts_with(p + ": its image \"" + name));
  // beside this one, a camera's name would be too long
  const auto longest = folder / (std::string(250, 'n') + ".tif");
  plain_tiff(longest, 4, 4, 1, GDT_Byte);
  CHECK(error_of<IoError>([&] {
          open_view(longest);
        }).starts_with(longest.string() + ": no camera (RPC)"));
}

TEST_CASE("what is no regular file is refused before anybody waits for it") {
  const TempFolder folder("pipe");
  const std::string p = (folder / "v.tif").string(), j = (folder / "v.json").string();
  REQUIRE(::mkfifo(p.c_str(), 0600) == 0);
  CHECK(error_of<IoError>([&] { read_info(p); }) == p + ": is a pipe, expected a raster");
  CHECK(error_of<IoError>([&] { read_geo_raster(p); }) == p + ": is a pipe, expected a raster");
  CHECK(error_of<IoError>([&] { read_rpc_file(p); }) == p + ": is a pipe, expected a camera file");
  write_bytes(j, as_satnerf(test::synthetic_rpc(), "v.tif", 9, 7).dump());
  CHECK(error_of<IoError>([&] { open_view(j); }) == p + ": is a pipe, expected a raster");
  write_bytes(j, as_satnerf(test::synthetic_rpc(), "/dev/zero", 9, 7).dump());
  CHECK(error_of<IoError>([&] { open_view(j, {"/dev"}); }) ==
        "/dev/zero: is a device, expected a raster");
  CHECK(error_of<IoError>([&] { read_info(folder.path()); }) ==
        folder.path().string() + ": is a folder, expected a raster");
}

TEST_CASE("pipes beside an image are refused before GDAL waits for them") {
  const TempFolder folder("beside");
  const std::string p = (folder / "v.tif").string();
  write_rpc_geotiff(p, Tensor({1, 7, 9}, 5), PixelType::uint8, test::synthetic_rpc());
  for (const std::string name : {"v_RPC.TXT", "v_rpc.txt", "v.RPB", "v.XML", "v.IMD", "v.tif.ovr",
                                 "v.tif.msk", "v.tif.aux.xml", "v_metadata.txt"}) {
    const std::string pipe = (folder / name).string();
    REQUIRE(::mkfifo(pipe.c_str(), 0600) == 0);
    for (const auto& read : {+[](const std::string& file) { read_info(file); },
                             +[](const std::string& file) { open_view(file); }})
      CHECK(error_of<IoError>([&] { read(p); }) ==
            pipe + ": is a pipe, expected a file or nothing under this name beside " + p);
    std::filesystem::remove(pipe);
  }
  REQUIRE(::mkfifo((folder / "notes").c_str(), 0600) == 0);
  CHECK(open_view(p).info.width == 9);
}

TEST_CASE("a view is a raster or a JSON that names one") {
  const TempFolder folder("view");
  const Rpc tag = test::synthetic_rpc(), adjusted = test::synthetic_rpc(12.3001);
  std::filesystem::create_directories(folder / "images");
  const auto tif = folder / "images/v.tif";
  write_rpc_geotiff(tif, Tensor({1, 7, 9}, 5), PixelType::uint8, tag, {{"SUN_ELEVATION", "1"}});
  const std::string p = (folder / "v.json").string();
  write_bytes(p, as_satnerf(adjusted, "v.tif", 9, 7).dump());

  CHECK(error_of<IoError>([&] { open_view(p); }) ==
        p + ": its image \"v.tif\" was not found, looked for " + (folder / "v.tif").string() +
            "; name its folder");
  for (const std::string& elsewhere : {tif.string(), std::string("../v.tif")}) {
    const std::string stranger = (folder / "stranger/v.json").string();
    std::filesystem::create_directories(folder / "stranger");
    write_bytes(stranger, as_satnerf(adjusted, elsewhere, 9, 7).dump());
    CHECK(error_of<IoError>([&] { open_view(stranger); }) ==
          stranger + ": its image \"" + elsewhere +
              "\" lies elsewhere, expected it in the folder of the file; name its folder");
    if (elsewhere == tif.string())
      CHECK(find_view(stranger, {(folder / "images").string() + "/"}).raster == tif);
  }
  const Image view = open_view(p, {folder / "elsewhere", folder / "images"});
  CHECK(*view.info.rpc == adjusted);
  CHECK(view.info.rpc_source == "Sat-NeRF JSON");
  CHECK(view.info.files == std::vector<std::filesystem::path>{p, tif});
  CHECK(view.info.sun_elevation_deg == 42.2);
  REQUIRE(view.info.height_range);
  CHECK(view.info.height_range->high == 30.5);
  CHECK(view.pixels.shape() == Shape{1, 7, 9});
  CHECK(view_info(p, {folder / "images"}).rpc == view.info.rpc);
  CHECK(worst_difference(*open_view(tif).info.rpc, tag) < 1e-6);

  write_bytes(p, as_satnerf(adjusted, "v.tif", 9, 8).dump());
  CHECK(error_of<IoError>([&] { open_view(p, {folder / "images"}); }) ==
        p + ": says 9 x 8 px, but " + tif.string() + " has 9 x 7");

  plain_tiff(folder / "bare.tif", 4, 4, 1, GDT_Byte);
  CHECK(error_of<IoError>([&] { open_view(folder / "bare.tif"); }) ==
        (folder / "bare.tif").string() +
            ": no camera (RPC), looked for bare.RPB, bare.XML, bare_RPC.TXT, bare_rpc.txt, "
            "bare.rpc, bare.tif.aux.xml, RPC_bare.XML, the "
            "TIFF tag or NITF RPC00B "
            "of the file itself");
}

TEST_CASE("pixel types, windows and the camera of a window") {
  const TempFolder folder("pixels");
  const std::vector<std::pair<GDALDataType, std::string>> types{
      {GDT_Byte, "uint8"}, {GDT_UInt16, "uint16"}, {GDT_Int16, "int16"}, {GDT_Float32, "float32"}};
  for (const auto& [type, name] : types) {
    CAPTURE(name);
    plain_tiff(folder / "t.tif", 5, 3, 2, type);
    const Image image = read_image(folder / "t.tif");
    CHECK(image.info.dtype == name);
    CHECK(image.pixels.shape() == Shape{2, 3, 5});
    CHECK(image.valid.shape() == Shape{3, 5});
    CHECK(image.pixels[0] == 1);
    CHECK(image.pixels[15 + 7] == 9);
    CHECK(image.valid[14] == 1);
  }
  write_rpc_geotiff(folder / "c.tif", read_image(folder / "t.tif").pixels, PixelType::uint8,
                    test::synthetic_rpc());
  const Rpc whole = *read_info(folder / "c.tif").rpc;
  const Image part = read_image(folder / "c.tif", PixelWindow{1, 2, 3, 1});
  CHECK(part.pixels.shape() == Shape{2, 1, 3});
  CHECK(part.pixels[0] == 12);
  CHECK(part.info.width == 3);
  CHECK(part.info.height == 1);
  CHECK(*part.info.rpc == whole.cropped(1, 2));
  CHECK(error_of<IoError>([&] {
          read_image(folder / "c.tif", PixelWindow{3, 0, 3, 1});
        }) ==
        (folder / "c.tif").string() + ": window of 3 x 1 px at (3, 0), expected one inside 5 x 3");
}

TEST_CASE("a reduced image has the image's values, whatever overviews there are") {
  const TempFolder folder("reduced");
  constexpr Index kSide = 400;
  Tensor pixels({3, kSide, kSide});
  Rng rng(5);
  for (float& v : pixels.values()) v = std::floor(static_cast<float>(rng.uniform(1, 255)));
  for (Index c = 0; c < 3; ++c)  // and a corner without any
    for (Index i = 0; i < 60; ++i) std::fill_n(pixels.data() + (c * kSide + i) * kSide, 90, 0.0F);
  Rpc camera = test::synthetic_rpc();
  camera.samp_off = camera.line_off = kSide / 2;
  const auto own = folder / "own.tif", beside = folder / "beside.tif", mosaic = folder / "of.vrt";
  for (const auto& file : {own, beside}) write_rpc_geotiff(file, pixels, PixelType::uint8, camera);
  const auto overviews = [](const std::filesystem::path& file, unsigned access) {
    const std::unique_ptr<GDALDataset> d(GDALDataset::Open(file.c_str(), access));
    REQUIRE(d);
    for (int b = 1; access == GDAL_OF_UPDATE && b <= 3; ++b)
      REQUIRE(d->GetRasterBand(b)->SetNoDataValue(0) == CE_None);
    const std::array<int, 2> factors{2, 4};
    REQUIRE(d->BuildOverviews("AVERAGE", 2, const_cast<int*>(factors.data()), 0, nullptr, nullptr,
                              nullptr) == CE_None);
  };
  overviews(own, GDAL_OF_UPDATE);
  overviews(beside, GDAL_OF_READONLY);
  CHECK(std::filesystem::exists(folder / "beside.tif.ovr"));
  {
    const std::unique_ptr<GDALDataset> from(GDALDataset::Open(own.c_str()));
    REQUIRE(from->GetRasterBand(1)->GetOverviewCount() == 2);
    const std::unique_ptr<GDALDataset> made(
        GetGDALDriverManager()->GetDriverByName("VRT")->CreateCopy(mosaic.c_str(), from.get(), 0,
                                                                   nullptr, nullptr, nullptr));
    REQUIRE(made);
  }
  for (const auto& file : {own, beside, mosaic})
    for (const Index factor : {2, 4, 7}) {
      CAPTURE(file.string());
      CAPTURE(factor);
      const Image small = open_reduced(find_view(file), factor);
      const Index side = kSide / factor;
      REQUIRE(small.pixels.shape() == Shape{3, side, side});
      Index wrong = 0;
      for (Index c = 0; c < 3; ++c)
        for (Index i = 0; i < side * side; ++i) {
          const Index y = i / side * factor + factor / 2, x = i % side * factor + factor / 2;
          wrong += small.pixels[c * side * side + i] != pixels[(c * kSide + y) * kSide + x];
          if (file != beside) wrong += (small.valid[i] > 0) != (y >= 60 || x >= 90);
        }
      CHECK(wrong == 0);
    }
  // A JPEG 2000 holds smaller images from the beginning, which are not decoded whole.
  GDALDriver* driver = GetGDALDriverManager()->GetDriverByName("JP2OpenJPEG");
  if (driver == nullptr) return;
  const auto packed = folder / "packed.jp2";
  {
    const std::unique_ptr<GDALDataset> from(GDALDataset::Open(beside.c_str()));
    CPLStringList options;
    options.AddString("QUALITY=100"), options.AddString("REVERSIBLE=YES");
    options.AddString("RESOLUTIONS=4"), options.AddString("YCBCR420=NO");
    const std::unique_ptr<GDALDataset> made(
        driver->CreateCopy(packed.c_str(), from.get(), 0, options, nullptr, nullptr));
    REQUIRE(made);
  }
  write_bytes(folder / "packed_RPC.TXT", as_text(camera));
  const Image whole = open_view(packed), small = open_reduced(find_view(packed), 4);
  CHECK(std::equal(whole.pixels.values().begin(), whole.pixels.values().end(),
                   pixels.values().begin()));
  REQUIRE(small.pixels.shape() == Shape{3, 100, 100});
  const auto deviation = [](const Image& image, Index row) {  // of a part that is noise
    double sum = 0, squares = 0;
    const Index n = image.info.width;
    for (Index x = n / 2; x < n; ++x) {
      const double v = image.pixels[row * n + x];
      sum += v, squares += v * v;
    }
    const auto count = static_cast<double>(n - n / 2);
    return std::sqrt(squares / count - sum / count * sum / count);
  };
  CHECK(deviation(whole, 300) > 60);
  CHECK(deviation(small, 75) < 50);
  for (const Index i : {Index{0}, Index{5 * 100 + 10}, Index{12 * 100 + 20}})
    CHECK(small.pixels[i] == 0);  // the filling keeps its value
}

TEST_CASE("an image in high blocks, read some columns at a time, has its values in their places") {
  const TempFolder folder("reduced_blocks");
  constexpr Index H = 100, W = 400;
  Tensor pixels({3, H, W});
  Rng rng(6);
  for (float& v : pixels.values()) v = std::floor(static_cast<float>(rng.uniform(1, 255)));
  for (Index c = 0; c < 3; ++c)  // and a part without any, across the columns read first
    for (Index y = 0; y < 30; ++y) std::fill_n(pixels.data() + (c * H + y) * W + 120, 90, 0.0F);
  const auto file = folder / "blocks.tif";
  {
    write_rpc_geotiff(folder / "plain.tif", pixels, PixelType::uint8, test::synthetic_rpc());
    const std::unique_ptr<GDALDataset> from(
        GDALDataset::Open((folder / "plain.tif").c_str(), GDAL_OF_UPDATE));
    REQUIRE(from);
    for (int b = 1; b <= 3; ++b) REQUIRE(from->GetRasterBand(b)->SetNoDataValue(0) == CE_None);
    // of which a row of 162 columns is all that is kept in memory
    CPLStringList options;
    for (const char* option : {"TILED=YES", "BLOCKXSIZE=16", "BLOCKYSIZE=65536", "COMPRESS=DEFLATE",
                               "ZLEVEL=1", "INTERLEAVE=PIXEL"})
      options.AddString(option);
    const std::unique_ptr<GDALDataset> made(
        GetGDALDriverManager()->GetDriverByName("GTiff")->CreateCopy(file.c_str(), from.get(), 0,
                                                                     options, nullptr, nullptr));
    REQUIRE(made);
    int width = 0, height = 0;
    made->GetRasterBand(1)->GetBlockSize(&width, &height);
    REQUIRE(width == 16);
    REQUIRE(height == 65536);
  }
  for (const Index factor : {2, 7}) {
    CAPTURE(factor);
    const Image small = open_reduced(find_view(file), factor);
    const Index h = H / factor, w = W / factor;
    REQUIRE(small.pixels.shape() == Shape{3, h, w});
    Index wrong = 0;
    for (Index c = 0; c < 3; ++c)
      for (Index i = 0; i < h * w; ++i) {
        const Index y = i / w * factor + factor / 2, x = i % w * factor + factor / 2;
        wrong += small.pixels[c * h * w + i] != pixels[(c * H + y) * W + x];
        wrong += (small.valid[i] > 0) != (y >= 30 || x < 120 || x >= 210);
      }
    CHECK(wrong == 0);
  }
}

TEST_CASE("what is no pixel: nodata, NaN, alpha") {
  const TempFolder folder("valid");
  const auto path = folder / "v.tif";
  plain_tiff(path, 2, 2, 1, GDT_Float32, {kNan, 2, -9999, 4}, -9999);
  Image image = read_image(path);
  CHECK(image.info.nodata == -9999);
  CHECK(image.valid[0] == 0);
  CHECK(image.valid[1] == 1);
  CHECK(image.valid[2] == 0);
  CHECK(image.valid[3] == 1);

  // Nodata in one channel of several is a colour; in all, a hole.
  plain_tiff(path, 2, 1, 3, GDT_Byte, {3, 0}, 3.0);
  image = read_image(path);  // bands: (3, 0), (2, 3), (3, 4)
  CHECK(image.valid[0] == 1);
  CHECK(image.valid[1] == 1);
  plain_tiff(path, 2, 1, 1, GDT_Byte, {3, 0}, 3.0);
  CHECK(read_image(path).valid[0] == 0);

  plain_tiff(path, 2, 2, 4, GDT_Byte, {}, {}, true);
  image = read_image(path);
  CHECK(image.info.bands == 3);
  CHECK(image.pixels.shape() == Shape{3, 2, 2});
  CHECK(image.valid[0] == 0);
  CHECK(image.valid[3] == 1);

  plain_tiff(path, 2, 2, 1, GDT_Float32, {kNan, kNan, -1, kNan}, -1);
  CHECK(error_of<IoError>([&] { read_image(path); }) ==
        path.string() + ": no valid pixel (all nodata, masked or NaN), expected an image");
}

TEST_CASE("files that are no rasters, in one line and in silence") {
  const TempFolder folder("refuse");
  const auto path = folder / "x.tif";
  const std::string p = path.string();
  int shouted = 0;
  const auto count = [](CPLErr, int, const char*) {
    ++*static_cast<int*>(CPLGetErrorHandlerUserData());
  };
  CPLPushErrorHandlerEx(count, &shouted);
  CHECK(error_of<IoError>([&] { read_image(path); }) == p + ": no such file, expected a raster");
  write_bytes(path, "This is a text.\n");
  std::string text = error_of<IoError>([&] { read_image(path); });
  CHECK(text.find(p + ": not a raster that can be read, expected GeoTIFF, NITF or alike; ") == 0);
  CHECK(text.find('\n') == std::string::npos);
  CHECK(text.find("no reason given") == std::string::npos);

  Rng rng(1);
  write_rpc_geotiff(path, uniform_tensor<float>({1, 300, 300}, rng, 0, 255), PixelType::uint8,
                    test::synthetic_rpc());
  const std::string whole = test::read_bytes(path);
  int pixels_missing = 0;
  for (const std::size_t kept :
       {whole.size() - 100, whole.size() / 2, std::size_t{500}, std::size_t{20}}) {
    write_bytes(path, whole.substr(0, kept));
    CAPTURE(kept);
    text = error_of<IoError>([&] { read_image(path); });
    CHECK(text.find(p + ": ") == 0);
    CHECK(text.find('\n') == std::string::npos);
    pixels_missing +=
        text.find(": the pixels cannot be read, expected a whole file; ") != std::string::npos;
  }
  CHECK(pixels_missing >= 1);
  CHECK(error_of<IoError>([&] { read_geo_raster(path); }).find(p + ": ") == 0);
  CPLPopErrorHandler();
  CHECK(shouted == 0);

  plain_tiff(folder / "c.tif", 2, 2, 1, GDT_CFloat32);
  CHECK(error_of<IoError>([&] { read_image(folder / "c.tif"); }) ==
        (folder / "c.tif").string() + ": pixels are complex (cfloat32), expected real numbers");
}

TEST_CASE("which bands are red, green and blue: as they say, else as Maxar delivers them") {
  const TempFolder folder("rgb");
  const auto path = folder / "v.tif";
  using Channels = std::array<Index, 3>;
  /// groups  of the file of metadata beside the image; none for no file
  const auto rgb = [&](int bands, const std::vector<std::string>& groups,
                       const std::vector<GDALColorInterp>& colours = {}) {
    std::filesystem::remove(folder / "v.IMD");
    std::filesystem::remove(folder / "v.tif.aux.xml");
    plain_tiff(path, 4, 3, bands, GDT_UInt16);
    std::string text = "version = \"28.4\";\n";
    for (const std::string& group : groups)
      text += "BEGIN_GROUP = " + group + "\n\tabsCalFactor = 9.2e-03;\nEND_GROUP = " + group + "\n";
    if (!groups.empty()) write_bytes(folder / "v.IMD", text + "END;\n");
    if (!colours.empty()) {
      const std::unique_ptr<GDALDataset> d(GDALDataset::Open(path.c_str(), GDAL_OF_UPDATE));
      REQUIRE(d);
      for (std::size_t b = 0; b < colours.size(); ++b)
        REQUIRE(d->GetRasterBand(static_cast<int>(b) + 1)->SetColorInterpretation(colours[b]) ==
                CE_None);
    }
    return read_info(path).rgb_channels;
  };
  const std::vector<std::string> four{"BAND_B", "BAND_G", "BAND_R", "BAND_N"},
      eight{"BAND_C", "BAND_B", "BAND_G", "BAND_Y", "BAND_R", "BAND_RE", "BAND_N", "BAND_N2"};
  CHECK(rgb(4, four) == Channels{2, 1, 0});
  CHECK(rgb(8, eight) == Channels{4, 2, 1});
  CHECK(rgb(4, {}) == Channels{0, 1, 2});
  CHECK(rgb(8, {}) == Channels{0, 1, 2});
  CHECK(rgb(4, {"BAND_P"}) == Channels{0, 1, 2});
  CHECK(rgb(3, four) == Channels{0, 1, 2});  // three of them, nobody knows which
  const auto red = GCI_RedBand, green = GCI_GreenBand, blue = GCI_BlueBand, none = GCI_Undefined;
  CHECK(rgb(3, {}, {blue, green, red}) == Channels{2, 1, 0});
  CHECK(rgb(4, four, {green, red, none, blue}) == Channels{1, 0, 3});
  CHECK(rgb(4, four, {green, red, none, none}) == Channels{2, 1, 0});  // not all of them said
}

TEST_CASE("colours for the network") {
  Image image;
  image.info.dtype = "uint8";
  image.pixels = Tensor::from({1, 1, 3}, {0, 51, 255});
  image.valid = Tensor::from({1, 3}, {1, 1, 0});
  Tensor rgb = to_rgb(image);
  CHECK(rgb.shape() == Shape{3, 1, 3});
  for (Index c = 0; c < 3; ++c) {
    CHECK(rgb[c * 3] == 0);
    CHECK(rgb[c * 3 + 1] == doctest::Approx(0.2));
    CHECK(rgb[c * 3 + 2] == 0);
  }
  image.pixels = Tensor::from({4, 1, 1}, {51, 102, 153, 204});
  image.valid = Tensor({1, 1}, 1);
  rgb = to_rgb(image);
  CHECK(rgb[0] == doctest::Approx(0.2));
  CHECK(rgb[2] == doctest::Approx(0.6));
  image.info.rgb_channels = {2, 1, 0};
  CHECK(to_rgb(image)[0] == doctest::Approx(0.6));

  // 16 bit: 1st and 99th percentile of the valid pixels, all channels together.
  const Index N = 1001;
  image.info.dtype = "uint16";
  image.info.rgb_channels = {0, 1, 2};
  image.pixels = Tensor({3, 1, N});
  image.valid = Tensor({1, N}, 1);
  for (Index c = 0; c < 3; ++c)
    for (Index i = 0; i < N; ++i) image.pixels[c * N + i] = static_cast<float>(200 + i);
  image.pixels[5] = 60000;
  image.valid[5] = 0;
  rgb = to_rgb(image);
  CHECK(rgb[0] == 0);
  CHECK(rgb[5] == 0);
  CHECK(rgb[N - 1] == 1);
  CHECK(rgb[500] == doctest::Approx(0.5).epsilon(0.01));
  CHECK(rgb[N + 500] == rgb[500]);
  CHECK(rgb[10] == doctest::Approx(0).epsilon(0.002));
  CHECK(rgb[20] > 0.005);
  image.pixels.fill(7);
  rgb = to_rgb(image);
  for (const float v : rgb.values()) CHECK_FALSE(std::isnan(v));
  image.valid = Tensor({2, 2});
  CHECK_THROWS_AS(to_rgb(image), ShapeError);
}

TEST_CASE("colours are the same for any number of threads") {
  Rng rng(8);
  Image image;
  image.info.dtype = "float32";
  image.pixels = uniform_tensor<float>({3, 301, 257}, rng, -5, 900);
  image.valid = uniform_tensor<float>({301, 257}, rng, 0, 2);
  for (float& v : image.valid.values()) v = v < 0.2F ? 0.0F : 1.0F;
  set_threads(1);
  const Tensor one = to_rgb(image);
  set_threads(2);
  const Tensor two = to_rgb(image);
  set_threads(0);
  Index different = 0;
  for (Index i = 0; i < one.count(); ++i) different += one[i] != two[i];
  CHECK(different == 0);
}

TEST_CASE("real camera files: every dialect as GDAL reads it, and its transformer's projection") {
  const auto data = test::data_folder();
  if (data.empty()) return;
  const TempFolder folder("formats");
  struct Format {
    std::string file, image, sidecar, source;
  };
  const std::vector<Format> formats{
      {"rpc_IKONOS.txt", "i.tif", "i_RPC.TXT", "_RPC.TXT"},
      {"rpc_PLANET_L1B.txt", "p.tif", "p_RPC.TXT", "_RPC.TXT"},
      {"20191015_073816_ssc1d3_0011_basic_l1a_panchromatic_dn_RPC.TXT", "s.tif", "s_RPC.TXT",
       "_RPC.TXT"},
      {"rpc_WV2.xml", "w.tif", "w.XML", "Maxar XML"},
      {"rpc_PLEIADES.xml", "IMG_h_R1C1.TIF", "RPC_h.XML", "DIMAP"}};
  double worst = 0, worst_gdal = 0;
  for (const Format& f : formats) {
    CAPTURE(f.file);
    const Rpc rpc = read_rpc_file(data / "rpc_formats" / f.file);
    plain_tiff(folder / f.image, 4, 4, 1, GDT_Byte);
    write_bytes(folder / f.sidecar, test::read_bytes(data / "rpc_formats" / f.file));
    if (f.source == "DIMAP") write_bytes(folder / "DIM_h.XML", kDim);
    const RasterInfo info = view_info(folder / f.image);
    CHECK(info.rpc_source == f.source);
    worst_gdal = std::max({worst_gdal, worst_difference(rpc, *info.rpc),
                           worst_difference(rpc, gdal_reads(folder / f.image))});
    const test::GdalRpc oracle(rpc);
    Rng rng(3);
    for (int i = 0; i < 50; ++i) {
      // A tenth of the box: SkySat's is a whole degree wide, far beyond its image.
      const double part = rpc.lat_scale == 1 ? 0.005 : 0.9;
      const Geodetic p{rpc.lon_off + part * rpc.lon_scale * rng.uniform(-1, 1),
                       rpc.lat_off + part * rpc.lat_scale * rng.uniform(-1, 1),
                       rpc.height_off + (rpc.lat_scale == 1 ? 0.01 : 0.9) * rpc.height_scale *
                                            rng.uniform(-1, 1)};
      const Pixel a = rpc.project(p), b = oracle.project(p);
      worst = std::max(worst, std::hypot(a.x - b.x, a.y - b.y));
      const Geodetic back = rpc.localize(a, p.h);
      CHECK(std::hypot(back.lon - p.lon, back.lat - p.lat) < 1e-9);
    }
  }
  MESSAGE("projection against GDAL ", worst, " px; our reading against GDAL's ", worst_gdal, " px");
  CHECK(worst < 1e-6);
  CHECK(worst_gdal < 1e-6);
}

TEST_CASE("real images: cameras from the tag and from the JSON files") {
  const auto data = test::data_folder();
  if (data.empty()) return;
  const auto views = data / "jax_068_views";
  for (const char* name : {"JAX_068_012_RGB", "JAX_068_018_RGB", "JAX_068_022_RGB"}) {
    CAPTURE(name);
    const RasterInfo tag = view_info(views / (std::string(name) + ".tif"));
    CHECK(tag.rpc_source == "TIFF tag");
    CHECK(!tag.geotransform);
    const RasterInfo raw = view_info(views / "rpc_raw" / (std::string(name) + ".json"), {views});
    const RasterInfo adjusted =
        view_info(views / "rpc_adjusted" / (std::string(name) + ".json"), {views});
    CHECK(raw.width == tag.width);
    REQUIRE(raw.sun_elevation_deg);
    CHECK(*raw.sun_elevation_deg > 20);
    REQUIRE(raw.height_range);
    // Within the image and the height range, the raw JSON is the tag, and the adjusted one is a few
    // pixels off.
    for (const double h : {raw.height_range->low, raw.height_range->high}) {
      const Geodetic p = tag.rpc->localize({400, 300}, h);
      const Pixel a = raw.rpc->project(p), b = adjusted.rpc->project(p);
      CHECK(std::hypot(a.x - 400, a.y - 300) < 1e-6);
      CHECK(std::hypot(b.x - 400, b.y - 300) < 5);
    }
  }
  const Image image = open_view(data / "pleiades_pair/img_01.tif");
  CHECK(image.info.dtype == "uint16");
  CHECK(image.pixels.shape() == Shape{1, 1024, 1024});
  const Tensor rgb = to_rgb(image);
  double sum = 0;
  for (const float v : rgb.values()) sum += v;
  CHECK(sum / static_cast<double>(rgb.count()) > 0.15);
  CHECK(sum / static_cast<double>(rgb.count()) < 0.85);
  CHECK(image.info.rpc->cropped(0, 0) == *image.info.rpc);
}

TEST_CASE("pixels that a file has lost are found without keeping any") {
  const TempFolder folder("read_cut");
  const auto whole = folder / "whole.tif", cut = folder / "cut.tif", png = folder / "whole.png";
  plain_tiff(whole, 64, 300, 2, GDT_Float32);
  CHECK_NOTHROW(check_pixels(whole));
  std::string bytes = read_text_file(whole, "");
  write_bytes(cut, bytes.substr(0, bytes.size() * 2 / 3));
  CHECK(error_of<IoError>([&] {
          check_pixels(cut);
        }).find("cut.tif: the pixels cannot be read from row ") != std::string::npos);

  plain_tiff(whole, 64, 300, 1, GDT_Byte);
  auto* driver = GetGDALDriverManager()->GetDriverByName("PNG");
  std::unique_ptr<GDALDataset> from(GDALDataset::Open(whole.c_str()));
  std::unique_ptr<GDALDataset>(
      driver->CreateCopy(png.c_str(), from.get(), 0, nullptr, nullptr, nullptr));
  CHECK_NOTHROW(check_pixels(png));
  bytes = read_text_file(png, "");
  write_bytes(folder / "cut.png", bytes.substr(0, bytes.size() / 2));
  CHECK(error_of<IoError>([&] {
          check_pixels(folder / "cut.png");
        }).find("expected a whole file") != std::string::npos);
}

TEST_CASE("a system of no place on the Earth is no georeference") {
  const TempFolder folder("read_local");
  const auto file = folder / "local.tif";
  plain_tiff(file, 4, 4, 1, GDT_Byte);
  {
    const std::unique_ptr<GDALDataset> d(GDALDataset::Open(file.c_str(), GDAL_OF_UPDATE));
    OGRSpatialReference local;
    local.SetLocalCS("somewhere");
    REQUIRE(d->SetSpatialRef(&local) == CE_None);
  }
  const RasterInfo info = read_info(file);
  CHECK(info.crs.empty());
  CHECK(info.local_crs == "somewhere");
}
