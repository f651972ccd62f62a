// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/core/rng.h"
#include "satsurf/mesh/surface.h"
#include "satsurf/mesh/tsdf.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <string>
#include <vector>

#include "tests/affine_scene.h"
#include "tests/temp_folder.h"
#include <doctest/doctest.h>

namespace satsurf::test {
namespace {

using mesh::FusionOptions;
using mesh::HeightImage;
using mesh::Mesh;

/// A turned box on a plane.
struct Box {
  double half_x = 9.3, half_y = 6.1, top = 12.7, turn = 0.5, x = 1.3, y = -0.7, ground = 2.2;

  std::array<double, 2> own(double px, double py) const {  // coordinates along the walls
    const double c = std::cos(turn), s = std::sin(turn);
    return {c * (px - x) + s * (py - y), -s * (px - x) + c * (py - y)};
  }
  /// Height at which a ray from `high`, at `top`, to `low`, on the ground, ends.
  double hit(std::array<double, 2> high, std::array<double, 2> low) const {
    const auto a = own(high[0], high[1]), b = own(low[0], low[1]);
    double enter = 0, leave = 1;
    const double half[2] = {half_x, half_y};
    for (std::size_t i = 0; i < 2; ++i) {
      const double d = b[i] - a[i];
      if (d == 0) {
        if (std::abs(a[i]) > half[i]) return ground;
        continue;
      }
      const double t0 = (-half[i] - a[i]) / d, t1 = (half[i] - a[i]) / d;
      enter = std::max(enter, std::min(t0, t1)), leave = std::min(leave, std::max(t0, t1));
    }
    return enter <= leave ? top + enter * (ground - top) : ground;
  }
  /// Distance of a point from the surface of box and plane.
  double distance(const std::array<float, 3>& p) const {
    const auto q = own(static_cast<double>(p[0]), static_cast<double>(p[1]));
    const auto z = static_cast<double>(p[2]);
    const double dx = std::abs(q[0]) - half_x, dy = std::abs(q[1]) - half_y;
    const double out = std::hypot(std::max(dx, 0.0), std::max(dy, 0.0));  // of the footprint
    const double roof = std::hypot(out, z - top);
    double wall = std::abs(std::max(dx, dy));
    if (out > 0) wall = out;
    wall = std::hypot(wall, std::max({0.0, z - top, ground - z}));
    const double plane = out > 0 ? std::abs(z - ground) : std::hypot(std::max(dx, dy), z - ground);
    return std::min({roof, wall, plane});
  }
};

/// Heights, confidences and colours of a box as affine cameras see it. The colour tells the height.
std::vector<HeightImage> views_of(const Box& box, Index size,
                                  const std::vector<std::array<double, 2>>& slopes) {
  std::vector<HeightImage> views;
  for (const auto& s : slopes) {
    const AffineCamera camera{0.5, s[0], s[1], (static_cast<double>(size) - 1) / 2};
    HeightImage v{Tensor({size, size + 2}), Tensor({size, size + 2}, 0.8f),
                  Tensor({3, size, size + 2}), camera.pixel_from_local(),
                  camera.local_from_pixel()};
    const Index P = v.height.count();
    for (Index p = 0; p < P; ++p) {
      const auto x = static_cast<double>(p % (size + 2)), y = static_cast<double>(p / (size + 2));
      const double z =
          box.hit(v.local_from_pixel(x, y, box.top), v.local_from_pixel(x, y, box.ground));
      v.height[p] = static_cast<float>(z);
      v.rgb[p] = z == box.top ? 1.f : 0.f;
      v.rgb[P + p] = z == box.ground ? 1.f : 0.f;
      v.rgb[2 * P + p] = z != box.ground && z != box.top ? 1.f : 0.f;
    }
    views.push_back(std::move(v));
  }
  return views;
}

// px per m, about 24 degrees off nadir, from three sides: every wall is seen
const std::vector<std::array<double, 2>> kThreeSides{{0.9, 0.0}, {-0.45, 0.78}, {-0.45, -0.78}};

/// Faces at every edge, by its two vertices in the order in which the first face has them.
struct Edges {
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> count;

  explicit Edges(const Mesh& m) {
    for (const auto& f : m.faces)
      for (std::size_t i = 0; i < 3; ++i) ++count[{f[i], f[(i + 1) % 3]}];
  }
};

struct Deviation {
  double worst = 0, roof = 0, ground = 0, wall = 0;  // m
  Index roofs = 0, grounds = 0, walls = 0;           // vertices
};
Deviation deviation(const Mesh& m, const Box& box, double voxel) {
  Deviation d;
  for (const auto& p : m.vertices) {
    const auto q = box.own(static_cast<double>(p[0]), static_cast<double>(p[1]));
    const auto z = static_cast<double>(p[2]);
    const double out = std::max(std::abs(q[0]) - box.half_x, std::abs(q[1]) - box.half_y);
    d.worst = std::max(d.worst, box.distance(p));
    if (out < -1.5 * voxel) d.roof = std::max(d.roof, std::abs(z - box.top)), ++d.roofs;
    if (out > 1.5 * voxel) d.ground = std::max(d.ground, std::abs(z - box.ground)), ++d.grounds;
    if (z > box.ground + 1.5 * voxel && z < box.top - 1.5 * voxel)
      d.wall = std::max(d.wall, std::abs(out)), ++d.walls;
  }
  return d;
}

/// A view from straight above of a level plane, `size` x `size` half metres around the origin.
HeightImage level(Index size, float z, float confidence) {
  const AffineCamera camera{0.5, 0, 0, (static_cast<double>(size) - 1) / 2};
  return {Tensor({size, size}, z),
          Tensor({size, size}, confidence),
          {},
          camera.pixel_from_local(),
          camera.local_from_pixel()};
}

double fade(double d, double voxel) { return std::clamp((d / voxel + 2.5) / 1.5, 0.01, 1.0); }

}  // namespace

TEST_CASE("a box on a plane seen from three sides comes out as it is") {
  for (const double voxel : {1.0, 0.5}) {
    CAPTURE(voxel);
    const Box box;
    const Mesh m = mesh::mesh_from_views(views_of(box, 120, kThreeSides), {voxel, 5});
    const Deviation d = deviation(m, box, voxel);
    CHECK(d.worst < 0.8 * voxel);  // no floating sheets
    CHECK(d.roof < 0.03);
    CHECK(d.ground < 0.08);
    CHECK(d.wall < 0.8 * voxel);
    CHECK(d.roofs > 100 / (voxel * voxel));
    CHECK(d.grounds > 2000 / (voxel * voxel));
    CHECK(d.walls > 300 / (voxel * voxel));

    // Closed but for the rim of what the cameras see, every edge between two faces that agree.
    const Edges edges(m);
    for (const auto& [edge, n] : edges.count) {
      REQUIRE(n == 1);
      if (edges.count.contains({edge.second, edge.first})) continue;
      const auto& p = m.vertices[edge.first];
      CHECK(std::max(std::abs(p[0]), std::abs(p[1])) > 20);
    }
    // Normals are of unit length and point outwards, colours are those of the pictures.
    REQUIRE(m.normals.size() == m.vertices.size());
    REQUIRE(m.colours.size() == m.vertices.size());
    for (std::size_t v = 0; v < m.vertices.size(); ++v) {
      const auto& n = m.normals[v];
      CHECK(std::abs(std::hypot(n[0], n[1], n[2]) - 1.f) < 1e-5f);
      const auto q =
          box.own(static_cast<double>(m.vertices[v][0]), static_cast<double>(m.vertices[v][1]));
      const double out = std::max(std::abs(q[0]) - box.half_x, std::abs(q[1]) - box.half_y);
      if (out > -3 * voxel && out < 3 * voxel) continue;
      CHECK(n[2] > 0.98f);
      CHECK(m.colours[v][out < 0 ? 0 : 1] > 0.95f);
    }
  }
}

TEST_CASE("walls that no camera sees stand upright all the same") {
  // Both cameras look along y: the walls across x are on edge.
  Box box;
  box.turn = 0;
  const Mesh m = mesh::mesh_from_views(views_of(box, 120, {{0, 0.9}, {0, -0.9}}), {1, 5});
  const Deviation d = deviation(m, box, 1);
  CHECK(d.worst < 1);
  CHECK(d.wall < 1);
  CHECK(d.walls > 300);
}

TEST_CASE("where no camera has a height the surface is open") {
  const Box box;
  auto views = views_of(box, 120, kThreeSides);
  const auto hidden = [](double x, double y) { return std::hypot(x - 16, y + 14) < 6; };
  for (HeightImage& v : views)
    for (Index p = 0; p < v.height.count(); ++p) {
      const auto at = v.local_from_pixel(static_cast<double>(p % 122), static_cast<double>(p / 122),
                                         static_cast<double>(v.height[p]));
      if (hidden(at[0], at[1])) v.height[p] = NAN;
    }
  const Mesh m = mesh::mesh_from_views(views, {1, 5});
  CHECK(deviation(m, box, 1).worst < 1);
  for (const auto& p : m.vertices)
    CHECK(std::hypot(static_cast<double>(p[0]) - 16, static_cast<double>(p[1]) + 14) > 4.5);
}

TEST_CASE("single wrong pixels neither drill shafts nor raise towers") {
  const Box box;
  auto views = views_of(box, 120, kThreeSides);
  Rng rng(3);
  for (HeightImage& v : views)
    for (int k = 0; k < 40; ++k)
      v.height[rng.below(v.height.count())] += rng.chance(0.5) ? -60.f : 60.f;
  for (const auto& p : mesh::mesh_from_views(views, {1, 5}).vertices) {
    CHECK(static_cast<double>(p[2]) > box.ground - 1.5);
    CHECK(static_cast<double>(p[2]) < box.top + 1.5);
  }
}

TEST_CASE("a mistake of one or two pixels says nothing, even where no other view does") {
  for (const Index side : {1, 2}) {
    CAPTURE(side);
    const AffineCamera camera{0.5, 0.3, 0.2, 40};
    HeightImage v{
        Tensor({80, 80}, 7.f), {}, {}, camera.pixel_from_local(), camera.local_from_pixel()};
    Rng rng(8);
    for (int k = 0; k < 12; ++k) {
      const Index x = 4 + 6 * rng.below(12), y = 4 + 6 * k;
      const float off = (side == 1 ? 8.f : 50.f) * (rng.chance(0.5) ? 1.f : -1.f);
      for (Index p = 0; p < side * side; ++p)
        v.height[(y + p / side) * 80 + x + p % side] = 7 + off;
    }
    const Mesh m = mesh::extract_surface(mesh::fuse(std::vector{v}, {0.5, 5}), 0);
    CHECK(m.vertices.size() > 5000);
    for (const auto& p : m.vertices) CHECK(std::abs(p[2] - 7) < 0.5f);
  }
}

TEST_CASE("behind a tower that one camera sees the surface goes down along its rays") {
  Box box;
  box.top = 17, box.turn = 0.2, box.half_x = 4, box.half_y = 4;
  const Mesh m = mesh::mesh_from_views(views_of(box, 160, {{1.2, 0.5}}), {0.5, 5});
  const Edges edges(m);
  float high = 0;
  for (const auto& p : m.vertices) high = std::max(high, p[2]);
  CHECK(high > 16.5f);
  for (const auto& [edge, n] : edges.count) {
    REQUIRE(n == 1);
    if (edges.count.contains({edge.second, edge.first})) continue;
    const auto& p = m.vertices[edge.first];
    CHECK(std::max(std::abs(p[0]), std::abs(p[1])) > 30);  // the rim of the picture
  }
}

TEST_CASE("values are the weighted mean of the views' distances along their rays") {
  const double voxel = 0.7;
  SUBCASE("one slanting view of a slope") {
    const AffineCamera camera{0.5, 0.5, -0.25, 30};
    HeightImage v{Tensor({61, 63}), {}, {}, camera.pixel_from_local(), camera.local_from_pixel()};
    // z = 1 + x / 4, so along a ray x = x0 - 0.25 z: z = (1 + x0 / 4) / 1.0625
    for (Index p = 0; p < v.height.count(); ++p)
      v.height[p] = static_cast<float>(
          (1 +
           v.local_from_pixel(static_cast<double>(p % 63), static_cast<double>(p / 63), 0)[0] / 4) /
          1.0625);
    const mesh::Tsdf field = mesh::fuse(std::vector{v}, {voxel, 5});
    const double slant = std::sqrt(1 + 0.25 * 0.25 + 0.125 * 0.125);
    int seen = 0;
    for (Index i = 8; i < 8 * field.columns - 8; ++i)
      for (Index j = 8; j < 8 * field.rows - 8; ++j)
        for (Index k = -10; k < 15; ++k) {
          const auto value = static_cast<double>(field.at(i, j, k));
          const double x = static_cast<double>(field.column + i) * voxel,
                       y = static_cast<double>(field.row + j) * voxel,
                       z = static_cast<double>(k) * voxel;
          const auto q = camera.pixel_from_local()(x, y, z);
          if (std::isnan(value) || q[0] < 0 || q[1] < 0 || q[0] > 62 || q[1] > 60) continue;
          const double hit = (1 + (x + 0.25 * z) / 4) / 1.0625;
          CHECK(value == doctest::Approx(std::clamp((z - hit) * slant, -3.5, 3.5)).epsilon(1e-5));
          ++seen;
        }
    CHECK(seen > 1000);
  }
  SUBCASE("two views that differ in height and confidence") {
    const float high = 3.1f, low = 2.2f;
    const mesh::Tsdf field =
        mesh::fuse(std::vector{level(41, high, 0.9f), level(43, low, 0.35f)}, {voxel, 4});
    for (Index k = 0; k < 8; ++k) {
      const double z = static_cast<double>(k) * voxel;
      const double a = std::clamp(z - 3.1, -2.8, 2.8), b = std::clamp(z - 2.2, -2.8, 2.8),
                   wa = 0.9 * fade(z - 3.1, voxel), wb = 0.35 * fade(z - 2.2, voxel);
      CHECK(static_cast<double>(field.at(20, 20, k)) ==
            doctest::Approx((wa * a + wb * b) / (wa + wb)).epsilon(1e-5));
    }
    CHECK(std::isnan(field.at(20, 20, 100)));
    CHECK(std::isnan(field.at(-1, 20, 3)));
  }
}

TEST_CASE("small pieces are left out, the largest never") {
  HeightImage v = level(160, 5, 1);
  for (Index p = 0; p < v.height.count(); ++p) {
    const Index x = p % 160;
    if (x >= 100 && x < 130) v.height[p] = NAN;  // leaves 50 x 80 m and 15 x 80 m
  }
  const mesh::Tsdf field = mesh::fuse(std::vector{v}, {1, 5});
  const auto width = [&](double least) {
    float low = INFINITY, high = -INFINITY;
    for (const auto& p : mesh::extract_surface(field, least).vertices)
      low = std::min(low, p[0]), high = std::max(high, p[0]);
    return high - low;
  };
  CHECK(width(0) > 70);
  CHECK(width(500) > 70);
  CHECK(width(2000) < 51);
  CHECK(width(1e6) < 51);
  CHECK(width(1e6) > 40);
}

TEST_CASE("the mesh does not depend on the number of threads") {
  const auto views = views_of({}, 90, kThreeSides);
  std::vector<Mesh> made;
  for (const int threads : {1, 2, 0}) {
    set_threads(threads);
    made.push_back(mesh::mesh_from_views(views, {0.6, 5}));
  }
  set_threads(0);
  for (const Mesh& m : made) {
    CHECK(m.vertices == made[0].vertices);
    CHECK(m.normals == made[0].normals);
    CHECK(m.colours == made[0].colours);
    CHECK(m.faces == made[0].faces);
  }
}

TEST_CASE("a shape is the mesh without what only pictures need") {
  auto views = views_of({}, 90, kThreeSides);
  const Mesh whole = mesh::mesh_from_views(views, {0.6, 5});
  const auto shape = mesh::shape_from_views(views, {0.6, 5});
  REQUIRE(shape);
  CHECK(shape->vertices == whole.vertices);
  CHECK(shape->faces == whole.faces);
  CHECK(shape->normals.empty());
  CHECK(shape->colours.empty());
  for (HeightImage& v : views) v.rgb = {};
  const Mesh plain = mesh::mesh_from_views(views, {0.6, 5});
  CHECK(plain.vertices == whole.vertices);
  CHECK(plain.normals == whole.normals);
  CHECK(plain.colours.empty());

  // Where there is no surface there is no shape, which is no error.
  HeightImage none = level(20, NAN, 1), thin = level(20, 1, 1);
  for (Index p = 0; p < 400; ++p)
    if (p != 210) thin.height[p] = NAN;
  CHECK_FALSE(mesh::shape_from_views(std::vector{none}, {1, 5}));
  CHECK_FALSE(mesh::shape_from_views(std::vector{none, thin}, {1, 5}));
  CHECK_FALSE(mesh::shape_from_views({}, {1, 5}));
  CHECK(error_of<ConfigError>([&] {
          mesh::shape_from_views(views, {0, 5});
        }) == "fuse: voxel 0, expected a positive number of metres");
}

TEST_CASE("what cannot be fused is refused") {
  const auto fuse = [](const HeightImage& v, FusionOptions how) {
    return [=] { mesh::fuse(std::vector{v}, how); };
  };
  const HeightImage good = level(20, 1, 1);
  CHECK(error_of<ConfigError>(fuse(good, {0, 5})) ==
        "fuse: voxel 0, expected a positive number of metres");
  CHECK(error_of<ConfigError>(fuse(good, {1, 9})) == "fuse: truncation 9, expected 2 to 8 voxels");
  CHECK(error_of<Error>(fuse(level(20, NAN, 1), {1, 5})) ==
        "fuse: no view has a height anywhere, expected views of a surface");
  CHECK(error_of<Error>([] {
          mesh::fuse({}, {1, 5});
        }) == "fuse: no view has a height anywhere, expected views of a surface");
  HeightImage wrong = level(20, 1, 1);
  wrong.confidence = Tensor({20, 19});
  CHECK(
      error_of<ShapeError>(fuse(wrong, {1, 5})) ==
      "fuse: confidence has shape [20,19], expected [H W] with H=20 from height, W=20 from height");
  // a thousand million voxels a metre
  CHECK(error_of<Error>(fuse(level(2000, 1, 1), {0.01, 5})).find("voxels need about") !=
        std::string::npos);
  // two views a thousand kilometres apart
  HeightImage far = level(20, 1, 1);
  for (auto& along : far.local_from_pixel.coeff) along[0] += 1e6;
  CHECK(error_of<Error>([&] {
          mesh::fuse(std::vector{good, far}, {1, 5});
        }).find("m in voxels of 1 m need about") != std::string::npos);
  HeightImage thin = level(20, 1, 1);
  for (Index p = 0; p < 400; ++p)
    if (p != 210) thin.height[p] = NAN;
  const mesh::Tsdf field = mesh::fuse(std::vector{thin}, {1, 5});
  CHECK(error_of<Error>([&] { mesh::extract_surface(field, 0); }).find("no surface in ") == 17);
}

}  // namespace satsurf::test
