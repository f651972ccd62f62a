// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/block_pool.h"
#include "satsurf/core/parallel.h"
#include "satsurf/nn/adamw.h"
#include "satsurf/nn/hypotheses.h"
#include "satsurf/nn/model.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/loss.h"
#include "satsurf/ops/reduce.h"
#include "satsurf/ops/resize.h"
#include "satsurf/splat/view.h"

#include <array>
#include <cmath>
#include <optional>

#include "tests/affine_scene.h"
#include "tests/gradcheck.h"

using namespace satsurf;
using namespace satsurf::test;

namespace {

nn::NetworkInput hill(Index size = 32) {
  return affine_scene(size, {{0.8, 0.1}, {-0.7, 0.3}, {0.1, -0.8}}, -6, 6, [](double x, double y) {
    return 2 * std::cos(0.3 * x) * std::cos(0.25 * y);
  });
}

/// Heights of all stages and the colours rendered into the first source, as one number.
template <class T>
BasicVar<T> objective(const nn::BasicModel<T>& model, const nn::NetworkInput& scene) {
  const auto stages = model.forward(scene);
  BasicVar<T> total;
  for (const auto& stage : stages) {
    const auto render =
        splat::render_view(stage.surfels, scene.sources[0].pixel_from_local,
                           scene.sources[0].rgb.dim(1), scene.sources[0].rgb.dim(2), stage.stride);
    const BasicVar<T> term = mean(stage.height * stage.height) +
                             mean(render.colour * render.colour) +
                             affine(mean(render.height), T(0.1), T(0)) + mean(stage.confidence);
    total = total.empty() ? term : total + term;
  }
  return total;
}

}  // namespace

TEST_CASE("the memory of a forward pass is known before, part by part") {
  const NoGrad no_grad;
  const auto check_of = [](const nn::ModelConfig& config, std::size_t views, Index side,
                           nn::Wanted wanted) {
    CAPTURE(views);
    CAPTURE(side);
    const nn::Model model(config, 1);
    auto scene = affine_scene(side, {{0.8, 0.1}, {-0.7, 0.3}, {0.1, -0.8}, {0.5, 0.5}, {-0.2, 0.6}},
                              -6, 6, [](double, double) { return 0.0; });
    scene.sources.resize(views), scene.transfer.resize(views);
    for (auto& row : scene.transfer) row.resize(views);
    const auto before = static_cast<double>(tensor_bytes());
    reset_peak_tensor_bytes();
    std::vector<nn::PartMemory> measured;
    model.forward(scene, {}, &measured, wanted);
    const auto planned = nn::forward_memory(config, static_cast<Index>(views), side, side, wanted);
    const std::size_t behind = wanted == nn::Wanted::surfels ? 3
                               : wanted == nn::Wanted::discs ? 1
                                                             : 0,
                      parts = 1 + nn::stages_of(wanted) + behind;
    REQUIRE(measured.size() == parts);
    REQUIRE(planned.size() == parts);
    double most = 0;
    for (std::size_t i = 0; i < parts; ++i) {
      CAPTURE(measured[i].part);
      CHECK(planned[i].part == measured[i].part);
      CHECK(planned[i].bytes / measured[i].bytes == doctest::Approx(1).epsilon(0.1));
      most = std::max(most, measured[i].bytes);
    }
    CHECK(nn::forward_bytes(config, static_cast<Index>(views), side, side, wanted) / most ==
          doctest::Approx(1).epsilon(0.1));
    CHECK(static_cast<double>(peak_tensor_bytes()) == before + most);  // measuring hides nothing
  };
  const auto check = [&](const char* preset, std::size_t views, Index side,
                         nn::Wanted wanted = nn::Wanted::surfels) {
    CAPTURE(preset);
    check_of(nn::model_preset(preset), views, side, wanted);
  };
  for (const std::size_t views : {2, 3, 5}) check("tiny", views, 256);
  check("tiny_full", 3, 256);
  check("base8", 3, 192);
  for (const nn::Wanted wanted :
       {nn::Wanted::coarse_heights, nn::Wanted::heights, nn::Wanted::discs}) {
    check("tiny_full", 3, 256, wanted);
    check("base8", 3, 192, wanted);
  }
  nn::ModelConfig pairs = nn::model_preset("wide8");
  pairs.visible_pairs = true;
  for (const std::size_t views : {2, 3, 5}) check_of(pairs, views, 192, nn::Wanted::heights);
}

#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)  // they get blocks of malloc's
TEST_CASE("a second pass of a size asks the system for no memory") {
  const NoGrad no_grad;
  const nn::Model model(nn::model_preset("tiny"), 1);
  const auto scene =
      affine_scene(192, {{0.8, 0.1}, {-0.7, 0.3}}, -6, 6, [](double, double) { return 0.0; });
  model.forward(scene);
  const std::size_t reserved = reserved_tensor_bytes();
  CHECK(reserved > 0);
  model.forward(scene);
  model.forward(scene);
  CHECK(reserved_tensor_bytes() == reserved);
}
#endif

TEST_CASE("discs lie where the surfels do, and are all alike") {
  const NoGrad no_grad;
  const nn::Model model(nn::model_preset("tiny_full"), 1);
  const auto scene = hill();
  const auto whole = model.forward(scene),
             light = model.forward(scene, {}, nullptr, nn::Wanted::discs);
  CHECK(light[0].surfels.means.empty());
  CHECK(light[1].surfels.means.empty());
  const auto same = [](const Var& a, const Var& b) {
    return std::ranges::equal(a.value().values(), b.value().values());
  };
  const splat::Surfels &discs = light[2].surfels, &surfels = whole[2].surfels;
  CHECK(same(light[2].height, whole[2].height));
  CHECK(same(discs.means, surfels.means));
  CHECK(same(discs.aux, surfels.aux));
  CHECK(std::ranges::all_of(discs.opacity.value().values(),
                            [](float v) { return std::abs(v - 0.3208f) < 1e-3f; }));
  // 0.6 pixels of 0.5 m
  CHECK(std::ranges::all_of(discs.scales.value().values(),
                            [](float v) { return v > 0.25f && v < 0.35f; }));
}

TEST_CASE("coarse heights are those of the first two stages") {
  const NoGrad no_grad;
  const nn::Model model(nn::model_preset("tiny_full"), 1);
  const auto scene = hill();
  const auto whole = model.forward(scene, {}, nullptr, nn::Wanted::heights),
             coarse = model.forward(scene, {}, nullptr, nn::Wanted::coarse_heights);
  for (const std::size_t s : {0, 1}) {
    CHECK(std::ranges::equal(coarse[s].height.value().values(), whole[s].height.value().values()));
    CHECK(std::ranges::equal(coarse[s].joint_confidence.values(),
                             whole[s].joint_confidence.values()));
  }
  CHECK(coarse[2].height.empty());
  CHECK(coarse[2].probability.empty());
}

TEST_CASE("a wide range of heights gets more hypotheses") {
  nn::ModelConfig config = nn::model_preset("wide8");
  CHECK(nn::first_hypotheses(config, 0) == 64);
  // 63 intervals of 0.35 pixels of a quarter of the resolution
  CHECK(nn::first_hypotheses(config, 88.1) == 64);
  CHECK(nn::first_hypotheses(config, 88.3) == 72);
  CHECK(nn::first_hypotheses(config, 177.7) == 128);
  CHECK(nn::first_hypotheses(config, 177.9) == 136);
  CHECK(nn::first_hypotheses(config, 1e300) == 256);
  config.most_hypotheses = 100;
  CHECK(nn::first_hypotheses(config, 1e300) == 96);
  config.most_hypotheses = 0;
  CHECK(nn::first_hypotheses(config, 1e300) == 64);
  CHECK(nn::first_hypotheses(nn::model_preset("paper"), 1e300) == 64);

  const NoGrad no_grad;
  config = nn::model_preset("tiny");
  config.most_hypotheses = 32;
  auto scene = hill();
  const nn::Model model(config, 1);
  scene.z_range = {-15, 9};
  const Index expected = nn::first_hypotheses(config, 24 * nn::mean_parallax(scene));
  CHECK(expected > 8);
  CHECK(expected < 32);
  for (const nn::Wanted wanted : {nn::Wanted::heights, nn::Wanted::surfels}) {
    const auto first = model.forward(scene, {}, nullptr, wanted)[0];
    const Tensor& z = first.hypotheses;
    const Index D = z.dim(1), P = z.dim(2) * z.dim(3);
    CHECK(D == (wanted == nn::Wanted::surfels ? 8 : expected));  // heads have so many inputs
    CHECK(first.probability.shape() == z.shape());
    CHECK(first.choices == D);
    CHECK(z[0] == -15);
    CHECK(z[(D - 1) * P] == 9);
    CHECK(first.interval == doctest::Approx(24.0 / static_cast<double>(D - 1)));
    const double apart = first.interval * nn::mean_parallax(scene) / 4;
    CHECK((apart <= config.first_interval_px) == (wanted != nn::Wanted::surfels));
  }
}

TEST_CASE("a forward pass can be stopped") {
  struct Stop {};
  int calls = 0;
  const nn::Model model(nn::model_preset("tiny"), 1);
  const NoGrad no_grad;
  model.forward(hill(), [&] { ++calls; });
  CHECK(calls > 3 * 3 * 5);  // stages, views, layers
  CHECK_THROWS_AS(model.forward(hill(), [] { throw Stop{}; }), Stop);
}

TEST_CASE("stages have the promised shapes, ranges and normalisation") {
  const nn::BasicModel<float> model(nn::model_preset("tiny"), 1);
  const auto scene = hill();
  const NoGrad no_grad;
  const auto stages = model.forward(scene);
  for (std::size_t s = 0; s < 3; ++s) {
    const Index stride = Index{4} >> s, w = 32 / stride, D = model.config().hypotheses[s];
    CHECK(stages[s].stride == stride);
    CHECK(stages[s].height.shape() == Shape{3, w, w});
    CHECK(stages[s].probability.shape() == Shape{3, D, w, w});
    CHECK(stages[s].surfels.means.shape() == Shape{3 * w * w, 3});
    for (Index i = 0; i < 3 * w * w; ++i) {
      const float low = stages[s].hypotheses[i / (w * w) * D * w * w + i % (w * w)];
      const float high = stages[s].hypotheses[(i / (w * w) * D + D - 1) * w * w + i % (w * w)];
      CHECK(stages[s].height.value()[i] >= low - 1e-4f);
      CHECK(stages[s].height.value()[i] <= high + 1e-4f);
      CHECK(stages[s].confidence.value()[i] >= 1.f / static_cast<float>(D) - 1e-6f);
    }
  }
  CHECK(stages[2].interval < stages[1].interval);
}

namespace {

/// A model whose layers that start at zero have small random values, so that everything below them
/// is reached.
template <class T = double>
nn::BasicModel<T> awake(const nn::ModelConfig& config, Rng& rng) {
  nn::BasicModel<T> model(config, 3);
  for (const auto& e : model.parameters().entries()) {
    const auto ends = [&](const char* text) { return e.name.ends_with(text); };
    if (!ends("head.out.weight") && !ends("guidance.residual2.weight") &&
        !ends("cost.context.gamma") && !ends("fusion.value_mono.weight") &&
        !ends("fusion.query.weight") && !ends("cost.first.more") && !ends("cost.first.pairs") &&
        !ends("full1.contrast") && !ends("features.around"))
      continue;
    BasicVar<T> v = e.var;
    for (T& x : v.mutable_value().values()) x = static_cast<T>(0.05 * rng.normal());
  }
  return model;
}

/// Small, with all parts: to tiny_full what wide8 is to base8.
nn::ModelConfig tiny_wide() {
  nn::ModelConfig config = nn::model_preset("tiny_full");
  config.best_pair = config.local_contrast = true;
  config.feature_levels = 2;
  config.height = nn::HeightOf::mode;
  config.centre = nn::Centre::nearest;
  return config;
}

}  // namespace

TEST_CASE("the order of the views does not matter") {
  const NoGrad no_grad;
  const nn::NetworkInput scene = hill();
  constexpr std::array<std::size_t, 3> order{2, 0, 1};
  nn::NetworkInput other = scene;
  for (std::size_t a = 0; a < 3; ++a) {
    other.sources[a] = scene.sources[order[a]];
    for (std::size_t b = 0; b < 3; ++b) other.transfer[a][b] = scene.transfer[order[a]][order[b]];
  }
  nn::ModelConfig pairs = tiny_wide();
  pairs.visible_pairs = true;
  for (const auto& config : {nn::model_preset("tiny_full"), tiny_wide(), pairs}) {
    CAPTURE(config.best_pair);
    CAPTURE(config.visible_pairs);
    Rng rng(11);
    const auto model = awake(config, rng);
    const auto before = model.forward(scene), after = model.forward(other);
    for (std::size_t s = 0; s < 3; ++s) {
      const auto of = [s](const auto& stages) {
        const auto& stage = stages[s];
        const auto& x = stage.surfels;
        return std::array{stage.height, stage.confidence, x.means,   x.quats,
                          x.scales,     x.opacity,        x.colours, x.aux};
      };
      for (std::size_t k = 0; k < of(before).size(); ++k) {
        CAPTURE(s);
        CAPTURE(k);
        const auto x = of(before)[k].value(), y = of(after)[k].value();
        REQUIRE(x.shape() == y.shape());
        const Index block = x.count() / 3;  // of a view
        Index apart = 0;
        for (std::size_t a = 0; a < 3; ++a)
          for (Index i = 0; i < block; ++i) {
            const double want = x[static_cast<Index>(order[a]) * block + i],
                         got = y[static_cast<Index>(a) * block + i];
            if (!(std::abs(got - want) <= 1e-6 * std::max(1.0, std::abs(want)))) ++apart;
          }
        CHECK(apart <= x.count() / 100);  // sums in another order may fall beyond a cutoff
      }
    }
  }
}

TEST_CASE("fusion and guidance start as identities in the default configuration") {
  const auto scene = hill(32);
  const NoGrad no_grad;
  // The same seed gives parameters of the same name the same values.
  nn::ModelConfig with = nn::model_preset("tiny_full"), without = with;
  without.fusion = nn::Fusion::none, without.guidance = nn::Guidance::none;
  // The heads' last layers start at zero: awake, they show what guidance gives them.
  const auto stages_of = [&](const nn::ModelConfig& config, bool wakes_guidance = false) {
    nn::BasicModel<double> model(config, 1);
    for (const auto& e : model.parameters().entries()) {
      if (!e.name.ends_with("head.out.weight") &&
          !(wakes_guidance && e.name.ends_with("guidance.residual2.weight")))
        continue;
      BasicVar<double> v = e.var;
      v.mutable_value() = normal(v.shape(), 8, 0.05);
    }
    return model.forward(scene);
  };
  const auto difference = [&](const nn::ModelConfig& a, const nn::ModelConfig& b,
                              bool wakes_guidance = false) {
    const auto x = stages_of(a, wakes_guidance), y = stages_of(b);
    double worst = 0;
    for (std::size_t s = 0; s < 3; ++s)
      for (const auto& [u, v] :
           {std::pair{x[s].height.value(), y[s].height.value()},
            std::pair{x[s].surfels.scales.value(), y[s].surfels.scales.value()},
            std::pair{x[s].surfels.colours.value(), y[s].surfels.colours.value()}})
        for (Index i = 0; i < u.count(); ++i) worst = std::max(worst, std::abs(u[i] - v[i]));
    return worst;
  };
  CHECK(nn::ModelConfig{}.fusion == nn::Fusion::cmmf);
  CHECK(nn::ModelConfig{}.fusion_start == nn::FusionStart::additive);
  CHECK(nn::ModelConfig{}.guidance == nn::Guidance::csrg);
  auto guided = without;
  guided.guidance = nn::Guidance::csrg;
  CHECK(difference(guided, without) == 0);
  CHECK(difference(guided, without, true) > 1e-3);  // it would show
  CHECK(difference(with, without) < 1e-9);
  auto gated = with;
  gated.fusion_start = nn::FusionStart::gated;
  CHECK(difference(gated, without) < 0.2);  // m: features 3 % smaller change heights by little
  auto paper = with;
  paper.fusion_start = nn::FusionStart::paper;
  CHECK(difference(paper, without) > 0.2);
}

TEST_CASE("what a network has beyond the base begins at nothing, and is reached") {
  const auto scene = hill(32);
  nn::ModelConfig base = nn::model_preset("tiny_full"), more = base;
  more.best_pair = more.visible_pairs = more.local_contrast = true;
  more.feature_levels = 2;
  const nn::BasicModel<double> before(base, 1), after(more, 1);
  const auto x = before.forward(scene), y = after.forward(scene);
  for (std::size_t s = 0; s < 3; ++s)
    for (Index i = 0; i < x[s].height.count(); ++i)
      REQUIRE(y[s].height.value()[i] == doctest::Approx(x[s].height.value()[i]).epsilon(1e-9));
  objective(after, scene).backward();
  Index grown = 0;
  for (const auto& e : after.parameters().entries()) {
    const bool behind = e.name.starts_with("features.level") ||
                        e.name.find(".cost.pairs.") != std::string::npos,
               is_new = e.name.ends_with(".first.more") || e.name.ends_with(".first.pairs") ||
                        e.name.ends_with(".contrast") || e.name == "features.around" || behind;
    if (!is_new) continue;
    ++grown;
    double sum = 0;
    for (const double g : e.var.grad().values()) sum += std::abs(g);
    CHECK_MESSAGE((sum > 0) == !behind, e.name);
  }
  CHECK(grown == 3 + 3 + 1 + 1 + 2 * 2 * 3 + 3 * 4);
}

TEST_CASE("the mode's heights and nearest centres") {
  const auto scene = hill(32);
  nn::ModelConfig config = nn::model_preset("tiny");
  const auto mean = nn::Model(config, 1).forward(scene);
  config.height = nn::HeightOf::mode;
  config.centre = nn::Centre::nearest;
  const auto mode = nn::Model(config, 1).forward(scene);
  double moved = 0;
  for (Index i = 0; i < mean[0].height.count(); ++i)
    moved += std::abs(static_cast<double>(mean[0].height.value()[i] - mode[0].height.value()[i]));
  CHECK(moved > 0.1);
  // stage 2 searches around the heights of stage 1, along their slopes
  const nn::StageGrid grid = nn::stage_grids(config, scene)[1];
  const Tensor expected = nn::narrowed_hypotheses(
      grid, nn::along_slopes(mode[0].height.value(), grid.height, grid.width),
      scene.z_range.widened(2 * grid.interval));
  for (Index i = 0; i < expected.count(); ++i) REQUIRE(mode[1].hypotheses[i] == expected[i]);
}

TEST_CASE("heights along slopes: exact on planes, on roof or ground at walls") {
  constexpr Index h = 5, w = 6;
  const auto made = [&](const auto& z) {
    BasicTensor<double> out({2, h, w});
    for (Index i = 0; i < 2 * h * w; ++i) out[i] = z(i / (h * w), i / w % h, i % w);
    return out;
  };
  const auto plane = [](Index n, double row, double column) {
    return static_cast<double>(n) + 2 * row - 0.5 * column;
  };
  const auto finer =
      nn::along_slopes(made([&](Index n, Index i, Index j) {
                         return plane(n, static_cast<double>(i), static_cast<double>(j));
                       }),
                       2 * h, 2 * w);
  REQUIRE(finer.shape() == Shape{2, 2 * h, 2 * w});
  for (Index n = 0; n < 2; ++n)
    for (Index i = 2; i < 2 * h - 2; ++i)
      for (Index j = 2; j < 2 * w - 2; ++j)
        CHECK(finer[(n * 2 * h + i) * 2 * w + j] ==
              doctest::Approx(plane(n, (static_cast<double>(i) - 0.5) / 2,
                                    (static_cast<double>(j) - 0.5) / 2)));
  CHECK(finer[0] == doctest::Approx(0));  // no slope across the border

  const auto wall = nn::along_slopes(made([](Index, Index, Index j) { return j < 3 ? 10.0 : 1.0; }),
                                     2 * h, 2 * w);
  for (Index i = 0; i < wall.count(); ++i) CHECK(wall[i] == (i % (2 * w) < 6 ? 10 : 1));
  // a ridge, whose slopes have opposite signs, is as high as it was; beside it the gentler slope counts
  const auto ridge = nn::along_slopes(
      made([](Index, Index, Index j) {
        return std::array{0.0, 1.0, 4.0, 3.0, 3.0, 3.0}[static_cast<std::size_t>(j)];
      }),
      2 * h, 2 * w);
  const std::array expected{0.0, 0.0, 0.75, 1.25, 4.0, 4.0, 3.0, 3.0, 3.0, 3.0, 3.0, 3.0};
  for (Index i = 0; i < ridge.count(); ++i)
    CHECK(ridge[i] == doctest::Approx(expected[static_cast<std::size_t>(i % (2 * w))]));
  CHECK_THROWS_AS(nn::along_slopes(Tensor({h, w}), 2 * h, 2 * w), ShapeError);
}

TEST_CASE("heights alone are the heights of the whole pass") {
  const auto scene = hill(32);
  const nn::Model model(nn::model_preset("tiny_full"), 3);
  const auto all = model.forward(scene),
             heights = model.forward(scene, {}, nullptr, nn::Wanted::heights);
  for (std::size_t s = 0; s < 3; ++s) {
    CHECK(heights[s].surfels.means.empty());
    for (Index i = 0; i < all[s].height.count(); ++i)
      REQUIRE(heights[s].height.value()[i] == all[s].height.value()[i]);
  }
}

TEST_CASE("local normalisation knows no gain, no offset, and no noise") {
  Rng rng(4);
  nn::PosedImage view;
  view.rgb = normal_tensor<float>({3, 20, 30}, rng);
  view.valid = Tensor({20, 30}, 1.f);
  for (Index i = 0; i < 5; ++i) view.valid[7 * 30 + i] = 0;
  nn::PosedImage brighter = view;
  brighter.rgb = view.rgb.clone();
  for (float& v : brighter.rgb.values()) v = 300 * v + 7;
  for (float& v : view.rgb.values()) v *= 100;  // far above what counts as flat
  const auto a = nn::locally_normalised<double>(view), b = nn::locally_normalised<double>(brighter);
  REQUIRE(a.shape() == Shape{1, 1, 20, 30});
  double squares = 0;
  for (Index i = 0; i < a.count(); ++i) {
    REQUIRE(a[i] == doctest::Approx(b[i]).epsilon(1e-3));
    squares += a[i] * a[i];
  }
  CHECK(squares / 600 == doctest::Approx(1).epsilon(0.2));
  for (Index i = 0; i < 5; ++i) CHECK(a[7 * 30 + i] == 0);
  // by hand in the corner: the window is 8 x 8 pixels
  double sum = 0, square = 0, count = 0;
  for (Index y = 0; y < 8; ++y)
    for (Index x = 0; x < 8; ++x) {
      if (view.valid[y * 30 + x] == 0) continue;
      double m = 0;
      for (Index c = 0; c < 3; ++c) m += static_cast<double>(view.rgb[(c * 20 + y) * 30 + x]) / 3;
      sum += m, square += m * m, count += 1;
    }
  double own = 0;
  for (Index c = 0; c < 3; ++c) own += static_cast<double>(view.rgb[c * 600]) / 3;
  const double mean = sum / count, deviation = std::sqrt(square / count - mean * mean);
  CHECK(a[0] == doctest::Approx((own - mean) / (deviation + 0.01)));
  view.rgb.fill(0.4f);
  view.rgb[100] = 0.402f;  // half a grey level of 255
  const auto flat = nn::locally_normalised<double>(view);
  for (const double v : flat.values()) CHECK(std::abs(v) < 0.1);
}

TEST_CASE("every parameter receives a gradient") {
  for (const char* preset : {"tiny", "tiny_full"}) {
    const nn::BasicModel<float> model(nn::model_preset(preset), 1);
    objective(model, hill()).backward();
    for (const auto& e : model.parameters().entries()) {
      double sum = 0;
      if (e.name.starts_with(nn::kMonoPrefix)) {
        CHECK(e.var.grad().empty());
        continue;
      }
      for (const float g : e.var.grad().values()) sum += std::abs(static_cast<double>(g));
      // Only the layers above a zero-initialised one start without a gradient.
      const bool behind_zero = (e.name.find(".head.") != std::string::npos &&
                                e.name.find(".out.") == std::string::npos) ||
                               e.name.find(".guidance.") != std::string::npos ||
                               e.name.ends_with(".context.weight") ||
                               e.name.find(".fusion.key_") != std::string::npos ||
                               e.name.find(".fusion.query") != std::string::npos;
      CHECK_MESSAGE((behind_zero || sum > 0), e.name);
    }
  }
}

TEST_CASE("a confidence that knows what the stages before missed") {
  const auto scene = hill();
  const NoGrad no_grad;
  nn::ModelConfig config = nn::model_preset("tiny");
  const auto stages = nn::BasicModel<double>(config, 1).forward(scene);
  BasicTensor<double> in_search;
  for (std::size_t s = 0; s < 3; ++s) {
    CAPTURE(s);
    const auto& stage = stages[s];
    const auto near = [&](double reach) { return nn::probability_within(stage, reach); };
    const BasicTensor<double> own = near(stage.interval);
    const Index side = 32 / stage.stride;
    const auto before = s == 0 ? BasicTensor<double>()
                               : resize_bilinear(BasicVar<double>(in_search), side, side).value();
    REQUIRE(stage.joint_confidence.shape() == own.shape());
    for (Index i = 0; i < own.count(); ++i) {
      REQUIRE(stage.joint_confidence[i] == doctest::Approx(s == 0 ? own[i] : own[i] * before[i]));
      REQUIRE(stage.joint_confidence[i] > 0);
      REQUIRE(stage.joint_confidence[i] <= 1);
      REQUIRE(nn::effective_confidence(config, stage)[i] == stage.joint_confidence[i]);
    }
    if (s == 2) break;
    // stage 2 searches 8 hypotheses of its own interval, stage 3 has 4
    const double half = s == 0 ? 4 * stages[1].interval : 2 * stages[2].interval;
    in_search = near(half);
    if (s > 0)
      for (Index i = 0; i < in_search.count(); ++i) in_search[i] *= before[i];
  }
  config.confidence = nn::Confidence::raw;
  const auto raw = nn::BasicModel<double>(config, 1).forward(scene);
  config.confidence = nn::Confidence::floor;
  const auto floor = nn::BasicModel<double>(config, 1).forward(scene);
  CHECK(raw[2].joint_confidence.empty());
  for (Index i = 0; i < raw[2].confidence.value().count(); ++i) {
    const double c = stages[2].confidence.value()[i];
    REQUIRE(raw[2].surfels.aux.value()[i] == c);
    REQUIRE(floor[2].surfels.aux.value()[i] == doctest::Approx((c - 0.25) / 0.75));
  }
}

TEST_CASE("surfel heads and guidance read the one confidence") {
  const auto scene = hill();
  const NoGrad no_grad;
  // What is read where the head's own channel, its last, is deaf, comes by way of the guidance.
  for (const bool by_guidance : {false, true}) {
    CAPTURE(by_guidance);
    const auto surfels = [&](nn::Confidence confidence) {
      nn::ModelConfig config = nn::model_preset("tiny_full");
      config.mono = nn::MonoBranch::none,
      config.fusion = nn::Fusion::none;  // whose confidence would change heights
      if (!by_guidance) config.guidance = nn::Guidance::none;
      config.confidence = confidence;
      Rng rng(7);
      const auto model = awake(config, rng);
      for (const auto& e : model.parameters().entries()) {
        if (!by_guidance || !e.name.ends_with("head.first.weight")) continue;
        BasicVar<double> v = e.var;
        const Index in = v.value().dim(1);
        for (Index o = 0; o < v.value().dim(0); ++o)
          for (Index k = 0; k < 9; ++k) v.mutable_value()[(o * in + in - 1) * 9 + k] = 0;
      }
      return model.forward(scene);
    };
    const auto raw = surfels(nn::Confidence::raw), floor = surfels(nn::Confidence::floor),
               joint = surfels(nn::Confidence::joint);
    for (const auto* other : {&floor, &joint}) {
      double heights = 0, opacities = 0;
      for (Index i = 0; i < raw[2].height.value().count(); ++i) {
        const auto apart = [&](const auto& a, const auto& b) {
          return std::abs(a.value()[i] - b.value()[i]);
        };
        heights = std::max(heights, apart(raw[2].height, (*other)[2].height));
        opacities = std::max(opacities, apart(raw[2].surfels.opacity, (*other)[2].surfels.opacity));
      }
      CHECK(heights == 0);
      CHECK(opacities > 1e-4);
    }
  }
}

TEST_CASE("stages that do not search interpolate, and surfels of all stages can be kept") {
  const auto scene = hill();
  const NoGrad no_grad;
  nn::ModelConfig config = nn::model_preset("tiny");
  config.hypotheses = {8, 0, 4};
  config.keep = nn::Keep::all;
  config.guidance = nn::Guidance::photometric;
  const nn::BasicModel<double> model(config, 1);
  const auto stages = model.forward(scene);
  CHECK(stages[1].probability.empty());
  CHECK(stages[1].choices == 8);
  CHECK(stages[2].choices == 4);
  const auto up = resize_bilinear(stages[0].height, 16, 16).value();
  for (Index i = 0; i < up.count(); ++i) CHECK(stages[1].height.value()[i] == up[i]);
  CHECK(stages[0].surfels.means.dim(0) == 3 * 8 * 8);
  CHECK(stages[1].surfels.means.dim(0) == 3 * (8 * 8 + 16 * 16));
  CHECK(stages[2].surfels.means.dim(0) == 3 * (8 * 8 + 16 * 16 + 32 * 32));
  // a stage's own come first
  for (Index i = 0; i < 3 * 16 * 16; ++i)
    CHECK(stages[1].surfels.aux.value()[i] == stages[1].joint_confidence[i]);
  config.hypotheses = {0, 8, 4};
  CHECK_THROWS_AS(nn::BasicModel<double>(config, 1), ConfigError);
  for (const char* preset : {"mvsplat_like", "hisplat_like", "skysplat_like", "paper"}) {
    CAPTURE(preset);
    const auto of_32 = nn::Model(nn::model_preset(preset), 1).forward(hill());
    CHECK(of_32[2].height.shape() == Shape{3, 32, 32});
  }
}

TEST_CASE("heights that are ruled out after the first stage are tried by none") {
  const auto scene = hill();
  const NoGrad no_grad;
  const nn::Model model(nn::model_preset("tiny"), 1);
  const auto forward = [&](const nn::NarrowSearch<float>& narrow) {
    return model.forward(scene, {}, nullptr, nn::Wanted::heights, narrow);
  };
  const auto all = forward({});
  int asked = 0;
  const auto unknown = forward([&](const nn::StageHeights<float>& first) {
    ++asked;
    CHECK(first.height.value()[5] == all[0].height.value()[5]);
    return std::nullopt;
  });
  CHECK(asked == 1);
  const rpc::HeightRange range{-1.5, 2.5};
  const auto some = forward([&](const nn::StageHeights<float>&) { return range; });
  for (std::size_t s = 0; s < 3; ++s)
    for (Index i = 0; i < all[s].height.count(); ++i)
      CHECK(unknown[s].height.value()[i] == all[s].height.value()[i]);
  // of the first stage the shares of those that are left, and nothing of the others
  const Tensor &before = all[0].probability.value(), &after = some[0].probability.value();
  const Index D = before.dim(1), P = before.dim(2) * before.dim(3);
  const double half = 0.5 * all[0].interval;
  Index out = 0;
  for (Index n = 0; n < before.dim(0); ++n)
    for (Index p = 0; p < P; ++p) {
      double left = 0;
      const auto inside = [&](Index d) {
        const auto z = static_cast<double>(all[0].hypotheses[(n * D + d) * P + p]);
        return z >= range.low - half && z <= range.high + half;
      };
      for (Index d = 0; d < D; ++d)
        if (inside(d)) left += static_cast<double>(before[(n * D + d) * P + p]);
      for (Index d = 0; d < D; ++d) {
        const Index i = (n * D + d) * P + p;
        out += inside(d) ? 0 : 1;
        CHECK(
            static_cast<double>(after[i]) ==
            doctest::Approx(inside(d) ? static_cast<double>(before[i]) / left : 0.0).epsilon(1e-4));
      }
    }
  CHECK(out > 0);
  for (std::size_t s = 1; s < 3; ++s)
    for (Index i = 0; i < some[s].hypotheses.count(); ++i) {
      const auto z = static_cast<double>(some[s].hypotheses[i]);
      const double reach =
          std::max(2 * some[s].interval,  // or the band about the middle is wider
                   0.5 * (static_cast<double>(some[s].hypotheses.dim(1) - 1) * some[s].interval -
                          range.span()));
      CHECK(z >= range.low - reach - 1e-4);
      CHECK(z <= range.high + reach + 1e-4);
    }
}

TEST_CASE("one and two threads give the same bits") {
  const auto scene = hill();
  std::vector<std::vector<float>> gradients;
  for (const int n : {1, 2}) {
    set_threads(n);
    Rng rng(5);
    const auto model = awake<float>(tiny_wide(), rng);
    objective(model, scene).backward();
    auto& all = gradients.emplace_back();
    for (const auto& e : model.parameters().entries())
      all.insert(all.end(), e.var.grad().values().begin(), e.var.grad().values().end());
  }
  set_threads(0);
  CHECK(gradients[0] == gradients[1]);
}

TEST_CASE("the network learns the surface of one scene") {
  nn::Model model(nn::model_preset("tiny"), 1);
  nn::AdamW adam(model.parameters(), {});
  const auto scene = affine_scene(32, {{0.8, 0.1}, {-0.7, 0.3}, {0.1, -0.8}}, -6, 6,
                                  [](double, double) { return 2.5; });
  double first = 0, last = 0;
  for (int step = 0; step < 60; ++step) {
    model.parameters().clear_grads();
    const auto stages = model.forward(scene);
    Var total;
    for (const auto& s : stages) {
      const Var term = smooth_l1(s.height, Tensor(s.height.shape(), 2.5f), {}, 1.f);
      total = total.empty() ? term : total + term;
    }
    last = static_cast<double>(total.value().item());
    if (step == 0) first = last;
    total.backward();
    adam.step(3e-3);
  }
  CHECK(last < 0.2 * first);
}

TEST_CASE("wrong inputs are refused by name") {
  const nn::Model model(nn::model_preset("tiny"), 1);
  auto scene = hill(24);
  CHECK_THROWS_WITH_AS(model.forward(scene), "model: views are [3,24,24], expected multiples of 16",
                       ShapeError);
  scene = hill();
  scene.sources.resize(1);
  CHECK_THROWS_WITH_AS(model.forward(scene), "model: 1 source views, expected two or more",
                       ShapeError);
  scene = hill();
  scene.sources[1].valid = Tensor({32, 31});
  CHECK_THROWS_WITH_AS(model.forward(scene),
                       "model: a validity mask has shape [32,31], expected [H W] of its view",
                       ShapeError);
  scene = hill();
  scene.sources[1].rgb = Tensor({3, 32, 48});
  CHECK_THROWS_WITH_AS(model.forward(scene),
                       "model: a view has shape [3,32,48], expected [3 H W], the same for all",
                       ShapeError);
  const char* no_transfer = "model: expected a pixel transfer for every pair of views";
  scene = hill();
  scene.transfer.pop_back();
  CHECK_THROWS_WITH_AS(model.forward(scene), no_transfer, ShapeError);
  scene = hill();
  scene.transfer[1].pop_back();
  CHECK_THROWS_WITH_AS(model.forward(scene), no_transfer, ShapeError);
  scene = hill();
  scene.z_range = {3, 3};
  CHECK_THROWS_WITH_AS(model.forward(scene),
                       "model: height range 3.000000 to 3.000000, expected a positive span",
                       ConfigError);
  nn::ModelConfig config = nn::model_preset("tiny");
  config.hypotheses = {8, 6, 4};
  CHECK_THROWS_WITH_AS(nn::Model(config, 1),
                       "model: 6 hypotheses, expected a multiple of 4 (volume_levels = 2)",
                       ConfigError);
  config = nn::model_preset("tiny");
  config.interval_min = 2, config.interval_max = 1;
  CHECK_THROWS_WITH_AS(nn::Model(config, 1),
                       "model: interval_min is 2.000000, expected no more than interval_max, which "
                       "is 1.000000",
                       ConfigError);
  config.interval_max = 2;  // as good as one that is fixed
  CHECK_NOTHROW(nn::Model(config, 1));
  CHECK_THROWS_WITH_AS(
      nn::model_preset("huge"),
      "preset: 'huge', expected one of tiny, tiny_full, base8, base16, wide8, cascade8, "
      "paper, mvsplat_like, hisplat_like, skysplat_like",
      ConfigError);
}
