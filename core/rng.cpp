// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/rng.h"

#include <array>
#include <cmath>
#include <numbers>

namespace satsurf {
namespace {

std::array<std::uint32_t, 4> philox(std::array<std::uint32_t, 4> c, std::uint32_t k0,
                                    std::uint32_t k1) {
  for (int round = 0; round < 10; ++round) {
    const std::uint64_t a = std::uint64_t{0xD2511F53} * c[0], b = std::uint64_t{0xCD9E8D57} * c[2];
    c = {static_cast<std::uint32_t>(b >> 32) ^ c[1] ^ k0, static_cast<std::uint32_t>(b),
         static_cast<std::uint32_t>(a >> 32) ^ c[3] ^ k1, static_cast<std::uint32_t>(a)};
    k0 += 0x9E3779B9;  // golden ratio and sqrt(3)-1: the constants of the paper's Weyl sequence
    k1 += 0xBB67AE85;
  }
  return c;
}

/// A draw as a T, which may round it out of [low, high): then the number beside that, inside.
template <class T>
T inside(double draw, double low, double high) {
  const T v = static_cast<T>(draw);
  if (static_cast<double>(v) < low) return std::nextafter(v, static_cast<T>(high));
  if (static_cast<double>(v) >= high) return std::nextafter(v, static_cast<T>(low));
  return v;
}

}  // namespace

std::uint64_t Rng::next_u64() {
  const auto r =
      philox({static_cast<std::uint32_t>(counter_), static_cast<std::uint32_t>(counter_ >> 32),
              static_cast<std::uint32_t>(stream_), static_cast<std::uint32_t>(stream_ >> 32)},
             static_cast<std::uint32_t>(seed_), static_cast<std::uint32_t>(seed_ >> 32));
  ++counter_;
  return (std::uint64_t{r[0]} << 32) | r[1];
}

double Rng::uniform() { return static_cast<double>(next_u64() >> 11) * 0x1p-53; }

Index Rng::below(Index n) {
  if (n <= 0) throw Error("Rng::below: n = " + std::to_string(n) + ", expected at least 1");
  return static_cast<Index>(uniform() * static_cast<double>(n));  // n is far below 2^53
}

double Rng::normal() {
  const double u = 1.0 - uniform(), v = uniform();  // u in (0, 1]: the logarithm is finite
  return std::sqrt(-2.0 * std::log(u)) * std::cos(2.0 * std::numbers::pi * v);
}

Rng Rng::fork(std::uint64_t key) const {
  Rng child(seed_, stream_);
  child.counter_ = ~key;  // far from the draws of the parent
  const std::uint64_t seed = child.next_u64();
  return Rng(seed, stream_ ^ key);
}

template <class T>
BasicTensor<T> normal_tensor(const Shape& shape, Rng& rng) {
  auto t = BasicTensor<T>::uninitialised(shape);
  for (T& v : t.values()) v = static_cast<T>(rng.normal());
  return t;
}

template <class T>
BasicTensor<T> uniform_tensor(const Shape& shape, Rng& rng, double low, double high) {
  auto t = BasicTensor<T>::uninitialised(shape);
  for (T& v : t.values()) v = inside<T>(rng.uniform(low, high), low, high);
  return t;
}

template BasicTensor<float> normal_tensor(const Shape&, Rng&);
template BasicTensor<double> normal_tensor(const Shape&, Rng&);
template BasicTensor<float> uniform_tensor(const Shape&, Rng&, double, double);
template BasicTensor<double> uniform_tensor(const Shape&, Rng&, double, double);

}  // namespace satsurf
