// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/fusion.h"
#include "satsurf/nn/guidance.h"
#include "satsurf/ops/resize.h"

#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "tests/gradcheck.h"
#include "tests/ref/conv_ref.h"

using namespace satsurf;
using namespace satsurf::test;

namespace {

using Parameters = nn::ParameterSet<double>;

/// Random values for every parameter, biases too: nothing that starts at zero hides what is behind.
std::map<std::string, Doubles> randomised(const Parameters& p, std::uint64_t seed) {
  std::map<std::string, Doubles> values;
  for (const auto& e : p.entries()) {
    BasicVar<double> v = e.var;
    v.mutable_value() = normal(v.shape(), ++seed, 0.4);
    values[e.name] = v.value();
  }
  return values;
}

DoubleVars vars_of(const Parameters& p, std::vector<BasicVar<double>> more) {
  for (const auto& e : p.entries()) more.push_back(e.var);
  return more;
}

Doubles confidences(const Shape& shape, std::uint64_t seed) {
  Rng rng(seed);
  Doubles c(shape);
  for (double& v : c.values()) v = rng.uniform();
  return c;
}

/// A 1 x 1 convolution at one pixel.
std::vector<double> linear(const std::map<std::string, Doubles>& p, const std::string& name,
                           const std::vector<double>& x) {
  const Doubles &w = p.at(name + ".weight"), &b = p.at(name + ".bias");
  std::vector<double> y;
  for (Index o = 0; o < w.dim(0); ++o) {
    double sum = b[o];
    for (Index i = 0; i < w.dim(1); ++i)
      sum += w[o * w.dim(1) + i] * x[static_cast<std::size_t>(i)];
    y.push_back(sum);
  }
  return y;
}

double dot(const std::vector<double>& a, const std::vector<double>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
  return sum;
}

std::vector<double> pixel(const Doubles& t, Index n, Index at) {
  const Index P = t.dim(2) * t.dim(3);
  std::vector<double> x;
  for (Index c = 0; c < t.dim(1); ++c) x.push_back(t[(n * t.dim(1) + c) * P + at]);
  return x;
}

/// A convolution that keeps the size, of maps [1 C H W].
Doubles convolved(const std::map<std::string, Doubles>& p, const std::string& name,
                  const Doubles& x) {
  const Doubles &w = p.at(name + ".weight"), &b = p.at(name + ".bias");
  const Index O = w.dim(0), K = w.dim(2), H = x.dim(2), W = x.dim(3);
  const conv::Geometry g{.C = w.dim(1),
                         .O = O,
                         .x_size = {1, H, W},
                         .y_size = {1, H, W},
                         .kernel = {1, K, K},
                         .stride = {1, 1, 1},
                         .padding = {0, K / 2, K / 2}};
  Doubles y = correlate_ref(g, x, w).reshaped({1, O, H, W});
  for (Index i = 0; i < y.count(); ++i) y[i] += b[i / (H * W)];
  return y;
}

constexpr Index kViews = 2, kChannels = 4, kMono = 3, kRows = 3, kColumns = 5;
const Shape kFeatureShape{kViews, kChannels, kRows, kColumns},
    kMonoShape{kViews, kMono, kRows, kColumns}, kMapShape{kViews, kRows, kColumns};

nn::ModelConfig fusion_config(const std::string& start) {
  nn::ModelConfig config;
  if (start == "naive")
    config.fusion = nn::Fusion::naive;
  else
    config.fusion_start = enum_from<nn::FusionStart>(start, "test");
  config.fusion_lambda = 1.7;
  config.fusion_tau = 0.35;
  return config;
}

}  // namespace

TEST_CASE("fusion is the published one, pixel by pixel") {
  const Doubles features = normal(kFeatureShape, 1), mono = normal(kMonoShape, 2),
                confidence = confidences(kMapShape, 3);
  for (const std::string start : {"paper", "gated", "additive", "naive"}) {
    CAPTURE(start);
    Parameters p(1);
    const nn::FeatureFusion<double> fusion(p, "f", fusion_config(start), kChannels, kMono);
    const auto w = randomised(p, 10);
    const Doubles fused =
        fusion(BasicVar<double>(features), BasicVar<double>(mono), confidence).value();
    REQUIRE(fused.shape() == kFeatureShape);
    double least = 1, most = 0;
    for (Index n = 0; n < kViews; ++n)
      for (Index i = 0; i < kRows * kColumns; ++i) {
        const auto f = pixel(features, n, i), m = pixel(mono, n, i), got = pixel(fused, n, i);
        std::vector<double> wanted;
        if (start == "naive") {
          auto both = f;
          both.insert(both.end(), m.begin(), m.end());
          wanted = linear(w, "f.joined", both);
        } else {
          const double b = 1.7 * (confidence[n * kRows * kColumns + i] - 0.35),
                       root = std::sqrt(4.0);
          const auto q = linear(w, "f.query", f);
          const double l_mvs = dot(q, linear(w, "f.key_features", f)) / root + b;
          const double l_mono = dot(q, linear(w, "f.key_mono", m)) / root - b +
                                (start == "gated" ? w.at("f.offset")[0] : 0);
          const double weight = std::exp(l_mono) / (std::exp(l_mvs) + std::exp(l_mono));
          least = std::min(least, weight), most = std::max(most, weight);
          const auto v_m = linear(w, "f.value_features", f), v_o = linear(w, "f.value_mono", m);
          for (std::size_t c = 0; c < v_m.size(); ++c)
            wanted.push_back((start == "additive" ? 1 : 1 - weight) * v_m[c] + weight * v_o[c]);
        }
        for (std::size_t c = 0; c < wanted.size(); ++c)
          REQUIRE(got[c] == doctest::Approx(wanted[c]).epsilon(1e-10));
      }
    if (start != "naive") CHECK(most - least > 0.3);  // the weights really differ
  }
}

TEST_CASE("all views at once and one after the other are the same") {
  const Doubles coarse = confidences({kViews, 2, 3}, 3);
  const BasicVar<double> features(normal(kFeatureShape, 1)), mono(normal(kMonoShape, 2));
  Parameters p(1);
  const nn::FeatureFusion<double> fusion(p, "f", fusion_config("gated"), kChannels, kMono);
  randomised(p, 10);
  const Doubles confidence = resize_bilinear(BasicVar<double>(coarse), kRows, kColumns).value();
  const Doubles at_once = fusion(features, mono, confidence).value(),
                by_view = fusion.fuse_views(features, mono, coarse).value();
  REQUIRE(by_view.shape() == kFeatureShape);
  for (Index i = 0; i < at_once.count(); ++i)
    REQUIRE(by_view[i] == doctest::Approx(at_once[i]).epsilon(1e-12));
}

TEST_CASE("fusion without a monocular branch") {
  const Doubles features = normal(kFeatureShape, 1), confidence = confidences(kMapShape, 3);
  for (const std::string start : {"paper", "gated", "additive", "naive"}) {
    CAPTURE(start);
    Parameters p(1);
    const nn::FeatureFusion<double> fusion(p, "f", fusion_config(start), kChannels, 0);
    const auto w = randomised(p, 10);
    const Doubles fused = fusion(BasicVar<double>(features), {}, confidence).value();
    for (Index n = 0; n < kViews; ++n)
      for (Index i = 0; i < kRows * kColumns; ++i) {
        const auto f = pixel(features, n, i), got = pixel(fused, n, i);
        const auto wanted = start == "naive" ? f : linear(w, "f.value_features", f);
        for (std::size_t c = 0; c < wanted.size(); ++c)
          REQUIRE(got[c] == doctest::Approx(wanted[c]).epsilon(1e-10));
      }
  }
}

TEST_CASE("what fusion is before training") {
  const Doubles features = normal(kFeatureShape, 1), mono = normal(kMonoShape, 2),
                confidence = confidences(kMapShape, 3);
  const auto fused = [&](const std::string& start) {
    Parameters p(1);
    const nn::FeatureFusion<double> fusion(p, "f", fusion_config(start), kChannels, kMono);
    return fusion(BasicVar<double>(features), BasicVar<double>(mono), confidence).value();
  };
  const Doubles additive = fused("additive"), gated = fused("gated"), paper = fused("paper");
  double apart = 0;
  for (Index i = 0; i < features.count(); ++i) {
    CHECK(additive[i] == features[i]);
    // (1 - W) F with W = sigmoid(-4 - 2 b), b between -0.595 and 1.105
    CHECK(gated[i] / features[i] > 0.94);
    CHECK(gated[i] / features[i] < 1);
    apart = std::max(apart, std::abs(paper[i] - features[i]));
  }
  CHECK(apart > 0.5);
}

TEST_CASE("gradients of fusion in double, to its inputs and every parameter") {
  const Doubles confidence = confidences(kMapShape, 3);
  for (const std::string start : {"paper", "gated", "additive", "naive"}) {
    CAPTURE(start);
    Parameters p(1);
    const nn::FeatureFusion<double> fusion(p, "f", fusion_config(start), kChannels, kMono);
    randomised(p, 10);
    const BasicVar<double> features(normal(kFeatureShape, 1), true),
        mono(normal(kMonoShape, 2), true);
    CHECK(gradcheck_of([&] { return fusion(features, mono, confidence); },
                       vars_of(p, {features, mono})));
  }
}

TEST_CASE("guidance adds the gated residual, and nothing before training") {
  const Shape map{1, 5, 6, 7};
  const BasicVar<double> x(normal(map, 1), true), residual(normal({1, 3, 6, 7}, 2), true);
  Parameters p(1);
  const nn::CrossStageGuidance<double> guidance(p, "g", {}, 5);
  const Doubles fresh = guidance(x, residual).value();
  for (Index i = 0; i < fresh.count(); ++i) REQUIRE(fresh[i] == x.value()[i]);

  const auto w = randomised(p, 20);
  const auto rectified = [](Doubles t) {
    for (double& v : t.values()) v = std::max(v, 0.0);
    return t;
  };
  const Doubles gate = convolved(w, "g.gate2", rectified(convolved(w, "g.gate1", x.value()))),
                added = convolved(w, "g.residual2",
                                  rectified(convolved(w, "g.residual1", residual.value())));
  const Doubles out = guidance(x, residual).value();
  for (Index i = 0; i < out.count(); ++i)
    REQUIRE(out[i] ==
            doctest::Approx(x.value()[i] + added[i] / (1 + std::exp(-gate[i]))).epsilon(1e-9));

  CHECK(gradcheck_of([&] { return guidance(x, residual); }, vars_of(p, {x, residual})));
}

TEST_CASE("the residual of colours is image less rendering where both are known") {
  const Index h = 4, w = 6;
  const Doubles image = normal({1, 3, h, w}, 1);
  Doubles valid({1, h, w}, 1.0), rendered({1, 3, h / 2, w / 2}), alpha({1, h / 2, w / 2}, 1.0);
  for (Index c = 0; c < 3; ++c)
    for (Index i = 0; i < h * w / 4; ++i)
      rendered[c * h * w / 4 + i] = 0.1 * static_cast<double>(c);
  valid[w - 1] = 0.2;  // top right: no data
  alpha[w / 2] = 0.3;  // bottom left: not covered
  const Doubles r =
      nn::photometric_residual<double>({.image = image, .validity = valid}, {rendered, alpha});
  REQUIRE(r.shape() == Shape{1, 3, h, w});
  for (Index c = 0; c < 3; ++c)
    for (Index y = 0; y < h; ++y)
      for (Index x = 0; x < w; ++x) {
        CAPTURE(y);
        CAPTURE(x);
        // bilinear samples of the lower left pixel reach rows 1 to 3 of columns 0 to 2
        const bool known = !(y == 0 && x == w - 1) && !(y >= 1 && x <= 2);
        const Index at = (c * h + y) * w + x;
        if (known)
          CHECK(r[at] == doctest::Approx(image[at] - 0.1 * static_cast<double>(c)));
        else
          CHECK(r[at] == 0);
      }
}
