// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/mesh/tsdf.h"

#include <array>
#include <span>
#include <vector>

namespace satsurf::mesh {

/// A view made ready to be asked for signed distances. Keeps a reference to the view.
class SampledView {
 public:
  /// throws  ShapeError
  SampledView(const HeightImage& view, const FusionOptions& options);

  Index height() const { return H_; }
  Index width() const { return W_; }
  /// Local z of a pixel, m, NaN where there is none.
  float z(Index pixel) const { return samples_[static_cast<std::size_t>(pixel)].z; }
  /// Local x and y of what a pixel shows, m; NaN alike.
  std::array<float, 2> ground(Index pixel) const {
    return ground_[static_cast<std::size_t>(pixel)];
  }
  /// Forgets what only `ground` needs.
  void drop_ground() { ground_ = {}; }
  /// Length of the ground displacement per metre of height, largest over the view, m.
  double reach() const { return reach_; }
  /// Ground that the pixels with a height cover, about, m^2.
  double area() const { return area_; }
  /// Metres along the ray per metre of height, near a point.
  double slant(double x, double y, double z) const;

  struct Answer {
    double distance = 0, weight = 0;  ///< signed distance in m; weight, 0 where nothing is known
  };
  /// What the view says of a point z above the pixel (x, y) that sees it.
  Answer ask(double x, double y, double z, double slant) const;

 private:
  struct Sample {
    float z, weight;
  };
  /// Bilinear where the neighbours hang together, else the nearest pixel's.
  double height_at(double x, double y, Index nearest) const;
  void weigh(const Tensor& confidence);

  const Quadratic& projection_;
  const Quadratic& localisation_;
  Index H_ = 0, W_ = 0;
  double voxel_, limit_, reach_ = 0, area_ = 0;
  std::vector<Sample> samples_;
  std::vector<std::array<float, 2>> ground_;
};

/// throws  ConfigError for options out of their range, ShapeError
std::vector<SampledView> sampled_views(std::span<const HeightImage> views,
                                       const FusionOptions& options);

/// `fuse` and `colour_vertices` of views that are ready.
/// sampled  lose their `ground`
Tsdf fuse(std::vector<SampledView>& sampled, std::span<const HeightImage> views,
          const FusionOptions& options);
void colour_vertices(Mesh& mesh, const std::vector<SampledView>& sampled,
                     std::span<const HeightImage> views, const FusionOptions& options);

}  // namespace satsurf::mesh
