// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/mesh/geometry.h"
#include "satsurf/mesh/glb.h"
#include "satsurf/mesh/ply.h"
#include "satsurf/mesh/simplify.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <limits>
#include <string>
#include <tuple>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>
#include <nlohmann/json.hpp>

using namespace satsurf;
using namespace satsurf::mesh;
using test::error_of;

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

template <class T>
T at(const std::string& bytes, std::size_t offset) {
  T value{};
  std::memcpy(&value, bytes.data() + offset, sizeof(T));
  return value;
}

/// A hill of H x W cells of 2 m.
Tensor hill(Index H, Index W) {
  Tensor z({H, W});
  for (Index i = 0; i < H; ++i)
    for (Index j = 0; j < W; ++j)
      z[i * W + j] = static_cast<float>(5 * std::sin(0.3 * static_cast<double>(i)) +
                                        0.1 * static_cast<double>(j));
  return z;
}

/// Every number of a picture another one, evenly from 0 up to 1.
Tensor ramp(const Shape& shape) {
  Tensor out(shape);
  for (Index i = 0; i < out.count(); ++i)
    out[i] = static_cast<float>(i) / static_cast<float>(out.count());
  return out;
}

}  // namespace

TEST_CASE("mesh_from_heights: triangles look up, holes stay holes") {
  Tensor z({3, 3}, 4.F);
  const Tensor colour = ramp({3, 3, 3});
  const Mesh whole = mesh_from_heights(z, 10, 20, 2, colour);
  CHECK(whole.vertices.size() == 9);
  CHECK(whole.faces.size() == 8);
  CHECK(whole.vertices[0] == std::array<float, 3>{11, 19, 4});
  REQUIRE(whole.colours.size() == 9);
  for (std::size_t v = 0; v < 9; ++v) {  // in the order of the faces
    const Index cell = 3 * static_cast<Index>((19 - whole.vertices[v][1]) / 2) +
                       static_cast<Index>((whole.vertices[v][0] - 11) / 2);
    CHECK(whole.colours[v] ==
          std::array<float, 3>{colour[cell], colour[9 + cell], colour[18 + cell]});
  }
  CHECK(whole.colours[1] != whole.colours[4]);
  for (const auto& n : whole.normals) CHECK(n == std::array<float, 3>{0, 0, 1});
  z[4] = kNan;
  CHECK(mesh_from_heights(z, 0, 0, 1, {}).faces.size() == 2);  // the two corners off the diagonals
  CHECK(error_of<Error>([] {
          mesh_from_heights(Tensor({4, 4}, kNan), 0, 0, 1, {});
        }) == "mesh_from_heights: no three neighbouring cells have heights, expected a surface");
}

TEST_CASE("write_glb: y up, linear colours, and what the format demands") {
  const test::TempFolder folder("glb");
  Mesh mesh = mesh_from_heights(hill(4, 5), 0, 0, 2, ramp({3, 4, 5}));
  write_glb(folder / "hill.glb", mesh, {{"crs", "EPSG:32617"}});
  const std::string bytes = test::read_bytes(folder / "hill.glb");
  CHECK(bytes.substr(0, 4) == "glTF");
  CHECK(at<std::uint32_t>(bytes, 4) == 2);
  CHECK(at<std::uint32_t>(bytes, 8) == bytes.size());
  const auto length = at<std::uint32_t>(bytes, 12);
  CHECK(length % 4 == 0);
  const nlohmann::json json = nlohmann::json::parse(bytes.substr(20, length));
  CHECK(json["asset"]["extras"]["crs"] == "EPSG:32617");
  CHECK(at<std::uint32_t>(bytes, 20 + length) == json["buffers"][0]["byteLength"]);
  CHECK(bytes.substr(24 + length, 4) == std::string("BIN\0", 4));
  const auto& attributes = json["meshes"][0]["primitives"][0]["attributes"];
  const auto begin = [&](std::size_t accessor) {
    return 28 + length +
           json["bufferViews"][json["accessors"][accessor]["bufferView"].get<std::size_t>()]
               ["byteOffset"]
                   .get<std::size_t>();
  };
  const std::size_t positions = begin(attributes["POSITION"]);
  for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
    CHECK(at<float>(bytes, positions + 12 * i) == mesh.vertices[i][0]);
    CHECK(at<float>(bytes, positions + 12 * i + 4) == mesh.vertices[i][2]);
    CHECK(at<float>(bytes, positions + 12 * i + 8) == -mesh.vertices[i][1]);
  }
  CHECK(json["accessors"][0]["max"][2] == 7.0);  // southernmost row: y = -7
  // cell 1 has the colours 1/60, 21/60 and 41/60, cell 10 has 10/60, 30/60 and 50/60
  using Colour = std::array<std::uint16_t, 4>;
  for (const auto& [cell, x, y, linear] :
       {std::tuple{1, 3.F, -1.F, Colour{85, 6585, 27827, 65535}},
        std::tuple{10, 1.F, -5.F, Colour{1550, 14027, 43376, 65535}}}) {
    CAPTURE(cell);
    const auto vertex =
        std::ranges::find_if(mesh.vertices, [&](const auto& p) { return p[0] == x && p[1] == y; });
    REQUIRE(vertex != mesh.vertices.end());
    const auto number = static_cast<std::size_t>(vertex - mesh.vertices.begin());
    CHECK(at<Colour>(bytes, begin(attributes["COLOR_0"]) + 8 * number) == linear);
  }
  CHECK(json["accessors"][3]["count"] == 3 * mesh.faces.size());
  mesh.faces[0][1] = 99;
  CHECK(error_of<IoError>([&] {
          write_glb(folder / "bad.glb", mesh, {});
        }).ends_with("a face of vertex 99, expected one below 20"));
  mesh.faces.clear();
  CHECK(error_of<IoError>([&] {
          write_glb(folder / "bad.glb", mesh, {});
        }).ends_with("the mesh has no faces, expected some"));
  CHECK(!std::filesystem::exists(folder / "bad.glb"));
}

TEST_CASE("a mesh that is being written can be given up, and leaves nothing") {
  const test::TempFolder folder("given-up");
  const Mesh mesh = mesh_from_heights(hill(300, 300), 0, 0, 2, {});
  struct Enough {};
  for (const int most : {0, 1, 3}) {
    int asked = 0;
    const auto poll = [&] {
      if (asked++ == most) throw Enough{};
    };
    CHECK_THROWS_AS(write_glb(folder / "x.glb", mesh, {}, poll), Enough);
    asked = 0;
    CHECK_THROWS_AS(write_ply(folder / "x.ply", mesh, {}, poll), Enough);
    CHECK(std::filesystem::is_empty(folder.path()));
  }
  // In pieces as in one: what is told of the parts is where they are.
  write_glb(folder / "x.glb", mesh, {});
  const std::string bytes = test::read_bytes(folder / "x.glb");
  const auto text = at<std::uint32_t>(bytes, 12);
  const auto json = nlohmann::json::parse(bytes.substr(20, text));
  const std::size_t begin = 20 + text + 8;
  CHECK(bytes.size() == begin + json["buffers"][0]["byteLength"].get<std::size_t>());
  const auto of = [&](std::size_t view) {
    return begin + json["bufferViews"][view]["byteOffset"].get<std::size_t>();
  };
  CHECK(at<std::array<float, 3>>(bytes, of(1) + 12 * 70000) ==
        std::array<float, 3>{mesh.normals[70000][0], mesh.normals[70000][2],
                             -mesh.normals[70000][1]});
  CHECK(at<std::array<std::uint32_t, 3>>(bytes, of(2) + 12 * 170000) == mesh.faces[170000]);
}

TEST_CASE("simplified: as many faces as are allowed, near the surface") {
  const Mesh fine = mesh_from_heights(hill(60, 60), 0, 0, 2, ramp({3, 60, 60}));
  const Mesh coarse = simplified(fine, 1000);
  CHECK(coarse.faces.size() <= 1000);
  CHECK(coarse.faces.size() > 400);
  CHECK(coarse.normals.size() == coarse.vertices.size());
  CHECK(coarse.colours.size() == coarse.vertices.size());
  for (std::size_t n = 0; n < coarse.vertices.size(); ++n) {
    const auto& v = coarse.vertices[n];
    const double i = (-static_cast<double>(v[1]) - 1) / 2, j = (static_cast<double>(v[0]) - 1) / 2;
    CHECK(std::abs(5 * std::sin(0.3 * i) + 0.1 * j - static_cast<double>(v[2])) < 1.5);
    // the ramp is linear: means of places have the means of its colours
    for (std::size_t c = 0; c < 3; ++c)
      CHECK(static_cast<double>(coarse.colours[n][c]) ==
            doctest::Approx((static_cast<double>(c) * 3600 + 60 * i + j) / 10800).epsilon(1e-4));
  }
  Index down = 0;  // seen from above, a surface of heights shows nothing but upper sides
  for (const auto& face : coarse.faces) {
    for (const std::uint32_t v : face) REQUIRE(v < coarse.vertices.size());
    if (doubled_area(corners(coarse, face))[2] < 0) ++down;
  }
  CHECK(down <= static_cast<Index>(coarse.faces.size()) / 100);
  CHECK(simplified(fine, 1'000'000).faces == fine.faces);
  CHECK_THROWS_AS(simplified(fine, 0), Error);
}

TEST_CASE("simplified: of faces on one point none is left") {
  Mesh point;
  point.vertices.assign(9, {3, 4, 5});
  point.faces = {{0, 1, 2}, {3, 4, 5}, {6, 7, 8}};
  CHECK(simplified(point, 1).faces.empty());
  CHECK(simplified(point, 3).faces == point.faces);
}
