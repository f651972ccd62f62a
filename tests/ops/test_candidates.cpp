// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/candidates.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "tests/gradcheck.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

/// Three candidates of 4 x 5 cells; some are missing, and one cell has none.
BasicTensor<double> some_candidates() {
  BasicTensor<double> z = normal({3, 4, 5}, 8, 4);
  for (Index k : {0, 21, 24, 43, 7}) z[k] = kNan;
  for (Index k = 0; k < 3; ++k) z[20 * k + 11] = kNan;
  return z;
}

}  // namespace

TEST_CASE("chosen_height by hand") {
  const auto z = BasicTensor<double>::from({3, 1, 3}, {1, 5, kNan, 3, kNan, kNan, 9, 7, kNan});
  BasicTensor<double> logits({3, 1, 3}), residual({1, 3});
  logits[3] = std::log(2.0);  // the second candidate of the first cell, twice as likely
  residual[1] = 0.5;
  residual[2] = 3;
  const auto h = chosen_height(BasicVar<double>(logits), BasicVar<double>(residual), z, 2).value();
  CHECK(h[0] == doctest::Approx((1 + 2 * 3 + 9) / 4.0));
  CHECK(h[1] == doctest::Approx(6 + 2 * std::tanh(0.5)));
  CHECK(h[2] == 0);  // nothing to choose from
}

TEST_CASE("logits that are no numbers stay visible, where there is something to choose") {
  const double inf = std::numeric_limits<double>::infinity();
  // of the last two cells the second candidate is missing, and both
  const auto z =
      BasicTensor<double>::from({2, 1, 5}, {10, 10, 10, 10, kNan, 20, 20, 20, kNan, kNan});
  const auto l = BasicTensor<double>::from({2, 1, 5}, {kNan, kNan, -inf, 1, kNan,  //
                                                       kNan, 0, -inf, kNan, kNan});
  BasicVar<double> logits(l, true);
  const BasicVar<double> h =
      chosen_height(logits, BasicVar<double>(BasicTensor<double>({1, 5})), z, 2);
  for (Index i = 0; i < 3; ++i) CHECK(std::isnan(h.value()[i]));
  CHECK(h.value()[3] == 10);
  CHECK(h.value()[4] == 0);
  h.backward(BasicTensor<double>({1, 5}, 1.0));
  for (const Index i : {0, 1, 2, 5, 6, 7}) CHECK(std::isnan(logits.grad()[i]));
  for (const Index i : {3, 4, 8, 9}) CHECK(logits.grad()[i] == 0);

  const auto loss = [&](Index cell) {
    BasicTensor<double> weight({1, 5});
    weight[cell] = 1;
    return candidate_cross_entropy(logits, z, BasicTensor<double>({1, 5}, 11.0), weight, 1.0);
  };
  for (const Index cell : {0, 1, 2}) {
    CAPTURE(cell);
    CHECK(std::isnan(loss(cell).value().item()));
  }
  CHECK(loss(3).value().item() == doctest::Approx(0));
  CHECK(loss(4).value().item() == 0);
  logits.clear_grad();
  loss(1).backward();
  CHECK(std::isnan(logits.grad()[1]));
  CHECK(std::isnan(logits.grad()[6]));
  CHECK(logits.grad()[3] == 0);
  const NanGuard guard;
  CHECK_THROWS_AS(chosen_height(logits, BasicVar<double>(BasicTensor<double>({1, 5})), z, 2),
                  Error);
}

TEST_CASE("chosen_height: gradient and threads") {
  const auto z = some_candidates();
  CHECK(gradcheck([&](const test::DoubleVars& v) { return chosen_height(v[0], v[1], z, 1.5); },
                  {normal({3, 4, 5}, 1), normal({4, 5}, 2)}));
  const auto run = [&](int threads) {
    set_threads(threads);
    const Var l(normal({4, 90, 70}, 3).cast<float>(), true);
    const Var h = chosen_height(l, Var(normal({90, 70}, 4).cast<float>()),
                                normal({4, 90, 70}, 5).cast<float>(), 2);
    h.backward(Tensor(h.shape(), 1.f));
    set_threads(0);
    return std::pair(h.value(), l.grad());
  };
  const auto one = run(1), two = run(2);
  for (Index i = 0; i < one.first.count(); ++i) REQUIRE(one.first[i] == two.first[i]);
  for (Index i = 0; i < one.second.count(); ++i) REQUIRE(one.second[i] == two.second[i]);
}

TEST_CASE("laplace_loss by hand") {
  const auto h = BasicTensor<double>::from({1, 4}, {3, 3, 100, 0}),
             s = BasicTensor<double>::from({1, 4}, {0, std::log(2.0), 0, -9}),
             t = BasicTensor<double>::from({1, 4}, {1, 4, kNan, 0}),
             w = BasicTensor<double>::from({1, 4}, {1, 3, 0, 0});
  const auto loss = [&](const BasicTensor<double>& weight) {
    return laplace_loss(BasicVar<double>(h), BasicVar<double>(s), t, weight, 0.5).value().item();
  };
  // errors of 4 and 2 units, expected 1 and 2
  CHECK(loss(w) == doctest::Approx((4 + std::log(2.0) + 3 * (1 + std::log(4.0))) / 4));
  CHECK(loss(BasicTensor<double>({1, 4})) == 0);
  auto last = BasicTensor<double>({1, 4});
  last[3] = 1;
  CHECK(loss(last) == doctest::Approx(-4 + std::log(2.0)));  // no surer than this
}

TEST_CASE("laplace_loss: gradient") {
  const auto t = normal({6, 7}, 3, 3);
  BasicTensor<double> w = normal({6, 7}, 4);
  for (double& v : w.values()) v = std::max(v, 0.0);
  BasicTensor<double> s = normal({6, 7}, 2);
  for (Index i = 0; i < s.count(); i += 5) s[i] = i % 2 == 0 ? 9 : -9;  // beyond the limits
  CHECK(gradcheck([&](const test::DoubleVars& v) { return laplace_loss(v[0], v[1], t, w, 0.7); },
                  {normal({6, 7}, 1, 3), s}));
  const BasicVar<double> log_scale(s, true);
  laplace_loss(BasicVar<double>(normal({6, 7}, 1, 3)), log_scale, t, w, 0.7).backward();
  for (Index i = 0; i < s.count(); ++i) {
    CAPTURE(i);
    CHECK((log_scale.grad()[i] != 0) == (i % 5 != 0 && w[i] > 0));
  }
}

TEST_CASE("sigma_loss by hand") {
  const auto h = BasicTensor<double>::from({1, 4}, {3, 3, 100, 5}),
             s = BasicTensor<double>::from({1, 4}, {0, std::log(8.0), 0, 9}),
             t = BasicTensor<double>::from({1, 4}, {1, 4, kNan, 5});
  const auto loss = [&](const std::vector<double>& weight) {
    return sigma_loss(h, BasicVar<double>(s), t, BasicTensor<double>::from({1, 4}, weight), 0.5,
                      0.5, 2.25)
        .value()
        .item();
  };
  // as likely within s as not where the error is s
  const auto within = [](double error_in_sigmas) {
    return 1 / (1 + std::pow(error_in_sigmas, 1 / 0.15));
  };
  // errors of 4 and 2 units where sigma is 0.5 and 4
  const double first = within(8) - 2.25 * within(4), second = within(0.5) - 2.25 * within(0.25);
  CHECK(loss({1, 0, 0, 0}) == doctest::Approx(first));
  CHECK(loss({0, 1, 0, 0}) == doctest::Approx(second));
  CHECK(second == doctest::Approx(-1.25).epsilon(0.01));
  CHECK(loss({1, 3, 0, 0}) == doctest::Approx((first + 3 * second) / 4));
  CHECK(loss({0, 0, 0, 1}) == doctest::Approx(-1.25));  // no error
  CHECK(loss({0, 0, 0, 0}) == 0);
}

TEST_CASE("sigma_loss is least at the standard deviation of normal errors") {
  const Index n = 20000;
  const BasicTensor<double> h = normal({1, n}, 3, 2), t({1, n});
  const auto ones = BasicTensor<double>({1, n}, 1);
  const auto loss = [&](double sigma) {
    const BasicTensor<double> s({1, n}, std::log(sigma / 2.5 / 0.7));
    return sigma_loss(h, BasicVar<double>(s), t, ones, 0.7, 2.5, std::exp(1.5) / 2).value().item();
  };
  double best = 0.5;
  for (double s = 0.5; s < 8; s *= 1.01)
    if (loss(s) < loss(best)) best = s;
  CHECK(best == doctest::Approx(2).epsilon(0.05));
}

TEST_CASE("sigma_loss: gradient") {
  const auto t = normal({6, 7}, 3, 3), h = normal({6, 7}, 1, 3);
  BasicTensor<double> w = normal({6, 7}, 4);
  for (double& v : w.values()) v = std::max(v, 0.0);
  BasicTensor<double> s = normal({6, 7}, 2);
  for (Index i = 0; i < s.count(); i += 5) s[i] = i % 2 == 0 ? 9 : -9;  // beyond the limits
  const auto loss = [&](const BasicVar<double>& of) {
    return sigma_loss(h, of, t, w, 0.7, 2.3, 2.24);
  };
  CHECK(gradcheck([&](const test::DoubleVars& v) { return loss(v[0]); }, {s}));
  const BasicVar<double> log_scale(s, true);
  loss(log_scale).backward();
  for (Index i = 0; i < s.count(); ++i) {
    CAPTURE(i);
    CHECK((log_scale.grad()[i] != 0) == (i % 5 != 0 && w[i] > 0));
  }
  CHECK_THROWS_AS(sigma_loss(h, BasicVar<double>(normal({7, 6}, 1)), t, w, 0.7, 2.3, 2.24),
                  ShapeError);
}

TEST_CASE("the losses of candidates give the same bits for any number of threads") {
  const Shape map{90, 70};
  Tensor weight = normal(map, 6).cast<float>(), z = normal({4, 90, 70}, 5).cast<float>();
  for (float& v : weight.values()) v = std::max(v, 0.f);
  for (Index i = 0; i < z.count(); i += 7) z[i] = std::numeric_limits<float>::quiet_NaN();
  const Tensor truth = normal(map, 7).cast<float>();
  const auto run = [&](int threads) {
    set_threads(threads);
    const Var h(normal(map, 1).cast<float>(), true), s(normal(map, 2).cast<float>(), true),
        l(normal({4, 90, 70}, 3).cast<float>(), true);
    const Var likelihood = laplace_loss(h, s, truth, weight, 0.5),
              entropy = candidate_cross_entropy(l, z, truth, weight, 0.5),
              sigma = sigma_loss(h.value(), s, truth, weight, 0.5, 1.148, 2.24);
    likelihood.backward();
    entropy.backward();
    sigma.backward();
    set_threads(0);
    return std::vector<Tensor>{likelihood.value(), entropy.value(), sigma.value(),
                               h.grad(),           s.grad(),        l.grad()};
  };
  const auto one = run(1), two = run(2);
  CHECK(one[0].item() > 0);
  CHECK(one[1].item() > 0);
  for (std::size_t k = 0; k < one.size(); ++k)
    for (Index i = 0; i < one[k].count(); ++i) REQUIRE(one[k][i] == two[k][i]);
}

TEST_CASE("candidate_cross_entropy by hand") {
  // Candidates 0 and 3 m with weights 0.25 and 0.75 in three cells.
  const auto z = BasicTensor<double>::from({2, 1, 3}, {0, 0, 0, 3, kNan, 3});
  BasicTensor<double> logits({2, 1, 3});
  for (Index i = 3; i < 6; ++i) logits[i] = std::log(3.0);
  const auto loss = [&](const std::vector<double>& truth, const std::vector<double>& weight) {
    return candidate_cross_entropy(BasicVar<double>(logits), z,
                                   BasicTensor<double>::from({1, 3}, truth),
                                   BasicTensor<double>::from({1, 3}, weight), 1.0)
        .value()
        .item();
  };
  const double q = 1 / (1 + std::exp(-1.0));  // of a truth at 1 m: e^-1 against e^-2
  CHECK(loss({1, 0, 0}, {2, 0, 0}) ==
        doctest::Approx(-q * std::log(0.25) - (1 - q) * std::log(0.75)));
  CHECK(loss({0, 1, 0}, {0, 1, 0}) == doctest::Approx(0));  // there is no other
  CHECK(loss({0, 0, 7.5}, {0, 0, 1}) == 0);                 // out of reach of both
}

TEST_CASE("candidate_cross_entropy: gradient") {
  const auto z = some_candidates(), t = normal({4, 5}, 3, 3);
  BasicTensor<double> w({4, 5}, 1.0);
  w[3] = 0, w[9] = 2;
  CHECK(gradcheck(
      [&](const test::DoubleVars& v) { return candidate_cross_entropy(v[0], z, t, w, 0.8); },
      {normal({3, 4, 5}, 1)}));
}

TEST_CASE("what does not fit is refused") {
  const BasicVar<double> logits{BasicTensor<double>({3, 4, 5})}, wrong{BasicTensor<double>({4, 6})};
  CHECK_THROWS_WITH_AS(chosen_height(logits, wrong, some_candidates(), 1),
                       "chosen_height: residual has shape [4,6], expected [H W] with H=4 from "
                       "logits, W=5 from logits",
                       ShapeError);
  const BasicTensor<double> many({17, 1, 1});
  const BasicTensor<double> one({1, 1});
  CHECK_THROWS_WITH_AS(chosen_height(BasicVar<double>(many), BasicVar<double>(one), many, 1),
                       "chosen_height: candidates has shape [17,1,1], expected K of at most 16",
                       ShapeError);
  CHECK_THROWS_WITH_AS(
      candidate_cross_entropy(BasicVar<double>(many), many, one, one, 1),
      "candidate_cross_entropy: candidates has shape [17,1,1], expected K of at most 16",
      ShapeError);
}
