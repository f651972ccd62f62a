// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/box_filters.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/rng.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <doctest/doctest.h>

namespace satsurf {
namespace {

TEST_CASE("mean and largest value of squares, cut off at the edges") {
  Rng rng(1);
  for (const Shape& shape : {Shape{9, 13}, Shape{1, 40}, Shape{70, 3}, Shape{35, 150}})
    for (const Index radius : {0, 1, 2, 4, 12, 30}) {
      CAPTURE(shape.str());
      CAPTURE(radius);
      const Index H = shape[0], W = shape[1];
      const Tensor grid = normal_tensor<float>(shape, rng), mean = box_mean(grid, radius),
                   most = box_max(grid, radius);
      for (Index i = 0; i < H; ++i)
        for (Index j = 0; j < W; ++j) {
          double total = 0, count = 0;
          float largest = -INFINITY;
          for (Index y = std::max<Index>(0, i - radius); y <= std::min(H - 1, i + radius); ++y)
            for (Index x = std::max<Index>(0, j - radius); x <= std::min(W - 1, j + radius); ++x) {
              total += static_cast<double>(grid[y * W + x]), count += 1;
              largest = std::max(largest, grid[y * W + x]);
            }
          REQUIRE(std::abs(static_cast<double>(mean[i * W + j]) - total / count) < 1e-5);
          REQUIRE(most[i * W + j] == largest);
        }
    }
}

TEST_CASE("squares without values have the largest of none") {
  Tensor grid({5, 7}, -INFINITY);
  grid[3 * 7 + 2] = -4;
  const Tensor most = box_max(grid, 1);
  for (Index i = 0; i < 5; ++i)
    for (Index j = 0; j < 7; ++j)
      CHECK(most[i * 7 + j] == (std::abs(i - 3) <= 1 && std::abs(j - 2) <= 1 ? -4 : -INFINITY));
}

TEST_CASE("squares give the same bits for any number of threads") {
  Rng rng(2);
  const Tensor grid = normal_tensor<float>({130, 210}, rng);
  const auto run = [&](int threads) {
    set_threads(threads);
    const Tensor mean = box_mean(grid, 9), most = box_max(grid, 9);
    set_threads(0);
    return std::pair{mean, most};
  };
  const auto one = run(1), two = run(2);
  CHECK(std::ranges::equal(one.first.values(), two.first.values()));
  CHECK(std::ranges::equal(one.second.values(), two.second.values()));
}

}  // namespace
}  // namespace satsurf
