// SPDX-License-Identifier: Apache-2.0
#include "satsurf/mesh/glb.h"

#include "satsurf/core/atomic_file.h"
#include "satsurf/core/error.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <limits>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

namespace satsurf::mesh {
namespace {

static_assert(std::endian::native == std::endian::little);  // numbers are copied as they lie

constexpr std::uint32_t kMagic = 0x46546C67, kVersion = 2, kJsonChunk = 0x4E4F534A,
                        kBinaryChunk = 0x004E4942;
enum ComponentType { kUnsignedShort = 5123, kUnsignedInt = 5125, kFloat = 5126 };
enum BufferTarget { kVertices = 34962, kIndices = 34963 };

using Triple = std::array<float, 3>;

template <class T>
void append(std::string& out, const T& value) {
  std::array<char, sizeof(T)> bytes{};
  std::memcpy(bytes.data(), &value, sizeof(T));
  out.append(bytes.data(), bytes.size());
}

Triple y_up(const Triple& v) { return {v[0], v[2], -v[1]}; }

/// Source: IEC 61966-2-1.
std::uint16_t linear16(float srgb) {
  const double v = std::clamp(static_cast<double>(srgb), 0.0, 1.0);
  const double linear = v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
  return static_cast<std::uint16_t>(std::lround(65535 * linear));
}

/// The document, and what its one buffer is made of: a part after the other, bit by bit, since all of it
/// would be as large as the mesh once more.
class Builder {
 public:
  Builder() {
    json_["bufferViews"] = nlohmann::ordered_json::array();
    json_["accessors"] = nlohmann::ordered_json::array();
  }
  /// Adds elements in a view of their own.
  /// put      appends the bytes of one, by its number
  /// returns  the number of its accessor
  std::size_t add(std::size_t count, std::size_t element_bytes,
                  std::function<void(std::size_t, std::string&)> put, const char* type,
                  ComponentType component, BufferTarget target, nlohmann::ordered_json more = {}) {
    const std::size_t length = count * element_bytes;
    json_["bufferViews"].push_back({{"buffer", 0},
                                    {"byteOffset", bytes_},
                                    {"byteLength", length},
                                    {"target", static_cast<int>(target)}});
    // A list of numbers is one of scalars, three of a triangle.
    const bool scalars = std::string_view(type) == "SCALAR";
    nlohmann::ordered_json accessor{{"bufferView", json_["bufferViews"].size() - 1},
                                    {"componentType", static_cast<int>(component)},
                                    {"count", scalars ? 3 * count : count},
                                    {"type", type}};
    if (!more.is_null()) accessor.update(more);
    json_["accessors"].push_back(std::move(accessor));
    bytes_ += length;
    parts_.push_back({count, std::move(put)});
    return json_["accessors"].size() - 1;
  }
  nlohmann::ordered_json& json() { return json_; }
  std::size_t bytes() const { return bytes_; }
  /// The next bytes of the buffer, which live until the next call; none at its end.
  std::string_view next() {
    constexpr std::size_t kTogether = 1 << 16;  // elements
    piece_.clear();
    while (piece_.empty() && part_ < parts_.size()) {
      const auto& [count, put] = parts_[part_];
      for (const std::size_t end = std::min(count, at_ + kTogether); at_ < end; ++at_)
        put(at_, piece_);
      if (at_ == count) ++part_, at_ = 0;
    }
    return piece_;
  }

 private:
  struct Part {
    std::size_t count;
    std::function<void(std::size_t, std::string&)> put;
  };
  nlohmann::ordered_json json_;
  std::vector<Part> parts_;
  std::size_t bytes_ = 0, part_ = 0, at_ = 0;
  std::string piece_;
};

void check(const std::string& where, const Mesh& mesh) {
  const std::size_t n = mesh.vertices.size();
  if (mesh.faces.empty()) throw IoError(where + "the mesh has no faces, expected some");
  const auto fits = [&](const std::vector<Triple>& list, const char* what) {
    if (!list.empty() && list.size() != n)
      throw IoError(where + std::to_string(list.size()) + " " + what + ", expected " +
                    std::to_string(n) + ", one for each vertex");
    for (const Triple& t : list)
      for (const float v : t)
        if (!std::isfinite(v)) throw IoError(where + what + " that are no numbers, expected some");
  };
  fits(mesh.vertices, "vertices");
  fits(mesh.normals, "normals");
  fits(mesh.colours, "colours");
  for (const auto& face : mesh.faces)
    for (const std::uint32_t v : face)
      if (v >= n)
        throw IoError(where + "a face of vertex " + std::to_string(v) + ", expected one below " +
                      std::to_string(n));
}

}  // namespace

void write_glb(const std::filesystem::path& path, const Mesh& mesh,
               const std::map<std::string, std::string>& extras,
               const std::function<void()>& poll) {
  const std::string where = path.string() + ": ";
  check(where, mesh);
  Builder glb;
  nlohmann::ordered_json attributes;
  Triple low = y_up(mesh.vertices.front()), high = low;
  for (const Triple& v : mesh.vertices) {
    const Triple p = y_up(v);
    for (std::size_t c = 0; c < 3; ++c)
      low[c] = std::min(low[c], p[c]), high[c] = std::max(high[c], p[c]);
  }
  const std::size_t V = mesh.vertices.size();
  attributes["POSITION"] =
      glb.add(V, 12, [&](std::size_t v, std::string& out) { append(out, y_up(mesh.vertices[v])); },
              "VEC3", kFloat, kVertices, {{"min", low}, {"max", high}});
  if (!mesh.normals.empty())
    attributes["NORMAL"] = glb.add(
        V, 12, [&](std::size_t v, std::string& out) { append(out, y_up(mesh.normals[v])); }, "VEC3",
        kFloat, kVertices);
  if (!mesh.colours.empty())
    attributes["COLOR_0"] =
        glb.add(V, 8,
                [&](std::size_t v, std::string& out) {
                  const Triple& c = mesh.colours[v];
                  append(out, std::array<std::uint16_t, 4>{linear16(c[0]), linear16(c[1]),
                                                           linear16(c[2]), 65535});
                },
                "VEC4", kUnsignedShort, kVertices, {{"normalized", true}});
  const std::size_t indices = glb.add(
      mesh.faces.size(), 12, [&](std::size_t f, std::string& out) { append(out, mesh.faces[f]); },
      "SCALAR", kUnsignedInt, kIndices);

  nlohmann::ordered_json json{{"asset", {{"version", "2.0"}, {"generator", "satsurf"}}}};
  if (!extras.empty()) json["asset"]["extras"] = extras;
  json["scene"] = 0;
  json["scenes"] = {{{"nodes", {0}}}};
  json["nodes"] = {{{"mesh", 0}, {"name", "surface"}}};
  json["materials"] = {{{"pbrMetallicRoughness", {{"metallicFactor", 0}, {"roughnessFactor", 1}}},
                        {"doubleSided", true}}};
  json["meshes"] = {
      {{"primitives", {{{"attributes", attributes}, {"indices", indices}, {"material", 0}}}}}};
  json["buffers"] = {{{"byteLength", glb.bytes()}}};
  json.update(glb.json());
  std::string text = json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
  text.resize((text.size() + 3) / 4 * 4, ' ');  // every part is a multiple of four bytes

  const std::size_t length = 12 + 8 + text.size() + 8 + glb.bytes();
  if (length > std::numeric_limits<std::uint32_t>::max())
    throw IoError(where + "more than 4 GB, expected a mesh of fewer faces");
  std::string head;
  append(head, kMagic), append(head, kVersion), append(head, static_cast<std::uint32_t>(length));
  append(head, static_cast<std::uint32_t>(text.size())), append(head, kJsonChunk);
  head += text;
  append(head, static_cast<std::uint32_t>(glb.bytes())), append(head, kBinaryChunk);
  bool begun = false;
  atomic_write(path, [&]() -> std::string_view {
    if (poll) poll();
    return std::exchange(begun, true) ? glb.next() : head;
  });
}

}  // namespace satsurf::mesh
