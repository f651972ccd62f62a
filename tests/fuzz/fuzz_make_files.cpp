// SPDX-License-Identifier: Apache-2.0
// Files of every form that is read, for the targets of readers to begin with.
//   fuzz_make_files FOLDER
#include "satsurf/core/safetensors.h"
#include "satsurf/mesh/ply.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/pointing_file.h"
#include "satsurf/splat/ply.h"

#include "tests/fuzz/seeds.h"
#include "tests/ref/rpc_dialects.h"
#include "tests/ref/synthetic_rpc.h"
#include <gdal_priv.h>

namespace satsurf::fuzz {
namespace {

namespace fs = std::filesystem;
using namespace test::dialects;

void tensors() {
  const auto put_file = [](const std::string& target, const std::string& name,
                           const TensorFile& file) {
    put(target, name,
        written("f.safetensors", [&](const fs::path& p) { save_safetensors(p, file); }));
  };
  TensorFile file;
  file.metadata = {{"format", "satsurf-1"}, {"k", "v"}};
  put_file("safetensors", "metadata", file);
  file.tensors = {{"a", ramp({2, 3})}, {"b", ramp({})}, {"none", Tensor({0, 4})}};
  put_file("safetensors", "floats", file);
  file.doubles["c"] = BasicTensor<double>({2}, 1.5);
  put_file("safetensors", "doubles", file);
  file.half = true;
  put_file("safetensors", "halves", file);
}

void surfaces() {
  const Index P = 2;
  splat::Surfels surfels{Var(ramp({P, 3})),      Var(ramp({P, 4})), Var(ramp({P, 2})),
                         Var(Tensor({P}, 0.5F)), Var(ramp({P, 3})), {}};
  for (const bool two : {false, true})
    put("surfels_ply", two ? "discs" : "splats", written("s.ply", [&](const fs::path& p) {
          splat::write_ply(p, surfels, {"frame EPSG:32633 1 2 3"}, two);
        }));
  mesh::Mesh mesh;
  mesh.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  mesh.faces = {{0, 1, 2}};
  put("mesh_ply", "plain",
      written("m.ply", [&](const fs::path& p) { mesh::write_ply(p, mesh, {}); }));
  mesh.normals = {{0, 0, 1}, {0, 0, 1}, {0, 0, 1}};
  mesh.colours = {{0, 0, 1}, {0, 1, 0}, {1, 0, 0}};
  put("mesh_ply", "coloured",
      written("m.ply", [&](const fs::path& p) { mesh::write_ply(p, mesh, {"comment"}); }));
  put("mesh_ply", "doubles_and_a_quad",
      "ply\nformat binary_little_endian 1.0\nobj_info x\nelement vertex 4\nproperty double "
      "x\nproperty double y\n"
      "property float z\nproperty uchar other\nelement face 1\nproperty list int uint "
      "vertex_index\nend_header\n" +
          std::string(4 * 21, '\0') + std::string("\4\0\0\0\0\0\0\0\1\0\0\0\2\0\0\0\3\0\0\0", 20));
}

void cameras() {
  const rpc::Rpc camera = test::synthetic_rpc();
  const std::string satnerf = as_satnerf(camera, "a.tif", 8, 8).dump();
  const std::string aux = [&] {
    std::ostringstream out;
    out << std::setprecision(17) << "<PAMDataset><Metadata domain=\"RPC\">";
    for (const auto& s : scalars(camera))
      out << "<MDI key=\"" << s.text << "\">" << s.value << "</MDI>";
    for (const auto& l : lists(camera))
      out << "<MDI key=\"" << l.text << "\">" << join(l.values, " ") << "</MDI>";
    out << "</Metadata></PAMDataset>";
    return out.str();
  }();
  const std::vector<std::pair<std::string, std::string>> dialects{
      {"rpb", as_rpb(camera)},          {"maxar_xml", as_maxar_xml(camera)},
      {"rpc_txt", as_text(camera)},     {"whu", as_whu(camera)},
      {"dimap", as_dimap(camera)},      {"aux_xml", aux},
      {"rpcm", as_rpcm(camera).dump()}, {"satnerf", satnerf}};
  for (const auto& [name, text] : dialects) put("camera_file", name, text);
  put("satnerf", "a", satnerf);
  // the first byte is the name, in the order of fuzz_sidecar.cpp
  const char* const beside[] = {"rpb", "maxar_xml", "rpc_txt", "rpc_txt", "whu", "dimap", "dimap"};
  for (std::size_t k = 0; k < std::size(beside); ++k)
    for (const auto& [name, text] : dialects)
      if (name == beside[k]) put("sidecar", std::to_string(k), static_cast<char>(k) + text);
  put("sidecar", "imd",
      "\7version = \"R\";\nbandId = \"P\";\nBEGIN_GROUP = IMAGE_1\n\tmeanSunEl = "
      "40.5;\n\tmeanSunAz = 160;\n"
      "\tfirstLineTime = 2015-09-30T10:56:56.1Z;\nEND_GROUP = IMAGE_1\nEND;\n");
  put("sidecar", "aux", '\10' + aux);
  put("sidecar", "world",
      "\11"
      "0.5\n0\n0\n-0.5\n500000\n5000000\n");
  put("dfc_grid", "a", "500000.0\n5000000.0\n8\n0.5\n");
}

void rasters() {
  const rpc::Rpc camera = test::synthetic_rpc();
  const std::string image = written("i.tif", [&](const fs::path& p) {
    rpc::write_rpc_geotiff(p, ramp({3, 8, 8}), rpc::PixelType::uint8, camera,
                           {{"SUN_ELEVATION", "40"}, {"ACQUISITION_DATE", "2015-09-30"}});
  });
  put("raster", "rpc_tif", image);
  put("picture", "tiff", image);
  put("raster", "rpc_tif_16", written("j.tif", [&](const fs::path& p) {
        rpc::write_rpc_geotiff(p, ramp({1, 8, 8}), rpc::PixelType::uint16, camera);
      }));
  put("raster", "dsm", written("d.tif", [&](const fs::path& p) {
        rpc::write_geo_raster(p, ramp({8, 8}), {32633, 500000, 5000000, 0.5},
                              rpc::ellipsoidal_height("heights"));
      }));
  put("raster", "dsm_egm96", written("e.tif", [&](const fs::path& p) {
        rpc::write_geo_raster(p, ramp({2, 8, 8}), {32633, 500000, 5000000, 0.5},
                              rpc::height_tags("heights", rpc::HeightDatum::egm96));
      }));
  put("raster", "ascii_grid",
      "ncols 3\nnrows 2\nxllcorner 500000\nyllcorner 5000000\ncellsize 0.5\nNODATA_value -9999\n1 "
      "2 3\n4 -9999 6\n");
  put("raster", "vrt",
      "<VRTDataset rasterXSize=\"8\" rasterYSize=\"8\"><VRTRasterBand dataType=\"Byte\" "
      "band=\"1\"><SimpleSource>"
      "<SourceFilename "
      "relativeToVRT=\"1\">b.tif</SourceFilename><SourceBand>1</SourceBand></SimpleSource>"
      "</VRTRasterBand></VRTDataset>");
  // the other formats by GDAL's own writers
  GDALAllRegister();
  const auto source = folder().path() / "i.tif";
  GDALDataset* d = static_cast<GDALDataset*>(GDALOpen(source.c_str(), GA_ReadOnly));
  for (const char* format : {"PNG", "JPEG", "BMP", "NITF", "PCIDSK", "JP2OpenJPEG"}) {
    auto* driver = GetGDALDriverManager()->GetDriverByName(format);
    if (d == nullptr || driver == nullptr) continue;
    const auto copy = folder().path() / (std::string("copy.") + format);
    CPLPushErrorHandler(CPLQuietErrorHandler);
    if (GDALDataset* c = driver->CreateCopy(copy.c_str(), d, FALSE, nullptr, nullptr, nullptr)) {
      GDALClose(c);
      put("raster", format, bytes_of(copy));
      if (format == std::string("PNG") || format == std::string("JPEG"))
        put("picture", format, bytes_of(copy));
    }
    CPLPopErrorHandler();
  }
  if (d != nullptr) GDALClose(d);
  // 65,535 tiles of a pixel, for which OpenJPEG would take 400 MB
  std::string tiles("\xff\x4f\xff\x51\0\x2f\0\0\0\0\xff\xff\0\0\0\1", 16);
  tiles += std::string(8, '\0') + std::string("\0\0\0\1\0\0\0\1", 8) + std::string(8, '\0');
  tiles += std::string("\0\3\7\1\1\7\1\1\7\1\1", 11);
  put("raster", "tiles", tiles);
}

void texts() {
  scene::Pointing pointing;
  pointing.names = {"a", "b"};
  pointing.shifts = {{0.5, -0.25}, {-0.5, 0.25}};
  put("pointing", "a",
      written("p.json", [&](const fs::path& p) { scene::write_pointing(p, pointing); }));
  pointing.slopes = {{{100, 200}, {{{1e-3, 0}, {0, -2e-3}}}}, {{50, 60}, {}}};
  put("pointing", "sloped",
      written("p.json", [&](const fs::path& p) { scene::write_pointing(p, pointing); }));
  put("area", "polygon",
      R"({"type":"FeatureCollection","features":[{"type":"Feature","properties":{},"geometry":{"type":"Polygon",)"
      R"("coordinates":[[[15,45],[15.01,45],[15.01,45.01],[15,45]]]}}]})");
  put("area", "many",
      R"({"type":"MultiPolygon","coordinates":[[[[15,45],[15.01,45],[15.01,45.01],[15,45]]],)"
      R"([[[15.1,45],[15.11,45],[15.11,45.01],[15.1,45]]]]})");
  put("area", "kml",
      "<?xml version=\"1.0\"?><kml "
      "xmlns=\"http://www.opengis.net/kml/2.2\"><Document><Placemark><Polygon>"
      "<outerBoundaryIs><LinearRing><coordinates>15,45 15.01,45 15.01,45.01 "
      "15,45</coordinates></LinearRing>"
      "</outerBoundaryIs></Polygon></Placemark></Document></kml>");
}

}  // namespace
}  // namespace satsurf::fuzz

int main(int argc, char** argv) {
  using namespace satsurf::fuzz;
  if (!takes_folder(argc, argv)) return 2;
  tensors();
  surfaces();
  cameras();
  rasters();
  texts();
}
