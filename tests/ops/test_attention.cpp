// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/attention.h"

#include <cmath>
#include <vector>

#include "tests/gradcheck.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;

namespace {

/// The definition, sum by sum.
BasicTensor<double> attention_ref(const BasicTensor<double>& q, const BasicTensor<double>& k,
                                  const BasicTensor<double>& v) {
  const Index H = q.dim(0), N = q.dim(1), d = q.dim(2), M = k.dim(1), e = v.dim(2);
  BasicTensor<double> out({H, N, e});
  for (Index h = 0; h < H; ++h)
    for (Index n = 0; n < N; ++n) {
      std::vector<double> weights(static_cast<std::size_t>(M));
      double total = 0;
      for (Index m = 0; m < M; ++m) {
        double dot = 0;
        for (Index i = 0; i < d; ++i) dot += q[(h * N + n) * d + i] * k[(h * M + m) * d + i];
        total += weights[static_cast<std::size_t>(m)] =
            std::exp(dot / std::sqrt(static_cast<double>(d)));
      }
      for (Index m = 0; m < M; ++m)
        for (Index j = 0; j < e; ++j)
          out[(h * N + n) * e + j] +=
              weights[static_cast<std::size_t>(m)] / total * v[(h * M + m) * e + j];
    }
  return out;
}

}  // namespace

TEST_CASE("attention agrees with its definition, over more than one block of queries") {
  struct Sizes {
    Index H, N, M, d, e;
  };
  for (const Sizes s : {Sizes{1, 1, 1, 1, 1}, Sizes{2, 5, 7, 3, 4}, Sizes{3, 131, 66, 17, 9},
                        Sizes{1, 260, 5, 8, 16}}) {
    CAPTURE(s.N);
    const auto q = normal({s.H, s.N, s.d}, 1), k = normal({s.H, s.M, s.d}, 2),
               v = normal({s.H, s.M, s.e}, 3);
    const auto want = attention_ref(q, k, v);
    const auto got =
        attention(BasicVar<double>(q), BasicVar<double>(k), BasicVar<double>(v)).value();
    const auto single =
        attention(Var(q.cast<float>()), Var(k.cast<float>()), Var(v.cast<float>())).value();
    REQUIRE(got.shape() == want.shape());
    for (Index i = 0; i < want.count(); ++i) {
      REQUIRE(std::abs(got[i] - want[i]) < 1e-12);
      REQUIRE(std::abs(static_cast<double>(single[i]) - want[i]) < 3e-6);
    }
  }
}

TEST_CASE("attention gradients") {
  const auto f = [](const test::DoubleVars& v) { return attention(v[0], v[1], v[2]); };
  CHECK(gradcheck(f, {normal({2, 5, 3}, 1), normal({2, 7, 3}, 2), normal({2, 7, 4}, 3)}));
  CHECK(gradcheck(f, {normal({1, 130, 2}, 4), normal({1, 3, 2}, 5), normal({1, 3, 1}, 6)}));
}

TEST_CASE("attention gives the same bits on one and on two threads") {
  const auto run = [](int threads) {
    set_threads(threads);
    const Var q(normal({3, 150, 16}, 1).cast<float>(), true),
        k(normal({3, 90, 16}, 2).cast<float>(), true), v(normal({3, 90, 8}, 3).cast<float>(), true);
    const Var out = attention(q, k, v);
    out.backward(normal(out.shape(), 4).cast<float>());
    set_threads(0);
    std::vector<float> all;
    for (const Tensor& t : {out.value(), q.grad(), k.grad(), v.grad()})
      all.insert(all.end(), t.values().begin(), t.values().end());
    return all;
  };
  CHECK(run(1) == run(2));
}

TEST_CASE("attention refuses what does not fit") {
  const Var q(Tensor({1, 2, 3})), k(Tensor({1, 4, 3}));
  CHECK_THROWS_AS(attention(q, k, Var(Tensor({1, 5, 2}))), ShapeError);
  CHECK_THROWS_WITH_AS(attention(q, Var(Tensor({1, 0, 3})), Var(Tensor({1, 0, 2}))),
                       "attention: key has shape [1,0,3], expected no extent of 0 but the heads'",
                       ShapeError);
}
