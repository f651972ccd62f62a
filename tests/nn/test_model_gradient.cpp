// SPDX-License-Identifier: Apache-2.0
// The whole model's gradient against central differences, and what of it is stopped by design.
#include "satsurf/nn/guidance.h"
#include "satsurf/nn/model.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/reduce.h"
#include "satsurf/splat/view.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <set>
#include <string>
#include <vector>

#include "tests/affine_scene.h"
#include "tests/gradcheck.h"

using namespace satsurf;
using namespace satsurf::test;

namespace {

using Model = nn::BasicModel<double>;
using Stages = std::array<nn::StageOutput<double>, 3>;
using Scalar = std::function<BasicVar<double>(const Stages&)>;

/// Three views of a hill, 32 x 64 pixels: the middle rows of square ones. One has a hole.
nn::NetworkInput strip() {
  constexpr Index kSide = 64, kRows = 32, kTop = 16;
  auto scene = affine_scene(kSide, {{0.8, 0.1}, {-0.7, 0.3}, {0.1, -0.8}}, -1.5, 1.5,
                            [](double x, double y) { return std::cos(0.3 * x + 0.2 * y); });
  for (nn::PosedImage& view : scene.sources) {
    Tensor rows({3, kRows, kSide});
    for (Index i = 0; i < rows.count(); ++i)
      rows[i] = view.rgb[i / (kRows * kSide) * kSide * kSide + kTop * kSide + i % (kRows * kSide)];
    view.rgb = rows;
    view.valid = Tensor({kRows, kSide}, 1.f);
    view.pixel_from_local.coeff[1][0] -= static_cast<double>(kTop);
    for (auto& c : view.local_from_pixel.coeff) c[0] += static_cast<double>(kTop) * c[2];
  }
  for (Index i = 0; i < 40; ++i) scene.sources[1].valid[9 * kSide + 12 + i] = 0;
  return scene;
}

/// Small, with all parts and extents that differ from each other. Where the search of a stage is
/// wider than the scene's range, its hypotheses are the same for every pixel, whatever the stage
/// before says; and where the confidence has no weight, nor has it in the fusion.
nn::ModelConfig config_of_all_parts() {
  nn::ModelConfig config = nn::model_preset("tiny_full");
  config.hypotheses = {12, 16, 8};
  config.head_width = {8, 12, 6};
  config.interval_min = config.interval_max = 1.05;
  config.fusion_lambda = 0;
  config.confidence = nn::Confidence::raw;  // the others reach the heads without a gradient
  config.best_pair = config.visible_pairs = config.local_contrast = true;
  config.feature_levels = 2;
  config.height = nn::HeightOf::mode;
  config.centre = nn::Centre::nearest;
  return config;
}

void randomise(BasicVar<double> parameter, std::uint64_t seed, double sigma) {
  parameter.mutable_value() = normal(parameter.shape(), seed, sigma);
}

/// A model whose layers that start at zero have small random values, so that everything below them
/// is reached.
Model awake(const nn::ModelConfig& config) {
  Model model(config, 3);
  std::uint64_t seed = 100;
  for (const auto& e : model.parameters().entries())
    for (const char* end :
         {"head.out.weight", "guidance.residual1.bias", "guidance.residual2.weight",
          "cost.context.gamma", "fusion.value_mono.weight", "fusion.query.weight",
          "cost.first.more", "cost.first.pairs", "full1.contrast", "features.around"})
      if (e.name.ends_with(end)) randomise(e.var, ++seed, 0.1);
  return model;
}

/// The same, whose guidance does not read the residual: weights of zero have a gradient all the
/// same, while no gradient is missing that rendered heights would have.
Model awake_without_residual(const nn::ModelConfig& config) {
  Model model = awake(config);
  for (const auto& e : model.parameters().entries())
    if (e.name.ends_with("guidance.residual1.weight")) {
      BasicVar<double> weight = e.var;
      weight.mutable_value().fill(0);
    }
  return model;
}

/// Heights, confidence and surfels of all stages as one number, every element with a weight of its
/// own.
BasicVar<double> everything(const Stages& stages) {
  BasicVar<double> total;
  std::uint64_t seed = 200;
  for (const auto& s : stages)
    for (const auto* x : {&s.height, &s.confidence, &s.surfels.means, &s.surfels.quats,
                          &s.surfels.scales, &s.surfels.opacity, &s.surfels.colours}) {
      const auto weights = normal(x->shape(), ++seed, std::sqrt(static_cast<double>(x->count())));
      const BasicVar<double> term = mean(*x * BasicVar<double>(weights));
      total = total.empty() ? term : total + term;
    }
  return total;
}

/// The derivative along a direction in the parameters `vars`.
struct Slope {
  double analytic = 0, numeric = 0;
  double gradient = 0;   ///< size of the whole analytic gradient
  bool reached = false;  ///< some of them have one
};
Slope slope(const std::function<double()>& value, const DoubleVars& vars, double step) {
  Slope out;
  std::vector<BasicTensor<double>> saved, along;
  for (std::size_t k = 0; k < vars.size(); ++k) {
    saved.push_back(vars[k].value().clone());
    along.push_back(normal(vars[k].shape(), 300 + k));
    if (vars[k].grad().empty()) continue;
    out.reached = true;
    for (Index i = 0; i < along[k].count(); ++i) {
      out.analytic += along[k][i] * vars[k].grad()[i];
      out.gradient += vars[k].grad()[i] * vars[k].grad()[i];
    }
  }
  out.gradient = std::sqrt(out.gradient);
  const auto at = [&](double distance) {
    for (std::size_t k = 0; k < vars.size(); ++k) {
      BasicVar<double> v = vars[k];
      for (Index i = 0; i < v.count(); ++i)
        v.mutable_value()[i] = saved[k][i] + distance * along[k][i];
    }
    return value();
  };
  out.numeric = (at(step) - at(-step)) / (2 * step);
  at(0);
  return out;
}

/// The layers, whose parameters are `LAYER.weight` and the like, in the order of creation.
std::vector<std::string> layers_of(const Model& model) {
  std::vector<std::string> layers;
  for (const auto& e : model.parameters().entries()) {
    const std::string layer = e.name.substr(0, e.name.rfind('.') + 1);
    if (std::ranges::find(layers, layer) == layers.end()) layers.push_back(layer);
  }
  return layers;
}

DoubleVars parameters_of(const Model& model, const std::string& part) {
  DoubleVars vars;
  for (const auto& e : model.parameters().entries())
    if (e.name.starts_with(part)) vars.push_back(e.var);
  return vars;
}

}  // namespace

TEST_CASE("the whole model's gradient, for every parameter of all three stages") {
  const auto scene = strip();
  for (const std::string start : {"additive", "gated", "paper", "naive"}) {
    CAPTURE(start);
    nn::ModelConfig config = config_of_all_parts();
    if (start == "naive")
      config.fusion = nn::Fusion::naive;
    else
      config.fusion_start = enum_from<nn::FusionStart>(start, "test");
    const Model model = awake_without_residual(config);
    everything(model.forward(scene)).backward();
    const auto value = [&] {
      const NoGrad no_grad;
      return everything(model.forward(scene)).value().item();
    };
    std::set<std::string> parts;
    for (const std::string& layer : layers_of(model)) {
      CAPTURE(layer);
      const DoubleVars parameters = parameters_of(model, layer);
      for (const auto& v : parameters)  // the monocular branch is trained by itself
        REQUIRE(v.grad().empty() == layer.starts_with(nn::kMonoPrefix));
      // the other starts differ in the fusion alone
      if (parameters[0].grad().empty() ||
          (start != "additive" && layer.find("fusion") == std::string::npos))
        continue;
      double error = INFINITY;
      // kinks may lie within the longer ones, and modes and best pairs that change
      for (const double step : {1e-7, 1e-6, 1e-8, 1e-9}) {
        const Slope s = slope(value, parameters, step);
        REQUIRE(s.gradient > 0);
        error = std::min(error, std::abs(s.numeric - s.analytic) / s.gradient);
        if (error < 1e-6) break;
      }
      CHECK(error < 1e-5);
      parts.insert(layer.substr(0, layer.find('.', layer.starts_with("stage") ? 7 : 0)));
    }
    const std::set<std::string> fusions{"stage2.fusion", "stage3.fusion"};
    const std::set<std::string> all{"features",        "stage1.cost",    "stage1.head",
                                    "stage2.cost",     "stage2.head",    "stage2.fusion",
                                    "stage2.guidance", "stage3.cost",    "stage3.head",
                                    "stage3.fusion",   "stage3.guidance"};
    CHECK(parts == (start == "additive" ? all : fusions));
  }
}

TEST_CASE("guidance compares every view with what is rendered into it") {
  const NoGrad no_grad;
  const auto scene = strip();
  const auto stages = Model(nn::model_preset("tiny_full"), 3).forward(scene);
  const auto& previous = stages[0];
  const nn::GuidedMaps<double> maps{.image = normal({3, 3, 16, 32}, 7),
                                    .height = stages[1].height.value(),
                                    .confidence = stages[1].confidence.value(),
                                    .validity = BasicTensor<double>({3, 16, 32}, 1.0),
                                    .interval = 1};
  std::vector<BasicVar<double>> heights, colours, alphas;
  for (const nn::PosedImage& view : scene.sources) {
    const auto render = splat::render_view(previous.surfels, view.pixel_from_local, view.rgb.dim(1),
                                           view.rgb.dim(2), previous.stride);
    REQUIRE(render.height.shape() == Shape{8, 16});
    heights.push_back(reshape(render.height, Shape{1, 8, 16}));
    colours.push_back(reshape(render.colour, Shape{1, 3, 8, 16}));
    alphas.push_back(reshape(render.alpha, Shape{1, 8, 16}));
  }
  const BasicTensor<double> alpha = concat(alphas, 0).value();
  for (const auto guidance : {nn::Guidance::csrg, nn::Guidance::photometric}) {
    CAPTURE(static_cast<int>(guidance));
    nn::ModelConfig config = nn::model_preset("tiny_full");
    config.guidance = guidance;
    nn::ParameterSet<double> parameters(1);
    const nn::CrossStageGuidance<double> part(parameters, "guidance", config, 5);
    const auto got = part.residual(maps, previous, scene.sources).value();
    const auto want =
        guidance == nn::Guidance::csrg
            ? nn::guidance_residual<double>(maps, {concat(heights, 0).value(), alpha},
                                            config.guidance_norm)
            : nn::photometric_residual<double>(maps, {concat(colours, 0).value(), alpha});
    REQUIRE(got.shape() == want.shape());
    CHECK(std::ranges::equal(got.values(), want.values()));
    for (Index n = 0; n < 3; ++n) {  // of each view most is covered, and has a residual
      Index known = 0;
      for (Index i = 0; i < 16 * 32; ++i) known += want[n * 3 * 16 * 32 + i] != 0;
      CHECK(known > 16 * 32 / 2);
    }
  }
}

TEST_CASE("gradients stop where a stage only tells the next what to look at") {
  const auto scene = strip();
  // how a number of the second stage depends on a part of the first
  const auto dependence = [&](const nn::ModelConfig& config, const std::string& part,
                              const Scalar& scalar, bool reads_residual = true) {
    const Model model = reads_residual ? awake(config) : awake_without_residual(config);
    scalar(model.forward(scene)).backward();
    const auto value = [&] {
      const NoGrad no_grad;
      return scalar(model.forward(scene)).value().item();
    };
    return slope(value, parameters_of(model, part), 1e-5);
  };
  const Scalar heights = [](const Stages& s) { return mean(s[1].height * s[1].height); };
  const Scalar opacities = [](const Stages& s) { return mean(s[1].surfels.opacity); };
  nn::ModelConfig matching = config_of_all_parts();
  matching.fusion = nn::Fusion::none, matching.guidance = nn::Guidance::none;

  SUBCASE("heights become hypotheses") {
    nn::ModelConfig narrow = matching;
    narrow.hypotheses = {12, 8, 8}, narrow.interval_min = narrow.interval_max = 0.1;
    const Slope s = dependence(narrow, "stage1.cost", heights);
    CHECK_FALSE(s.reached);
    CHECK(std::abs(s.numeric) > 1e-3);
    CHECK(dependence(matching, "stage1.cost", heights).numeric == 0);  // they search everything
  }
  SUBCASE("confidence weighs the fusion") {
    nn::ModelConfig weighed = matching, unweighed = matching;
    weighed.fusion = unweighed.fusion = nn::Fusion::cmmf;
    weighed.fusion_lambda = 5;
    const Slope s = dependence(weighed, "stage1.cost", heights);
    CHECK_FALSE(s.reached);
    CHECK(std::abs(s.numeric) > 1e-3);
    CHECK(dependence(unweighed, "stage1.cost", heights).numeric == 0);
  }
  SUBCASE("rendered surfels become the residual of guidance") {
    nn::ModelConfig guided = matching;
    guided.guidance = nn::Guidance::csrg;
    const Slope s = dependence(guided, "stage1.head", opacities);
    CHECK_FALSE(s.reached);
    CHECK(std::abs(s.numeric) > 1e-4);
    CHECK(dependence(guided, "stage1.head", opacities, false).numeric == 0);
  }
}
