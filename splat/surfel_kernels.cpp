// SPDX-License-Identifier: Apache-2.0
#include "satsurf/splat/surfel_kernels.h"

#include "satsurf/core/simd.h"

namespace satsurf::SATSURF_KERNEL_ISA {
namespace {

using splat::Box;
using splat::SurfelArrays;
using splat::SurfelGradients;

/// N numbers of each of kLanes surfels, one vector per number.
template <class T, Index N>
struct Columns {
  alignas(64) T values[N][kLanes<T>];

  /// Surfels first..first+count-1 of a [P N] array; the lanes behind them are zero.
  Columns(const T* rows, Index first, Index count) {
    for (Index n = 0; n < N; ++n)
      for (Index l = count; l < kLanes<T>; ++l) values[n][l] = T(0);
    for (Index l = 0; l < count; ++l)
      for (Index n = 0; n < N; ++n) values[n][l] = rows[(first + l) * N + n];
  }
  Columns() = default;
  Batch<T> operator[](Index n) const { return Batch<T>::load_aligned(values[n]); }
  void set(Index n, const Batch<T>& x) { x.store_aligned(values[n]); }
};

template <class T>
struct Vector3 {
  Batch<T> x, y, z;
};
template <class T>
inline Batch<T> dot(const Vector3<T>& a, const Vector3<T>& b) {
  return xsimd::fma(a.x, b.x, xsimd::fma(a.y, b.y, a.z * b.z));
}

/// Everything that follows from a surfel and its camera, for kLanes surfels at once.
template <class T>
struct Geometry {
  Batch<T> w, x, y, z, inverse_length;  // unit quaternion
  Vector3<T> tangent_u, tangent_v, normal;
  Vector3<T> row_x, row_y;  // camera: pixels per metre
  Batch<T> scale_u, scale_v;
  Batch<T> j00, j01, j10, j11, det;  // pixels per standard deviation
  Batch<T> k00, k01, k10, k11;       // its inverse
  Batch<T> flip;                     // +-1: turns the normal towards the camera

  Geometry(const Columns<T, 4>& quat, const Columns<T, 2>& scale, const Columns<T, 6>& camera)
      : row_x{camera[0], camera[1], camera[2]},
        row_y{camera[3], camera[4], camera[5]},
        scale_u(scale[0]),
        scale_v(scale[1]) {
    const Batch<T> one(T(1)), two(T(2));
    w = quat[0], x = quat[1], y = quat[2], z = quat[3];
    inverse_length = one / xsimd::sqrt(xsimd::fma(w, w, xsimd::fma(x, x, xsimd::fma(y, y, z * z))));
    w *= inverse_length, x *= inverse_length, y *= inverse_length, z *= inverse_length;
    tangent_u = {one - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y)};
    tangent_v = {two * (x * y - w * z), one - two * (x * x + z * z), two * (y * z + w * x)};
    normal = {two * (x * z + w * y), two * (y * z - w * x), one - two * (x * x + y * y)};
    j00 = dot(row_x, tangent_u) * scale_u;
    j01 = dot(row_x, tangent_v) * scale_v;
    j10 = dot(row_y, tangent_u) * scale_u;
    j11 = dot(row_y, tangent_v) * scale_v;
    det = j00 * j11 - j01 * j10;
    const Batch<T> inverse_det = one / det;
    k00 = j11 * inverse_det;
    k01 = -j01 * inverse_det;
    k10 = -j10 * inverse_det;
    k11 = j00 * inverse_det;
    // The viewing direction is the cross product of the camera's rows, either way; the satellite is
    // above, so the way up leads to it.
    const Vector3<T> sight{row_x.y * row_y.z - row_x.z * row_y.y,
                           row_x.z * row_y.x - row_x.x * row_y.z,
                           row_x.x * row_y.y - row_x.y * row_y.x};
    const Batch<T> zero(T(0)), facing = dot(normal, sight);
    flip = xsimd::select(facing * sight.z > zero, one, -one);
  }
};

/// Zero where x is finite, NaN elsewhere.
template <class T>
inline Batch<T> poison(const Batch<T>& x) {
  return x * Batch<T>(T(0));
}

template <class T>
inline T at_most(T x, T limit) {
  return x < limit ? x : limit;
}

/// Records of the surfels first..first+count-1, count <= kLanes.
template <class T>
void prepare_lanes(const SurfelArrays<T>& in, Index height, Index width, bool smooth, Index first,
                   Index count, T* records, Box* boxes) {
  using B = Batch<T>;
  const Columns<T, 3> mean(in.means, first, count), colour(in.colours, first, count);
  const Columns<T, 4> quat(in.quats, first, count);
  const Columns<T, 2> scale(in.scales, first, count), pixel(in.pixels, first, count);
  const Columns<T, 1> opacity(in.opacity, first, count);
  const Columns<T, 6> camera(in.jacobians, first, count);
  const Geometry<T> g(quat, scale, camera);
  const B zero(T(0)), o = opacity[0], log_opacity = xsimd::log(o);

  Columns<T, splat::kRecord> record;
  record.set(splat::kPixelX, pixel[0]);
  record.set(splat::kPixelY, pixel[1]);
  record.set(splat::kInverse, g.k00);
  record.set(splat::kInverse + 1, g.k01);
  record.set(splat::kInverse + 2, g.k10);
  record.set(splat::kInverse + 3, g.k11);
  record.set(splat::kLogOpacity, log_opacity);
  record.set(splat::kHeight, mean[2]);
  record.set(splat::kSlope, g.scale_u * g.tangent_u.z);
  record.set(splat::kSlope + 1, g.scale_v * g.tangent_v.z);
  for (Index c = 0; c < 3; ++c) record.set(splat::kColour + c, colour[c]);
  record.set(splat::kNormal, g.flip * g.normal.x);
  record.set(splat::kNormal + 1, g.flip * g.normal.y);
  record.set(splat::kNormal + 2, g.flip * g.normal.z);

  B bad = poison(mean[0]) + poison(mean[1]) + poison(o) + poison(g.det);
  for (Index n = 0; n < 6; ++n) bad += poison(camera[n]);
  for (Index n = 0; n < splat::kRecord; ++n) bad += poison(record[n]);
  const T alpha_min = smooth ? T(0) : static_cast<T>(splat::kAlphaMin);
  const auto visible =
      (bad == zero) & (xsimd::abs(g.det) >= B(static_cast<T>(splat::kDetMin))) & (o > B(alpha_min));

  // A surfel counts where o exp(-rho/2) >= 1/255, that is rho <= 2 ln(255 o). That region lies
  // inside the disc's ellipse joined with the filter's circle of radius sqrt(rho/2); the margin
  // covers rounding.
  Columns<T, 5> corner;
  const B right(static_cast<T>(width - 1)), bottom(static_cast<T>(height - 1));
  if (smooth) {
    corner.set(0, zero), corner.set(1, zero), corner.set(2, right), corner.set(3, bottom);
  } else {
    const B rho = B(T(2)) * xsimd::log(B(T(255)) * o), half(T(0.5)), margin(T(0.01));
    const B reach_x = xsimd::sqrt(rho * xsimd::max(g.j00 * g.j00 + g.j01 * g.j01, half)) + margin;
    const B reach_y = xsimd::sqrt(rho * xsimd::max(g.j10 * g.j10 + g.j11 * g.j11, half)) + margin;
    corner.set(0, xsimd::max(xsimd::ceil(pixel[0] - reach_x), zero));
    corner.set(1, xsimd::max(xsimd::ceil(pixel[1] - reach_y), zero));
    corner.set(2, xsimd::min(xsimd::floor(pixel[0] + reach_x), right));
    corner.set(3, xsimd::min(xsimd::floor(pixel[1] + reach_y), bottom));
  }
  const auto inside = (corner[0] <= corner[2]) & (corner[1] <= corner[3]);
  corner.set(4, xsimd::select(visible & inside, B(T(1)), zero));

  for (Index l = 0; l < count; ++l) {
    bool draw = corner.values[4][l] != T(0);
    const T* aux = in.aux + (in.aux == nullptr ? 0 : (first + l) * in.aux_channels);
    for (Index k = 0; k < in.aux_channels; ++k) draw = draw && aux[k] * T(0) == T(0);
    T* row = records + (first + l) * splat::kRecord;
    for (Index n = 0; n < splat::kRecord; ++n) row[n] = record.values[n][l];
    Box& box = boxes[first + l];
    if (draw) {
      box.x0 = static_cast<std::int32_t>(corner.values[0][l]);
      box.y0 = static_cast<std::int32_t>(corner.values[1][l]);
      box.x1 = static_cast<std::int32_t>(corner.values[2][l]);
      box.y1 = static_cast<std::int32_t>(corner.values[3][l]);
    } else {
      box.x0 = box.y0 = 0;
      box.x1 = box.y1 = -1;
    }
  }
}

/// The gradient of the unit quaternion's rotation matrix, G = d/dR with columns u, v, n, taken back
/// to the quaternion as it came.
template <class T>
void quaternion_gradient(const Geometry<T>& g, const Vector3<T>& u, const Vector3<T>& v,
                         const Vector3<T>& n, Columns<T, 4>& out) {
  using B = Batch<T>;
  const B two(T(2));
  const B dw = two * (g.x * (v.z - n.y) + g.y * (n.x - u.z) + g.z * (u.y - v.x));
  const B dx =
      two * (g.y * (v.x + u.y) + g.z * (n.x + u.z) + g.w * (v.z - n.y) - two * g.x * (v.y + n.z));
  const B dy =
      two * (g.x * (v.x + u.y) + g.z * (n.y + v.z) + g.w * (n.x - u.z) - two * g.y * (u.x + n.z));
  const B dz =
      two * (g.x * (n.x + u.z) + g.y * (n.y + v.z) + g.w * (u.y - v.x) - two * g.z * (u.x + v.y));
  const B along = g.w * dw + g.x * dx + g.y * dy + g.z * dz;  // the length has no effect
  out.set(0, (dw - g.w * along) * g.inverse_length);
  out.set(1, (dx - g.x * along) * g.inverse_length);
  out.set(2, (dy - g.y * along) * g.inverse_length);
  out.set(3, (dz - g.z * along) * g.inverse_length);
}

/// Adds lane l of `columns` to row `first + l` for the surfels that were drawn.
template <class T, Index N>
inline void add_rows(const Columns<T, N>& columns, const Index* first_slot, Index first,
                     Index count, T* rows) {
  if (rows == nullptr) return;
  for (Index l = 0; l < count; ++l) {
    if (first_slot[first + l] == first_slot[first + l + 1])
      continue;  // culled: its numbers may be NaN
    for (Index n = 0; n < N; ++n) rows[(first + l) * N + n] += columns.values[n][l];
  }
}

template <class T>
void gather_lanes(const SurfelArrays<T>& in, const Index* first_slot, const T* slots, Index first,
                  Index count, const SurfelGradients<T>& out) {
  using B = Batch<T>;
  const Index stride = splat::kSlot + in.aux_channels;
  Columns<T, splat::kSlot> sum;
  for (Index l = 0; l < kLanes<T>; ++l) {
    T row[splat::kSlot] = {};
    if (l < count)
      for (Index s = first_slot[first + l]; s < first_slot[first + l + 1]; ++s)
        for (Index n = 0; n < splat::kSlot; ++n) row[n] += slots[s * stride + n];
    for (Index n = 0; n < splat::kSlot; ++n) sum.values[n][l] = row[n];
  }
  if (out.aux != nullptr)
    for (Index l = 0; l < count; ++l)
      for (Index s = first_slot[first + l]; s < first_slot[first + l + 1]; ++s)
        for (Index k = 0; k < in.aux_channels; ++k)
          out.aux[(first + l) * in.aux_channels + k] += slots[s * stride + splat::kSlot + k];

  const Columns<T, 4> quat(in.quats, first, count);
  const Columns<T, 2> scale(in.scales, first, count);
  const Columns<T, 1> opacity(in.opacity, first, count);
  const Columns<T, 6> camera(in.jacobians, first, count);
  const Geometry<T> g(quat, scale, camera);
  const B two(T(2));

  Columns<T, 1> opacity_grad;  // alpha d/d(alpha) / o = -2 d/d(rho) / o
  opacity_grad.set(0, -two * sum[splat::kSlotRho] / opacity[0]);
  add_rows(opacity_grad, first_slot, first, count, out.opacity);

  Columns<T, 3> triple;
  for (Index c = 0; c < 3; ++c) triple.set(c, sum[splat::kSlotColour + c]);
  add_rows(triple, first_slot, first, count, out.colours);

  const B px = sum[splat::kSlotPixel], py = sum[splat::kSlotPixel + 1];
  triple.set(0, g.row_x.x * px + g.row_y.x * py);
  triple.set(1, g.row_x.y * px + g.row_y.y * py);
  triple.set(2, g.row_x.z * px + g.row_y.z * py + sum[splat::kSlotHeight]);
  add_rows(triple, first_slot, first, count, out.means);
  if (out.quats == nullptr && out.scales == nullptr) return;

  // M = sum d/d(xi) xi^T, the height's part of d/d(xi) included; dJ = -J^-T M.
  const B hu = g.scale_u * g.tangent_u.z, hv = g.scale_v * g.tangent_v.z;
  const B slope_u = sum[splat::kSlotSlope], slope_v = sum[splat::kSlotSlope + 1];
  const B uu = two * sum[splat::kSlotMoment] + hu * slope_u;
  const B uv = two * sum[splat::kSlotMoment + 1] + hu * slope_v;
  const B vu = two * sum[splat::kSlotMoment + 1] + hv * slope_u;
  const B vv = two * sum[splat::kSlotMoment + 2] + hv * slope_v;
  const B j00 = -(g.k00 * uu + g.k10 * vu), j01 = -(g.k00 * uv + g.k10 * vv);
  const B j10 = -(g.k01 * uu + g.k11 * vu), j11 = -(g.k01 * uv + g.k11 * vv);
  const Vector3<T> du{g.row_x.x * j00 + g.row_y.x * j10, g.row_x.y * j00 + g.row_y.y * j10,
                      g.row_x.z * j00 + g.row_y.z * j10 + slope_u};
  const Vector3<T> dv{g.row_x.x * j01 + g.row_y.x * j11, g.row_x.y * j01 + g.row_y.y * j11,
                      g.row_x.z * j01 + g.row_y.z * j11 + slope_v};
  Columns<T, 2> scale_grad;
  scale_grad.set(0, dot(g.tangent_u, du));
  scale_grad.set(1, dot(g.tangent_v, dv));
  add_rows(scale_grad, first_slot, first, count, out.scales);

  Columns<T, 4> quat_grad;
  quaternion_gradient<T>(g, {g.scale_u * du.x, g.scale_u * du.y, g.scale_u * du.z},
                         {g.scale_v * dv.x, g.scale_v * dv.y, g.scale_v * dv.z},
                         {g.flip * sum[splat::kSlotNormal], g.flip * sum[splat::kSlotNormal + 1],
                          g.flip * sum[splat::kSlotNormal + 2]},
                         quat_grad);
  add_rows(quat_grad, first_slot, first, count, out.quats);
}

template <class T>
void prepare(const SurfelArrays<T>& in, Index height, Index width, bool smooth, Index begin,
             Index end, T* records, Box* boxes) {
  for (Index p = begin; p < end; p += kLanes<T>)
    prepare_lanes(in, height, width, smooth, p, at_most(end - p, kLanes<T>), records, boxes);
}

template <class T>
void gather(const SurfelArrays<T>& in, const Index* first_slot, const T* slots, Index begin,
            Index end, const SurfelGradients<T>& out) {
  for (Index p = begin; p < end; p += kLanes<T>)
    gather_lanes(in, first_slot, slots, p, at_most(end - p, kLanes<T>), out);
}

}  // namespace
}  // namespace satsurf::SATSURF_KERNEL_ISA

namespace satsurf::splat {

template <class T>
template <Isa isa>
SurfelKernels<T> SurfelKernels<T>::compiled_for() {
  return {.prepare = here::prepare<T>, .gather = here::gather<T>};
}
template SurfelKernels<float> SurfelKernels<float>::compiled_for<kIsa>();
template SurfelKernels<double> SurfelKernels<double>::compiled_for<kIsa>();

}  // namespace satsurf::splat
