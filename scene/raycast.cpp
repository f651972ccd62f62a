// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/raycast.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/whole.h"
#include "satsurf/scene/ray_walk.h"

namespace satsurf::scene {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Parameter steps of a straight track over unit cells along one axis.
struct Axis {
  double start, delta;  // position = start + s delta, s in [0, 1]
  Index sign;
  double per_cell;  // parameter needed to cross one cell

  Axis(double from, double to)
      : start(from),
        delta(to - from),
        sign(delta > 0   ? 1
             : delta < 0 ? -1
                         : 0),
        per_cell(sign == 0 ? kInfinity : 1.0 / std::abs(delta)) {}
  double at(double s) const { return start + s * delta; }
  // Parameter at which the track leaves cells [first, first + count).
  double exit(Index first, Index count) const {
    if (sign == 0) return kInfinity;
    const double edge = static_cast<double>(sign > 0 ? first + count : first);
    return (edge - start) / delta;
  }
  // Parameters between which the track is over [0, extent).
  void clip(double extent, double& enter, double& leave) const {
    if (sign == 0) {
      if (start < 0 || start >= extent) enter = kInfinity;
      return;
    }
    const double a = -start / delta, b = (extent - start) / delta;
    enter = std::max(enter, std::min(a, b));
    leave = std::min(leave, std::max(a, b));
  }
};

Index cell_of(double position, Index first, Index count) {
  return std::clamp(floored(position), first, first + count - 1);
}

}  // namespace

ColumnField::ColumnField(const HeightField& field)
    : z_(field.z.data()), x0_(field.x0), y0_(field.y0), inverse_step_(1.0 / field.step) {
  Dims dim("ColumnField");
  dim.match("field.z", field.z, "H W");
  rows_ = dim["H"];
  cols_ = dim["W"];
  const auto blocks_of = [](Index count, Index side) { return (count + side - 1) / side; };
  const Index block_rows = blocks_of(rows_, kBlock), block_cols = blocks_of(cols_, kBlock);
  blocks_ = {block_cols, std::vector<float>(static_cast<std::size_t>(block_rows * block_cols))};
  std::vector<float> lows(blocks_.high.size()), highs(blocks_.high.size());
  for_range(block_rows, 8, [&](Index begin, Index end) {
    for (Index br = begin; br < end; ++br) {
      for (Index bc = 0; bc < block_cols; ++bc) {
        float low = std::numeric_limits<float>::infinity(), high = -low;
        bool unknown = false;
        for (Index r = br * kBlock; r < std::min(rows_, (br + 1) * kBlock); ++r) {
          for (Index c = bc * kBlock; c < std::min(cols_, (bc + 1) * kBlock); ++c) {
            const float z = z_[r * cols_ + c];
            unknown = unknown || std::isnan(z);
            low = z < low ? z : low;
            high = z > high ? z : high;
          }
        }
        const auto i = static_cast<std::size_t>(br * block_cols + bc);
        lows[i] = low;
        highs[i] = high;
        blocks_.high[i] = unknown ? std::numeric_limits<float>::infinity() : high;
      }
    }
  });
  const Index group_rows = blocks_of(block_rows, kGroup),
              group_cols = blocks_of(block_cols, kGroup);
  groups_ = {group_cols, std::vector<float>(static_cast<std::size_t>(group_rows * group_cols),
                                            -std::numeric_limits<float>::infinity())};
  for (Index br = 0; br < block_rows; ++br)
    for (Index bc = 0; bc < block_cols; ++bc) {
      float& high = groups_.high[static_cast<std::size_t>(br / kGroup * group_cols + bc / kGroup)];
      high = std::max(high, blocks_.at(br, bc));
    }
  for (const float z : lows) low_ = std::min(low_, static_cast<double>(z));
  for (const float z : highs) high_ = std::max(high_, static_cast<double>(z));
}

ColumnField::Hit ColumnField::walk(double x_high, double y_high, double x_low, double y_low) const {
  const Axis u((x_high - x0_) * inverse_step_, (x_low - x0_) * inverse_step_);
  const Axis v((y0_ - y_high) * inverse_step_, (y0_ - y_low) * inverse_step_);
  const double drop = high_ - low_;
  double s = 0, last = 1;
  u.clip(static_cast<double>(cols_), s, last);
  v.clip(static_cast<double>(rows_), s, last);
  if (!(s <= last)) return {};

  const bool entered = s > 0;  // through the cut face at the edge of the grid
  Index c = cell_of(u.at(s), 0, cols_), r = cell_of(v.at(s), 0, rows_);
  Index front_c = -1, front_r = -1;
  if (entered && high_ - s * drop <= static_cast<double>(z_[r * cols_ + c])) return {};
  // Steps over the square of columns around, of so many a side, if the ray leaves it above `top`.
  const auto passes_over = [&](Index side, double top) {
    const Index first_c = c / side * side, first_r = r / side * side;
    const double s_u = u.exit(first_c, side), s_v = v.exit(first_r, side);
    const double s_out = std::min({s_u, s_v, 1.0});
    // Never skip the end: rounding could put it above a block that is all at the lowest height.
    if (!(s_out < 1.0 && high_ - s_out * drop > top)) return false;
    s = s_out;
    // the crossed axis is stepped exactly, the other one is read off
    const bool by_u = s_u <= s_v;
    front_c = cell_of(u.at(s), first_c, side);
    front_r = cell_of(v.at(s), first_r, side);
    c = by_u ? (u.sign > 0 ? first_c + side : first_c - 1) : front_c;
    r = by_u ? front_r : (v.sign > 0 ? first_r + side : first_r - 1);
    if (by_u) front_c = c - u.sign;
    if (!by_u) front_r = r - v.sign;
    return true;
  };
  Index group = -1;  // that the ray does not pass over
  for (;;) {
    const Index bc = c / kBlock, br = r / kBlock, gc = bc / kGroup, gr = br / kGroup;
    const Index here = gr * groups_.columns + gc;
    bool over =
        here != group && passes_over(kGroup * kBlock, static_cast<double>(groups_.at(gr, gc)));
    if (!over) {
      group = here;
      over = passes_over(kBlock, static_cast<double>(blocks_.at(br, bc)));
    }
    if (over) {
      if (c < 0 || c >= cols_ || r < 0 || r >= rows_) return {};
      continue;
    }
    double next_u = u.exit(c, 1), next_v = v.exit(r, 1);
    while (c / kBlock == bc && r / kBlock == br) {
      const double z = static_cast<double>(z_[r * cols_ + c]);
      if (std::isnan(z)) return {};
      const double z_in = high_ - s * drop;
      if (z_in < z && front_c >= 0) return {r, c, static_cast<float>(z_in), true, front_r, front_c};
      const double s_out = std::min({next_u, next_v, 1.0});
      // At the very end the ray is at the lowest height there is, whatever rounding says.
      if (high_ - s_out * drop <= z || s_out >= 1.0) {
        return {r, c, static_cast<float>(z), false, -1, -1};
      }
      s = s_out;
      front_c = c;
      front_r = r;
      if (next_u <= next_v) {
        c += u.sign;
        next_u += u.per_cell;
        if (c < 0 || c >= cols_) return {};
      } else {
        r += v.sign;
        next_v += v.per_cell;
        if (r < 0 || r >= rows_) return {};
      }
    }
  }
}

Tensor heights_in_view(const HeightField& field, const Quadratic& local_from_pixel, Index height,
                       Index width) {
  auto out = Tensor::uninitialised({height, width});
  const ColumnField columns(field);
  if (columns.empty()) {
    out.fill(std::numeric_limits<float>::quiet_NaN());
    return out;
  }
  for_range(height, 8, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      for (Index j = 0; j < width; ++j) {
        const auto x = static_cast<double>(j), y = static_cast<double>(i);
        const auto top = local_from_pixel(x, y, columns.high());
        const auto bottom = local_from_pixel(x, y, columns.low());
        out[i * width + j] = columns.walk(top[0], top[1], bottom[0], bottom[1]).z;
      }
    }
  });
  return out;
}

}  // namespace satsurf::scene
