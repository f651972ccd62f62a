// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/matmul.h"
#include "satsurf/ops/matmul_kernels.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "tests/gradcheck.h"
#include "tests/isa_variants.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;

namespace {

constexpr bool kBoth[] = {false, true};

Shape matrix(Index rows, Index columns, bool transposed) {
  return transposed ? Shape{columns, rows} : Shape{rows, columns};
}

/// Factors of a product, numbers that a float holds, and the sums it stands for.
struct Product {
  Index M, N, K;
  BasicTensor<double> a, b, sums, sizes;  ///< sizes: of the terms, which rounding errors scale with

  Product(Index m, Index n, Index k)
      : M(m),
        N(n),
        K(k),
        a(normal({M, K}, 1).cast<float>().cast<double>()),
        b(normal({K, N}, 2).cast<float>().cast<double>()),
        sums({M, N}),
        sizes({M, N}, 1) {
    for (Index i = 0; i < M; ++i)
      for (Index l = 0; l < K; ++l)
        for (Index j = 0; j < N; ++j) {
          const double term = a[i * K + l] * b[l * N + j];
          sums[i * N + j] += term;
          sizes[i * N + j] += std::abs(term);
        }
  }
};

/// A factor as it is stored, in memory that ends with it.
template <class T>
std::vector<T> stored(const BasicTensor<double>& x, bool transposed) {
  const Index R = x.dim(0), C = x.dim(1);
  std::vector<T> out;
  out.reserve(static_cast<std::size_t>(R * C));
  for (Index i = 0; i < R * C; ++i)
    out.push_back(static_cast<T>(transposed ? x[i % R * C + i / R] : x[i]));
  return out;
}

template <class T>
bool close(double got, double want, double size) {
  return std::abs(got - want) < (sizeof(T) == sizeof(float) ? 1e-6 : 1e-14) * size;
}

template <class T>
void check_gemm(const Product& p, Isa isa, bool ta, bool tb) {
  constexpr std::size_t kGuard = 64;
  const auto a = stored<T>(p.a, ta), b = stored<T>(p.b, tb);
  const auto count = static_cast<std::size_t>(p.M * p.N);
  for (const bool accumulate : kBoth) {
    CAPTURE(accumulate);
    std::vector<T> out(count + 2 * kGuard, T(7));
    if (!accumulate)  // what was there must not be read
      std::fill_n(out.begin() + kGuard, count, std::numeric_limits<T>::quiet_NaN());
    gemm(kernels_for<MatmulKernels<T>>(isa), p.M, p.N, p.K, a.data(), ta, b.data(), tb,
         out.data() + kGuard, accumulate);
    bool right = true, untouched = true;
    for (std::size_t i = 0; i < count; ++i) {
      const auto o = static_cast<Index>(i);
      const double before = accumulate ? 7 : 0;
      right = right && close<T>(static_cast<double>(out[kGuard + i]), before + p.sums[o],
                                before + p.sizes[o]);
    }
    for (std::size_t i = 0; i < kGuard; ++i)
      untouched = untouched && out[i] == T(7) && out[kGuard + count + i] == T(7);
    CHECK(right);
    CHECK(untouched);
  }
}

}  // namespace

TEST_CASE("gemm agrees with the sums it stands for") {
  const std::array<Index, 3> sizes[] = {
      {1, 1, 1},     {1, 9, 4},    {6, 1, 5},      {5, 7, 3},
      {3, 2, 1},     {9, 49, 17},  // one more than a tile and a vector, of every instruction set
      {7, 47, 15},                 // one less
      {8, 48, 256},  {13, 65, 1},  {33, 83, 19},   {13, 100, 257},  // one more than a block
      {1031, 5, 17}, {3, 5, 1301}, {70, 37, 1100},                  // parts of k
      {70, 261, 301}};                                              // groups of panels
  for (const auto& [M, N, K] : sizes) {
    const Product p(M, N, K);
    for (const Isa isa : test::tested_isas()) {
      for (const bool ta : kBoth)
        for (const bool tb : kBoth) {
          CAPTURE(std::string(isa_name(isa)));
          CAPTURE(M);
          CAPTURE(N);
          CAPTURE(K);
          CAPTURE(ta);
          CAPTURE(tb);
          check_gemm<float>(p, isa, ta, tb);
          check_gemm<double>(p, isa, ta, tb);
        }
    }
  }
}

TEST_CASE("matmul takes either factor transposed") {
  const Product p(5, 7, 3);
  for (const bool ta : kBoth)
    for (const bool tb : kBoth) {
      CAPTURE(ta);
      CAPTURE(tb);
      const auto a = stored<double>(p.a, ta), b = stored<double>(p.b, tb);
      const BasicVar<double> x(BasicTensor<double>::from(matrix(5, 3, ta), a)),
          w(BasicTensor<double>::from(matrix(3, 7, tb), b));
      const auto y = matmul(x, w, ta, tb).value();
      REQUIRE(y.shape() == Shape{5, 7});
      for (Index i = 0; i < y.count(); ++i) CHECK(close<double>(y[i], p.sums[i], p.sizes[i]));
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

TEST_CASE("matmul adds to the gradients it finds") {
  const auto a = normal({5, 3}, 9), b = normal({3, 4}, 10), g = normal({5, 4}, 11);
  const BasicVar<double> x(a, true), w(b, true), once_x(a, true), once_w(b, true);
  for (int pass = 0; pass < 2; ++pass) matmul(x, w).backward(g);
  matmul(once_x, once_w).backward(g);
  for (Index i = 0; i < 15; ++i) CHECK(x.grad()[i] == doctest::Approx(2 * once_x.grad()[i]));
  for (Index i = 0; i < 12; ++i) CHECK(w.grad()[i] == doctest::Approx(2 * once_w.grad()[i]));
}

TEST_CASE("matmul gives the same bits for any number of threads") {
  const std::array<Index, 3> sizes[] = {{3001, 29, 37}, {70, 261, 301}};
  for (const auto& [M, N, K] : sizes) {
    const auto a = normal({M, K}, 6).cast<float>(), b = normal({N, K}, 7).cast<float>();
    const auto g = normal({M, N}, 8).cast<float>();
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
