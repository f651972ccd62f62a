// SPDX-License-Identifier: Apache-2.0
#include "satsurf/bench/bench.h"
#include "satsurf/core/block_pool.h"
#include "satsurf/nn/adamw.h"
#include "satsurf/nn/cost_net.h"
#include "satsurf/nn/feature_net.h"
#include "satsurf/nn/hypotheses.h"
#include "satsurf/nn/model.h"
#include "satsurf/nn/mono.h"
#include "satsurf/nn/surface_net.h"
#include "satsurf/nn/surfel_head.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/cost_volume.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/loss.h"
#include "satsurf/ops/softmax.h"
#include "satsurf/splat/view.h"

#include <array>
#include <fstream>
#include <string>
#include <utility>

#include "tests/affine_scene.h"

/// The whole network, its parts and its training step. Their cost is that of the convolutions.
namespace satsurf::bench {
namespace {

using nn::kStrides;

nn::NetworkInput bench_scene(Index side) {
  return test::affine_scene(
      side, {{0.8, 0.1}, {-0.7, 0.3}, {0.1, -0.8}}, -25, 25,
      [](double x, double y) { return 4 * std::cos(0.1 * x) * std::cos(0.08 * y); });
}

/// Multiply-adds per image of P pixels, layer by layer as in nn/feature_net.cpp.
double feature_multiply_adds(const nn::ModelConfig& c, double P) {
  const double b = number(c.base), full = 9 * (3 * b + b * b), half = 2 * b * b * (16 + 2 * 18),
               quarter = 4 * b * 2 * b * 16 + 2 * 9 * 16 * b * b + 16 * b * b,
               top_half = 2 * b * 4 * b + 9 * 4 * b * 2 * b, top_full = b * 4 * b + 9 * 4 * b * b;
  return P * (full + top_full + (half + top_half) / 4 + quarter / 16);
}

/// The same for a volume of V points, as in nn/cost_net.cpp.
double cost_multiply_adds(const nn::ModelConfig& c, double channels, double V) {
  double sum = 27 * V * (channels + 1) * number(c.volume_base), b = number(c.volume_base);
  for (Index l = 0; l < c.volume_levels; ++l, b *= 2) {
    V /= 8;
    sum += 27 * V * (2 * b * b + 4 * b * b + 2 * b * b);  // down, same, up
  }
  return sum;
}

/// The same for a map of P pixels, as in nn/surfel_head.cpp.
double head_multiply_adds(double channels, double width, double P) {
  return P * (9 * width * (channels + 2 * width) + width * nn::SurfelHead<float>::kOutputs);
}

/// The same for an image of P pixels, as in nn/mono.cpp.
double mono_multiply_adds(const nn::MonoConfig& c, double P) {
  constexpr std::array<double, 6> kWidths{1, 2, 4, 6, 8, 8};
  constexpr std::array<double, 5> kSame{0, 1, 1, 1, 2};
  const double b = number(c.base);
  double sum = P * 9 * (3 * b + b);
  for (std::size_t l = 0; l < kSame.size(); ++l, P /= 4) {
    const double wide = kWidths[l] * b, deep = kWidths[l + 1] * b;
    sum +=
        P / 4 * (16 * wide * deep + kSame[l] * 9 * deep * deep + deep * wide) + P * 9 * wide * wide;
  }
  return sum;
}

/// What the modules beside search and head add to a stage of P pixels, as in nn/fusion.cpp,
/// nn/guidance.cpp and the context of nn/cost_net.cpp.
double module_multiply_adds(const nn::ModelConfig& c, std::size_t stage, double channels,
                            double head_in, double P) {
  double sum = 0;
  if (c.context == nn::Context::reference) sum += P / 4 * 16 * channels * 2 * number(c.volume_base);
  if (stage == 0) return sum;
  if (c.fusion == nn::Fusion::cmmf) {
    const double mono = number(c.mono_net.base * (stage == 1 ? 2 : 1));
    sum += P * channels * (3 * channels + 2 * mono);
  }
  constexpr double kHidden = 32;
  if (c.guidance == nn::Guidance::csrg) sum += P * kHidden * (2 * 9 * head_in + 3 + head_in);
  return sum;
}

double stage_multiply_adds(const nn::ModelConfig& c, std::size_t stage, double side) {
  const double channels = number(c.base * kStrides[stage]), D = number(c.hypotheses[stage]),
               P = side * side / number(kStrides[stage] * kStrides[stage]);
  return cost_multiply_adds(c, channels, D * P) +
         head_multiply_adds(3 + channels + D + 1, number(c.head_width[stage]), P) +
         module_multiply_adds(c, stage, channels, 3 + channels + D, P);
}

Cost model_cost(const nn::ModelConfig& c, Index views, Index side) {
  double sum = feature_multiply_adds(c, number(side * side));
  if (c.mono != nn::MonoBranch::none) sum += mono_multiply_adds(c.mono_net, number(side * side));
  for (std::size_t s = 0; s < 3; ++s) sum += stage_multiply_adds(c, s, number(side));
  return {.flop = 2 * number(views) * sum};
}

/// The most memory this process held since the last `reset_peak_memory()`; 0 where Linux's /proc
/// does not say.
double peak_memory_bytes() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);)
    if (line.starts_with("VmHWM:")) return std::stod(line.substr(6)) * 1024;
  return 0;
}
void reset_peak_memory() { std::ofstream("/proc/self/clear_refs") << 5; }

/// Times `work` and notes the most memory it took: its tensors, and the whole process.
template <class Work>
void time_and_weigh(benchmark::State& state, const Cost& cost, const Work& work) {
  release_limit_arrays();
  release_tensor_cache();
  reset_peak_tensor_bytes();
  reset_peak_memory();
  time_row(state, cost, work);
  state.counters["peak_MB"] = static_cast<double>(peak_tensor_bytes()) * 1e-6;
  state.counters["process_MB"] = peak_memory_bytes() * 1e-6;
}

/// All of a preset, from images to surfels.
void infer(benchmark::State& state, const std::string& preset) {
  const nn::Model model(nn::model_preset(preset), 1);
  const auto scene = bench_scene(state.range(1));
  const NoGrad no_grad;
  time_and_weigh(state, model_cost(model.config(), state.range(0), state.range(1)),
                 [&] { benchmark::DoNotOptimize(model.forward(scene)[2].height.value().data()); });
}

/// What a reconstruction asks of the shipped cascade: the heights. Its multiply-adds are not counted.
void shipped_infer(benchmark::State& state) {
  const nn::Model model(nn::model_preset("wide8"), 1);
  const auto scene = bench_scene(state.range(1));
  const NoGrad no_grad;
  time_and_weigh(state, {}, [&] {
    const auto stages = model.forward(scene, {}, nullptr, nn::Wanted::heights);
    benchmark::DoNotOptimize(stages[2].height.value().data());
  });
}

/// The surface network, both looks, of side x side cells. Its multiply-adds are not counted.
void surface_infer(benchmark::State& state) {
  const nn::SurfaceModel network({.sigma_hidden = 64}, 1);  // as shipped
  const Index side = state.range(0);
  const nn::SurfaceInput input{normal({nn::kSurfaceCandidates, side, side}).value(),
                               normal({nn::kSurfacePlanes, side, side}).value(), 1};
  const NoGrad no_grad;
  time_and_weigh(state, {},
                 [&] { benchmark::DoNotOptimize(nn::refined(network, input).heights.data()); });
}

void mono_infer(benchmark::State& state) {
  const nn::MonoConfig config = nn::model_preset("base8").mono_net;
  nn::ParameterSet<float> parameters(1);
  const nn::MonoNet<float> mono(parameters, "", config);
  const Index N = state.range(0), side = state.range(1);
  const Var images = normal({N, 3, side, side});
  const NoGrad no_grad;
  time_and_weigh(state, {.flop = 2 * number(N) * mono_multiply_adds(config, number(side * side))},
                 [&] { benchmark::DoNotOptimize(mono(images).height.value().data()); });
}

void features_infer(benchmark::State& state) {
  const nn::ModelConfig config = nn::model_preset("cascade8");
  nn::ParameterSet<float> parameters(1);
  const nn::FeatureNet<float> features(parameters, {.base = config.base});
  const Index N = state.range(0), side = state.range(1);
  const Var images = normal({N, 3, side, side});
  const NoGrad no_grad;
  time_and_weigh(state,
                 {.flop = 2 * number(N) * feature_multiply_adds(config, number(side * side))},
                 [&] { benchmark::DoNotOptimize(features(images)[2].value().data()); });
}

/// One stage, from the features of all views to their surfels, as in nn/model.cpp.
void stage_infer(benchmark::State& state) {
  const std::size_t stage = static_cast<std::size_t>(state.range(1)) - 1;
  const nn::ModelConfig config = nn::model_preset("cascade8");
  const Index N = state.range(0), stride = kStrides[stage], side = state.range(2) / stride,
              C = config.base * stride, D = config.hypotheses[stage];
  nn::ParameterSet<float> parameters(1);
  const nn::CostNet<float> cost_net(
      parameters, "cost",
      {.channels = C, .base = config.volume_base, .levels = config.volume_levels});
  const nn::SurfelHead<float> head(parameters, "head", 3 + C + D + 1, config.head_width[stage]);
  const auto scene = bench_scene(state.range(2));
  std::vector<nn::PixelGeometry> geometry;
  for (const nn::PosedImage& v : scene.sources)
    geometry.push_back(nn::pixel_geometry(v, 0, stride));
  const double reach = stage == 0 ? 25 : 25 / number(Index{4} << stage);
  const Tensor heights = nn::uniform_hypotheses<float>(
      {.views = N, .height = side, .width = side, .hypotheses = D}, {-reach, reach});
  const Var features = normal({N, C, side, side}), image = normal({N, 3, side, side});
  const NoGrad no_grad;
  const auto run = [&] {
    std::vector<Var> logits;
    for (std::size_t i = 0; i < scene.sources.size(); ++i) {
      std::vector<Quadratic> maps;
      for (const Quadratic& q : scene.transfer[i])
        maps.push_back(rescale_pixels(q, number(stride), number(stride)));
      const Index reference = static_cast<Index>(i);
      logits.push_back(cost_net(
          plane_sweep_variance(features, reference, maps, heights.slice0(reference), Tensor{})));
    }
    const auto [p, height, confidence] = height_distribution(concat(logits, 0), heights);
    const Var raw =
        head(concat<float>({image, features, p, reshape(confidence, Shape{N, 1, side, side})}, 1));
    benchmark::DoNotOptimize(nn::surfels_from_maps<float>({raw, height, image.value(), confidence},
                                                          geometry, nn::Rotation::residual));
  };
  time_and_weigh(
      state, {.flop = 2 * number(N) * stage_multiply_adds(config, stage, number(state.range(2)))},
      run);
}

/// Forward, losses at all stages, a rendered view, backward, update.
void train_step(benchmark::State& state, const std::string& preset) {
  nn::Model model(nn::model_preset(preset), 1);
  nn::AdamW adam(model.parameters(), {});
  const Index side = state.range(1);
  const auto scene = bench_scene(side);
  Cost cost = model_cost(model.config(), state.range(0), side);
  cost.flop *= 3;
  if (model.config().mono != nn::MonoBranch::none)  // frozen: only forward
    cost.flop -= 4 * number(state.range(0)) *
                 mono_multiply_adds(model.config().mono_net, number(side * side));
  time_and_weigh(state, cost, [&] {
    model.parameters().clear_grads();
    Var total;
    for (const auto& s : model.forward(scene)) {
      const auto render =
          splat::render_view(s.surfels, scene.sources[0].pixel_from_local, side, side, s.stride);
      const Var term = smooth_l1(s.height, Tensor(s.height.shape(), 0.F), {}, 1.F) +
                       mse(render.colour, Tensor(render.colour.shape(), 0.5F), {});
      total = total.empty() ? term : total + term;
    }
    total.backward();
    nn::clip_gradient_norm(model.parameters(), 0.5);
    adam.step(1e-4);
  });
}

}  // namespace

void add_model_rows() {
  const std::vector<std::string> names{"views", "side"};
  for (const std::int64_t side : {256, 512, 1024})
    benchmark::RegisterBenchmark("features_infer", features_infer)
        ->ArgNames(names)
        ->Args({3, side});
  for (const std::int64_t side : {256, 512, 1024})
    for (const std::int64_t stage : {1, 2, 3})
      benchmark::RegisterBenchmark("stage_infer", stage_infer)
          ->ArgNames({"views", "stage", "side"})
          ->Args({3, stage, side});
  for (const std::int64_t side : {256, 512, 1024})
    benchmark::RegisterBenchmark("mono_infer", mono_infer)->ArgNames(names)->Args({3, side});
  for (const std::int64_t side : {256, 512, 1024}) {
    benchmark::RegisterBenchmark("shipped_infer", shipped_infer)->ArgNames(names)->Args({3, side});
    benchmark::RegisterBenchmark("surface_infer", surface_infer)->ArgNames({"side"})->Args({side});
  }
  // matching alone, and the whole method
  const std::pair<std::string, std::string> presets[]{{"cascade", "cascade8"}, {"method", "base8"}};
  for (const auto& [name, preset] : presets) {
    const auto infers = [preset](benchmark::State& state) { infer(state, preset); };
    for (const std::int64_t side : {256, 512, 1024})
      benchmark::RegisterBenchmark((name + "_infer").c_str(), infers)
          ->ArgNames(names)
          ->Args({3, side});
    const auto trains = [preset](benchmark::State& state) { train_step(state, preset); };
    const std::string row = name == "cascade" ? "train_step" : name + "_train_step";
    for (const std::int64_t side : {128, 256})
      benchmark::RegisterBenchmark(row.c_str(), trains)->ArgNames(names)->Args({3, side});
  }
}

}  // namespace satsurf::bench
