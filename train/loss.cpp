// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/loss.h"

#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/loss.h"
#include "satsurf/ops/reduce.h"
#include "satsurf/ops/resize.h"

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

Var plus(const Var& total, const Var& term, double weight) {
  const Var scaled = affine(term, static_cast<float>(weight), 0.f);
  return total.empty() ? scaled : total + scaled;
}

}  // namespace

LossReport training_loss(const TrainConfig& config,
                         const std::array<nn::StageOutput<float>, 3>& stages, const Crop& crop) {
  LossReport report{{}, std::nan(""), std::nan("")};
  for (std::size_t s = 0; s < 3; ++s) {
    const nn::StageOutput<float>& stage = stages[s];
    const double weight = config.stage_weight[s];
    if (!crop.source_truth.empty()) {
      const Target truth = height_target(crop.source_truth[s]);
      report.total = plus(report.total,
                          smooth_l1(stage.height, truth.value, truth.weight,
                                    static_cast<float>(config.height_beta)),
                          weight * config.height_weight);
      if (s == 2) {
        double error = 0, count = 0;
        for (Index i = 0; i < truth.value.count(); ++i) {
          error += static_cast<double>(truth.weight[i] *
                                       std::abs(stage.height.value()[i] - truth.value[i]));
          count += static_cast<double>(truth.weight[i]);
        }
        report.height_mae = error / count;
      }
    }
    if (!crop.target || (config.colour_weight <= 0 && config.render_height_weight <= 0)) continue;

    const nn::View& view = *crop.target;
    const auto render = nn::render_view(stage.surfels, view.pixel_from_local, view.rgb.dim(1),
                                        view.rgb.dim(2), stage.stride);
    const Index h = render.alpha.dim(0), w = render.alpha.dim(1), P = h * w;
    const Tensor image = area_downsample(Var(view.rgb), stage.stride).value();
    const Tensor seen = area_downsample(Var(view.valid), stage.stride).value();
    Tensor opaque({h, w}), opaque3({3, h, w}), known({h, w}), truth({h, w});
    if (!crop.target_truth.empty()) truth = subsampled(crop.target_truth, stage.stride);
    double error = 0, count = 0;
    for (Index i = 0; i < P; ++i) {
      const bool counts = render.alpha.value()[i] > 0.5f && seen[i] > 0.99f;
      opaque[i] = counts ? 1.f : 0.f;
      known[i] = counts && !crop.target_truth.empty() && std::isfinite(truth[i]) ? 1.f : 0.f;
      for (Index c = 0; c < 3; ++c) {
        opaque3[c * P + i] = opaque[i];
        const double e = static_cast<double>(render.colour.value()[c * P + i] - image[c * P + i]);
        if (counts) error += e * e;
      }
      count += counts ? 3 : 0;
    }
    if (s == 2 && count > 0) report.colour_psnr = -10 * std::log10(std::max(error / count, 1e-10));
    report.total =
        plus(report.total, mse(render.colour, image, opaque3), weight * config.colour_weight);
    if (!crop.target_truth.empty())
      report.total =
          plus(report.total,
               smooth_l1(render.height, truth, known, static_cast<float>(config.height_beta)),
               weight * config.render_height_weight);
  }
  if (report.total.empty())
    throw Error("training_loss: neither truth nor target, expected at least one");
  return report;
}

}  // namespace satsurf::train
