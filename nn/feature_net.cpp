// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/feature_net.h"

#include "satsurf/ops/concat.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/resize.h"

namespace satsurf::nn {

template <class T>
FeatureNet<T>::FeatureNet(ParameterSet<T>& p, const FeatureNetOptions& options)
    : FeatureNet(p, options.base) {
  const Index b = options.base;
  if (options.local_contrast)
    contrast_ = p.create("features.full1.contrast", {b, 1, 3, 3}, Init::constant(0), true);
  for (Index l = 0; l < options.levels; ++l) {
    const std::string name = "features.level" + std::to_string(l + 1);
    levels_.push_back({{p, name + ".halve", l == 0 ? 4 * b : 8 * b, 8 * b, 4, 2, Activation::relu},
                       {p, name + ".same", 8 * b, 8 * b, 3, 1, Activation::relu}});
  }
  if (options.levels > 0)
    around_ = p.create("features.around", {4 * b, 8 * b, 1, 1}, Init::constant(0), true);
}

template <class T>
FeatureNet<T>::FeatureNet(ParameterSet<T>& p, Index b)
    : full1_(p, "features.full1", 3, b, 3, 1, Activation::relu),
      full2_(p, "features.full2", b, b, 3, 1, Activation::relu),
      half1_(p, "features.half1", b, 2 * b, 4, 2, Activation::relu),
      half2_(p, "features.half2", 2 * b, 2 * b, 3, 1, Activation::relu),
      half3_(p, "features.half3", 2 * b, 2 * b, 3, 1, Activation::relu),
      quarter1_(p, "features.quarter1", 2 * b, 4 * b, 4, 2, Activation::relu),
      quarter2_(p, "features.quarter2", 4 * b, 4 * b, 3, 1, Activation::relu),
      quarter3_(p, "features.quarter3", 4 * b, 4 * b, 3, 1, Activation::relu),
      out_quarter_(p, "features.out_quarter", 4 * b, 4 * b, 1),
      lateral_half_(p, "features.lateral_half", 2 * b, 4 * b, 1),
      out_half_(p, "features.out_half", 4 * b, 2 * b, 3),
      lateral_full_(p, "features.lateral_full", b, 4 * b, 1),
      out_full_(p, "features.out_full", 4 * b, b, 3) {}

template <class T>
BasicVar<T> FeatureNet<T>::surroundings(const Normalised<T>& quarter) const {
  std::vector<BasicVar<T>> maps;
  for (const Level& level : levels_)
    maps.push_back(
        materialise(level.same(level.halve(maps.empty() ? quarter : Normalised<T>(maps.back())))));
  BasicVar<T> sum = maps.back();
  for (std::size_t l = maps.size() - 1; l-- > 0;)
    sum = resize_nearest(sum, maps[l].dim(2), maps[l].dim(3)) + maps[l];
  return resize_nearest(conv2d<T>(sum, *around_, {}, {}), quarter.dim(2), quarter.dim(3));
}

template <class T>
std::array<BasicVar<T>, 3> FeatureNet<T>::operator()(const BasicVar<T>& images) const {
  const BasicVar<T> first = contrast_ ? concat<T>({full1_.weight, *contrast_}, 1) : full1_.weight;
  const Normalised<T> full = full2_(full1_.apply(images, first));
  const Normalised<T> half = half3_(half2_(half1_(full)));
  BasicVar<T> quarter = materialise(quarter3_(quarter2_(quarter1_(half))));
  if (!levels_.empty()) quarter = quarter + surroundings(quarter);
  const BasicVar<T> top_half =
      resize_nearest(quarter, half.dim(2), half.dim(3)) + lateral_half_(half);
  const BasicVar<T> top_full =
      resize_nearest(top_half, full.dim(2), full.dim(3)) + lateral_full_(full);
  return {out_quarter_(quarter), out_half_(top_half), out_full_(top_full)};
}

template class FeatureNet<float>;
template class FeatureNet<double>;

}  // namespace satsurf::nn
