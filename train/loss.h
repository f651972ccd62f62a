// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"
#include "satsurf/nn/lpips.h"
#include "satsurf/nn/model.h"
#include "satsurf/scene/crop.h"
#include "satsurf/train/routing.h"

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>

namespace satsurf::train {

/// What heights are correlated with: the relative heights of the monocular branch, the true ones.
enum class GeoTarget { mono, dsm, both };

}  // namespace satsurf::train

template <>
struct satsurf::EnumNames<satsurf::train::GeoTarget> {
  static constexpr std::array names{"mono", "dsm", "both"};
};

namespace satsurf::train {

/// What the cascade is trained for.
struct LossConfig {
  std::array<double, 3> stage_weight{0.5, 1, 2};  ///< of the stages' losses, coarse to fine
  double height_weight = 1;                       ///< smooth-L1 of the stage heights, per metre
  double height_beta = 1;                         ///< its transition, m
  double distribution_weight = 0;  ///< cross-entropy of the stage's distribution of heights
  /// No smooth-L1 where a stage does not search at the truth, nor where a mode is on another surface.
  bool height_in_reach = false;
  double render_height_weight = 0.1;  ///< smooth-L1 of the height rendered in the target
  double geo_weight = 0.01;           ///< patch-wise Pearson losses of the stage heights
  GeoTarget geo_target = GeoTarget::mono;
  double colour_weight = 1;             ///< MSE of the rendered target
  double ssim_weight = 0.05;            ///< 1 - SSIM of it
  double lpips_weight = 0.1;            ///< LPIPS of it
  std::filesystem::path lpips_weights;  ///< its network; without a file the term is off
  Routing routing = Routing::cbrl;      ///< of Pearson and appearance losses
  double routing_tau = 0.2;             ///< confidence that parts them
  Index appearance_warmup = 200;        ///< steps in which appearance counts everywhere

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("stage_weight", s.stage_weight, Field{.help = "loss weight of the three stages", .min = 0});
    v("height_weight", s.height_weight,
      Field{.help = "weight of the height loss", .unit = "1/m", .min = 0});
    v("height_beta", s.height_beta,
      Field{.help = "where the height loss turns linear", .unit = "m", .min = 1e-6});
    v("distribution_weight", s.distribution_weight,
      Field{.help = "weight of the cross-entropy of a stage's distribution of heights", .min = 0});
    v("height_in_reach", s.height_in_reach,
      Field{.help = "take the height loss only where the truth lies within what a stage searches "
                    "and, of modes, near the height found"});
    v("render_height_weight", s.render_height_weight,
      Field{.help = "weight of the rendered target's height loss", .unit = "1/m", .min = 0});
    v("geo_weight", s.geo_weight,
      Field{.help = "weight of the patch-wise correlation of heights", .min = 0});
    v("geo_target", s.geo_target, Field{.help = "what heights are correlated with"});
    v("colour_weight", s.colour_weight,
      Field{.help = "weight of the rendered target's colour loss", .min = 0});
    v("ssim_weight", s.ssim_weight,
      Field{.help = "weight of the rendered target's structural dissimilarity", .min = 0});
    v("lpips_weight", s.lpips_weight,
      Field{.help = "weight of the rendered target's perceptual distance", .min = 0});
    v("lpips_weights", s.lpips_weights,
      Field{.help = "network of the perceptual distance; empty leaves the term out, as do stages "
                    "smaller than it takes (of alex 31 px)",
            .flag = "--lpips_weights,--lpips-weights"});
    v("routing", s.routing, Field{.help = "which pixels correlation and appearance learn from"});
    v("routing_tau", s.routing_tau,
      Field{.help = "confidence that parts them", .min = 0, .max = 1});
    v("appearance_warmup", s.appearance_warmup,
      Field{.help = "steps in which appearance counts everywhere", .min = 0});
  }
  friend bool operator==(const LossConfig&, const LossConfig&) = default;
};

/// The objective that belongs to a model preset (nn/config.h):
///   paper           no true heights, no warm-up of the routing
///   wide8           the distribution of heights before their mean
///   cascade8, tiny  no routing and no correlation
///   *_like          the terms and stage weights those are trained with: no routing, no SSIM, LPIPS
///                   0.05 (where `lpips_weights` names its network), of one stage only the last; of
///                   `skysplat_like` correlation on every pixel. Our true heights stay, so that a
///                   comparison is one of networks
/// and the defaults for the others.
/// throws  ConfigError as `model_preset`
LossConfig loss_preset(const std::string& name);

/// When a loss is taken, and with what.
struct LossContext {
  Index step = 0;                    ///< from 0
  std::uint64_t seed = 0;            ///< of where patches lie, with the step
  const nn::Lpips* lpips = nullptr;  ///< network of the perceptual term; nullptr leaves it out
};

/// Whether a loss renders anything, or heights alone are enough for it.
nn::Wanted wanted_by(const LossConfig& config, bool has_target);

/// The training objective of one crop and what it says in numbers.
struct LossReport {
  Var total;               ///< scalar
  double height_mae = 0;   ///< of the last stage's heights against the truth, m; NaN without truth
  double colour_psnr = 0;  ///< of the target rendered from the last stage, dB; NaN without a target
  /// Share of the target's pixels in which the last stage's surface is opaque that appearance is
  /// routed to; NaN without a target.
  double confident = 0;
};

/// The training objective:
///   L = sum_s w_s ( a smoothL1(H_s, H*) + g CE(P_s, H*) + b smoothL1(H^_s, H*_target) + c L_geo
///                   + L_app )
///   CE as `height_cross_entropy`: only where the truth lies within what the stage searches
///   L_geo = mean(m_geo (local + global) / 2), of `patch_pearson` of H_s with patches of an eighth,
///     a quarter and half of its side, randomly placed; none without relative heights
///   L_app = mean(m_app (d MSE + e (1 - SSIM))) + f LPIPS of the colours rendered in the target
/// with the true heights of the sources, and colour and height rendered in the target view; the
/// target's terms count only where the rendered surface is opaque (alpha > 0.5). The masks m route
/// pixels by confidence (train/routing.h), that of the target rendered like its colours; means are
/// over all valid pixels, so routing weighs the losses against each other. A confident pixel takes
/// part in the moments of its patch, so L_geo of its doubtful neighbours reaches it. LPIPS is that
/// of both pictures, black outside m_app, over the whole view, in stages as large as its network
/// takes.
/// Source: SatSurfGS, confidence-based routing of losses; the terms of H* are ours, CE after Chen et
/// al. 2019.
/// config   weights
/// model    of the network: how confidence is read
/// stages   what the network made of the crop
/// crop     with its target and the truth
/// context  step and random numbers
LossReport training_loss(const LossConfig& config, const nn::ModelConfig& model,
                         const std::array<nn::StageOutput<float>, 3>& stages,
                         const scene::Crop& crop, const LossContext& context = {});

}  // namespace satsurf::train
