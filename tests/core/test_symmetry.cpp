// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/symmetry.h"

#include <set>
#include <vector>

#include <doctest/doctest.h>

using namespace satsurf;

namespace {

Tensor numbered(const Shape& shape) {
  Tensor out(shape);
  for (Index i = 0; i < out.count(); ++i) out[i] = static_cast<float>(i);
  return out;
}

std::vector<float> values(const Tensor& t) { return {t.data(), t.data() + t.count()}; }

}  // namespace

TEST_CASE("the eight symmetries of the square") {
  const Tensor map = numbered({2, 2});
  const std::vector<std::vector<float>> expected{{0, 1, 2, 3}, {1, 0, 3, 2}, {2, 3, 0, 1},
                                                 {3, 2, 1, 0}, {0, 2, 1, 3}, {2, 0, 3, 1},
                                                 {1, 3, 0, 2}, {3, 1, 2, 0}};
  for (Index s = 0; s < kSymmetries; ++s) CHECK(values(turned(map, s)) == expected[s]);
}

TEST_CASE("every plane is turned alike, and each symmetry has another that undoes it") {
  const Tensor map = numbered({3, 5, 5});
  std::set<std::vector<float>> seen;
  for (Index s = 0; s < kSymmetries; ++s) {
    const Tensor once = turned(map, s);
    seen.insert(values(once));
    for (Index c = 1; c < 3; ++c)
      for (Index i = 0; i < 25; ++i)
        CHECK(once[c * 25 + i] == once[i] + static_cast<float>(25 * c));
    int undone = 0;
    for (Index t = 0; t < kSymmetries; ++t) undone += values(turned(once, t)) == values(map);
    CHECK(undone == 1);
  }
  CHECK(seen.size() == 8);
}

TEST_CASE("what is not square is refused") {
  CHECK_THROWS_WITH_AS(turned(Tensor({2, 3}), 1),
                       "turned: map has shape [2,3], expected [S S] or [C S S]", ShapeError);
  CHECK_THROWS_AS(turned(Tensor({4}), 1), ShapeError);
  CHECK(turned(Tensor({2, 0, 0}), 1).count() == 0);
}
