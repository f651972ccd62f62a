// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/core/symmetry.h"
#include "satsurf/nn/surface_net.h"
#include "satsurf/nn/weights_file.h"
#include "satsurf/ops/candidates.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/reduce.h"

#include <cmath>
#include <cstring>

#include "tests/gradcheck.h"
#include "tests/temp_folder.h"

using namespace satsurf;
using namespace satsurf::nn;
using test::normal;

namespace {

SurfaceInput some_input(Index H, Index W) {
  SurfaceInput input{normal({kSurfaceCandidates, H, W}, 1, 5).cast<float>(),
                     normal({kSurfacePlanes, H, W}, 2).cast<float>(), 0.8};
  for (Index k = 0; k < input.candidates.count(); k += 7) input.candidates[k] = std::nanf("");
  constexpr Index kUnknown = 5;  // a cell nobody knows anything of, where there are so many
  for (Index k = 0; k < kSurfaceCandidates && kUnknown < H * W; ++k)
    input.candidates[k * H * W + kUnknown] = std::nanf("");
  return input;
}

bool same_bits(const Tensor& a, const Tensor& b) {
  return a.shape() == b.shape() &&
         std::memcmp(a.data(), b.data(), static_cast<std::size_t>(a.count()) * sizeof(float)) == 0;
}

}  // namespace

TEST_CASE("the surface network takes surfaces of any size and keeps to the candidates") {
  for (const auto& [H, W] : {std::pair<Index, Index>{32, 48}, {37, 19}, {1, 1}, {5, 2}}) {
    CAPTURE(H);
    const SurfaceModel network({.base = 3}, 1);
    const SurfaceInput input = some_input(H, W);
    const RefinedSurface out = refined(network, input);
    REQUIRE(out.heights.shape() == Shape{H, W});
    REQUIRE(out.sigma.shape() == Shape{H, W});
    const Index P = H * W;
    for (Index i = 0; i < P; ++i) {
      double low = INFINITY, high = -INFINITY;
      for (Index k = 0; k < kSurfaceCandidates; ++k)
        if (const auto z = static_cast<double>(input.candidates[k * P + i]); std::isfinite(z))
          low = std::min(low, z), high = std::max(high, z);
      if (!(low <= high)) {
        CHECK(std::isnan(out.heights[i]));
        CHECK(std::isnan(out.sigma[i]));
        continue;
      }
      const double reach = kSurfaceReach * input.interval + 1e-4;
      REQUIRE(static_cast<double>(out.heights[i]) >= low - reach);
      REQUIRE(static_cast<double>(out.heights[i]) <= high + reach);
      REQUIRE(out.sigma[i] > 0);
    }
  }
}

TEST_CASE("a cell's height does not depend on the surface far away, nor on the threads") {
  const SurfaceModel network({.base = 4}, 2);
  const SurfaceInput whole = some_input(64, 400);
  SurfaceInput part{Tensor({kSurfaceCandidates, 64, 208}), Tensor({kSurfacePlanes, 64, 208}),
                    whole.interval};
  const auto cut = [](const Tensor& from, Tensor& to) {
    for (Index c = 0; c < to.dim(0); ++c)
      for (Index i = 0; i < 64; ++i)
        std::copy_n(from.data() + (c * 64 + i) * 400, 208, to.data() + (c * 64 + i) * 208);
  };
  cut(whole.candidates, part.candidates);
  cut(whole.planes, part.planes);
  const RefinedSurface all = refined(network, whole), some = refined(network, part);
  float worst = 0, beyond = 0;  // a map's width decides how convolutions are cut up, and rounded
  for (Index i = 0; i < 64; ++i)
    for (Index j = 0; j < 208; ++j) {
      const float a = all.heights[i * 400 + j], b = some.heights[i * 208 + j];
      REQUIRE(std::isnan(a) == std::isnan(b));
      float& most = j < 208 - 160 ? worst : beyond;
      most = std::fmax(most, std::abs(a - b));
    }
  CHECK(worst < 1e-3f);
  CHECK(beyond > 1e-2f);
  set_threads(1);
  const RefinedSurface alone = refined(network, whole);
  set_threads(0);
  CHECK(same_bits(alone.heights, all.heights));
  CHECK(same_bits(alone.sigma, all.sigma));
}

TEST_CASE(
    "a surface turned by 180 degrees stays the same surface, and a turned network sees all "
    "turned") {
  const SurfaceModel network({.base = 3}, 4);
  const SurfaceInput input = some_input(32, 32);
  const RefinedSurface upright = refined(network, input);
  const Tensor once = network(input).log_scale.value();
  const NoGrad no_grad;
  float differ = 0;  // of the network that looks once
  for (Index s = 0; s < kSymmetries; ++s) {
    CAPTURE(s);
    const SurfaceInput other{turned(input.candidates, s), turned(input.planes, s), input.interval};
    const RefinedSurface back = refined(network, other);
    const Tensor heights = turned(upright.heights, s), sigma = turned(upright.sigma, s);
    const Tensor mirrored = turned(network, s)(other).log_scale.value(), expected = turned(once, s),
                 alone = network(other).log_scale.value();
    for (Index i = 0; i < heights.count(); ++i) {
      REQUIRE(std::isnan(heights[i]) == std::isnan(back.heights[i]));
      if (std::isnan(heights[i])) continue;
      if (s == 0 || s == 3) {
        REQUIRE(back.heights[i] == doctest::Approx(heights[i]).epsilon(1e-3));
        REQUIRE(back.sigma[i] == doctest::Approx(sigma[i]).epsilon(1e-3));
      }
      REQUIRE(mirrored[i] == doctest::Approx(expected[i]).epsilon(1e-3));
      differ = std::max(differ, std::abs(alone[i] - expected[i]));
    }
  }
  CHECK(differ > 1e-2f);
}

TEST_CASE("a surface is what a network and its mirror image say together, a quarter more surely") {
  const SurfaceModel network({.base = 3}, 4);
  const SurfaceInput input = some_input(32, 48);
  const NoGrad no_grad;
  Tensor logits({kSurfaceCandidates, 32, 48}), residual({32, 48}), scale({32, 48});
  const auto add = [](Tensor& to, const Tensor& from, float share) {
    for (Index i = 0; i < to.count(); ++i) to[i] += share * from[i];
  };
  for (const Index s : {0, 3}) {
    const auto one = turned(network, s)(input);
    add(logits, one.logits.value(), 1.25F / 2);
    add(residual, one.residual.value(), 0.5F);
    add(scale, one.log_scale.value(), 0.5F);
  }
  const Tensor heights =
      chosen_height(Var(logits), Var(residual), input.candidates, kSurfaceReach * input.interval)
          .value();
  const RefinedSurface out = refined(network, input);
  Index known = 0;
  for (Index i = 0; i < heights.count(); ++i) {
    REQUIRE(std::isnan(out.heights[i]) == !has_candidate(input.candidates, i));
    if (std::isnan(out.heights[i])) continue;
    ++known;
    REQUIRE(out.heights[i] == doctest::Approx(heights[i]).epsilon(1e-4));
    REQUIRE(static_cast<double>(out.sigma[i]) ==
            doctest::Approx(1.148 * laplace_scale(static_cast<double>(scale[i]), input.interval))
                .epsilon(1e-4));
  }
  CHECK(known > 1000);
}

TEST_CASE("surface network: gradients in double") {
  BasicSurfaceModel<double> network({.base = 2, .sigma_hidden = 2}, 3);
  const SurfaceInput input = some_input(18, 21);
  const auto height = [&](const SurfaceOutput<double>& out) {
    return chosen_height(out.logits, out.residual, input.candidates.template cast<double>(), 1.0);
  };
  const SurfaceOutput<double> said =
      network(input);  // what the second network is told, no matter by whom
  const BasicTensor<double> heights = height(said).value();
  const SurfaceOutput<double> known{BasicVar<double>(said.logits.value()),
                                    BasicVar<double>(said.residual.value()),
                                    BasicVar<double>(said.log_scale.value())};
  const auto objective = [&] {
    const auto out = network(input);
    const auto h = height(out), scale = network.net().log_scale(input, known, heights);
    return mean(h * h) + mean(out.log_scale * out.log_scale) + mean(scale * scale);
  };
  // A bias of nothing beside nothing to look at stands on the kink of the ReLU.
  for (const auto& entry : network.parameters().entries())
    if (entry.name.ends_with(".bias")) {
      BasicVar<double> var = entry.var;
      for (double& b : var.mutable_value().values()) b = 0.05;
    }
  network.parameters().clear_grads();
  objective().backward();
  for (const auto& entry : network.parameters().entries()) {
    CAPTURE(entry.name);
    BasicVar<double> var = entry.var;
    REQUIRE(!var.grad().empty());
    double largest = 0;
    for (const double g : var.grad().values()) largest = std::max(largest, std::abs(g));
    CHECK(largest > 0);
    const NoGrad no_grad;
    for (const Index k : {Index{0}, var.count() / 2, var.count() - 1}) {
      const double was = var.value()[k], step = 1e-6;
      var.mutable_value()[k] = was + step;
      const double above = objective().value().item();
      var.mutable_value()[k] = was - step;
      const double below = objective().value().item();
      var.mutable_value()[k] = was;
      CHECK(std::abs(var.grad()[k] - (above - below) / (2 * step)) <= 1e-4 * largest + 1e-8);
    }
  }
}

TEST_CASE("a file may hold a surface network beside others") {
  const test::TempFolder folder("surface-net");
  SurfaceModel network({.base = 5}, 7);
  TensorFile file;
  store_surface(file, network);
  save_safetensors(folder / "with.safetensors", file);
  const auto back = load_surface(folder / "with.safetensors");
  REQUIRE(back);
  CHECK(back->config().base == 5);
  const SurfaceInput input = some_input(20, 20);
  CHECK(same_bits(refined(*back, input).heights, refined(network, input).heights));
  TensorFile none;
  none.metadata["format"] = "satsurf-1";
  none.tensors["model.x"] = Tensor({1});
  save_safetensors(folder / "without.safetensors", none);
  CHECK(!load_surface(folder / "without.safetensors"));
}

TEST_CASE("a small file does not make a large network") {
  TensorFile file;
  file.metadata["format"] = "satsurf-1";
  file.tensors["model.x"] = file.tensors["mono.x"] = file.tensors["surface.x"] = Tensor({1});
  const std::string text = "w: its configuration asks for a network of more than ";
  file.metadata["model"] = R"({"base": 64, "volume_base": 64, "head_width": [256, 256, 256]})";
  CHECK(test::error_of<IoError>([&] { model_from(file, "w"); }).starts_with(text));
  file.metadata["mono"] = R"({"base": 64})";
  CHECK(test::error_of<IoError>([&] { mono_from(file, "w"); }).starts_with(text));
  file.metadata["surface"] = R"({"base": 64})";
  CHECK(test::error_of<IoError>([&] { surface_from(file, "w"); }).starts_with(text));
  // the limit ends with the file, and what is asked for by others is made
  CHECK(Mono({.base = 64}, 1).parameters().count() > (1 << 20));
}

TEST_CASE("the surface network refuses what does not fit") {
  const SurfaceModel network({.base = 2}, 1);
  SurfaceInput input = some_input(8, 8);
  input.planes = Tensor({3, 8, 8});
  CHECK_THROWS_AS(refined(network, input), ShapeError);
}
