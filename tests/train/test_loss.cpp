// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/resize.h"
#include "satsurf/splat/view.h"
#include "satsurf/train/loss.h"

#include <array>
#include <cmath>
#include <string>

#include "tests/affine_scene.h"
#include "tests/gradcheck.h"
#include "tests/small_lpips.h"

using namespace satsurf;
using namespace satsurf::scene;
using namespace satsurf::test;
using namespace satsurf::train;

namespace {

constexpr Index kSide = 32;

/// Three sources and a target of a hill, with its heights.
Crop hill() {
  const auto surface = [](double x, double y) {
    return 2 * std::cos(0.3 * x) * std::cos(0.25 * y);
  };
  auto views =
      affine_scene(kSide, {{0.8, 0.1}, {-0.7, 0.3}, {0.1, -0.8}, {0.4, 0.5}}, -6, 6, surface);
  const auto heights = [&](const nn::PosedImage& view, Index stride) {
    const Index side = kSide / stride;
    Tensor z({side, side});
    for (Index i = 0; i < side * side; ++i) {
      const double half = 0.5 * static_cast<double>(stride - 1), step = static_cast<double>(stride);
      const double px = static_cast<double>(i % side) * step + half,
                   py = static_cast<double>(i / side) * step + half;
      double at = 0;
      for (int k = 0; k < 30; ++k) {
        const auto p = view.local_from_pixel(px, py, at);
        at = surface(p[0], p[1]);
      }
      z[i] = static_cast<float>(at);
    }
    return z;
  };
  Crop crop;
  crop.source_truth.resize(3);
  for (std::size_t s = 0; s < 3; ++s)
    for (std::size_t n = 0; n < 3; ++n)
      crop.source_truth[s].push_back(heights(views.sources[n], nn::kStrides[s]));
  crop.target_truth = heights(views.sources[3], 1);
  crop.target = views.sources[3];
  views.sources.resize(3);
  views.transfer.resize(3);
  for (auto& row : views.transfer) row.resize(3);
  crop.input = std::move(views);
  return crop;
}

using Stages = std::array<nn::StageOutput<float>, 3>;

/// What a network with all its parts makes of it, before training.
struct Made {
  nn::ModelConfig model = nn::model_preset("tiny_full");
  Crop crop = hill();
  Stages stages = nn::Model(model, 1).forward(crop.input);

  double total(const LossConfig& config, const LossContext& context = {}) const {
    return static_cast<double>(
        training_loss(config, model, stages, crop, context).total.value().item());
  }
};

/// Nothing but what the caller turns on, in the last stage.
LossConfig silent() {
  LossConfig c;
  c.stage_weight = {0, 0, 1};
  c.height_weight = c.render_height_weight = c.geo_weight = 0;
  c.colour_weight = c.ssim_weight = c.lpips_weight = 0;
  return c;
}

const LossContext kLate{.step = 100'000, .seed = 3};

/// Colours rendered in the target, what they should be, and where they count.
struct TargetView {
  Tensor colour, image, opaque;
};
TargetView target_view(const Made& made, std::size_t s) {
  const nn::PosedImage& view = *made.crop.target;
  const auto render = splat::render_view(made.stages[s].surfels, view.pixel_from_local, kSide,
                                         kSide, nn::kStrides[s]);
  TargetView out{render.colour.value(), area_downsample(Var(view.rgb), nn::kStrides[s]).value(),
                 render.alpha.value().clone()};
  for (float& a : out.opaque.values()) a = a > 0.5f ? 1.f : 0.f;
  return out;
}

double squared_error(const TargetView& v) {
  double sum = 0, count = 0;
  for (Index i = 0; i < v.colour.count(); ++i) {
    const double e = static_cast<double>(v.colour[i] - v.image[i]);
    const double counts = static_cast<double>(v.opaque[i % v.opaque.count()]);
    sum += counts * e * e, count += counts;
  }
  return sum / count;
}

}  // namespace

TEST_CASE("every loss term counts, and stages by their weights") {
  const Made made;
  LossConfig terms;
  double before = made.total(terms);
  for (double LossConfig::*term : {&LossConfig::colour_weight, &LossConfig::ssim_weight,
                                   &LossConfig::geo_weight, &LossConfig::render_height_weight}) {
    terms.*term = 0;
    const double after = made.total(terms);
    CHECK(after < before);
    before = after;
  }
  terms.height_weight = 2;  // those of the heights alone are left
  CHECK(made.total(terms) == doctest::Approx(2 * before));

  const LossConfig all;
  CHECK(all.stage_weight == std::array<double, 3>{0.5, 1, 2});
  double sum = 0;
  for (std::size_t s = 0; s < 3; ++s) {
    LossConfig one;
    one.stage_weight = {0, 0, 0};
    one.stage_weight[s] = all.stage_weight[s];
    sum += made.total(one);
  }
  CHECK(made.total(all) == doctest::Approx(sum));
  CHECK_THROWS_AS(made.total(silent()), Error);
}

TEST_CASE("the height and colour losses are what they are defined as") {
  const Made made;
  LossConfig heights = silent();
  heights.height_weight = 3;
  heights.height_beta = 0.7;
  double sum = 0;
  const Tensor& found = made.stages[2].height.value();
  for (Index n = 0; n < 3; ++n)
    for (Index i = 0; i < kSide * kSide; ++i) {
      const Tensor& truth = made.crop.source_truth[2][static_cast<std::size_t>(n)];
      const double d = std::abs(static_cast<double>(found[n * kSide * kSide + i] - truth[i]));
      sum += d < 0.7 ? 0.5 * d * d / 0.7 : d - 0.35;
    }
  CHECK(made.total(heights) == doctest::Approx(3 * sum / (3 * kSide * kSide)).epsilon(1e-5));

  LossConfig colours = silent();
  colours.colour_weight = 2;
  colours.routing = Routing::none;
  CHECK(made.total(colours) ==
        doctest::Approx(2 * squared_error(target_view(made, 2))).epsilon(1e-4));
}

TEST_CASE("the loss of the distribution, and of heights within reach") {
  const Crop crop = hill();
  const nn::ModelConfig config = nn::model_preset("tiny");
  const auto stages = nn::Model(config, 2).forward(crop.input);
  const auto total = [&](const LossConfig& loss) {
    return static_cast<double>(training_loss(loss, config, stages, crop).total.value().item());
  };
  LossConfig only;
  only.colour_weight = only.ssim_weight = only.lpips_weight = only.render_height_weight = 0;
  only.geo_weight = 0;
  CHECK(wanted_by(only, true) == nn::Wanted::heights);
  CHECK(wanted_by({}, true) == nn::Wanted::surfels);
  CHECK(wanted_by({}, false) == nn::Wanted::heights);
  LossConfig distribution = only;
  distribution.height_weight = 0;
  distribution.distribution_weight = 1;
  distribution.stage_weight = {1, 0, 0};
  // An untrained network gives every height about the same probability.
  CHECK(total(distribution) ==
        doctest::Approx(std::log(static_cast<double>(config.hypotheses[0]))).epsilon(0.2));
  // A truth that no stage but the first searches for teaches the others nothing.
  Crop far = crop;
  for (std::size_t s = 1; s < 3; ++s)
    for (Tensor& map : far.source_truth[s]) map = Tensor(map.shape(), 1000.f);
  LossConfig in_reach = only;
  in_reach.stage_weight = {0, 1, 1};
  const auto far_loss = [&](const LossConfig& loss) {
    return static_cast<double>(training_loss(loss, config, stages, far).total.value().item());
  };
  CHECK(far_loss(in_reach) > 900);
  in_reach.height_in_reach = true;
  in_reach.distribution_weight = 1;
  CHECK(far_loss(in_reach) == 0);
}

TEST_CASE("a mode on another surface is not drawn to the true one") {
  const Crop crop = hill();
  nn::ModelConfig config = nn::model_preset("tiny");
  config.height = nn::HeightOf::mode;
  auto stages = nn::Model(config, 2).forward(crop.input);
  nn::StageOutput<float>& last = stages[2];
  const Index D = last.hypotheses.dim(1), P = last.height.dim(1) * last.height.dim(2);
  LossConfig loss = silent();
  loss.height_weight = 1, loss.height_in_reach = true;
  // Found heights lie a share of the spacing beside true ones, which are in the middle of the search.
  const auto loss_at = [&](float spacings) {
    Crop told = crop;
    Tensor height(last.height.shape());
    for (Index i = 0; i < height.count(); ++i) {
      const float* h = last.hypotheses.data() + i / P * D * P + i % P;
      const float spacing = (h[(D - 1) * P] - h[0]) / static_cast<float>(D - 1);
      const float truth = (h[0] + h[(D - 1) * P]) / 2;
      told.source_truth[2][static_cast<std::size_t>(i / P)][i % P] = truth;
      height[i] = truth + spacings * spacing;
    }
    last.height = Var(height);
    return static_cast<double>(training_loss(loss, config, stages, told).total.value().item());
  };
  CHECK(loss_at(0) == doctest::Approx(0));
  CHECK(loss_at(1.9F) > 0);
  CHECK(loss_at(-1.9F) == doctest::Approx(loss_at(1.9F)).epsilon(1e-3));
  CHECK(loss_at(2.1F) == 0);
  CHECK(loss_at(-3) == 0);
  loss.height_in_reach = false;
  CHECK(loss_at(2.1F) > loss_at(1.9F));
}

TEST_CASE("appearance learns from confident pixels, from all while it warms up") {
  Made made;
  LossConfig routed = silent();
  routed.colour_weight = 1;
  LossConfig everywhere = routed;
  everywhere.routing = Routing::none;
  const LossContext warm{.step = routed.appearance_warmup - 1, .seed = 3},
      after{.step = routed.appearance_warmup, .seed = 3};
  const double all = made.total(everywhere, kLate);
  const auto with_confidence = [&](const std::array<float, 3>& of_view) {
    auto& aux = made.stages[2].surfels.aux;
    Tensor values(aux.shape());
    for (Index i = 0; i < values.count(); ++i)
      values[i] = of_view[static_cast<std::size_t>(i / (kSide * kSide))];
    aux = Var(values);
  };
  with_confidence({0.1f, 0.1f, 0.1f});
  CHECK(made.total(routed, after) == 0);
  CHECK(made.total(routed, warm) == doctest::Approx(all));
  with_confidence({0.9f, 0.9f, 0.9f});
  CHECK(made.total(routed, after) == doctest::Approx(all));
  with_confidence({0.1f, 0.35f, 0.1f});
  const double some = made.total(routed, after);
  CHECK(some > 0);
  CHECK(some < 0.95 * all);  // a mean over all pixels, also those that learn nothing
  routed.routing_tau = 0.4;
  CHECK(made.total(routed, after) == 0);
}

TEST_CASE("correlation learns from doubtful pixels") {
  Made made;
  nn::StageOutput<float>& stage = made.stages[2];
  const auto relative = [&](float factor, float offset) {
    stage.mono_height = stage.height.value().clone();
    for (float& z : stage.mono_height.values()) z = factor * z + offset;
  };
  const auto confident = [&](float left, float right) {
    stage.joint_confidence = Tensor(stage.height.shape());
    for (Index i = 0; i < stage.joint_confidence.count(); ++i)
      stage.joint_confidence[i] = i % kSide < kSide / 2 ? left : right;
  };
  LossConfig routed = silent();
  routed.geo_weight = 1;
  LossConfig everywhere = routed;
  everywhere.routing = Routing::none;

  confident(0.1f, 0.1f);
  relative(2, 5);  // unit and offset do not matter
  CHECK(made.total(everywhere, kLate) < 0.01);
  relative(-1, 0);  // rho = -1: local is 2, global 2 z^2, z of deviation 1 over the map
  const double all = made.total(everywhere, kLate);
  CHECK(all > 1);
  CHECK(all < 2.05);
  CHECK(made.total(routed, kLate) == doctest::Approx(all));
  confident(0.9f, 0.9f);
  CHECK(made.total(routed, kLate) == 0);
  confident(0.1f, 0.9f);
  const double half = made.total(routed, kLate);
  CHECK(half > 0.3 * all);
  CHECK(half < 0.7 * all);
  CHECK(made.total(routed, {.step = 100'001, .seed = 3}) != half);  // other patches

  routed.geo_target = GeoTarget::dsm;
  const double dsm = made.total(routed, kLate);
  routed.geo_target = GeoTarget::both;
  CHECK(made.total(routed, kLate) == doctest::Approx(dsm + half));
  stage.mono_height = {};  // without a branch there is nothing relative to learn from
  CHECK(made.total(routed, kLate) == doctest::Approx(dsm));
  routed.geo_target = GeoTarget::mono;
  CHECK_THROWS_AS(made.total(routed, kLate), Error);
}

TEST_CASE("the perceptual term, in stages large enough for its network") {
  const Made made;
  const nn::Lpips lpips = small_lpips();
  REQUIRE(lpips.smallest_side() > kSide / 2);
  REQUIRE(lpips.smallest_side() <= kSide);
  LossConfig config = silent();
  config.stage_weight = {5, 7, 2};
  config.lpips_weight = 0.3;
  config.routing = Routing::none;
  const TargetView target = target_view(made, 2);
  const double distance =
      static_cast<double>(lpips(Var(target.colour), target.image, target.opaque).value().item());
  REQUIRE(distance > 1e-4);
  CHECK(made.total(config, {.lpips = &lpips}) == doctest::Approx(2 * 0.3 * distance).epsilon(1e-5));
  CHECK_THROWS_AS(made.total(config), Error);  // no network, no other term
}

TEST_CASE("the losses of presets") {
  LossConfig paper;
  paper.height_weight = paper.render_height_weight = 0;
  paper.appearance_warmup = 0;
  LossConfig cascade;
  cascade.routing = Routing::none;
  cascade.geo_weight = 0;
  LossConfig others = cascade;
  others.ssim_weight = 0;
  others.lpips_weight = 0.05;
  LossConfig mvsplat = others, hisplat = others, skysplat = others;
  mvsplat.stage_weight = skysplat.stage_weight = {0, 0, 2};
  hisplat.stage_weight = {1, 1, 1};
  skysplat.geo_weight = 1;
  CHECK(loss_preset("base8") == LossConfig());
  CHECK(loss_preset("base16") == LossConfig());
  LossConfig distribution;
  distribution.distribution_weight = 1;
  distribution.height_in_reach = true;
  distribution.height_weight = 0.3;
  CHECK(loss_preset("wide8") == distribution);
  CHECK(loss_preset("paper") == paper);
  CHECK(loss_preset("cascade8") == cascade);
  CHECK(loss_preset("mvsplat_like") == mvsplat);
  CHECK(loss_preset("hisplat_like") == hisplat);
  CHECK(loss_preset("skysplat_like") == skysplat);
  CHECK_THROWS_AS(loss_preset("base9"), ConfigError);

  const LossConfig c;
  CHECK(c.height_weight == 1);
  CHECK(c.render_height_weight == 0.1);
  CHECK(c.geo_weight == 0.01);
  CHECK(c.geo_target == GeoTarget::mono);
  CHECK(c.colour_weight == 1);
  CHECK(c.ssim_weight == 0.05);
  CHECK(c.lpips_weight == 0.1);
  CHECK(c.routing == Routing::cbrl);
  CHECK(c.routing_tau == 0.2);
}
