// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/packed_tensor.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>

namespace satsurf {
namespace {

std::uint16_t half_of(float v) {
  __extension__ using Half = _Float16;
  return std::bit_cast<std::uint16_t>(static_cast<Half>(v));
}

/// In integers, for whole vectors at a time: the compiler's own conversion is a call for each where
/// the processor it builds for is not known to have one.
float float_of(std::uint16_t half) {
  const std::uint32_t sign = (half & 0x8000u) << 16, magnitude = (half & 0x7fffu) << 13;
  // The exponent's bias is 112 larger; what was below the normal numbers becomes one.
  std::uint32_t bits = std::bit_cast<std::uint32_t>(std::bit_cast<float>(magnitude) * 0x1p112f);
  if (magnitude >= 0x7c00u << 13) bits |= 0x7f800000u;  // infinite, or no number
  return std::bit_cast<float>(bits | sign);
}

}  // namespace

PackedTensor PackedTensor::levels(const Tensor& t, float unit) {
  PackedTensor out;
  if (t.empty()) return out;
  out.shape_ = t.shape();
  out.unit_ = unit;
  Levels levels(static_cast<std::size_t>(t.count()));
  for (Index i = 0; i < t.count(); ++i) {
    const float level = std::round(t[i] / unit);
    if (!(level >= 0 && level <= 255 && level * unit == t[i])) return PackedTensor(t);
    levels[static_cast<std::size_t>(i)] = static_cast<std::uint8_t>(level);
  }
  out.elements_ = std::move(levels);
  return out;
}

PackedTensor PackedTensor::halves(const Tensor& t) {
  PackedTensor out;
  if (t.empty()) return out;
  out.shape_ = t.shape();
  Halves halves(static_cast<std::size_t>(t.count()));
  std::ranges::transform(t.values(), halves.begin(), half_of);
  out.elements_ = std::move(halves);
  return out;
}

std::size_t PackedTensor::bytes() const {
  if (const auto* t = std::get_if<Tensor>(&elements_))
    return static_cast<std::size_t>(t->count()) * sizeof(float);
  if (const auto* l = std::get_if<Levels>(&elements_)) return l->size();
  return std::get<Halves>(elements_).size() * sizeof(std::uint16_t);
}

Tensor PackedTensor::tensor() const {
  if (const auto* t = std::get_if<Tensor>(&elements_)) return *t;
  auto out = Tensor::uninitialised(shape_);
  read(0, out.count(), out.data());
  return out;
}

void PackedTensor::read(Index begin, Index count, float* to) const {
  if (const auto* t = std::get_if<Tensor>(&elements_)) {
    std::copy_n(t->data() + begin, count, to);
  } else if (const auto* levels = std::get_if<Levels>(&elements_)) {
    const float unit = unit_;
    std::transform(levels->data() + begin, levels->data() + begin + count, to,
                   [unit](std::uint8_t level) { return static_cast<float>(level) * unit; });
  } else {
    const auto& halves = std::get<Halves>(elements_);
    std::transform(halves.data() + begin, halves.data() + begin + count, to, float_of);
  }
}

}  // namespace satsurf
