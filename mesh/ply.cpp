// SPDX-License-Identifier: Apache-2.0
#include "satsurf/mesh/ply.h"

#include "satsurf/core/atomic_file.h"
#include "satsurf/core/error.h"
#include "satsurf/core/files.h"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <optional>
#include <sstream>
#include <string>
#include <string_view>
#include <utility>

namespace satsurf::mesh {
namespace {

static_assert(std::endian::native == std::endian::little);  // numbers are copied as they lie

constexpr std::size_t kMostHeader = 1 << 20, kMostProperties = 4096;
constexpr std::uint64_t kMostElements = 0x7fffffff;  // a face holds 31-bit vertex numbers
// m; there the next float is 8 mm away
constexpr double kFarthest = 1e5;

/// One number type of the format.
struct Type {
  std::string_view name, other_name;
  std::size_t size;
};
constexpr std::array<Type, 8> kTypes{{{"char", "int8", 1},
                                      {"uchar", "uint8", 1},
                                      {"short", "int16", 2},
                                      {"ushort", "uint16", 2},
                                      {"int", "int32", 4},
                                      {"uint", "uint32", 4},
                                      {"float", "float32", 4},
                                      {"double", "float64", 8}}};
enum TypeNumber : std::size_t { kUchar = 1, kInt = 4, kUint = 5, kFloat = 6, kDouble = 7 };

constexpr std::array<const char*, 9> kNames{"x",  "y",   "z",     "nx",  "ny",
                                            "nz", "red", "green", "blue"};
enum Property : std::size_t { kPosition = 0, kNormal = 3, kColour = 6 };

std::vector<std::string> words_of(const std::string& line) {
  std::istringstream in(line);
  return {std::istream_iterator<std::string>(in), {}};
}

class Reader {
 public:
  explicit Reader(const std::filesystem::path& path) : path_(path) {
    std::ifstream in;
    require_file(path, "a PLY file");
    in.open(path, std::ios::binary);
    if (!in.is_open()) fail("cannot be opened");
    bytes_.assign(std::istreambuf_iterator<char>(in), {});
    if (in.bad()) fail("cannot be read");
  }

  PlyContent read() {
    read_header();
    for (std::size_t n = 0; n < kNames.size(); ++n) find(n);
    for (std::size_t n = 0; n < kNormal; ++n)
      if (!place_[n]) fail(std::string("property ") + kNames[n] + " is missing");
    read_vertices();
    read_faces();
    if (at_ != bytes_.size())
      fail(std::to_string(bytes_.size() - at_) + " bytes behind the last face, expected none");
    return std::move(content_);
  }

 private:
  struct Scalar {
    std::string name;
    std::size_t type, offset;
  };

  [[noreturn]] void fail(const std::string& what) const {
    throw IoError("read_ply: " + path_.string() + ": " + what);
  }

  std::string line() {
    const std::size_t end = bytes_.find('\n', at_);
    if (end == std::string::npos || end > kMostHeader)
      fail("the header does not end; is this a PLY file?");
    std::string text = bytes_.substr(at_, end - at_);
    at_ = end + 1;
    if (!text.empty() && text.back() == '\r') text.pop_back();
    return text;
  }

  std::uint64_t count_of(const std::string& text, const std::string& word) const {
    std::uint64_t n = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), n);
    if (error != std::errc() || end != word.data() + word.size() || n > kMostElements)
      fail("'" + text.substr(0, 60) + "', expected a number below 2^31");
    return n;
  }

  std::size_t type_of(const std::string& text, const std::string& word) const {
    for (std::size_t t = 0; t < kTypes.size(); ++t)
      if (word == kTypes[t].name || word == kTypes[t].other_name) return t;
    fail("'" + text.substr(0, 60) + "', expected a type of PLY such as float");
  }

  void read_header() {
    if (line() != "ply") fail("does not begin with 'ply'");
    if (const std::string format = line(); format != "format binary_little_endian 1.0")
      fail("'" + format.substr(0, 60) + "', expected 'format binary_little_endian 1.0'");
    bool in_vertices = false, in_faces = false;
    while (true) {
      const std::string text = line();
      const auto word = words_of(text);
      const auto is = [&](std::size_t n, const char* first) {
        return word.size() == n && word[0] == first;
      };
      if (is(1, "end_header")) break;
      if (!word.empty() && word[0] == "comment") {
        content_.comments.push_back(text.substr(std::min<std::size_t>(text.size(), 8)));
      } else if (!word.empty() && word[0] == "obj_info") {
        continue;
      } else if (is(3, "element") && word[1] == "vertex" && !in_vertices) {
        vertices_ = count_of(text, word[2]), in_vertices = true;
      } else if (is(3, "element") && word[1] == "face" && in_vertices && !in_faces) {
        faces_ = count_of(text, word[2]), in_faces = true;
      } else if (is(3, "property") && in_vertices && !in_faces) {
        const std::size_t type = type_of(text, word[1]);
        if (scalars_.size() >= kMostProperties) fail("more than 4096 properties");
        for (const Scalar& s : scalars_)
          if (s.name == word[2]) fail("property " + word[2] + " comes twice");
        scalars_.push_back({word[2], type, stride_});
        stride_ += kTypes[type].size;
      } else if (is(5, "property") && in_faces && word[1] == "list" && !list_) {
        list_ = {type_of(text, word[2]), type_of(text, word[3])};
        if (list_->first != kUchar && list_->first != kInt && list_->first != kUint)
          fail("'" + text.substr(0, 60) + "', expected a list counted by uchar, int or uint");
        if (list_->second != kInt && list_->second != kUint)
          fail("'" + text.substr(0, 60) + "', expected a list of int or uint");
      } else {
        fail("'" + text.substr(0, 60) + "', expected vertices of numbers, then faces of one list");
      }
    }
    if (!list_ || faces_ == 0) fail("no faces, expected a mesh");
  }

  void find(std::size_t property) {
    for (const Scalar& s : scalars_) {
      if (s.name != kNames[property]) continue;
      const bool colour = property >= kColour;
      if (colour && s.type != kUchar) return;  // of another program; geometry is what counts
      if (!colour && s.type != kFloat && s.type != kDouble)
        fail("property " + s.name + " is " + std::string(kTypes[s.type].name) +
             ", expected float or double");
      place_[property] = s;
    }
  }

  void need(std::uint64_t n, const char* of) const {
    if (bytes_.size() - at_ < n)
      fail("ends within the " + std::string(of) + ", expected " + std::to_string(vertices_) +
           " vertices and " + std::to_string(faces_) + " faces");
  }

  double number(std::size_t type, std::size_t at) const {
    const auto load = [&](auto value) {
      std::memcpy(&value, bytes_.data() + at, sizeof value);
      return static_cast<double>(value);
    };
    switch (type) {
      case kUchar:
        return load(std::uint8_t{});
      case kInt:
        return load(std::int32_t{});
      case kUint:
        return load(std::uint32_t{});
      case kFloat:
        return load(float{});
      default:
        return load(double{});
    }
  }

  void read_vertices() {
    need(vertices_ * stride_, "vertices");
    Mesh& mesh = content_.mesh;
    const auto whole = [&](std::size_t first) {
      return place_[first] && place_[first + 1] && place_[first + 2];
    };
    const auto fill = [&](std::vector<std::array<float, 3>>& out, std::size_t first, double scale) {
      if (!whole(first)) return;
      out.resize(vertices_);
      for (std::size_t v = 0; v < vertices_; ++v)
        for (std::size_t a = 0; a < 3; ++a) {
          const Scalar& s = *place_[first + a];
          const double x = number(s.type, at_ + v * stride_ + s.offset) * scale;
          if (!std::isfinite(static_cast<float>(x)))
            fail("property " + s.name + " of vertex " + std::to_string(v) + " is " +
                 std::to_string(x) + ", expected a finite number");
          if (first == kPosition && std::abs(x) > kFarthest)
            fail("property " + s.name + " of vertex " + std::to_string(v) + " is " +
                 std::to_string(x) +
                 ", expected at most 100000 m either way: coordinates relative to an origin near "
                 "the mesh");
          out[v][a] = static_cast<float>(x);
        }
    };
    fill(mesh.vertices, kPosition, 1);
    fill(mesh.normals, kNormal, 1);
    fill(mesh.colours, kColour, 1.0 / 255);
    at_ += vertices_ * stride_;
  }

  void read_faces() {
    const auto [count_type, index_type] = *list_;
    const std::size_t count_size = kTypes[count_type].size;
    content_.mesh.faces.reserve(std::min<std::uint64_t>(faces_, bytes_.size() / 13));
    for (std::uint64_t f = 0; f < faces_; ++f) {
      need(count_size, "faces");
      const double corners = number(count_type, at_);
      at_ += count_size;
      if (!(corners >= 3))
        fail("face " + std::to_string(f) + " has " + std::to_string(static_cast<long>(corners)) +
             " corners, expected 3 or more");
      const auto n = static_cast<std::size_t>(corners);
      need(4 * std::uint64_t{n}, "faces");
      const auto corner = [&](std::size_t c) {
        const double v = number(index_type, at_ + 4 * c);
        if (!(v >= 0 && v < static_cast<double>(vertices_)))
          fail("face " + std::to_string(f) + " has vertex " +
               std::to_string(static_cast<long long>(v)) + ", expected 0 to " +
               std::to_string(static_cast<long long>(vertices_) - 1));
        return static_cast<std::uint32_t>(v);
      };
      for (std::size_t c = 2; c < n; ++c)
        content_.mesh.faces.push_back({corner(0), corner(c - 1), corner(c)});
      at_ += 4 * n;
    }
  }

  std::filesystem::path path_;
  std::string bytes_;
  std::size_t at_ = 0, stride_ = 0;
  std::uint64_t vertices_ = 0, faces_ = 0;
  std::vector<Scalar> scalars_;
  std::array<std::optional<Scalar>, kNames.size()> place_;
  std::optional<std::pair<std::size_t, std::size_t>> list_;  // types of count and index
  PlyContent content_;
};

}  // namespace

void write_ply(const std::filesystem::path& path, const Mesh& mesh,
               const std::vector<std::string>& comments, const std::function<void()>& poll) {
  const auto fail = [&](const std::string& what) {
    throw IoError("write_ply: " + path.string() + ": " + what);
  };
  const std::size_t V = mesh.vertices.size();
  const bool normals = !mesh.normals.empty(), colours = !mesh.colours.empty();
  if ((normals && mesh.normals.size() != V) || (colours && mesh.colours.size() != V))
    fail(std::to_string(V) + " vertices, " + std::to_string(mesh.normals.size()) + " normals and " +
         std::to_string(mesh.colours.size()) + " colours, expected as many of each, or none");
  if (V > kMostElements || mesh.faces.size() > kMostElements)
    fail("more vertices or faces than fit, expected fewer than 2^31");
  std::string bytes = "ply\nformat binary_little_endian 1.0\n";
  for (const std::string& c : comments) {
    if (c.find_first_of("\r\n") != std::string::npos)
      fail("comment '" + c + "' has more than one line");
    bytes += "comment " + c + "\n";
  }
  bytes += "element vertex " + std::to_string(V) + "\n";
  for (std::size_t n = 0; n < kNames.size(); ++n)
    if (n < kNormal || (n < kColour ? normals : colours))
      bytes += std::string("property ") + (n < kColour ? "float " : "uchar ") + kNames[n] + "\n";
  bytes += "element face " + std::to_string(mesh.faces.size()) +
           "\nproperty list uchar int vertex_indices\nend_header\n";

  const auto put = [&](const auto& value) {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
  };
  const auto put_vertex = [&](std::size_t v) {
    const auto floats = [&](const std::array<float, 3>& p, std::size_t first) {
      for (std::size_t a = 0; a < 3; ++a) {
        if (!std::isfinite(p[a]))
          fail(std::string("property ") + kNames[first + a] + " of vertex " + std::to_string(v) +
               " is " + std::to_string(p[a]) + ", expected a finite number");
        put(p[a]);
      }
    };
    floats(mesh.vertices[v], kPosition);
    if (normals) floats(mesh.normals[v], kNormal);
    if (!colours) return;
    for (std::size_t c = 0; c < 3; ++c) {
      const float x = mesh.colours[v][c];
      if (!std::isfinite(x))
        fail(std::string("property ") + kNames[kColour + c] + " of vertex " + std::to_string(v) +
             " is " + std::to_string(x) + ", expected a finite number");
      put(static_cast<std::uint8_t>(std::lround(255 * std::clamp(x, 0.f, 1.f))));
    }
  };
  const auto put_face = [&](const std::array<std::uint32_t, 3>& face) {
    put(std::uint8_t{3});
    for (const std::uint32_t v : face) {
      if (v >= V)
        fail("a face has vertex " + std::to_string(v) + ", expected fewer than " +
             std::to_string(V));
      put(static_cast<std::int32_t>(v));
    }
  };
  // Bit by bit: all of the file would be as large as the mesh once more.
  constexpr std::size_t kTogether = 1 << 16;  // vertices or faces
  const std::size_t all = V + mesh.faces.size();
  std::size_t at = 0;
  bool begun = false;
  atomic_write(path, [&]() -> std::string_view {
    if (poll) poll();
    if (std::exchange(begun, true)) bytes.clear();
    for (const std::size_t end = std::min(all, at + kTogether); at < end; ++at)
      if (at < V)
        put_vertex(at);
      else
        put_face(mesh.faces[at - V]);
    return bytes;
  });
}

PlyContent read_ply(const std::filesystem::path& path) { return Reader(path).read(); }

}  // namespace satsurf::mesh
