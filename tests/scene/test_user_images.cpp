// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/rng.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/terrain.h"
#include "satsurf/scene/user_images.h"
#include "satsurf/scene/view_geometry.h"

#include <algorithm>
#include <cmath>
#include <filesystem>

#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::scene;
namespace fs = std::filesystem;

namespace {

/// A camera that looks from the north by `slant` px per m of height; north up, 0.5 m per pixel, W x
/// H pixels.
rpc::Rpc camera(Index width, Index height, double slant, double lon = 20, double lat = 10) {
  const double metres_per_degree = 110575;  // near 10 degrees of latitude
  rpc::Rpc r;
  r.samp_off = (static_cast<double>(width) - 1) / 2,
  r.line_off = (static_cast<double>(height) - 1) / 2;
  r.samp_scale = static_cast<double>(width) / 2, r.line_scale = static_cast<double>(height) / 2;
  r.lon_off = lon, r.lat_off = lat, r.height_off = 20;
  r.lat_scale = r.line_scale * 0.5 / metres_per_degree;
  r.lon_scale = r.samp_scale * 0.5 / (111320 * std::cos(lat * M_PI / 180));
  r.height_scale = 100;
  r.samp_num[1] = 1;
  r.line_num[2] = -1, r.line_num[3] = slant * r.height_scale / r.line_scale;
  r.samp_den[0] = r.line_den[0] = 1;
  return r;
}

struct Folder {
  fs::path path = fs::temp_directory_path() / "satsurf_test_views";
  Folder() {
    fs::remove_all(path);
    fs::create_directories(path);
  }
  ~Folder() { fs::remove_all(path); }
  fs::path image(const std::string& name, const rpc::Rpc& rpc) const {
    Rng rng(1);
    rpc::write_rpc_geotiff(path / name, uniform_tensor<float>({1, 40, 60}, rng, 20, 200),
                           rpc::PixelType::uint8, rpc);
    return path / name;
  }
};

std::string refusal(const std::vector<fs::path>& files, const rpc::HeightRange& range = {0, 40}) {
  try {
    scene_from_views(files, {}, range);
  } catch (const Error& e) {
    return e.what();
  }
  return "accepted";
}

}  // namespace

TEST_CASE("polygons") {
  const Polygon square{{0, 0}, {4, 0}, {4, 4}, {0, 4}};
  CHECK(polygon_area(square) == 16);
  CHECK(polygon_centroid({{1000, 1000}, {1006, 1000}, {1000, 1003}})[0] == doctest::Approx(1002));
  CHECK(polygon_centroid({{1000, 1000}, {1006, 1000}, {1000, 1003}})[1] == doctest::Approx(1001));
  CHECK(polygon_area(intersect(square, {{3, 1}, {6, 1}, {6, 3}, {3, 3}})) == doctest::Approx(2));
  CHECK(polygon_area(intersect(square, {{2, 1}, {3, 2}, {2, 3}, {1, 2}})) ==
        doctest::Approx(2));  // inside
  CHECK(polygon_area(intersect(square, {{-1, -1}, {9, -1}, {9, 9}, {-1, 9}})) ==
        doctest::Approx(16));  // around
  // a triangle whose tip is cut off: (2, 2), (8, 2), (2, 8) within x, y <= 4
  CHECK(polygon_area(intersect(square, {{2, 2}, {8, 2}, {2, 8}})) == doctest::Approx(4));
  CHECK(intersect(square, {{5, 0}, {7, 0}, {7, 2}, {5, 2}}).empty());
  CHECK(intersect(square, {{4, 0}, {7, 0}, {7, 4}, {4, 4}}).empty());  // a shared edge is no ground
}

TEST_CASE("the hull of points, the bounds of a polygon and what it contains") {
  const Polygon hull =
      convex_hull({{2, 1}, {0, 0}, {4, 0}, {2, 0}, {3, 3}, {2, 2}, {0, 4}, {0, 0}});
  CHECK(hull == Polygon{{0, 0}, {4, 0}, {3, 3}, {0, 4}});
  CHECK(convex_hull({{0, 0}, {1, 1}, {2, 2}}).empty());
  CHECK(convex_hull({{1, 1}, {1, 1}}).empty());
  CHECK(convex_hull({}).empty());
  const Ground box = bounds_of(hull);
  CHECK(box.x0 == 0);
  CHECK(box.y0 == 0);
  CHECK(box.x1 == 4);
  CHECK(box.y1 == 4);
  CHECK(corners_of(box) == Polygon{{0, 0}, {4, 0}, {4, 4}, {0, 4}});
  CHECK(contains(hull, 3, 2.5));
  CHECK(contains(hull, 0, 2));  // on its rim
  CHECK_FALSE(contains(hull, 3.5, 3));
  CHECK_FALSE(contains(hull, -0.1, 2));
  CHECK_FALSE(contains({}, 0, 0));
}

TEST_CASE("footprint, angles and parallax of a camera made by hand") {
  const rpc::Rpc level = camera(60, 40, 0), tilted = camera(60, 40, 0.8);
  const rpc::UtmZone zone = rpc::utm_zone_of(20, 10);
  const Polygon ground = footprint(level, 60, 40, zone, 20);
  CHECK(polygon_area(ground) == doctest::Approx(30.0 * 20).epsilon(0.01));
  const auto centre = polygon_centroid(ground), expected = rpc::utm_from_geodetic(zone, 20, 10);
  CHECK(std::hypot(centre[0] - expected[0], centre[1] - expected[1]) < 1e-3);

  const ViewAngles down = view_angles(level, 60, 40, 20);
  CHECK(down.gsd == doctest::Approx(0.5).epsilon(0.01));
  CHECK(down.off_nadir_deg < 1e-6);
  // line grows by 0.8 px per m: higher points move down in the image, away from a satellite in
  // the north
  const ViewAngles slanted = view_angles(tilted, 60, 40, 20);
  CHECK(slanted.off_nadir_deg == doctest::Approx(std::atan(0.8 * 0.5) * 180 / M_PI).epsilon(0.01));
  CHECK(std::min(slanted.azimuth_deg, 360 - slanted.azimuth_deg) ==
        doctest::Approx(0).epsilon(1).scale(1));
  CHECK(slanted.gsd < down.gsd);  // across the ray, not on the ground
  CHECK(parallax(level, tilted, {20, 10, 20}) == doctest::Approx(0.8));
  CHECK(parallax(tilted, tilted, {20, 10, 20}) == doctest::Approx(0).scale(1));
}

TEST_CASE("scene_from_views") {
  const Folder folder;
  const fs::path a = folder.image("a.tif", camera(60, 40, 0)),
                 b = folder.image("b.tif", camera(60, 40, 0.5));
  SUBCASE("frame and range") {
    const UserScene user = scene_from_views({a, b}, {}, rpc::HeightRange{3, 40});
    const Scene& s = user.scene;
    CHECK(s.views.size() == 2);
    CHECK(s.views[1].name == "b");
    CHECK(s.views[0].rgb.shape() == Shape{3, 40, 60});
    CHECK(s.frame.zone == rpc::utm_zone_of(20, 10));
    CHECK(s.frame.easting0 == std::round(s.frame.easting0));
    CHECK(s.frame.h0 == 22);
    CHECK(s.z_range == rpc::HeightRange{3 - 22, 40 - 22});
    CHECK(user.range.source == "as given");
    CHECK(s.views[0].files == std::vector<fs::path>{a});
    const auto origin = s.frame.local_from_geodetic({20, 10, 20});
    CHECK(std::hypot(origin[0], origin[1]) < 1.5);
  }
  SUBCASE("a model of the terrain says the range, or why it does not") {
    const rpc::UtmZone zone = rpc::utm_zone_of(20, 10);
    const auto middle = rpc::utm_from_geodetic(zone, 20, 10);
    const auto terrain = [&](const char* name, float height, double east) {
      rpc::write_geo_raster(folder.path / name, Tensor({200, 200}, height),
                            {zone.epsg(), middle[0] - 200 + east, middle[1] + 200, 2},
                            rpc::ellipsoidal_height("Terrain"));
      return std::make_shared<rpc::Terrain>(folder.path / name);
    };
    const auto user_with = [&](std::shared_ptr<const rpc::Terrain> by,
                               std::optional<rpc::HeightRange> wanted = {}) {
      return scene_from_views({a, b}, {}, wanted, {},
                              {.pointing = {.measure = false}, .terrain = std::move(by)});
    };
    const UserScene by = user_with(terrain("ground.tif", 8, 0));
    CHECK(by.range.height_range.low == doctest::Approx(8 - kBelowTerrain));
    CHECK(by.range.height_range.high == doctest::Approx(8 + kAboveTerrain));
    CHECK(by.range.source == "from the terrain");
    CHECK(by.range.trouble.empty());
    const auto ground = terrain("ground.tif", 8, 0);
    CHECK(user_with(ground, rpc::HeightRange{3, 40}).range.source == "as given");
    // what it is no help for is searched, and the reason is told
    const auto trouble = [&](std::shared_ptr<const rpc::Terrain> of) {
      const TerrainRange found = terrain_range(
          *of, zone, {middle[0] - 10, middle[1] - 10, middle[0] + 10, middle[1] + 10});
      CHECK_FALSE(found.height_range);
      return found.trouble;
    };
    CHECK(trouble(terrain("beside.tif", 8, 200)).find("ground, expected 90 % or more") !=
          std::string::npos);
    CHECK(trouble(terrain("elsewhere.tif", 8, 900)).find("it knows 0 % of") != std::string::npos);
    CHECK(trouble(terrain("void.tif", -32768, 0)).find("-32768 to -32768 m, expected those of") !=
          std::string::npos);
  }
  SUBCASE("two files of one name stay apart") {
    fs::create_directories(folder.path / "other");
    const fs::path again = folder.image("other/a.tif", camera(60, 40, 0.5));
    CHECK(scene_from_views({a, again}, {}, rpc::HeightRange{0, 40}).scene.views[1].name == "a_2");
  }
  SUBCASE("refusals name the files") {
    CHECK(refusal({a}) == a.string() + " is the only image, expected two or more");
    CHECK(refusal({}) == "no image, expected two or more");
    CHECK(
        refusal({a, a}) ==
        a.string() + " and " + a.string() +
            " are seen from one direction (parallax 0 px/m), expected different ones; leave one of "
            "them out");
    const fs::path near = folder.image("near.tif", camera(60, 40, 0.5, 20.01));  // 1.1 km east
    CHECK(refusal({a, near}) ==
          a.string() + " and " + near.string() +
              " do not overlap on the ground (centres 1.1 km apart), expected images of one place");
    const fs::path far = folder.image("far.tif", camera(60, 40, 0.5, -100));
    CHECK(refusal({a, far}) == a.string() + " and " + far.string() +
                                   " do not overlap on the ground, expected images of one place");
  }
  SUBCASE("of more than two the useless ones are left out") {
    const fs::path near = folder.image("near.tif", camera(60, 40, 0.5, 20.01)),
                   far = folder.image("far.tif", camera(60, 40, 0.5, -100)),
                   twin = folder.image("twin.tif", camera(60, 40, 0));
    const UserScene user = scene_from_views({a, near, b, far, twin}, {}, rpc::HeightRange{3, 40});
    REQUIRE(user.scene.views.size() == 2);
    CHECK(user.scene.views[0].file == a);
    CHECK(user.scene.views[1].file == b);
    REQUIRE(user.left_out.size() == 3);
    CHECK(user.left_out[0].label == near.string());
    CHECK(user.left_out[0].why == "shares no ground with " + a.string());
    CHECK(user.left_out[1].label == far.string());
    CHECK(user.left_out[2].label == twin.string());
    CHECK(user.left_out[2].why == "seen from the same direction as " + a.string());
    CHECK(refusal({a, twin, a}).find("seen from one direction") != std::string::npos);
  }
  SUBCASE("images in which nothing can be found again") {
    rpc::write_rpc_geotiff(folder.path / "flat.tif", Tensor({1, 40, 60}, 90.f),
                           rpc::PixelType::uint8, camera(60, 40, 0.5));
    CHECK(refusal({a, folder.path / "flat.tif"}) ==
          (folder.path / "flat.tif").string() +
              ": the same grey everywhere, expected an image with texture to compare");
    rpc::write_rpc_geotiff(folder.path / "slim.tif", Tensor({1, 40, 1}, 90.f),
                           rpc::PixelType::uint8, camera(1, 40, 0.5));
    CHECK(refusal({a, folder.path / "slim.tif"}) ==
          (folder.path / "slim.tif").string() + ": 1 x 40 px, expected at least 16 x 16");
  }
  SUBCASE("a wanted range is one of the cameras") {  // which are made for -80 to 120 m
    const auto told = [&](double low, double high) { return refusal({a, b}, {low, high}); };
    CHECK(told(-100, 200) == "accepted");
    CHECK(told(200, 300) == "height range: 200 to 300 m, expected heights that the camera of " +
                                a.string() + " is made for, -80 to 120 m");
    CHECK(told(-80, 1000).ends_with("is made for, -80 to 120 m"));
    // 100 m up, images of 20 m that part by half a pixel a metre have nothing in common
    CHECK(told(99, 101).find("see no common ground at these heights (they do at ") !=
          std::string::npos);
  }
  SUBCASE("cameras for different heights") {
    rpc::Rpc high = camera(60, 40, 0.5);  // the same ground, told to lie at 4000 m
    high.height_off = 4000;
    const fs::path c = folder.image("c.tif", high);
    CHECK_THROWS_WITH_AS(
        scene_from_views({a, c}, {}, {}),
        (a.string() + " and the others: cameras for different heights, expected a range "
                      "they share; give a height range")
            .c_str(),
        Error);
  }
}

TEST_CASE("a mask that leaves nothing of the images is named") {
  const Folder folder;
  const std::vector<fs::path> files{folder.image("a.tif", camera(60, 40, 1)),
                                    folder.image("b.tif", camera(60, 40, -1))};
  const rpc::UtmZone zone = rpc::utm_zone_of(20, 10);
  const auto middle = rpc::utm_from_geodetic(zone, 20, 10);
  const rpc::GeoGrid grid{zone.epsg(), middle[0] - 50, middle[1] + 50, 1};
  const auto masked_by = [&](Index first_row) {
    Tensor classes({100, 100}, 2.F);  // of ground all over, and water in the south
    for (Index i = first_row * 100; i < classes.count(); ++i) classes[i] = 9;
    rpc::write_geo_raster(folder.path / "classes.tif", classes, grid, {.unit = ""});
    return folder.path / "classes.tif";
  };
  const auto made_under = [&](const fs::path& mask, const std::vector<double>& values) {
    ViewRules rules;
    rules.pointing.measure = false;
    rules.mask = std::make_shared<rpc::GroundMask>(mask, values);
    scene_from_views(files, {}, rpc::HeightRange{0, 40}, {}, rules);
  };
  const fs::path mask = masked_by(50);
  CHECK_NOTHROW(made_under(mask, {9}));
  for (const std::vector<double>& values : {std::vector<double>{}, std::vector<double>{2, 9}}) {
    std::string said = "accepted";
    try {
      made_under(mask, values);
    } catch (const Error& e) {
      said = e.what();
    }
    CHECK(said ==
          mask.string() +
              ": the mask leaves 0 % of the ground that two images see, expected 1 % or more; "
              "--mask takes away all cells of a raster but those of 0 and nodata, --mask-values "
              "those of some values");
  }
}
