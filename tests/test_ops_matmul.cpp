// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/matmul.h"

#include <array>
#include <cmath>

#include "tests/gradcheck.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;

namespace {

constexpr bool kBoth[] = {false, true};

Shape matrix(Index rows, Index columns, bool transposed) {
  return transposed ? Shape{columns, rows} : Shape{rows, columns};
}

}  // namespace

TEST_CASE("matmul agrees with the sum it stands for") {
  const std::array<Index, 3> sizes[] = {{5, 7, 3}, {1, 1, 1},     {1, 9, 4},
                                        {6, 1, 5}, {67, 33, 129}, {1031, 5, 17}};
  for (const auto& [M, N, K] : sizes)
    for (const bool ta : kBoth)
      for (const bool tb : kBoth) {
        CAPTURE(M);
        CAPTURE(ta);
        CAPTURE(tb);
        const auto a = normal(matrix(M, K, ta), 1), b = normal(matrix(K, N, tb), 2);
        const auto y = matmul(BasicVar<double>(a), BasicVar<double>(b), ta, tb).value();
        const auto f = matmul(Var(a.cast<float>()), Var(b.cast<float>()), ta, tb).value();
        REQUIRE(y.shape() == Shape{M, N});
        for (Index m = 0; m < M; ++m)
          for (Index n = 0; n < N; ++n) {
            double want = 0, size = 1;
            for (Index k = 0; k < K; ++k) {
              const double term =
                  (ta ? a[k * M + m] : a[m * K + k]) * (tb ? b[n * K + k] : b[k * N + n]);
              want += term;
              size += std::abs(term);
            }
            REQUIRE(std::abs(y[m * N + n] - want) < 1e-14 * size);
            REQUIRE(std::abs(static_cast<double>(f[m * N + n]) - want) < 1e-6 * size);
          }
      }
}

TEST_CASE("matmul gradient") {
  for (const bool ta : kBoth)
    for (const bool tb : kBoth) {
      CAPTURE(ta);
      CAPTURE(tb);
      CHECK(gradcheck([=](const test::DoubleVars& v) { return matmul(v[0], v[1], ta, tb); },
                      {normal(matrix(5, 3, ta), 3), normal(matrix(3, 4, tb), 4)}));
    }
  CHECK(gradcheck([](const test::DoubleVars& v) { return matmul(v[0], v[0], true, false); },
                  {normal({5, 3}, 5)}));
}

TEST_CASE("an empty sum is zero") {
  const Var a(Tensor({3, 0})), b(Tensor({0, 2}));
  const Tensor y = matmul(a, b).value();
  REQUIRE(y.shape() == Shape{3, 2});
  for (Index i = 0; i < 6; ++i) CHECK(y[i] == 0);
}

TEST_CASE("matmul gives the same bits for any number of threads") {
  const auto a = normal({3001, 37}, 6).cast<float>(), b = normal({29, 37}, 7).cast<float>();
  const auto g = normal({3001, 29}, 8).cast<float>();
  const auto run = [&](int threads) {
    set_threads(threads);
    const Var x(a, true), w(b, true);
    const Var y = matmul(x, w, false, true);
    y.backward(g);
    set_threads(0);
    return std::vector<Tensor>{y.value(), x.grad(), w.grad()};
  };
  const auto one = run(1), two = run(2);
  for (std::size_t k = 0; k < one.size(); ++k)
    for (Index i = 0; i < one[k].count(); ++i) REQUIRE(one[k][i] == two[k][i]);
}

TEST_CASE("matmul refuses") {
  const Var a(Tensor({3, 4})), b(Tensor({5, 2}));
  CHECK_THROWS_WITH_AS(matmul(a, b), "matmul: b has shape [5,2], expected [K N] with K=4 from a",
                       ShapeError);
  CHECK_THROWS_WITH_AS(matmul(a, b, true),
                       "matmul: b has shape [5,2], expected [K N] with K=3 from a", ShapeError);
  CHECK_THROWS_WITH_AS(matmul(a, b, false, true),
                       "matmul: b has shape [5,2], expected [N K] with K=4 from a", ShapeError);
  CHECK_THROWS_WITH_AS(matmul(Var(Tensor({3})), b), "matmul: a has shape [3], expected [M K]",
                       ShapeError);
}
