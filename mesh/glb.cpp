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
#include <limits>
#include <string_view>
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

/// The document with its buffer.
class Builder {
 public:
  Builder() {
    json_["bufferViews"] = nlohmann::ordered_json::array();
    json_["accessors"] = nlohmann::ordered_json::array();
  }
  /// Closes what was appended since the last call to a view of its own.
  /// returns  the number of its accessor
  std::size_t close(std::size_t count, const char* type, ComponentType component,
                    BufferTarget target, nlohmann::ordered_json more = {}) {
    json_["bufferViews"].push_back({{"buffer", 0},
                                    {"byteOffset", begin_},
                                    {"byteLength", binary.size() - begin_},
                                    {"target", static_cast<int>(target)}});
    nlohmann::ordered_json accessor{{"bufferView", json_["bufferViews"].size() - 1},
                                    {"componentType", static_cast<int>(component)},
                                    {"count", count},
                                    {"type", type}};
    if (!more.is_null()) accessor.update(more);
    json_["accessors"].push_back(std::move(accessor));
    begin_ = binary.size();
    return json_["accessors"].size() - 1;
  }
  nlohmann::ordered_json& json() { return json_; }
  std::string binary;

 private:
  nlohmann::ordered_json json_;
  std::size_t begin_ = 0;
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
               const std::map<std::string, std::string>& extras) {
  const std::string where = path.string() + ": ";
  check(where, mesh);
  Builder glb;
  nlohmann::ordered_json attributes;
  Triple low = y_up(mesh.vertices.front()), high = low;
  for (const Triple& v : mesh.vertices) {
    const Triple p = y_up(v);
    for (std::size_t c = 0; c < 3; ++c)
      low[c] = std::min(low[c], p[c]), high[c] = std::max(high[c], p[c]);
    append(glb.binary, p);
  }
  attributes["POSITION"] =
      glb.close(mesh.vertices.size(), "VEC3", kFloat, kVertices, {{"min", low}, {"max", high}});
  if (!mesh.normals.empty()) {
    for (const Triple& n : mesh.normals) append(glb.binary, y_up(n));
    attributes["NORMAL"] = glb.close(mesh.vertices.size(), "VEC3", kFloat, kVertices);
  }
  if (!mesh.colours.empty()) {
    for (const Triple& c : mesh.colours)
      append(glb.binary,
             std::array<std::uint16_t, 4>{linear16(c[0]), linear16(c[1]), linear16(c[2]), 65535});
    attributes["COLOR_0"] =
        glb.close(mesh.vertices.size(), "VEC4", kUnsignedShort, kVertices, {{"normalized", true}});
  }
  for (const auto& face : mesh.faces) append(glb.binary, face);
  const std::size_t indices = glb.close(3 * mesh.faces.size(), "SCALAR", kUnsignedInt, kIndices);

  nlohmann::ordered_json json{{"asset", {{"version", "2.0"}, {"generator", "satsurf"}}}};
  if (!extras.empty()) json["asset"]["extras"] = extras;
  json["scene"] = 0;
  json["scenes"] = {{{"nodes", {0}}}};
  json["nodes"] = {{{"mesh", 0}, {"name", "surface"}}};
  json["materials"] = {{{"pbrMetallicRoughness", {{"metallicFactor", 0}, {"roughnessFactor", 1}}},
                        {"doubleSided", true}}};
  json["meshes"] = {
      {{"primitives", {{{"attributes", attributes}, {"indices", indices}, {"material", 0}}}}}};
  json["buffers"] = {{{"byteLength", glb.binary.size()}}};
  json.update(glb.json());
  std::string text = json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
  text.resize((text.size() + 3) / 4 * 4, ' ');  // every part is a multiple of four bytes

  const std::size_t length = 12 + 8 + text.size() + 8 + glb.binary.size();
  if (length > std::numeric_limits<std::uint32_t>::max())
    throw IoError(where + "more than 4 GB, expected a mesh of fewer faces");
  std::string head, chunk;
  append(head, kMagic), append(head, kVersion), append(head, static_cast<std::uint32_t>(length));
  append(head, static_cast<std::uint32_t>(text.size())), append(head, kJsonChunk);
  append(chunk, static_cast<std::uint32_t>(glb.binary.size())), append(chunk, kBinaryChunk);
  const std::array<std::string_view, 4> pieces{head, text, chunk, glb.binary};
  atomic_write(path, pieces);
}

}  // namespace satsurf::mesh
