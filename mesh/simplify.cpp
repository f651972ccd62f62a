// SPDX-License-Identifier: Apache-2.0
#include "satsurf/mesh/simplify.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/error.h"
#include "satsurf/mesh/geometry.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <unordered_map>
#include <vector>

namespace satsurf::mesh {
namespace {

using Triple = std::array<float, 3>;

constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();

/// Which cube each vertex is in, cubes numbered in the order they are met.
std::vector<std::uint32_t> cubes_of(const Mesh& mesh, const Triple& low, double side,
                                    std::uint32_t& count) {
  std::unordered_map<std::uint64_t, std::uint32_t> known;
  std::vector<std::uint32_t> out;
  out.reserve(mesh.vertices.size());
  for (const Triple& v : mesh.vertices) {
    std::uint64_t key = 0;  // 21 bits for each axis
    for (std::size_t c = 0; c < 3; ++c)
      key = key << 21 | (static_cast<std::uint64_t>(
                             (static_cast<double>(v[c]) - static_cast<double>(low[c])) / side) &
                         0x1fffff);
    out.push_back(known.try_emplace(key, static_cast<std::uint32_t>(known.size())).first->second);
  }
  count = static_cast<std::uint32_t>(known.size());
  return out;
}

/// The faces whose corners are in three cubes, by the numbers of these; of those that have become
/// equal, one.
std::vector<std::array<std::uint32_t, 3>> faces_between(const Mesh& mesh,
                                                        const std::vector<std::uint32_t>& cubes) {
  std::vector<std::array<std::uint32_t, 3>> out;
  for (const auto& face : mesh.faces) {
    std::array<std::uint32_t, 3> f{cubes[face[0]], cubes[face[1]], cubes[face[2]]};
    if (f[0] == f[1] || f[1] == f[2] || f[2] == f[0]) continue;
    std::ranges::rotate(f, std::ranges::min_element(f));  // the same way round
    out.push_back(f);
  }
  std::ranges::sort(out);
  const auto repeated = std::ranges::unique(out);
  out.erase(repeated.begin(), repeated.end());
  return out;
}

void normalise(Triple& v) {
  const float length = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
  if (length > 0)
    for (float& x : v) x /= length;
  else
    v = {0, 0, 1};
}

/// Means of what the vertices of a cube have.
std::vector<Triple> means(const std::vector<Triple>& values,
                          const std::vector<std::uint32_t>& cubes, std::uint32_t count) {
  std::vector<std::array<double, 4>> sums(values.empty() ? 0 : count);
  for (std::size_t i = 0; i < values.size(); ++i) {
    std::array<double, 4>& sum = sums[cubes[i]];
    for (std::size_t c = 0; c < 3; ++c) sum[c] += static_cast<double>(values[i][c]);
    sum[3] += 1;
  }
  std::vector<Triple> out;
  for (const auto& s : sums)
    out.push_back({static_cast<float>(s[0] / s[3]), static_cast<float>(s[1] / s[3]),
                   static_cast<float>(s[2] / s[3])});
  return out;
}

}  // namespace

Mesh simplified(const Mesh& mesh, Index most) {
  if (most < 1) throw Error("simplified: most is " + std::to_string(most) + ", expected 1 or more");
  if (static_cast<Index>(mesh.faces.size()) <= most) return mesh;
  Triple low = mesh.vertices.front(), high = low;
  for (const Triple& v : mesh.vertices)
    for (std::size_t c = 0; c < 3; ++c)
      low[c] = std::min(low[c], v[c]), high[c] = std::max(high[c], v[c]);
  double extent = 0;
  for (std::size_t c = 0; c < 3; ++c)
    extent = std::max(extent, static_cast<double>(high[c]) - static_cast<double>(low[c]));
  // with one cube nothing is left, so a side that is coarse enough lies between; vertices that all
  // lie in one place are in one cube of any side
  double coarse = extent > 0 ? 1.001 * extent : 1, fine = extent > 0 ? extent / 0x1ffffe : coarse;
  std::uint32_t count = 0;
  const auto allowed = [&](double side) {
    return static_cast<Index>(faces_between(mesh, cubes_of(mesh, low, side, count)).size()) <= most;
  };
  while (coarse > 1.02 * fine) {
    const double side = std::sqrt(coarse * fine);
    (allowed(side) ? coarse : fine) = side;
  }
  const std::vector<std::uint32_t> cubes = cubes_of(mesh, low, coarse, count);
  Mesh out;
  out.vertices = means(mesh.vertices, cubes, count);
  out.colours = means(mesh.colours, cubes, count);
  out.normals = means(mesh.normals, cubes, count);
  for (Triple& n : out.normals) normalise(n);
  out.faces = faces_between(mesh, cubes);
  return out;
}

Mesh mesh_from_heights(const Tensor& z, double x0, double y0, double step, const Tensor& colour) {
  Dims dim("mesh_from_heights");
  dim.match("z", z, "H W");
  if (!colour.empty()) dim.match("colour", colour, "3 H W");
  const Index H = dim["H"], W = dim["W"], P = H * W;
  Mesh out;
  std::vector<std::uint32_t> number(static_cast<std::size_t>(P), kNone);
  const auto known = static_cast<std::size_t>(
      std::ranges::count_if(z.values(), [](float v) { return std::isfinite(v); }));
  out.vertices.reserve(known), out.faces.reserve(2 * known);  // at most; growing would copy
  if (!colour.empty()) out.colours.reserve(known);
  const auto vertex = [&](Index at) {
    std::uint32_t& n = number[static_cast<std::size_t>(at)];
    if (n != kNone) return n;
    n = static_cast<std::uint32_t>(out.vertices.size());
    out.vertices.push_back({static_cast<float>(x0 + (static_cast<double>(at % W) + 0.5) * step),
                            static_cast<float>(y0 - (static_cast<double>(at / W) + 0.5) * step),
                            z[at]});
    if (!colour.empty()) {
      Triple c{colour[at], colour[P + at], colour[2 * P + at]};
      for (float& v : c) v = std::isfinite(v) ? std::clamp(v, 0.F, 1.F) : 0.5F;
      out.colours.push_back(c);
    }
    return n;
  };
  const auto add = [&](Index a, Index b, Index c) {
    if (!std::isfinite(z[a]) || !std::isfinite(z[b]) || !std::isfinite(z[c])) return;
    const std::uint32_t first = vertex(a), second = vertex(b), third = vertex(c);
    out.faces.push_back({first, second, third});
  };
  for (Index i = 0; i + 1 < H; ++i)
    for (Index j = 0; j + 1 < W; ++j) {
      const Index a = i * W + j, b = a + 1, c = a + W, d = c + 1;
      add(a, c, b);  // counter-clockwise from above
      add(b, c, d);
    }
  if (out.faces.empty())
    throw Error("mesh_from_heights: no three neighbouring cells have heights, expected a surface");
  find_normals(out);
  return out;
}

}  // namespace satsurf::mesh
