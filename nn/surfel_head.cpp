// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/surfel_head.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/rpc/fit.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

namespace satsurf::nn {
namespace {

constexpr double kScaleLow = 0.1, kScaleSpan = 2.9;  // standard deviation in pixels: 0.1 to 3
constexpr double kScaleBias = -1.57;  // sigmoid -> 0.17: 0.6 pixels, neighbours just overlap
/// 0.73 behind the sigmoid: front surfels dominate, those behind still get gradients.
constexpr double kOpacityBias = 1.0;
// Several views cover a place, so that each of them need not be opaque: all are seen, not the first.
constexpr double kDiscOpacity = -0.75;
constexpr Index kPacked = 13;  // means 3, quats 4, scales 2, opacity 1, colours 3

double sigmoid_of(double x) {
  return x >= 0 ? 1 / (1 + std::exp(-x)) : std::exp(x) / (1 + std::exp(x));
}

/// Hamilton product as a 4 x 4 matrix acting on the right factor: (q (x) r)_k = sum_l m[k][l] r_l.
std::array<std::array<double, 4>, 4> left_product(const std::array<double, 4>& q) {
  const auto [w, x, y, z] = q;
  return {{{w, -x, -y, -z}, {x, w, -z, y}, {y, z, w, -x}, {z, -y, x, w}}};
}

/// Slope of the heights along one axis: half the difference of the neighbours, of the pixel itself
/// in place of one that is missing.
double slope_of(double before, double after, bool first, bool last) {
  return (after - before) / (first || last ? 1 : 2);
}

/// The frame of a pixel's tangents dmu/dx and dmu/dy, made orthogonal from the first on; the camera's
/// where they are parallel.
template <class T>
std::array<double, 4> surface_quat(const PixelGeometry& g, const T* height, Index H, Index W,
                                   Index y, Index x) {
  const auto z = [&](Index row, Index column) {
    return static_cast<double>(
        height[std::clamp<Index>(row, 0, H - 1) * W + std::clamp<Index>(column, 0, W - 1)]);
  };
  const double zx = slope_of(z(y, x - 1), z(y, x + 1), x == 0, x == W - 1);
  const double zy = slope_of(z(y - 1, x), z(y + 1, x), y == 0, y == H - 1);
  const auto j =
      g.local_from_pixel.jacobian(static_cast<double>(x), static_cast<double>(y), z(y, x));
  const Eigen::Vector3d u(j[0][0] + j[0][2] * zx, j[1][0] + j[1][2] * zx, zx);
  const Eigen::Vector3d v(j[0][1] + j[0][2] * zy, j[1][1] + j[1][2] * zy, zy);
  const Eigen::Vector3d normal = u.cross(v);
  if (!(normal.norm() > 1e-9 * u.norm() * v.norm())) return g.quat;
  Eigen::Matrix3d frame;
  frame.col(0) = u.normalized();
  frame.col(2) = normal.normalized();
  frame.col(1) = frame.col(2).cross(frame.col(0));
  const Eigen::Quaterniond q(frame);
  return {q.w(), q.x(), q.y(), q.z()};
}

}  // namespace

PixelGeometry pixel_geometry(const PosedImage& view, double z, Index stride) {
  const double s = static_cast<double>(stride);
  const auto centre = view.local_from_pixel((static_cast<double>(view.rgb.dim(2)) - 1) / 2,
                                            (static_cast<double>(view.rgb.dim(1)) - 1) / 2, z);
  const auto camera = rpc::view_geometry(view.pixel_from_local.jacobian(centre[0], centre[1], z));
  return {rescale_pixels(view.local_from_pixel, s, 1), camera.quat, camera.footprint * s};
}

template <class T>
SurfelHead<T>::SurfelHead(ParameterSet<T>& p, const std::string& name, Index channels, Index width)
    : first_(p, name + ".first", channels, width, 3, 1, Activation::gelu),
      residual1_(p, name + ".residual1", width, width, 3, 1, Activation::gelu),
      residual2_(p, name + ".residual2", width, width, 3, 1, Activation::gelu),
      weight_(p.create(name + ".out.weight", {kOutputs, width, 1, 1}, Init::constant(0), true)),
      bias_(p.create(name + ".out.bias", {kOutputs}, Init::constant(0), false)) {
  auto& b = bias_.mutable_value();
  b[0] = b[1] = static_cast<T>(kScaleBias);
  b[6] = static_cast<T>(kOpacityBias);
}

template <class T>
BasicVar<T> SurfelHead<T>::operator()(const BasicVar<T>& x) const {
  Normalised<T> h = first_(x);
  h = add(h, residual1_(h));
  h = add(h, residual2_(h));
  return conv2d(h, weight_, bias_);
}

template <class T>
splat::BasicSurfels<T> surfels_from_maps(const SurfelMaps<T>& maps,
                                         const std::vector<PixelGeometry>& geometry,
                                         Rotation rotation) {
  const auto& [raw, height, image, confidence] = maps;
  Dims dim("surfels_from_maps");
  dim.match("raw", raw, "N 10 H W")
      .match("height", height, "N H W")
      .match("image", image, "N 3 H W");
  dim.match("confidence", confidence, "N H W");
  const Index N = dim["N"], H = dim["H"], W = dim["W"], P = H * W;
  if (static_cast<Index>(geometry.size()) != N)
    throw ShapeError("surfels_from_maps: " + std::to_string(geometry.size()) +
                     " cameras, expected " + std::to_string(N));

  auto out = BasicTensor<T>::uninitialised({N * P, kPacked});
  for_each_index(N * H, [&](Index row) {
    const Index n = row / H, y = row % H;
    const PixelGeometry& g = geometry[static_cast<std::size_t>(n)];
    const auto product = left_product(g.quat);
    for (Index x = 0; x < W; ++x) {
      const Index i = y * W + x;
      // channel k at r[k * P]
      const T* r = raw.value().data() + n * SurfelHead<T>::kOutputs * P + i;
      T* o = out.data() + (n * P + i) * kPacked;
      const double z = static_cast<double>(height.value()[n * P + i]);
      const auto ground = g.local_from_pixel(static_cast<double>(x), static_cast<double>(y), z);
      o[0] = static_cast<T>(ground[0]);
      o[1] = static_cast<T>(ground[1]);
      o[2] = static_cast<T>(z);
      const double residual[4] = {1 + static_cast<double>(r[2 * P]), static_cast<double>(r[3 * P]),
                                  static_cast<double>(r[4 * P]), static_cast<double>(r[5 * P])};
      const auto along = rotation == Rotation::gradient
                             ? surface_quat(g, height.value().data() + n * P, H, W, y, x)
                             : g.quat;
      for (std::size_t k = 0; k < 4; ++k) {
        double q = along[k];
        if (rotation == Rotation::residual) {
          q = 0;
          for (std::size_t l = 0; l < 4; ++l) q += product[k][l] * residual[l];
        }
        o[3 + k] = static_cast<T>(q);
      }
      for (Index k = 0; k < 2; ++k)
        o[7 + k] = static_cast<T>(
            g.footprint * (kScaleLow + kScaleSpan * sigmoid_of(static_cast<double>(r[k * P]))));
      o[9] = static_cast<T>(sigmoid_of(static_cast<double>(r[6 * P])));
      for (Index k = 0; k < 3; ++k) o[10 + k] = image[(n * 3 + k) * P + i] + r[(7 + k) * P];
    }
  });

  const auto packed =
      BasicVar<T>::record("surfels_from_maps", out, {raw, height}, [=](Node<T>& node) {
        T* d_raw = node.grad_in(0);
        T* d_height = node.grad_in(1);
        const T* z_map = node.in(1);
        const T* grad = node.grad.data();
        for_each_index(N * H, [&](Index row) {
          const Index n = row / H, y = row % H;
          const PixelGeometry& g = geometry[static_cast<std::size_t>(n)];
          const auto product = left_product(g.quat);
          for (Index x = 0; x < W; ++x) {
            const Index i = y * W + x;
            const T* u = grad + (n * P + i) * kPacked;
            const T* o = out.data() + (n * P + i) * kPacked;
            if (d_height != nullptr) {
              const auto j =
                  g.local_from_pixel.jacobian(static_cast<double>(x), static_cast<double>(y),
                                              static_cast<double>(z_map[n * P + i]));
              d_height[n * P + i] +=
                  static_cast<T>(j[0][2]) * u[0] + static_cast<T>(j[1][2]) * u[1] + u[2];
            }
            if (d_raw == nullptr) continue;
            T* d = d_raw + n * SurfelHead<T>::kOutputs * P + i;
            for (Index k = 0; k < 2; ++k) {  // s = f (a + b sigma)  ->  ds = f b sigma (1 - sigma)
              const double sigma =
                  (static_cast<double>(o[7 + k]) / g.footprint - kScaleLow) / kScaleSpan;
              d[k * P] += static_cast<T>(g.footprint * kScaleSpan * sigma * (1 - sigma)) * u[7 + k];
            }
            if (rotation == Rotation::residual)
              for (std::size_t l = 0; l < 4; ++l) {
                T sum = 0;
                for (std::size_t k = 0; k < 4; ++k) sum += static_cast<T>(product[k][l]) * u[3 + k];
                d[(2 + static_cast<Index>(l)) * P] += sum;
              }
            d[6 * P] += o[9] * (1 - o[9]) * u[9];
            for (Index k = 0; k < 3; ++k) d[(7 + k) * P] += u[10 + k];
          }
        });
      });

  splat::BasicSurfels<T> s;
  s.means = slice(packed, 1, 0, 3);
  s.quats = slice(packed, 1, 3, 7);
  s.scales = slice(packed, 1, 7, 9);
  s.opacity = reshape(slice(packed, 1, 9, 10), Shape{N * P});
  s.colours = slice(packed, 1, 10, 13);
  s.aux = reshape(confidence, Shape{N * P, 1});
  return s;
}

template <class T>
splat::BasicSurfels<T> discs_from_maps(const BasicVar<T>& height, const BasicTensor<T>& image,
                                       const BasicVar<T>& confidence,
                                       const std::vector<PixelGeometry>& geometry) {
  const Index N = height.value().dim(0), H = height.value().dim(1), W = height.value().dim(2);
  BasicTensor<T> raw({N, SurfelHead<T>::kOutputs, H, W});
  for (Index n = 0; n < N; ++n) {
    T* r = raw.data() + n * SurfelHead<T>::kOutputs * H * W;
    std::fill_n(r, 2 * H * W, static_cast<T>(kScaleBias));
    std::fill_n(r + 6 * H * W, H * W, static_cast<T>(kDiscOpacity));
  }
  return surfels_from_maps<T>({BasicVar<T>(std::move(raw)), height, image, confidence}, geometry,
                              Rotation::camera);
}

template class SurfelHead<float>;
template class SurfelHead<double>;
template splat::BasicSurfels<float> surfels_from_maps(const SurfelMaps<float>&,
                                                      const std::vector<PixelGeometry>&, Rotation);
template splat::BasicSurfels<double> surfels_from_maps(const SurfelMaps<double>&,
                                                       const std::vector<PixelGeometry>&, Rotation);

template splat::BasicSurfels<float> discs_from_maps(const BasicVar<float>&,
                                                    const BasicTensor<float>&,
                                                    const BasicVar<float>&,
                                                    const std::vector<PixelGeometry>&);
template splat::BasicSurfels<double> discs_from_maps(const BasicVar<double>&,
                                                     const BasicTensor<double>&,
                                                     const BasicVar<double>&,
                                                     const std::vector<PixelGeometry>&);

}  // namespace satsurf::nn
