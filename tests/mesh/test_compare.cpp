// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/mesh/compare.h"

#include <cmath>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

namespace satsurf::test {
namespace {

using mesh::Mesh;

/// Adds a parallelogram in two triangles.
void add_sheet(Mesh& m, std::array<float, 3> p, std::array<float, 3> u, std::array<float, 3> v) {
  const auto first = static_cast<std::uint32_t>(m.vertices.size());
  for (int i = 0; i < 4; ++i) {
    const auto a = static_cast<float>(i == 1 || i == 2), b = static_cast<float>(i >= 2);
    m.vertices.push_back(
        {p[0] + a * u[0] + b * v[0], p[1] + a * u[1] + b * v[1], p[2] + a * u[2] + b * v[2]});
  }
  m.faces.push_back({first, first + 1, first + 2});
  m.faces.push_back({first, first + 2, first + 3});
}
Mesh level(float z, float x = 0, float side = 60) {
  Mesh m;
  add_sheet(m, {x, 0, z}, {side, 0, 0}, {0, 50, 0});
  return m;
}
/// A level sheet cut into small triangles of different sizes.
Mesh gridded(float z) {
  Mesh m;
  for (int i = 0; i < 40; ++i)
    for (int j = 0; j < 25; ++j)
      add_sheet(m, {1.5f * static_cast<float>(i), 2.f * static_cast<float>(j), z}, {1.5f, 0, 0},
                {0, 2, 0});
  return m;
}

/// Distance of a point from a triangle, by brute force over the triangle.
double slow_distance(const std::array<double, 3>& p,
                     const std::array<std::array<double, 3>, 3>& t) {
  double best = INFINITY;
  constexpr int kSteps = 400;
  for (int i = 0; i <= kSteps; ++i)
    for (int j = 0; i + j <= kSteps; ++j) {
      const double a = static_cast<double>(i) / kSteps, b = static_cast<double>(j) / kSteps;
      double square = 0;
      for (std::size_t k = 0; k < 3; ++k) {
        const double d = p[k] - (t[0][k] + a * (t[1][k] - t[0][k]) + b * (t[2][k] - t[0][k]));
        square += d * d;
      }
      best = std::min(best, square);
    }
  return std::sqrt(best);
}

}  // namespace

TEST_CASE("parallel planes are as far apart as they are") {
  for (const float d : {0.3f, 0.7f, 2.f, 7.f}) {
    const auto c = mesh::compare_meshes(level(1), level(1 + d));
    CHECK(c.all.chamfer == doctest::Approx(static_cast<double>(d)).epsilon(1e-5));
    CHECK(c.all.to_mesh == doctest::Approx(static_cast<double>(d)).epsilon(1e-5));
    CHECK(c.all.to_reference == doctest::Approx(static_cast<double>(d)).epsilon(1e-5));
    CHECK(c.all.mesh_samples == 12000);  // 60 m x 50 m at 4 per m^2
    for (const mesh::FScore& f : c.all.f) {
      const double expected = static_cast<double>(d) < f.threshold ? 1 : 0;
      CHECK(f.f1 == expected);
      CHECK(f.precision == expected);
      CHECK(f.recall == expected);
    }
    CHECK(c.all.f[0].threshold == 0.5);
    CHECK(c.all.f[2].threshold == 2.5);
    CHECK(c.without_walls.chamfer == c.all.chamfer);
  }
  CHECK(mesh::compare_meshes(level(1), level(101)).all.chamfer == 20);  // the cap
  // however the triangles lie
  CHECK(mesh::compare_meshes(gridded(0), level(0)).all.chamfer < 0.005);
  CHECK(mesh::compare_meshes(gridded(0), gridded(1.25f)).all.chamfer ==
        doctest::Approx(1.25).epsilon(1e-3));
}

TEST_CASE("precision is of the mesh, recall of the reference") {
  // The mesh has 60 m of ground in x, the reference the first 45 m of it: a quarter is too much,
  // but 1 m of that is within 1 m.
  const auto c = mesh::compare_meshes(level(0), level(0, 0, 45)).all;
  CHECK(c.f[1].precision == doctest::Approx(46.0 / 60).epsilon(0.002));
  CHECK(c.f[1].recall == 1);
  CHECK(c.f[1].f1 == doctest::Approx(2 * 46.0 / 60 / (1 + 46.0 / 60)).epsilon(0.002));
  CHECK(c.to_mesh < 1e-3);
  CHECK(c.to_reference == doctest::Approx(0.25 * 7.5).epsilon(0.01));
  CHECK(c.chamfer == doctest::Approx(0.125 * 7.5).epsilon(0.01));
}

TEST_CASE("walls can be left out") {
  Mesh with = level(0);
  add_sheet(with, {30, 10, 0}, {0, 20, 0}, {0, 0, 15});  // upright
  add_sheet(with, {60, 0, 0}, {10, 0, 30}, {0, 50, 0});  // steep: n_z = 0.32
  const auto c = mesh::compare_meshes(with, level(0));
  CHECK(c.all.chamfer > 1);
  CHECK(c.without_walls.chamfer < 1e-6);
  CHECK(c.without_walls.mesh_samples < c.all.mesh_samples);
  Mesh wall;
  add_sheet(wall, {0, 0, 0}, {0, 20, 0}, {0, 0, 15});
  const auto nothing = mesh::compare_meshes(wall, level(0));
  CHECK(std::isfinite(nothing.all.chamfer));
  CHECK(std::isnan(nothing.without_walls.chamfer));
  CHECK(std::isnan(nothing.without_walls.f[0].f1));
}

TEST_CASE("distances reach faces, edges and corners") {
  // one large triangle, and ever the same small one around a point
  const std::array<std::array<double, 3>, 3> big{{{0, 0, 0}, {8, 1, 2}, {2, 7, -1}}};
  Mesh reference;
  for (const auto& v : big)
    reference.vertices.push_back(
        {static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2])});
  reference.faces = {{0, 1, 2}};
  for (const std::array<double, 3>& p : std::initializer_list<std::array<double, 3>>{
           {3, 3, 4}, {-2, -1, 1}, {11, 1, 2}, {2, 11, -3}, {5, -2, 0}, {-1, 4, 3}, {6, 6, 2}}) {
    Mesh speck;
    const auto x = static_cast<float>(p[0]), y = static_cast<float>(p[1]),
               z = static_cast<float>(p[2]);
    speck.vertices = {{x, y, z}, {x + 1e-3f, y, z}, {x, y + 1e-3f, z}};
    speck.faces = {{0, 1, 2}};
    CHECK(mesh::compare_meshes(speck, reference).all.to_reference ==
          doctest::Approx(slow_distance(p, big)).epsilon(2e-3));
  }
}

TEST_CASE("samples spread evenly and are the same every time") {
  Mesh m = level(0);
  add_sheet(m, {0, 0, 5}, {30, 0, 0}, {0, 0, 10});
  mesh::CompareOptions how;
  const mesh::Samples a = mesh::sample_surface(m, how);
  CHECK(a.points.size() == 4 * 3300);
  Index on_wall = 0, west = 0;
  for (std::size_t s = 0; s < a.points.size(); ++s) {
    if (a.faces[s] >= 2) {
      ++on_wall;
      CHECK(a.points[s][1] == 0);
      CHECK(a.points[s][2] >= 5);
    } else {
      CHECK(a.points[s][2] == 0);
      west += a.points[s][0] < 15 ? 1 : 0;
    }
  }
  CHECK(on_wall == 1200);
  CHECK(std::abs(static_cast<double>(west) - 3000) < 150);  // three standard deviations
  CHECK(mesh::sample_surface(m, how).points == a.points);
  how.most = 77;
  CHECK(mesh::sample_surface(m, how).points.size() == 77);

  const Mesh other = gridded(1);
  set_threads(1);
  const auto one = mesh::compare_meshes(m, other);
  set_threads(2);
  const auto two = mesh::compare_meshes(m, other);
  set_threads(0);
  CHECK(one.all.chamfer == two.all.chamfer);
  CHECK(one.all.f[1].f1 == two.all.f[1].f1);
  CHECK(one.without_walls.chamfer == two.without_walls.chamfer);
}

TEST_CASE("a mesh without area is refused") {
  Mesh flat;
  flat.vertices = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}};
  flat.faces = {{0, 1, 2}};
  CHECK(error_of<Error>([&] { mesh::compare_meshes(flat, level(0)); }) ==
        "sample_surface: 1 faces without area, expected a surface");
}

}  // namespace satsurf::test
