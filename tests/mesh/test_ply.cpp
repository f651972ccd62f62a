// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/mesh/ply.h"

#include <cmath>
#include <cstring>
#include <limits>
#include <string>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

namespace satsurf::test {
namespace {

using mesh::Mesh;

Mesh two_faces() {
  Mesh m;
  m.vertices = {{1.5f, -2.25f, 3}, {4, 5, 6}, {7, 8.125f, 9}, {-1e4f, 1e5f, 0.001f}};
  m.normals = {{0, 0, 1}, {0, 1, 0}, {1, 0, 0}, {0.6f, 0, 0.8f}};
  m.colours = {{0, 0.2f, 1}, {1, 0, 0}, {0, 1, 0}, {0.6f, 0.8f, 0.4f}};
  m.faces = {{0, 1, 2}, {2, 1, 3}};
  return m;
}

template <class T>
std::string raw(std::initializer_list<T> values) {
  std::string out;
  for (const T v : values) out.append(reinterpret_cast<const char*>(&v), sizeof v);
  return out;
}

const std::string kFront = "ply\nformat binary_little_endian 1.0\n";

}  // namespace

TEST_CASE("a mesh file holds what was written") {
  const TempFolder folder("mesh-ply");
  const std::vector<std::string> comments{"crs EPSG:32631", "origin 1.2345678901234567 2 3"};
  const Mesh m = two_faces();
  mesh::write_ply(folder / "m.ply", m, comments);
  const mesh::PlyContent read = mesh::read_ply(folder / "m.ply");
  CHECK(read.comments == comments);
  CHECK(read.mesh.vertices == m.vertices);
  CHECK(read.mesh.normals == m.normals);
  CHECK(read.mesh.faces == m.faces);
  REQUIRE(read.mesh.colours.size() == 4);
  for (std::size_t v = 0; v < 4; ++v)
    for (std::size_t c = 0; c < 3; ++c)
      CHECK(read.mesh.colours[v][c] == doctest::Approx(m.colours[v][c]).epsilon(1e-6));
  mesh::write_ply(folder / "again.ply", read.mesh, comments);
  CHECK(read_bytes(folder / "again.ply") == read_bytes(folder / "m.ply"));

  // the layout that viewers expect, to the byte
  const std::string header = kFront + "comment " + comments[0] + "\ncomment " + comments[1] +
                             "\nelement vertex 4\nproperty float x\nproperty float y\n"
                             "property float z\nproperty float nx\nproperty float ny\n"
                             "property float nz\nproperty uchar red\nproperty uchar green\n"
                             "property uchar blue\nelement face 2\n"
                             "property list uchar int vertex_indices\nend_header\n";
  const std::string bytes = read_bytes(folder / "m.ply");
  CHECK(bytes.substr(0, header.size()) == header);
  CHECK(bytes.size() == header.size() + 4 * 27 + 2 * 13);
  CHECK(bytes.substr(header.size(), 27) ==
        raw({1.5f, -2.25f, 3.f, 0.f, 0.f, 1.f}) + raw<std::uint8_t>({0, 51, 255}));
  CHECK(bytes.substr(bytes.size() - 13) == raw<std::uint8_t>({3}) + raw<std::int32_t>({2, 1, 3}));

  Mesh bare = m;
  bare.normals.clear(), bare.colours.clear();
  mesh::write_ply(folder / "bare.ply", bare, {});
  CHECK(mesh::read_ply(folder / "bare.ply").mesh.normals.empty());
  CHECK(mesh::read_ply(folder / "bare.ply").mesh.colours.empty());
}

TEST_CASE("meshes of other programs are read") {
  const TempFolder folder("mesh-ply-other");
  write_bytes(
      folder / "m.ply",
      kFront +
          "obj_info by hand\r\nelement vertex 5\nproperty uchar alpha\nproperty double z\n"
          "property double x\nproperty float64 y\nproperty float quality\nelement face 2\n"
          "property list int uint vertex_index\nend_header\n" +
          [] {
            std::string rows;
            for (int v = 0; v < 5; ++v)
              rows += raw<std::uint8_t>({255}) + raw({3.0 + v, 1.0 + v, 2.0 + v}) + raw({0.5f});
            return rows;
          }() +
          raw<std::int32_t>({4, 0, 1, 2, 3, 3, 4, 3, 0}));
  const Mesh m = mesh::read_ply(folder / "m.ply").mesh;
  REQUIRE(m.vertices.size() == 5);
  CHECK(m.vertices[4] == std::array<float, 3>{5, 6, 7});
  CHECK(m.faces == std::vector<std::array<std::uint32_t, 3>>{{0, 1, 2}, {0, 2, 3}, {4, 3, 0}});
}

TEST_CASE("mesh files that are damaged are refused") {
  const TempFolder folder("mesh-ply-bad");
  const auto complaint = [&](const std::string& bytes) {
    write_bytes(folder / "m.ply", bytes);
    const std::string text = error_of<IoError>([&] { mesh::read_ply(folder / "m.ply"); }),
                      front = "read_ply: " + (folder / "m.ply").string() + ": ";
    return text.starts_with(front) ? text.substr(front.size()) : text;
  };
  const std::string xyz = "property float x\nproperty float y\nproperty float z\n",
                    list = "property list uchar int vertex_indices\n",
                    head = kFront + "element vertex 3\n" + xyz + "element face 1\n" + list +
                           "end_header\n",
                    points = raw({0.f, 0.f, 0.f, 1.f, 0.f, 0.f, 0.f, 1.f, 0.f}),
                    face = raw<std::uint8_t>({3}) + raw<std::int32_t>({0, 1, 2});
  CHECK(complaint(head + points + face) == "no exception");
  CHECK(complaint("") == "the header does not end; is this a PLY file?");
  CHECK(complaint("plx\n") == "does not begin with 'ply'");
  CHECK(complaint("ply\nformat ascii 1.0\n") ==
        "'format ascii 1.0', expected 'format binary_little_endian 1.0'");
  CHECK(complaint(kFront + "element vertex -3\n") ==
        "'element vertex -3', expected a number below 2^31");
  CHECK(complaint(kFront + "element vertex 3\nproperty half x\n") ==
        "'property half x', expected a type of PLY such as float");
  CHECK(complaint(kFront + "element vertex 3\nproperty float x\nproperty float x\n") ==
        "property x comes twice");
  CHECK(complaint(kFront + "element vertex 0\n" + xyz + "end_header\n") ==
        "no faces, expected a mesh");
  CHECK(complaint(kFront + "element vertex 3\n" + xyz + "element face 0\n" + list + "end_header\n" +
                  points) == "no faces, expected a mesh");
  CHECK(complaint(kFront + "element edge 3\n") ==
        "'element edge 3', expected vertices of numbers, then faces of one list");
  CHECK(complaint(kFront + "element vertex 3\nproperty float x\nelement face 1\n" + list +
                  "end_header\n") == "property y is missing");
  CHECK(complaint(kFront + "element vertex 3\nproperty int x\nelement face 1\n" + list +
                  "end_header\n") == "property x is int, expected float or double");
  CHECK(complaint(kFront + "element vertex 3\n" + xyz + "element face 1\n" +
                  "property list uchar float vertex_indices\n") ==
        "'property list uchar float vertex_indices', expected a list of int or uint");
  CHECK(complaint(kFront + "element vertex 3\n" + xyz + "element face 1\n" +
                  "property list float int vertex_indices\n") ==
        "'property list float int vertex_indices', expected a list counted by uchar, int or uint");
  CHECK(complaint(head + points.substr(1)) ==
        "ends within the vertices, expected 3 vertices and 1 faces");
  CHECK(complaint(head + points) == "ends within the faces, expected 3 vertices and 1 faces");
  CHECK(complaint(head + points + face.substr(0, 12)) ==
        "ends within the faces, expected 3 vertices and 1 faces");
  CHECK(complaint(head + points + face + "x") == "1 bytes behind the last face, expected none");
  CHECK(complaint(head + points + raw<std::uint8_t>({2}) + raw<std::int32_t>({0, 1})) ==
        "face 0 has 2 corners, expected 3 or more");
  CHECK(complaint(head + points + raw<std::uint8_t>({3}) + raw<std::int32_t>({0, 1, 3})) ==
        "face 0 has vertex 3, expected 0 to 2");
  CHECK(complaint(head + points + raw<std::uint8_t>({3}) + raw<std::int32_t>({0, -1, 2})) ==
        "face 0 has vertex -1, expected 0 to 2");
  const float nan = std::numeric_limits<float>::quiet_NaN();
  CHECK(complaint(head + raw({0.f, 0.f, 0.f, 1.f, nan, 0.f, 0.f, 1.f, 0.f}) + face) ==
        "property y of vertex 1 is nan, expected a finite number");
  const std::string wide = kFront +
                           "element vertex 3\nproperty double x\nproperty double y\n"
                           "property double z\nelement face 1\n" +
                           list + "end_header\n";
  CHECK(complaint(wide + raw({1e5, 0., 0., 1., -1e5, 0., 0., 1., 0.}) + face) == "no exception");
  CHECK(complaint(wide + raw({0., 0., 0., 1., -3354000.25, 0., 0., 1., 0.}) + face) ==
        "property y of vertex 1 is -3354000.250000, expected at most 100000 m either way: "
        "coordinates relative to an origin near the mesh");
  CHECK(complaint(head + raw({0.f, 0.f, 0.f, 4e5f, 0.f, 0.f, 0.f, 1.f, 0.f}) + face)
            .starts_with("property x of vertex 1 is 400000.000000, expected at most "));
  CHECK(error_of<IoError>([&] { mesh::read_ply(folder / "none.ply"); }) ==
        (folder / "none.ply").string() + ": no such file, expected a PLY file");
}

TEST_CASE("meshes that no reader takes are not written") {
  const TempFolder folder("mesh-ply-write");
  const auto complaint = [&](const Mesh& m, const std::vector<std::string>& comments = {}) {
    const std::string text = error_of<IoError>(
                          [&] { mesh::write_ply(folder / "m.ply", m, comments); }),
                      front = "write_ply: " + (folder / "m.ply").string() + ": ";
    CHECK(!std::filesystem::exists(folder / "m.ply"));
    return text.starts_with(front) ? text.substr(front.size()) : text;
  };
  Mesh m = two_faces();
  m.vertices[2][1] = std::numeric_limits<float>::infinity();
  CHECK(complaint(m) == "property y of vertex 2 is inf, expected a finite number");
  m = two_faces();
  m.colours[1][2] = std::nanf("");
  CHECK(complaint(m) == "property blue of vertex 1 is nan, expected a finite number");
  m = two_faces();
  m.faces[1][0] = 4;
  CHECK(complaint(m) == "a face has vertex 4, expected fewer than 4");
  m = two_faces();
  m.normals.pop_back();
  CHECK(complaint(m) == "4 vertices, 3 normals and 4 colours, expected as many of each, or none");
  CHECK(complaint(two_faces(), {"two\nlines"}) == "comment 'two\\nlines' has more than one line");
}

}  // namespace satsurf::test
