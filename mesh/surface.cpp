// SPDX-License-Identifier: Apache-2.0
#include "satsurf/mesh/surface.h"

#include "satsurf/core/error.h"
#include "satsurf/core/parallel.h"
#include "satsurf/mesh/geometry.h"
#include "satsurf/mesh/sampled_view.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numeric>
#include <string>
#include <vector>

#include <openvdb/Grid.h>
#include <openvdb/tools/VolumeToMesh.h>

// The only file that knows OpenVDB: its headers take the better part of a minute to compile.

namespace satsurf::mesh {
namespace {

using Leaf = openvdb::FloatTree::LeafNodeType;
using Triangle = std::array<std::uint32_t, 3>;

constexpr Index kTile = Tsdf::kTile;
static_assert(kTile == Index{Leaf::DIM});

/// The values of a tile with one voxel more on every side.
class Padded {
 public:
  Padded(const Tsdf& field, Index tile)
      : bottom_(field.tiles[static_cast<std::size_t>(tile)].bottom),
        layers_(field.tiles[static_cast<std::size_t>(tile)].layers),
        values_(static_cast<std::size_t>(kSide * kSide * (layers_ + 2))) {
    const Index i0 = tile % field.columns * kTile, j0 = tile / field.columns * kTile;
    for (Index l = -1; l <= layers_; ++l)
      for (Index j = -1; j <= kTile; ++j)
        for (Index i = -1; i <= kTile; ++i)
          values_[index(i, j, l)] = field.at(i0 + i, j0 + j, bottom_ + l);
  }

  float at(Index i, Index j, Index l) const { return values_[index(i, j, l)]; }
  /// Whether surface passes next to the voxel, through cells of which every corner is known.
  bool active(Index i, Index j, Index l) const {
    const bool inside = at(i, j, l) < 0;
    const bool crossed = (at(i - 1, j, l) < 0) != inside || (at(i + 1, j, l) < 0) != inside ||
                         (at(i, j - 1, l) < 0) != inside || (at(i, j + 1, l) < 0) != inside ||
                         (at(i, j, l - 1) < 0) != inside || (at(i, j, l + 1) < 0) != inside;
    if (!crossed) return false;
    for (Index c = -1; c <= 1; ++c)
      for (Index b = -1; b <= 1; ++b)
        for (Index a = -1; a <= 1; ++a)
          if (std::isnan(at(i + a, j + b, l + c))) return false;
    return true;
  }

 private:
  static constexpr Index kSide = kTile + 2;
  static std::size_t index(Index i, Index j, Index l) {
    return static_cast<std::size_t>(((l + 1) * kSide + j + 1) * kSide + i + 1);
  }

  Index bottom_, layers_;
  std::vector<float> values_;
};

/// The leaves that hold a tile.
std::vector<std::unique_ptr<Leaf>> leaves_of(const Tsdf& field, Index tile) {
  const auto [bottom, layers, first] = field.tiles[static_cast<std::size_t>(tile)];
  std::vector<std::unique_ptr<Leaf>> out;
  if (layers == 0) return out;
  const Padded values(field, tile);
  const auto outside = static_cast<float>(field.truncation * field.voxel);
  const auto coord = [&](Index i, Index j, Index k) {
    return openvdb::Coord(static_cast<int>(tile % field.columns * kTile + i),
                          static_cast<int>(tile / field.columns * kTile + j), static_cast<int>(k));
  };
  for (Index l = 0; l < layers; ++l) {
    const openvdb::Coord base = coord(0, 0, bottom + l);
    if (out.empty() || out.back()->origin().z() != (base.z() & ~(static_cast<int>(kTile) - 1)))
      out.push_back(std::make_unique<Leaf>(base, outside, false));
    Leaf& leaf = *out.back();
    for (Index j = 0; j < kTile; ++j)
      for (Index i = 0; i < kTile; ++i) {
        const float v = values.at(i, j, l);
        const openvdb::Index n = Leaf::coordToOffset(coord(i, j, bottom + l));
        leaf.setValueOnly(n, std::isnan(v) ? outside : v);
        leaf.setActiveState(n, !std::isnan(v) && values.active(i, j, l));
      }
  }
  return out;
}

openvdb::FloatTree::Ptr tree_of(const Tsdf& field) {
  std::vector<std::vector<std::unique_ptr<Leaf>>> leaves(field.tiles.size());
  for_each_index(static_cast<Index>(field.tiles.size()),
                 [&](Index t) { leaves[static_cast<std::size_t>(t)] = leaves_of(field, t); });
  auto tree =
      std::make_shared<openvdb::FloatTree>(static_cast<float>(field.truncation * field.voxel));
  for (auto& tile : leaves)
    for (auto& leaf : tile) tree->addLeaf(leaf.release());
  return tree;
}

/// Two triangles, cut along the shorter diagonal.
void add_quad(Mesh& mesh, std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t d) {
  const auto distance = [&](std::uint32_t p, std::uint32_t q) {
    return length(wide(mesh.vertices[p]) - wide(mesh.vertices[q]));
  };
  if (distance(a, c) <= distance(b, d)) {
    mesh.faces.push_back({a, b, c});
    mesh.faces.push_back({a, c, d});
  } else {
    mesh.faces.push_back({a, b, d});
    mesh.faces.push_back({b, c, d});
  }
}

/// Leaves out connected pieces below an area, and vertices without a face.
void drop_small_pieces(Mesh& mesh, double least_area) {
  std::vector<std::uint32_t> parent(mesh.vertices.size());
  std::iota(parent.begin(), parent.end(), 0u);
  const auto root = [&](std::uint32_t v) {
    while (parent[v] != v) v = parent[v] = parent[parent[v]];
    return v;
  };
  for (const Triangle& f : mesh.faces)
    for (const std::uint32_t v : {f[1], f[2]}) {
      const std::uint32_t a = root(f[0]), b = root(v);
      parent[std::max(a, b)] = std::min(a, b);
    }
  std::vector<double> area(mesh.vertices.size(), 0.0);
  for (const Triangle& f : mesh.faces)
    area[root(f[0])] += 0.5 * length(doubled_area(corners(mesh, f)));
  const double largest = area.empty() ? 0 : *std::max_element(area.begin(), area.end());
  const double least = std::min(least_area, largest);
  std::erase_if(mesh.faces, [&](const Triangle& f) { return area[root(f[0])] < least; });

  constexpr std::uint32_t kUnused = 0xffffffff;
  std::vector<std::uint32_t> number(mesh.vertices.size(), kUnused);
  for (const Triangle& f : mesh.faces)
    for (const std::uint32_t v : f) number[v] = 0;
  std::uint32_t next = 0;
  for (std::size_t v = 0; v < number.size(); ++v) {
    if (number[v] == kUnused) continue;
    number[v] = next;
    mesh.vertices[next++] = mesh.vertices[v];
  }
  mesh.vertices.resize(next);
  for (Triangle& f : mesh.faces)
    for (std::uint32_t& v : f) v = number[v];
}

/// Vertices and faces, both none where there is no surface.
Mesh zero_level(const Tsdf& field, double least_area) {
  openvdb::tools::VolumeToMesh found(0.0, 0.0);
  // In the arena of our loops, so that the cap on threads holds.
  detail::run_pieces(1, [&](Index) {
    openvdb::FloatGrid grid(tree_of(field));
    found(grid);
  });
  Mesh mesh;
  mesh.vertices.resize(found.pointListSize());
  for (std::size_t v = 0; v < mesh.vertices.size(); ++v) {
    const openvdb::Vec3s& p = found.pointList()[v];
    const double at[3] = {static_cast<double>(p[0]) + static_cast<double>(field.column),
                          static_cast<double>(p[1]) + static_cast<double>(field.row),
                          static_cast<double>(p[2])};
    for (std::size_t a = 0; a < 3; ++a)
      mesh.vertices[v][a] = static_cast<float>(at[a] * field.voxel);
  }
  for (std::size_t n = 0; n < found.polygonPoolListSize(); ++n) {
    const openvdb::tools::PolygonPool& pool = found.polygonPoolList()[n];
    for (std::size_t i = 0; i < pool.numQuads(); ++i) {
      const openvdb::Vec4I& q = pool.quad(i);
      add_quad(mesh, q[0], q[1], q[2], q[3]);
    }
    for (std::size_t i = 0; i < pool.numTriangles(); ++i) {
      const openvdb::Vec3I& t = pool.triangle(i);
      mesh.faces.push_back({t[0], t[1], t[2]});
    }
  }
  drop_small_pieces(mesh, least_area);
  return mesh;
}

/// Smaller pieces are noise that hangs in the air, m^2.
double least_area_of(const FusionOptions& options) {
  constexpr double kLeastSide = 20;  // voxels
  const double side = kLeastSide * options.voxel;
  return side * side;
}

}  // namespace

Mesh extract_surface(const Tsdf& field, double least_area) {
  Mesh mesh = zero_level(field, least_area);
  if (mesh.faces.empty())
    throw Error("extract_surface: no surface in " + std::to_string(field.values.count()) +
                " voxels, expected one; views that see the same ground give one");
  find_normals(mesh);
  return mesh;
}

Mesh mesh_from_views(std::span<const HeightImage> views, const FusionOptions& options) {
  std::vector<SampledView> sampled = sampled_views(views, options);
  Mesh mesh = extract_surface(fuse(sampled, views, options), least_area_of(options));
  colour_vertices(mesh, sampled, views, options);
  return mesh;
}

std::optional<Mesh> shape_from_views(std::span<const HeightImage> views,
                                     const FusionOptions& options) {
  const bool any = std::any_of(views.begin(), views.end(), [](const HeightImage& v) {
    return std::any_of(v.height.values().begin(), v.height.values().end(),
                       [](float z) { return std::isfinite(z); });
  });
  if (!any) return std::nullopt;
  Mesh mesh = zero_level(fuse(views, options), least_area_of(options));
  if (mesh.faces.empty()) return std::nullopt;
  return mesh;
}

}  // namespace satsurf::mesh
