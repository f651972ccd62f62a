// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/dims.h"
#include "satsurf/core/error.h"
#include "satsurf/core/tensor.h"

#include <cstdint>
#include <limits>

#include <doctest/doctest.h>

using namespace satsurf;

TEST_CASE("shape: extents, counts and text") {
  const Shape s{4, 3, 2};
  CHECK(s.rank() == 3);
  CHECK(s.count() == 24);
  CHECK(s.count(1, 3) == 6);
  CHECK(s.count(2, 2) == 1);
  CHECK(s.str() == "[4,3,2]");
  CHECK(s.with(1, 7) == Shape{4, 7, 2});
  CHECK(s != Shape{4, 3});
  CHECK(Shape{}.count() == 1);
  CHECK(Shape{}.str() == "[]");
  CHECK(Shape{3, 0}.count() == 0);
}

TEST_CASE("shape: what cannot be a shape is refused") {
  CHECK_THROWS_WITH_AS(Shape({1, 1, 1, 1, 1, 1}), "Shape: rank 6, expected at most 5", ShapeError);
  CHECK_THROWS_WITH_AS(Shape({2, -3}), "Shape: extent -3, expected 0 or more", ShapeError);
  CHECK_THROWS_WITH_AS(Shape({2, 3}).with(0, -1), "Shape: extent -1, expected 0 or more",
                       ShapeError);
  CHECK_THROWS_WITH_AS(Shape({1 << 30, 1 << 30}),
                       "Shape: [1073741824,1073741824], expected at most 2^59 elements",
                       ShapeError);
  constexpr Index kHuge = std::numeric_limits<Index>::max();
  CHECK_THROWS_AS(Shape({kHuge, kHuge, kHuge}), ShapeError);
  CHECK_THROWS_AS(Shape({0, kHuge}), ShapeError);
}

TEST_CASE_TEMPLATE("tensor: buffers are aligned to 64 bytes whatever their size", T, float,
                   double) {
  for (const Index n : {0, 1, 3, 17, 1000, 20011}) {
    const auto t = BasicTensor<T>::uninitialised({n});
    CHECK(reinterpret_cast<std::uintptr_t>(t.data()) % 64 == 0);
    CHECK(!t.empty());
    CHECK(t.count() == n);
  }
}

TEST_CASE_TEMPLATE("tensor: copies share, clones do not", T, float, double) {
  auto a = BasicTensor<T>::from({2, 3}, {1, 2, 3, 4, 5, 6});
  auto shared = a;
  const auto cloned = a.clone();
  auto flat = a.reshaped({6});
  a[4] = 50;
  CHECK(shared[4] == 50);
  CHECK(flat[4] == 50);
  CHECK(cloned[4] == 5);
  CHECK(flat.shape() == Shape{6});
  CHECK(a.shape() == Shape{2, 3});
  const auto row = a.slice0(1);
  CHECK(row.shape() == Shape{3});
  a[3] = -1;
  CHECK(row[0] == 4);
  CHECK(row[1] == 50);
}

TEST_CASE("tensor: fills, casts and scalars") {
  const Tensor zeros(Shape{3, 2}), twos({3, 2}, 2.0F);
  for (Index i = 0; i < 6; ++i) {
    CHECK(zeros[i] == 0);
    CHECK(twos[i] == 2);
  }
  CHECK(Tensor::zeros_like(twos).shape() == twos.shape());
  CHECK(Tensor::zeros_like(twos)[5] == 0);
  CHECK(Tensor::scalar(2.5F).item() == 2.5F);
  CHECK(Tensor::scalar(2.5F).rank() == 0);
  const auto d = twos.cast<double>();
  CHECK(d.shape() == twos.shape());
  CHECK(d[3] == 2.0);
  CHECK(twos.values().size() == 6);
}

TEST_CASE("tensor: the empty tensor stays empty") {
  const Tensor none;
  CHECK(none.empty());
  CHECK(none.count() == 0);
  CHECK(none.values().empty());
  CHECK(none.clone().empty());
  CHECK(none.cast<double>().empty());
  CHECK(Tensor::zeros_like(none).empty());
  CHECK_THROWS_WITH_AS(none.reshaped({1}),
                       "Tensor::reshaped: from empty to [1], expected equal counts", ShapeError);
  CHECK_THROWS_AS(static_cast<void>(none.item()), ShapeError);
}

TEST_CASE("tensor: misuse is refused with both shapes") {
  const Tensor t({2, 3});
  CHECK_THROWS_WITH_AS(t.reshaped({7}),
                       "Tensor::reshaped: from [2,3] to [7], expected equal counts", ShapeError);
  CHECK_THROWS_WITH_AS(
      t.slice0(2), "Tensor::slice0: index 2, expected one of axis 0 of shape [2,3]", ShapeError);
  CHECK_THROWS_WITH_AS(
      t.slice0(-1), "Tensor::slice0: index -1, expected one of axis 0 of shape [2,3]", ShapeError);
  CHECK_THROWS_WITH_AS(static_cast<void>(t.item()),
                       "Tensor::item: shape [2,3], expected one element", ShapeError);
  CHECK_THROWS_WITH_AS(Tensor::from({2, 2}, {1, 2, 3}),
                       "Tensor::from: 3 values, expected 4 for shape [2,2]", ShapeError);
}

TEST_CASE("dims: names are bound once and compared ever after") {
  Dims dim("op");
  dim.match("image", Shape{2, 3, 5, 7}, "B C H W").match("weight", Shape{4, 3, 3, 3}, "O C 3 3");
  CHECK(dim["B"] == 2);
  CHECK(dim["C"] == 3);
  CHECK(dim["W"] == 7);
  CHECK(dim["O"] == 4);
  CHECK_NOTHROW(dim.match("scalar", Tensor::scalar(1), ""));
}

TEST_CASE("dims: the failing argument is named with what came and what was wanted") {
  Dims dim("op");
  dim.match("image", Shape{2, 3, 5}, "C H W");
  CHECK_THROWS_WITH_AS(dim.match("bias", Shape{4}, "C"),
                       "op: bias has shape [4], expected [C] with C=2 from image", ShapeError);
  CHECK_THROWS_WITH_AS(
      dim.match("mask", Shape{3, 6}, "H W"),
      "op: mask has shape [3,6], expected [H W] with H=3 from image, W=5 from image", ShapeError);
  CHECK_THROWS_WITH_AS(dim.match("quats", Shape{9, 3}, "P 4"),
                       "op: quats has shape [9,3], expected [P 4]", ShapeError);
  CHECK_THROWS_WITH_AS(dim.match("square", Shape{4, 5}, "K K"),
                       "op: square has shape [4,5], expected [K K]", ShapeError);
  CHECK_THROWS_WITH_AS(dim.match("flat", Shape{30}, "A B"),
                       "op: flat has shape [30], expected [A B]", ShapeError);
  CHECK_THROWS_WITH_AS(static_cast<void>(dim["Z"]),
                       "op: extent Z, expected one that an argument has bound", ShapeError);
}
