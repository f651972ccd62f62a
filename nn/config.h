// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"
#include "satsurf/core/shape.h"
#include "satsurf/nn/choices.h"
#include "satsurf/nn/mono.h"

#include <array>
#include <string>
#include <vector>

namespace satsurf::nn {

/// Every width, depth count and switch of the network.
struct ModelConfig {
  Index base = 8;  ///< feature channels at full resolution; x2, x4 at strides 2, 4
  /// Heights per pixel at strides 4, 2, 1; 0 for a later stage that does not search but takes the
  /// heights of the one before, interpolated.
  std::array<Index, 3> hypotheses{64, 32, 8};
  /// Of stage 1 at most: where the heights to search span more than `hypotheses` do at
  /// `first_interval_px`, it tries more (nn::first_hypotheses).
  Index most_hypotheses = 256;
  double first_interval_px = 0.35;              ///< disparity between those, stage pixels
  Index volume_base = 8;                        ///< channels of the first level of each 3D U-Net
  Index volume_levels = 3;                      ///< halvings inside each 3D U-Net
  std::array<Index, 3> head_width{64, 48, 32};  ///< channels of the surfel heads
  double interval_px = 0.5;   ///< disparity between neighbouring hypotheses, stage pixels
  double interval_min = 0.2;  ///< of the last stage, m
  double interval_max = 1.0;  ///< of the last stage, m
  bool variance_includes_reference = true;
  bool best_pair = false;                  ///< channels of the best pair beside variances
  bool visible_pairs = false;              ///< and of all pairs by learned visibility
  Index feature_levels = 0;                ///< halvings of the features below stride 4
  bool local_contrast = false;             ///< the features see the locally normalised image, too
  HeightOf height = HeightOf::mean;        ///< of a stage's distribution
  Centre centre = Centre::bilinear;        ///< of what stages 2 and 3 search
  Context context = Context::reference;    ///< of the 3D U-Nets
  Rotation rotation = Rotation::residual;  ///< of the surfels
  MonoBranch mono = MonoBranch::own;
  MonoConfig mono_net{};
  Fusion fusion = Fusion::cmmf;                       ///< of matching and monocular features
  FusionStart fusion_start = FusionStart::additive;   ///< of cmmf
  double fusion_lambda = 1;                           ///< weight of the confidence in cmmf
  double fusion_tau = 0.2;                            ///< confidence that favours neither side
  Guidance guidance = Guidance::csrg;                 ///< of a stage by the one before
  GuidanceNorm guidance_norm = GuidanceNorm::robust;  ///< of csrg
  Keep keep = Keep::last;                             ///< surfels of a stage
  Confidence confidence = Confidence::joint;          ///< see `effective_confidence`

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("base", s.base, Field{.help = "feature channels at full resolution", .min = 1, .max = 64});
    v("hypotheses", s.hypotheses,
      Field{.help = "height hypotheses per pixel at strides 4, 2 and 1; 0 interpolates",
            .min = 0,
            .max = 256});
    v("most_hypotheses", s.most_hypotheses,
      Field{.help = "most of them at stride 4, which gets more where heights to search span more; "
                    "never fewer than `hypotheses`",
            .min = 0,
            .max = 1024});
    v("first_interval_px", s.first_interval_px,
      Field{.help =
                "disparity between neighbouring hypotheses at stride 4 from which on it gets more",
            .unit = "stage px",
            .min = 0.05,
            .max = 4});
    v("volume_base", s.volume_base,
      Field{.help = "first-level channels of each 3D U-Net", .min = 1, .max = 64});
    v("volume_levels", s.volume_levels,
      Field{.help = "halvings inside each 3D U-Net", .min = 1, .max = 4});
    v("head_width", s.head_width,
      Field{.help = "channels of the surfel heads", .min = 1, .max = 256});
    v("interval_px", s.interval_px,
      Field{.help = "disparity between neighbouring hypotheses",
            .unit = "stage px",
            .min = 0.05,
            .max = 4});
    v("interval_min", s.interval_min,
      Field{.help = "smallest interval of the last stage", .unit = "m", .min = 0.01, .max = 100});
    v("interval_max", s.interval_max,
      Field{.help = "largest interval of the last stage", .unit = "m", .min = 0.01, .max = 100});
    v("variance_includes_reference", s.variance_includes_reference,
      Field{.help = "count the reference view's own feature in the variance; without it two views "
                    "have none"});
    v("best_pair", s.best_pair,
      Field{.help =
                "tell the 3D U-Nets of the best pair of views, too, and of how many see a point"});
    v("visible_pairs", s.visible_pairs,
      Field{.help = "tell them of all pairs, too, by a learned visibility of each"});
    v("feature_levels", s.feature_levels,
      Field{.help = "how often the matching features are halved below a quarter of the resolution: "
                    "how far they look around",
            .min = 0,
            .max = 4});
    v("local_contrast", s.local_contrast,
      Field{.help = "show the matching features the locally normalised image beside the colours"});
    v("height", s.height, Field{.help = "what a stage makes of its distribution of heights"});
    v("centre", s.centre,
      Field{.help = "how the heights that stages 2 and 3 search around are interpolated"});
    v("context", s.context,
      Field{.help = "what the 3D U-Nets are told beside variances: nothing or the reference view's "
                    "features"});
    v("rotation", s.rotation, Field{.help = "surfel orientation"});
    v("mono", s.mono, Field{.help = "branch that sees one image at a time"});
    v("mono_net", s.mono_net, Field{.help = "the monocular network"});
    v("fusion", s.fusion, Field{.help = "how monocular features join the matching features"});
    v("fusion_start", s.fusion_start, Field{.help = "what cmmf is before training"});
    v("fusion_lambda", s.fusion_lambda,
      Field{.help = "weight of the confidence in cmmf", .min = 0, .max = 100});
    v("fusion_tau", s.fusion_tau,
      Field{.help = "confidence at which cmmf favours neither side", .min = 0, .max = 1});
    v("guidance", s.guidance, Field{.help = "how rendered heights guide the next stage"});
    v("guidance_norm", s.guidance_norm,
      Field{.help = "how they are compared with the stage's own"});
    v("keep", s.keep, Field{.help = "whose surfels a stage hands on: its own or all so far"});
    v("confidence", s.confidence,
      Field{.help = "confidence that fusion, guidance, surfels and loss routing read"});
  }

  friend bool operator==(const ModelConfig&, const ModelConfig&) = default;
};

/// Named configurations, each with losses of its own (train/loss.h):
///   tiny, tiny_full  for tests, as cascade8 and as base8
///   base8            the whole method
///   base16           features and volumes twice as wide, heads one and a half times
///   wide8            base8 that looks around and through: features from a sixteenth of the
///                    resolution and of local contrast, the best pair beside the variance, the mode
///                    of each distribution, nearest centres of the search; trained for the
///                    distribution, and with weights of base8 to start from
///   cascade8         base8 without monocular branch, fusion, guidance and context
///   paper            base8 with the published choices where the defaults are others: no context,
///                    surfels that face the camera, CMMF as it stands, raw max P for confidence.
///                    Not: a large pretrained monocular network, for which ours stands in; a
///                    pinhole for the renderer, where each surfel has its own affine camera from
///                    the RPC; its batches and length of training. Where it is silent or can be
///                    read in two ways it is base8: the variance has the reference's feature, as of
///                    two other views alone it would be blind to the reference; colours are of
///                    degree 0.
/// and other methods as far as this engine's parts can stand for theirs. All three have base8's
/// feature and head widths, RPC cameras, variance volumes, 3D U-Nets, flat surfels and joint
/// confidence:
///   mvsplat_like   after Chen et al. 2024 (MVSplat). Keeps: one plane sweep at a quarter of the
///                  resolution, 128 hypotheses, expectation, interpolation to full size, attributes
///                  from image and features there. Not: its cross-view transformer, correlation
///                  volume, 2D U-Nets that refine volume and depth, inverse depth; surfels are
///                  turned by a residual as base8's.
///   hisplat_like   after Tang et al. 2024 (HiSplat). Keeps: three stages whose surfels are all
///                  kept, each guided by the colour error of the ones before, equal loss weights.
///                  Not: the 128 hypotheses of its first stage, here 64; its later stages refine
///                  depth by a 2D network where these search a narrow volume; its opacity modulator
///                  and image backbone; losses of all stages at full resolution.
///   skysplat_like  after Huang et al. 2025 (SkySplat). Keeps: one stage, 64 hypotheses between the
///                  scene's heights, interpolation to full size, surfels that face the camera,
///                  correlation with relative heights as a loss on every pixel. Not: its recurrent
///                  regulariser, 3D Gaussians, cross-view consistency masks; that correlation is
///                  patch-wise here and of the whole map there; colours are compared in a target
///                  view here and in the sources there.
/// throws  ConfigError naming the presets there are
ModelConfig model_preset(const std::string& name);
/// Their names, in the order above.
std::vector<std::string> model_preset_names();

/// Image pixels per pixel of each stage, coarse to fine.
inline constexpr std::array<Index, 3> kStrides{4, 2, 1};

/// Pixel sizes must be multiples of this: the coarsest stride times the U-Net's halvings.
Index size_multiple(const ModelConfig& config);

}  // namespace satsurf::nn
