// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/rpc/area.h"
#include "satsurf/rpc/raster.h"

#include <algorithm>
#include <cmath>
#include <csignal>
#include <filesystem>
#include <iterator>
#include <limits>
#include <memory>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "tests/rpc/quiet_server.h"
#include "tests/temp_folder.h"
#include <doctest/doctest.h>
#include <ogrsf_frmts.h>
#include <sys/resource.h>

using namespace satsurf;
using namespace satsurf::rpc;
using test::TempFolder;
using test::write_bytes;

namespace {

const UtmZone kZone{17, true};

/// A square with a square hole, in the coordinates of `crs`.
std::string geojson(const std::string& crs) {
  return R"({"type":"FeatureCollection",)" + crs +
         R"("features":[{"type":"Feature","properties":{},"geometry":{"type":"Polygon","coordinates":[
[[500000,3350000],[500100,3350000],[500100,3350100],[500000,3350100],[500000,3350000]],
[[500040,3350040],[500040,3350060],[500060,3350060],[500060,3350040],[500040,3350040]]]}}]})";
}

}  // namespace

TEST_CASE("polygons are read in whatever system the file names, holes and all") {
  const TempFolder folder("area");
  write_bytes(folder / "utm.geojson",
              geojson(R"("crs":{"type":"name","properties":{"name":"EPSG:32617"}},)"));
  const Area area = read_area(folder / "utm.geojson", kZone);
  CHECK(area.contains(500010, 3350010));
  CHECK_FALSE(area.contains(500050, 3350050));
  CHECK_FALSE(area.contains(500110, 3350050));
  CHECK(area.bounds()[0] == doctest::Approx(500000));
  CHECK(area.bounds()[3] == doctest::Approx(3350100));
  CHECK(area.crossings(3350050).size() == 4);
  CHECK(area.crossings(3350200).empty());

  const GeoGrid grid{kZone.epsg(), 499985, 3350112, 7};
  const Tensor cells = area.cells(grid, 18, 19);
  for (Index i = 0; i < cells.count(); ++i) {
    CAPTURE(i);
    const double x = grid.x0 + (static_cast<double>(i % 19) + 0.5) * grid.step,
                 y = grid.y0 - (static_cast<double>(i / 19) + 0.5) * grid.step;
    CHECK(cells[i] == (area.contains(x, y) ? 1 : 0));
  }
  CHECK(std::ranges::count(cells.values(), 1.0F) > 0);

  const auto [lon, lat] = geodetic_from_utm(kZone, 500050, 3350050);
  const auto at = [](double v) { return std::to_string(v); };
  const double d = 0.001;
  write_bytes(folder / "degrees.geojson", R"({"type":"Polygon","coordinates":[[[)" + at(lon - d) +
                                              "," + at(lat - d) + "],[" + at(lon + d) + "," +
                                              at(lat - d) + "],[" + at(lon) + "," + at(lat + d) +
                                              "],[" + at(lon - d) + "," + at(lat - d) + "]]]}");
  const Area triangle = read_area(folder / "degrees.geojson", kZone);
  CHECK(triangle.contains(500050, 3350050));
  CHECK_FALSE(triangle.contains(500050 - 90, 3350050 + 90));
}

TEST_CASE("polygons that overlap or touch are one area") {
  const TempFolder folder("area_joined");
  const auto read = [&](const std::vector<std::array<double, 4>>& boxes) {
    std::ostringstream text;
    text << std::fixed << R"({"type":"FeatureCollection","crs":{"type":"name","properties":)"
         << R"({"name":"EPSG:32617"}},"features":[)";
    for (std::size_t i = 0; i < boxes.size(); ++i) {
      const auto& [x0, y0, x1, y1] = boxes[i];
      text << (i > 0 ? "," : "") << R"({"type":"Feature","properties":{},"geometry":{"type":)"
           << R"("Polygon","coordinates":[[[)" << x0 << ',' << y0 << "],[" << x1 << ',' << y0
           << "],[" << x1 << ',' << y1 << "],[" << x0 << ',' << y1 << "],[" << x0 << ',' << y0
           << "]]]}}";
    }
    write_bytes(folder / "boxes.geojson", text.str() + "]}");
    return read_area(folder / "boxes.geojson", kZone);
  };
  const Area two = read({{500000, 3350000, 500100, 3350100}, {500060, 3350060, 500160, 3350160}});
  CHECK(two.rings.size() == 1);
  CHECK(two.contains(500080, 3350080));  // in both
  CHECK(two.contains(500020, 3350020));
  CHECK(two.contains(500140, 3350140));
  CHECK_FALSE(two.contains(500020, 3350140));
  CHECK_FALSE(two.contains(500140, 3350020));

  // so many that they are joined part by part; every second overlaps its neighbour in the east and
  // touches that in the north, also where the parts meet
  std::vector<std::array<double, 4>> many;
  for (int row = 0; row < 12; ++row)
    for (int column = 0; column < 12; ++column) {
      const double x = 500000 + 30 * column + (column % 2 != 0 ? 15 : 0),
                   y = 3350000 + 30 * row + (row % 2 != 0 ? 10 : 0);
      many.push_back({x, y, x + 20, y + 20});
    }
  const Area area = read(many);
  Index wrong = 0, inside = 0;
  for (double y = 3349997.5; y < 3350400; y += 5)
    for (double x = 499997.5; x < 500400; x += 5) {
      const bool in = std::ranges::any_of(many, [&](const std::array<double, 4>& box) {
        return x > box[0] && x < box[2] && y > box[1] && y < box[3];
      });
      inside += in;
      wrong += area.contains(x, y) != in;
    }
  CHECK(wrong == 0);
  CHECK(inside == 43 * 48);
}

TEST_CASE("files without polygons, and files that are none, are refused by name") {
  const TempFolder folder("area");
  write_bytes(folder / "point.geojson", R"({"type":"Point","coordinates":[-81,30]})");
  write_bytes(folder / "text.geojson", "no map");
  for (const char* name : {"point.geojson", "text.geojson", "nowhere.geojson"}) {
    CAPTURE(name);
    try {
      read_area(folder / name, kZone);
      FAIL("accepted");
    } catch (const IoError& e) {
      CHECK(std::string(e.what()).find(name) != std::string::npos);
      CHECK(std::string(e.what()).find("expected") != std::string::npos);
    }
  }
}

TEST_CASE("sides around the Earth a hundred times do not fill the memory with corners") {
  const TempFolder folder("area");
  write_bytes(
      folder / "vast.geojson",
      R"({"type":"FeatureCollection","crs":{"type":"name","properties":{"name":"EPSG:32617"}},)"
      R"("features":[{"type":"Feature","properties":{},"geometry":{"type":"Polygon","coordinates":)"
      R"([[[0,0],[9e7,0],[9e7,9e7],[0,0]]]}}]})");
  std::size_t corners = 0;
  for (const auto& ring : read_area(folder / "vast.geojson", kZone).rings) corners += ring.size();
  CHECK(corners > 1000);
  // of which sides that cross each other are joined within a second
  CHECK(corners < 4'000);
  const auto says = [&](const std::string& corner) {
    write_bytes(folder / "far.geojson", R"({"type":"Polygon","coordinates":[[[-81,30],[)" + corner +
                                            "],[-81,31],[-81,30]]]}");
    return test::error_of<IoError>([&] { read_area(folder / "far.geojson", kZone); });
  };
  const std::string where = (folder / "far.geojson").string() + ": corners from (-81, 30) to (";
  CHECK(says("214748364845,30.5") == where + "2.14748e+11, 31), expected degrees");
  CHECK(says("-80,1e300") == where + "-80, 1e+300), expected degrees");
  // to which no envelope and no length of a step say no
  write_bytes(
      folder / "nan.kml",
      R"(<?xml version="1.0"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark>)"
      R"(<Polygon><outerBoundaryIs><LinearRing><coordinates>-81,30 -80,30 nan,30.5 -81,30)"
      R"(</coordinates></LinearRing></outerBoundaryIs></Polygon></Placemark></Document></kml>)");
  CHECK(test::error_of<IoError>([&] { read_area(folder / "nan.kml", kZone); }) ==
        (folder / "nan.kml").string() + ": a corner is no number, expected degrees");
}

TEST_CASE("what is no polygon is no area, and not looked at") {
  const TempFolder folder("area");
  const std::string polygon =
      R"({"type":"Polygon","coordinates":[[[-81,30],[-80.9,30],[-80.9,30.1],[-81,30]]]})";
  write_bytes(folder / "alone.geojson", polygon);
  write_bytes(folder / "mixed.geojson",
              R"({"type":"GeometryCollection","geometries":[{"type":"LineString","coordinates":)"
              R"([[-1e300,30],[1e300,30]]},{"type":"GeometryCollection","geometries":[)" +
                  polygon + "]}]}");
  const Area alone = read_area(folder / "alone.geojson", kZone),
             mixed = read_area(folder / "mixed.geojson", kZone);
  REQUIRE(mixed.rings.size() == 1);
  CHECK(mixed.rings[0].size() == alone.rings[0].size());
  CHECK(mixed.bounds() == alone.bounds());
}

TEST_CASE("polygons ask no network and leave nothing behind") {
  const TempFolder folder("area");
  const test::QuietServer server;
  write_bytes(folder / "link.geojson",
              geojson(R"("crs":{"type":"link","properties":{"href":")" + server.url() + R"("}},)"));
  CHECK(test::error_of<IoError>([&] { read_area(folder / "link.geojson", kZone); }) ==
        (folder / "link.geojson").string() + ": names " + server.url() +
            ", expected files on this machine");
  write_bytes(
      folder / "a.gml",
      R"(<wfs:FeatureCollection xmlns:wfs="http://www.opengis.net/wfs" )"
      R"(xmlns:gml="http://www.opengis.net/gml" xmlns:a="http://a" )"
      R"(xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:schemaLocation="http://a )" +
          server.url() +
          R"("><gml:featureMember><a:b><a:g><gml:Polygon srsName="EPSG:4326">)"
          R"(<gml:outerBoundaryIs><gml:LinearRing><gml:coordinates>-81,30 -80.9,30 -80.9,30.1 )"
          R"(-81,30</gml:coordinates></gml:LinearRing></gml:outerBoundaryIs></gml:Polygon></a:g>)"
          R"(</a:b></gml:featureMember></wfs:FeatureCollection>)");
  CHECK(test::error_of<IoError>([&] { read_area(folder / "a.gml", kZone); }) ==
        (folder / "a.gml").string() +
            ": of the format GML, expected GeoJSON, GeoPackage, a shapefile or alike; "
            "SATSURF_GDAL_DRIVERS=GML in the environment allows it");
  CHECK(server.visits() == 0);
  CHECK(std::distance(std::filesystem::directory_iterator(folder.path()), {}) == 2);
}

TEST_CASE("a GeoPackage with views, which may have no end, is refused") {
  const TempFolder folder("area");
  const std::string path = (folder / "a.gpkg").string();
  GDALAllRegister();
  {
    const std::unique_ptr<GDALDataset> d(GetGDALDriverManager()->GetDriverByName("GPKG")->Create(
        path.c_str(), 0, 0, 0, GDT_Unknown, nullptr));
    REQUIRE(d != nullptr);
    OGRSpatialReference degrees;
    REQUIRE(degrees.importFromEPSG(4326) == OGRERR_NONE);
    degrees.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
    OGRLayer* layer = d->CreateLayer("fields", &degrees, wkbPolygon);
    REQUIRE(layer != nullptr);
    OGRFeature feature(layer->GetLayerDefn());
    OGRGeometry* polygon = nullptr;
    OGRGeometryFactory::createFromWkt("POLYGON((-81 30,-80.9 30,-80.9 30.1,-81 30))", nullptr,
                                      &polygon);
    feature.SetGeometryDirectly(polygon);
    REQUIRE(layer->CreateFeature(&feature) == OGRERR_NONE);
  }
  CHECK(read_area(path, kZone).rings.size() == 1);
  {
    const std::unique_ptr<GDALDataset> d(
        GDALDataset::Open(path.c_str(), GDAL_OF_VECTOR | GDAL_OF_UPDATE));
    REQUIRE(d != nullptr);
    d->ExecuteSQL(
        "CREATE VIEW v AS WITH RECURSIVE r(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM r) "
        "SELECT i AS fid, NULL AS geom FROM r",
        nullptr, nullptr);
    d->ExecuteSQL(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, srs_id) "
        "VALUES ('v', 'features', 'v', 4326)",
        nullptr, nullptr);
    d->ExecuteSQL("INSERT INTO gpkg_geometry_columns VALUES ('v', 'geom', 'POLYGON', 4326, 0, 0)",
                  nullptr, nullptr);
  }
  CHECK(test::error_of<IoError>([&] { read_area(path, kZone); }) ==
        path + ": holds views, expected tables alone; ogr2ogr makes one of a view");
}

TEST_CASE("more polygons than are drawn around ground are refused, and the wait can be ended") {
  const TempFolder folder("area");
  const std::string path = (folder / "many.geojson").string();
  const auto write = [&](const std::string& begin, const std::string& element, int count,
                         const std::string& end) {
    std::string text = begin + element;
    for (int i = 1; i < count; ++i) text += "," + element;
    write_bytes(path, text + end);
  };
  const std::string ring = "[[-81,30],[-80.9,30],[-80.9,30.1],[-81,30]]";
  write(R"({"type":"MultiPolygon","coordinates":[)", "[" + ring + "]", 20'001, "]}");
  const auto says = [&] { return test::error_of<IoError>([&] { read_area(path, kZone); }); };
  CHECK(says() ==
        path +
            ": more than 20000 rings of polygons, expected the polygons around some ground; "
            "cut or join them (ogr2ogr)");
  write(R"({"type":"FeatureCollection","features":[)",
        R"({"type":"Feature","properties":{},"geometry":null})", 100'001, "]}");
  CHECK(says().starts_with(path + ": more than 100000 features, "));
  struct Told {};
  CHECK_THROWS_AS(read_area(path, kZone, [] { throw Told{}; }), Told);
}

TEST_CASE("a box in degrees becomes the same ground in the zone") {
  const auto [lon, lat] = geodetic_from_utm(kZone, 500050, 3350050);
  const Area area = area_of_box({lon - 0.01, lat - 0.01, lon + 0.01, lat + 0.01}, kZone);
  CHECK(area.contains(500050, 3350050));
  for (const double part : {-0.999, 0.999}) {
    const auto in = utm_from_geodetic(kZone, lon + 0.01 * part, lat + 0.01 * part);
    CHECK(area.contains(in[0], in[1]));
    const auto out = utm_from_geodetic(kZone, lon + 0.01 * part * 1.01, lat + 0.01 * part);
    CHECK_FALSE(area.contains(out[0], out[1]));
  }
  CHECK_THROWS_AS(area_of_box({1, 1, 0, 2}, kZone), ConfigError);
  CHECK_THROWS_AS(area_of_box({0, 0, 50, 2}, kZone), ConfigError);
}

TEST_CASE("a box across the antimeridian") {
  const UtmZone zone{60, false};
  const Area area = area_of_box({179.9, -17, -179.95, -16.8}, zone);
  const auto in = [&](double lon, double lat) {
    const auto at = utm_from_geodetic(zone, lon, lat);
    return area.contains(at[0], at[1]);
  };
  for (const double lon : {179.91, 179.99, -179.99, -179.96}) CHECK(in(lon, -16.9));
  for (const double lon : {179.89, -179.94, 179.0, 0.0}) CHECK_FALSE(in(lon, -16.9));
  CHECK_FALSE(in(180, -17.01));
  const std::array<double, 4> bounds = area.bounds();
  CHECK(bounds[2] - bounds[0] == doctest::Approx(16000).epsilon(0.05));  // 0.15 degrees
  // ends at it, from either side
  CHECK(area_of_box({179.9, -17, 180, -16.8}, zone).contains(bounds[0] + 1000, bounds[1] + 5000));
  CHECK_NOTHROW(area_of_box({-180, -17, -179.9, -16.8}, zone));
  // the long way round, and nothing at all
  CHECK(test::error_of<ConfigError>([&] {
          area_of_box({175, -17, -174, -16}, zone);
        }) ==
        "bbox: 175,-17,-174,-16, expected west, south, east and north in degrees, of at most 10 a "
        "side, with west above east only across the antimeridian");
  CHECK_THROWS_AS(area_of_box({180, -17, -180, -16}, zone), ConfigError);
  CHECK_THROWS_AS(area_of_box({179, -17, 181, -16}, zone), ConfigError);
}

TEST_CASE("a raster written row by row holds what one written at once holds") {
  const TempFolder folder("rows");
  const float nan = std::numeric_limits<float>::quiet_NaN();
  Tensor values({2, 700, 300});
  for (Index i = 0; i < values.count(); ++i)
    values[i] = i % 97 == 0 ? nan : std::sin(0.01f * static_cast<float>(i));
  const GeoGrid grid{32617, 500000, 3350000, 0.5};
  GeoTags tags = ellipsoidal_height("Heights");
  tags.band_names = {"a", "b"};
  write_geo_raster(folder / "once.tif", values, grid, tags);
  {
    GeoRasterRows rows(folder / "rows.tif", 2, 700, 300, grid, tags);
    for (const auto& [y0, n] : {std::pair<Index, Index>{0, 1}, {1, 299}, {300, 400}}) {
      Tensor part({2, n, 300});
      for (Index c = 0; c < 2; ++c)
        std::copy_n(values.data() + (c * 700 + y0) * 300, n * 300, part.data() + c * n * 300);
      CHECK_FALSE(std::filesystem::exists(folder / "rows.tif"));
      rows.append(part);
    }
    CHECK_THROWS_AS(rows.append(Tensor({2, 1, 300})), ShapeError);
    rows.finish();
  }
  const GeoRaster a = read_geo_raster(folder / "once.tif"),
                  b = read_geo_raster(folder / "rows.tif");
  CHECK(a.grid == b.grid);
  CHECK(a.tags.metadata == b.tags.metadata);
  CHECK(a.tags.band_names == b.tags.band_names);
  Index wrong = 0;
  for (Index i = 0; i < values.count(); ++i)
    wrong += !(a.values[i] == b.values[i] || (std::isnan(a.values[i]) && std::isnan(b.values[i])));
  CHECK(wrong == 0);
  CHECK(std::distance(std::filesystem::directory_iterator(folder.path()), {}) == 2);
  {
    GeoRasterRows left(folder / "left.tif", 2, 10, 10, grid, tags);
    CHECK_THROWS_AS(left.finish(), Error);
  }
  CHECK(std::distance(std::filesystem::directory_iterator(folder.path()), {}) == 2);
  // tags that do not fit come when the room has been taken
  GeoTags one_name = tags;
  one_name.band_names = {"a"};
  CHECK(test::error_of<Error>([&] {
          GeoRasterRows(folder / "odd.tif", 2, 700, 300, grid, one_name);
        }) == "write_geo_raster: 1 band names, expected 2");
  CHECK(std::distance(std::filesystem::directory_iterator(folder.path()), {}) == 2);
  // a name that is taken by a folder is found at the end
  std::filesystem::create_directories(folder / "folder.tif" / "inside");
  {
    GeoRasterRows taken(folder / "folder.tif", 2, 1, 1, grid, tags);
    taken.append(Tensor({2, 1, 1}));
    CHECK(test::error_of<IoError>([&] {
            taken.finish();
          }).starts_with((folder / "folder.tif").string() + ": cannot be put in its place ("));
  }
  std::filesystem::remove_all(folder / "folder.tif");
  CHECK(std::distance(std::filesystem::directory_iterator(folder.path()), {}) == 2);
  // no room: known before the first row, and nothing is left
  rlimit before{};
  REQUIRE(getrlimit(RLIMIT_FSIZE, &before) == 0);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{100'000, before.rlim_max};
  REQUIRE(setrlimit(RLIMIT_FSIZE, &small) == 0);
  const std::string refusal = test::error_of<IoError>(
      [&] { GeoRasterRows(folder / "large.tif", 2, 700, 300, grid, tags); });
  setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, handler);
  CHECK(refusal == (folder / "large.tif").string() +
                       ": 1680000 bytes for its values cannot be had (File too large)");
  CHECK(std::distance(std::filesystem::directory_iterator(folder.path()), {}) == 2);
}
