// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/loss.h"

#include "satsurf/core/rng.h"
#include "satsurf/nn/search.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/height_cross_entropy.h"
#include "satsurf/ops/loss.h"
#include "satsurf/ops/pearson.h"
#include "satsurf/ops/reduce.h"
#include "satsurf/ops/resize.h"
#include "satsurf/ops/ssim.h"
#include "satsurf/splat/view.h"
#include "satsurf/train/routing.h"

#include <algorithm>
#include <cmath>

namespace satsurf::train {
namespace {

/// [N h w] truth and weight of all source views of a stage; unknown pixels get weight 0.
struct Target {
  Tensor value, weight;
};

Target height_target(const std::vector<Tensor>& maps) {
  const Index N = static_cast<Index>(maps.size()), h = maps[0].dim(0), w = maps[0].dim(1);
  Target t{Tensor({N, h, w}), Tensor({N, h, w})};
  for (Index n = 0; n < N; ++n)
    for (Index i = 0; i < h * w; ++i) {
      const float z = maps[static_cast<std::size_t>(n)][i];
      if (!std::isfinite(z)) continue;
      t.value[n * h * w + i] = z;
      t.weight[n * h * w + i] = 1;
    }
  return t;
}

/// True heights of the target at a stage's resolution: the full-resolution pixel nearest to each
/// centre.
Tensor subsampled(const Tensor& z, Index stride) {
  const Index h = z.dim(0) / stride, w = z.dim(1) / stride;
  auto out = Tensor::uninitialised({h, w});
  for (Index y = 0; y < h; ++y)
    for (Index x = 0; x < w; ++x)
      out[y * w + x] = z[(y * stride + stride / 2) * z.dim(1) + x * stride + stride / 2];
  return out;
}

void add_term(Var& total, const Var& term, double weight) {
  const Var scaled = affine(term, static_cast<float>(weight), 0.f);
  total = total.empty() ? scaled : total + scaled;
}

double sum_of(const Tensor& t) {
  double sum = 0;
  for (const float v : t.values()) sum += static_cast<double>(v);
  return sum;
}

/// 1 where the sources have data for all of a stage's pixel, [N h w].
Tensor source_pixels(const std::vector<nn::PosedImage>& views, Index stride) {
  const Index N = static_cast<Index>(views.size());
  Tensor out;
  for (Index n = 0; n < N; ++n) {
    const Tensor seen =
        area_downsample(Var(views[static_cast<std::size_t>(n)].valid), stride).value();
    if (out.empty()) out = Tensor({N, seen.dim(0), seen.dim(1)});
    for (Index i = 0; i < seen.count(); ++i)
      out[n * seen.count() + i] = seen[i] > 0.99f ? 1.f : 0.f;
  }
  return out;
}

/// Takes pixels out whose height lies on another surface than the true one, by more than the
/// hypotheses that a mode is the mean of: their weights would only be moved to that side of the wrong
/// mode on which the true height lies.
/// weight  [N h w] of the pixels
void keep_at_surface(Tensor& weight, const nn::StageOutput<float>& stage, const Tensor& truth) {
  const Index D = stage.hypotheses.dim(1), P = weight.dim(1) * weight.dim(2);
  if (D < 2) return;
  const Tensor& height = stage.height.value();
  for (Index i = 0; i < weight.count(); ++i) {
    const float* first = stage.hypotheses.data() + i / P * D * P + i % P;
    const float spacing = std::abs(first[(D - 1) * P] - first[0]) / static_cast<float>(D - 1);
    if (!(std::abs(height[i] - truth[i]) <= static_cast<float>(nn::kModeRadius) * spacing))
      weight[i] = 0;
  }
}

/// What the terms of one stage have in common.
struct StageLoss {
  const LossConfig& config;
  const nn::ModelConfig& model;
  const nn::StageOutput<float>& stage;
  std::size_t index;  ///< of the stage
  const scene::Crop& crop;
  const LossContext& context;

  RoutingMasks route(const Tensor& confidence, const Tensor& valid) const {
    return route_losses(confidence, valid,
                        {.routing = config.routing,
                         .threshold = config.routing_tau,
                         .warmup = context.step < config.appearance_warmup});
  }

  /// L_geo of the stage's heights and one target.
  Var correlation(const Tensor& target, const Tensor& known) const {
    const Index side = std::min(stage.height.dim(1), stage.height.dim(2));
    Rng rng = Rng(context.seed)
                  .fork(0x70617463)
                  .fork(static_cast<std::uint64_t>(context.step * 4 + stage.stride));
    PatchPearsonOptions options;
    for (const Index part : {8, 4, 2}) {
      const Index patch = std::max<Index>(2, side / part);
      options.grids.push_back({patch, rng.below(patch), rng.below(patch)});
    }
    const PatchPearson<float> loss = patch_pearson(stage.height, target, known, options);
    Tensor mask = route(nn::effective_confidence(model, stage), known).geometry;
    for (Index i = 0; i < mask.count(); ++i) mask[i] *= loss.defined[i];
    return masked_mean(affine(loss.local + loss.global, 0.5f, 0.f), mask, known);
  }

  /// L_geo, weighted.
  void add_geometry(Var& total, double weight) const {
    if (config.geo_weight <= 0) return;
    const Tensor seen = source_pixels(crop.input.sources, stage.stride);
    if (config.geo_target != GeoTarget::dsm && !stage.mono_height.empty())
      add_term(total, correlation(stage.mono_height, seen), weight * config.geo_weight);
    if (config.geo_target == GeoTarget::mono || crop.source_truth.empty()) return;
    Target truth = height_target(crop.source_truth[index]);
    for (Index i = 0; i < seen.count(); ++i) truth.weight[i] *= seen[i];
    add_term(total, correlation(truth.value, truth.weight), weight * config.geo_weight);
  }

  /// The terms of the stage's heights against the true ones, weighted. Returns the mean error, m.
  double add_heights(Var& total, double weight) const {
    const Target truth = height_target(crop.source_truth[index]);
    const bool searches = !stage.probability.empty();
    if (config.height_weight > 0) {
      Tensor teaching = truth.weight;
      if (config.height_in_reach && searches) {
        teaching = within_hypotheses(stage.hypotheses, truth.value, truth.weight);
        if (model.height == nn::HeightOf::mode) keep_at_surface(teaching, stage, truth.value);
      }
      add_term(
          total,
          smooth_l1(stage.height, truth.value, teaching, static_cast<float>(config.height_beta)),
          weight * config.height_weight);
    }
    if (config.distribution_weight > 0 && searches)
      add_term(total,
               height_cross_entropy(stage.probability, stage.hypotheses, truth.value, truth.weight),
               weight * config.distribution_weight);
    double error = 0;
    for (Index i = 0; i < truth.value.count(); ++i)
      error +=
          static_cast<double>(truth.weight[i] * std::abs(stage.height.value()[i] - truth.value[i]));
    return error / sum_of(truth.weight);
  }

  bool wants_target() const {
    return wanted_by(config, crop.target.has_value()) == nn::Wanted::surfels;
  }

  /// L_app and the rendered height. Returns the PSNR over opaque pixels and the share of them that
  /// appearance is routed to.
  std::pair<double, double> add_target(Var& total, double weight) const {
    const nn::PosedImage& view = *crop.target;
    const auto render = splat::render_view(stage.surfels, view.pixel_from_local, view.rgb.dim(1),
                                           view.rgb.dim(2), stage.stride);
    const Index h = render.alpha.dim(0), w = render.alpha.dim(1), P = h * w;
    const Tensor image = area_downsample(Var(view.rgb), stage.stride).value();
    const Tensor seen = area_downsample(Var(view.valid), stage.stride).value();
    Tensor opaque({h, w}), confidence({h, w});
    double error = 0;
    for (Index i = 0; i < P; ++i) {
      const float alpha = render.alpha.value()[i];
      opaque[i] = alpha > 0.5f && seen[i] > 0.99f ? 1.f : 0.f;
      confidence[i] = render.aux.value()[i] / std::max(alpha, 1e-6f);
      for (Index c = 0; c < 3; ++c) {
        const double e = static_cast<double>(render.colour.value()[c * P + i] - image[c * P + i]);
        error += static_cast<double>(opaque[i]) * e * e;
      }
    }
    const double count = sum_of(opaque);
    const Tensor mask = route(confidence, opaque).appearance;
    const double share = count > 0 ? sum_of(mask) / count : 0;

    // MSE and SSIM are means over the mask; its share makes them means over all opaque pixels.
    if (config.colour_weight > 0) {
      Tensor mask3({3, h, w});
      for (Index i = 0; i < 3 * P; ++i) mask3[i] = mask[i % P];
      add_term(total, mse(render.colour, image, mask3), weight * share * config.colour_weight);
    }
    if (config.ssim_weight > 0)
      add_term(total, affine(ssim(render.colour, image, SsimKind::conv, mask), -1.f, 1.f),
               weight * share * config.ssim_weight);
    if (config.lpips_weight > 0 && context.lpips != nullptr &&
        std::min(h, w) >= context.lpips->smallest_side())
      add_term(total, (*context.lpips)(render.colour, image, mask), weight * config.lpips_weight);
    if (!crop.target_truth.empty() && config.render_height_weight > 0) {
      const Tensor truth = subsampled(crop.target_truth, stage.stride);
      Tensor known({h, w});
      for (Index i = 0; i < P; ++i) known[i] = std::isfinite(truth[i]) ? opaque[i] : 0.f;
      add_term(total,
               smooth_l1(render.height, truth, known, static_cast<float>(config.height_beta)),
               weight * config.render_height_weight);
    }
    const double psnr =
        count > 0 ? -10 * std::log10(std::max(error / (3 * count), 1e-10)) : std::nan("");
    return {psnr, share};
  }
};

}  // namespace

LossConfig loss_preset(const std::string& name) {
  nn::model_preset(name);  // refuses what is none
  LossConfig c;
  const auto unrouted = [&c] {
    c.routing = Routing::none;
    c.geo_weight = 0;
  };
  if (name == "paper") {
    c.height_weight = c.render_height_weight = 0;
    c.appearance_warmup = 0;
  } else if (name == "wide8") {
    c.distribution_weight = 1;
    c.height_in_reach = true;
    c.height_weight = 0.3;
  } else if (name == "cascade8" || name == "tiny") {
    unrouted();
  } else if (name == "mvsplat_like") {
    unrouted();
    c.stage_weight = {0, 0, 2};
    c.ssim_weight = 0;
    c.lpips_weight = 0.05;
  } else if (name == "hisplat_like") {
    unrouted();
    c.stage_weight = {1, 1, 1};
    c.ssim_weight = 0;
    c.lpips_weight = 0.05;
  } else if (name == "skysplat_like") {
    unrouted();
    c.stage_weight = {0, 0, 2};
    c.geo_weight = 1;
    c.ssim_weight = 0;
    c.lpips_weight = 0.05;
  }
  return c;
}

nn::Wanted wanted_by(const LossConfig& config, bool has_target) {
  const bool renders = config.colour_weight > 0 || config.ssim_weight > 0 ||
                       config.lpips_weight > 0 || config.render_height_weight > 0;
  return has_target && renders ? nn::Wanted::surfels : nn::Wanted::heights;
}

LossReport training_loss(const LossConfig& config, const nn::ModelConfig& model,
                         const std::array<nn::StageOutput<float>, 3>& stages,
                         const scene::Crop& crop, const LossContext& context) {
  LossReport report{{}, std::nan(""), std::nan(""), std::nan("")};
  for (std::size_t s = 0; s < 3; ++s) {
    const nn::StageOutput<float>& stage = stages[s];
    const StageLoss loss{config, model, stage, s, crop, context};
    const double weight = config.stage_weight[s];
    if (weight <= 0) continue;
    if (!crop.source_truth.empty()) {
      const double error = loss.add_heights(report.total, weight);
      if (s == 2) report.height_mae = error;
    }
    loss.add_geometry(report.total, weight);
    if (!loss.wants_target()) continue;
    const auto [psnr, share] = loss.add_target(report.total, weight);
    if (s == 2) {
      report.colour_psnr = psnr;
      report.confident = share;
    }
  }
  if (report.total.empty())
    throw Error("training_loss: nothing to learn from, expected truth or target and a weight");
  return report;
}

}  // namespace satsurf::train
