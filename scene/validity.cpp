// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/validity.h"

#include "satsurf/core/dims.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <utility>
#include <vector>

namespace satsurf::scene {
namespace {

constexpr Index kLeastArea = 64;       // px; smaller patches cost nothing
constexpr Index kLeastPartOfSide = 4;  // a quarter

/// Pixels joined side by side that have the value of the first of them.
class Patches {
 public:
  Patches(const Tensor& pixels, const Tensor& valid)
      : pixels_(pixels),
        channels_(pixels.dim(0)),
        height_(pixels.dim(1)),
        width_(pixels.dim(2)),
        state_(static_cast<std::size_t>(height_ * width_)) {
    for (Index i = 0; i < height_ * width_; ++i)
      if (!(valid[i] > 0)) state_[static_cast<std::size_t>(i)] = kTaken;
  }

  /// Looks at the patch that holds a pixel, and keeps it if it is a border.
  void look_at(Index seed) {
    if (state_[static_cast<std::size_t>(seed)] != kUnseen) return;
    found_.clear();
    take(seed);
    for (std::size_t k = 0; k < found_.size(); ++k) {
      const Index i = found_[k], x = i % width_, y = i / width_;
      if (x > 0) try_to_take(i - 1, seed);
      if (x + 1 < width_) try_to_take(i + 1, seed);
      if (y > 0) try_to_take(i - width_, seed);
      if (y + 1 < height_) try_to_take(i + width_, seed);
    }
    if (is_border())
      for (const Index i : found_) state_[static_cast<std::size_t>(i)] = kBorder;
  }
  bool border_at(Index i) const { return state_[static_cast<std::size_t>(i)] == kBorder; }

 private:
  enum State : std::uint8_t { kUnseen, kTaken, kBorder };

  void take(Index i) {
    state_[static_cast<std::size_t>(i)] = kTaken;
    found_.push_back(i);
  }
  void try_to_take(Index i, Index seed) {
    if (state_[static_cast<std::size_t>(i)] != kUnseen) return;
    for (Index c = 0; c < channels_; ++c) {
      const Index plane = c * height_ * width_;
      if (pixels_[plane + i] != pixels_[plane + seed]) return;
    }
    take(i);
  }
  bool is_border() const {
    if (static_cast<Index>(found_.size()) < kLeastArea) return false;
    std::array<Index, 4> along{};  // pixels at the left, right, upper and lower rim
    bool corner = false;
    for (const Index i : found_) {
      const Index x = i % width_, y = i / width_;
      const std::array<bool, 4> at{x == 0, x + 1 == width_, y == 0, y + 1 == height_};
      corner = corner || ((at[0] || at[1]) && (at[2] || at[3]));
      for (std::size_t side = 0; side < 4; ++side) along[side] += at[side] ? 1 : 0;
    }
    const Index tall = std::max(along[0], along[1]), wide = std::max(along[2], along[3]);
    return corner || kLeastPartOfSide * tall >= height_ || kLeastPartOfSide * wide >= width_;
  }

  const Tensor& pixels_;
  Index channels_, height_, width_;
  std::vector<std::uint8_t> state_;
  std::vector<Index> found_;
};

}  // namespace

Tensor border_of(const Tensor& pixels, const Tensor& valid) {
  Dims dim("border_of");
  dim.match("pixels", pixels, "C H W").match("valid", valid, "H W");
  const Index H = dim["H"], W = dim["W"];
  Patches patches(pixels, valid);
  for (Index x = 0; x < W; ++x) patches.look_at(x), patches.look_at((H - 1) * W + x);
  for (Index y = 0; y < H; ++y) patches.look_at(y * W), patches.look_at(y * W + W - 1);
  Tensor out({H, W});
  bool other = false;
  for (Index i = 0; i < H * W; ++i) {
    out[i] = patches.border_at(i) ? 1.0F : 0.0F;
    other = other || (valid[i] > 0 && !patches.border_at(i));
  }
  if (!other) out.fill(0);
  return out;
}

Validity apply(const ValidityRules& rules, const Tensor& pixels, const Tensor& valid) {
  const Index C = pixels.dim(0), P = valid.count();
  Validity out{valid.clone()};
  for (const double value : rules.nodata) {
    const auto nodata = static_cast<float>(value);
    for (Index i = 0; i < P; ++i) {
      bool lost = true;
      for (Index c = 0; c < C && lost; ++c) lost = pixels[c * P + i] == nodata;
      if (lost) out.valid[i] = 0;
    }
  }
  if (!rules.borders) return out;
  const Tensor border = border_of(pixels, out.valid);
  Index lost = 0;
  for (Index i = 0; i < P; ++i)
    if (border[i] > 0) out.valid[i] = 0, ++lost;
  out.border = static_cast<double>(lost) / static_cast<double>(P);
  return out;
}

}  // namespace satsurf::scene
