// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/window_correlation.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/error.h"
#include "satsurf/ops/window_correlation_kernels.h"

#include <algorithm>
#include <array>
#include <string>

namespace satsurf {
namespace {

/// The row of `a` at y in the box, and where it lies in `b` at one height.
WarpedRow<float> warped_row(const MaskedGrey& a, const MaskedGrey& b, const Quadratic& map,
                            const PixelBox& box, Index y, double z) {
  const Index from = y * a.width() + box.x0;
  WarpedRow<float> row{.n = box.width(),
                       .a = a.grey.data() + from,
                       .a_valid = a.valid.data() + from,
                       .H = b.height(),
                       .W = b.width(),
                       .b = b.grey.data(),
                       .b_valid = b.valid.data(),
                       .t0 = (static_cast<double>(box.x0) - map.offset[0]) / map.scale[0],
                       .step = 1 / map.scale[0],
                       .u = {},
                       .v = {}};
  const double p = (static_cast<double>(y) - map.offset[1]) / map.scale[1],
               q = (z - map.offset[2]) / map.scale[2];
  const auto along = [&](const std::array<double, 10>& c, double* terms) {
    terms[0] = c[0] + c[2] * p + c[3] * q + c[7] * p * p + c[8] * p * q + c[9] * q * q;
    terms[1] = c[1] + c[5] * p + c[6] * q;
    terms[2] = c[4];
  };
  along(map.coeff[0], row.u);
  along(map.coeff[1], row.v);
  return row;
}

}  // namespace

Tensor window_correlation(const MaskedGrey& a, const MaskedGrey& b, const Quadratic& b_from_a,
                          const PixelBox& box, double z) {
  Dims("window_correlation")
      .match("a", a.grey, "H W")
      .match("valid of a", a.valid, "H W")
      .match("b", b.grey, "h w")
      .match("valid of b", b.valid, "h w");
  if (box.x0 < 0 || box.y0 < 0 || box.x1 < box.x0 || box.y1 < box.y0 || box.x1 > a.width() ||
      box.y1 > a.height())
    throw ShapeError("window_correlation: the box is columns " + std::to_string(box.x0) + " to " +
                     std::to_string(box.x1) + " and rows " + std::to_string(box.y0) + " to " +
                     std::to_string(box.y1) + ", expected a part of a " + a.grey.shape().str());
  constexpr Index r = ComparedWindow::kRadius, kSide = kWindowSide;
  const auto& kernels = active_kernels<WindowCorrelationKernels<float>>();
  const Index H = box.height(), W = box.width();
  auto out = Tensor::uninitialised({H, W});
  // The rows of a window at a time, row y in place y modulo their number; they fit into a cache.
  auto rows = Tensor::uninitialised({kSide, kWindowSums, W}),
       sums = Tensor::uninitialised({kWindowSums, W});
  const Tensor none({kWindowSums, W});
  Tensor columns({W + 2 * r});
  std::array<Index, kSide> counts{};
  const auto make = [&](Index y) {
    const auto k = static_cast<std::size_t>(y % kSide);
    counts[k] = y < H ? kernels.products(warped_row(a, b, b_from_a, box, box.y0 + y, z),
                                         rows.data() + y % kSide * kWindowSums * W)
                      : 0;
  };
  for (Index y = 0; y < r; ++y) make(y);
  for (Index y = 0; y < H; ++y) {
    make(y + r);
    std::array<const float*, kSide> around{};
    Index seen = 0;
    for (Index k = 0; k < kSide; ++k) {
      const Index at = y + k - r;
      const bool in = at >= 0 && at < H;
      around[static_cast<std::size_t>(k)] =
          in ? rows.data() + at % kSide * kWindowSums * W : none.data();
      seen += in ? counts[static_cast<std::size_t>(at % kSide)] : 0;
    }
    float* to = out.data() + y * W;
    if (static_cast<float>(seen) < ComparedWindow::kWhole)
      std::fill(to, to + W, -1.f);
    else
      kernels.correlate(around.data(), W, columns.data(), sums.data(), to);
  }
  return out;
}

void window_products(const float* weights, Index side, const float* image, Index stride,
                     Index count, float* out) {
  active_kernels<WindowCorrelationKernels<float>>().window_products(weights, side, image, stride,
                                                                    count, out);
}

}  // namespace satsurf
