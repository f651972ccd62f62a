// SPDX-License-Identifier: Apache-2.0
#include "satsurf/splat/select.h"

#include "satsurf/core/error.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <utility>

namespace satsurf::splat {
namespace {

/// Rows of `t` ([P ...]) named by `keep`.
Tensor rows_of(const Tensor& t, const std::vector<Index>& keep) {
  const Index n = std::ssize(keep), width = t.dim(0) > 0 ? t.count() / t.dim(0) : 0;
  auto out = Tensor::uninitialised(t.shape().with(0, n));
  constexpr Index kGrain = 1 << 14;  // rows of one piece of work
  for_range(n, kGrain, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i)
      std::copy_n(t.data() + keep[i] * width, width, out.data() + i * width);
  });
  return out;
}

}  // namespace

template <class T>
BasicSurfels<T> joined(const std::vector<BasicSurfels<T>>& parts) {
  if (parts.empty()) throw ShapeError("joined: no sets, expected one or more");
  if (parts.size() == 1) return parts[0];
  const auto join = [&](const char* name, BasicVar<T> BasicSurfels<T>::*member) {
    std::vector<BasicVar<T>> list;
    for (const auto& p : parts)
      if (!(p.*member).empty()) list.push_back(p.*member);
    if (list.empty()) return BasicVar<T>();
    if (list.size() != parts.size())
      throw ShapeError(std::string("joined: ") + std::to_string(list.size()) + " of " +
                       std::to_string(parts.size()) + " sets have " + name +
                       ", expected all or none");
    return concat(list, 0);
  };
  using S = BasicSurfels<T>;
  return {join("means", &S::means),     join("quats", &S::quats),     join("scales", &S::scales),
          join("opacity", &S::opacity), join("colours", &S::colours), join("aux", &S::aux)};
}

Surfels selected(const Surfels& s, const std::vector<Index>& keep) {
  const auto take = [&](const Var& v) { return v.empty() ? Var() : Var(rows_of(v.value(), keep)); };
  return {take(s.means),   take(s.quats),   take(s.scales),
          take(s.opacity), take(s.colours), take(s.aux)};
}

namespace {

/// Which cube of side `side` holds a point; far outside of the 20 bits a side has, the outermost.
std::uint64_t cube_of(const float* mean, double side) {
  constexpr double kHalf = 1 << 20;
  std::uint64_t key = 0;
  for (int i = 0; i < 3; ++i) {
    const double at = std::floor(static_cast<double>(mean[i]) / side) + kHalf;
    key = key << 21 | static_cast<std::uint64_t>(std::clamp(at, 0.0, 2 * kHalf - 1));
  }
  return key;
}

/// The most opaque surfel of every cube of side `side`, in the order of their numbers.
std::vector<Index> best_of_cubes(const Surfels& s, double side) {
  const Tensor &means = s.means.value(), &opacity = s.opacity.value();
  std::vector<std::pair<std::uint64_t, Index>> order;
  for (Index p = 0; p < means.dim(0); ++p)
    order.emplace_back(cube_of(means.data() + 3 * p, side), p);
  std::ranges::sort(order);
  std::vector<Index> out;
  for (std::size_t k = 0; k < order.size(); ++k) {
    const Index p = order[k].second;
    if (k == 0 || order[k].first != order[k - 1].first)
      out.push_back(p);
    else if (opacity[p] > opacity[out.back()])
      out.back() = p;
  }
  std::ranges::sort(out);
  return out;
}

}  // namespace

Surfels thinned(const Surfels& surfels, Index most) {
  if (most < 1) throw Error("thinned: " + std::to_string(most) + " surfels, expected 1 or more");
  if (surfels.means.value().dim(0) <= most) return surfels;
  constexpr double kSmallest = 0.01, kClose = 1.02;  // m; ratio of the sides tried last
  double small = kSmallest, large = small;
  std::vector<Index> keep;
  do {
    small = large, large *= 4;
    keep = best_of_cubes(surfels, large);
  } while (static_cast<Index>(keep.size()) > most && large < 1e9);
  while (large > kClose * small) {
    const double side = std::sqrt(small * large);
    std::vector<Index> fewer = best_of_cubes(surfels, side);
    if (static_cast<Index>(fewer.size()) > most)
      small = side;
    else
      large = side, keep = std::move(fewer);
  }
  // around the origin eight cubes of any size meet
  if (static_cast<Index>(keep.size()) > most) keep.resize(static_cast<std::size_t>(most));
  Surfels out = selected(surfels, keep);
  Tensor scales = out.scales.value().clone();
  for (float& v : scales.values()) v = std::max(v, static_cast<float>(large / 2));
  out.scales = Var(scales);
  return out;
}

template BasicSurfels<float> joined(const std::vector<BasicSurfels<float>>&);
template BasicSurfels<double> joined(const std::vector<BasicSurfels<double>>&);

}  // namespace satsurf::splat
