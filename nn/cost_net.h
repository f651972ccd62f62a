// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/blocks.h"
#include "satsurf/nn/choices.h"
#include "satsurf/ops/cost_volume.h"

#include <functional>
#include <optional>
#include <vector>

namespace satsurf::nn {

/// Rows of a volume that are swept and convolved together.
/// row  numbers in a row of all its planes
Index band_rows(Index row);

/// The sizes of a CostNet.
struct CostNetOptions {
  Index channels = 0;  ///< of the variance volume
  Index more = 0;      ///< channels of the volume behind those; the network starts blind to them
  Index pairs = 0;     ///< behind those, of nn/visible_pairs.h, likewise
  Index base = 8;      ///< channels of the first level
  Index levels = 3;    ///< halvings
  Context context = Context::none;
};

/// 3D U-Net that turns a variance volume into one logit per hypothesis. A variance says how well
/// views agree and nothing of what is seen there: with `context`, the first halved level is also
/// told the reference's features, the same for every hypothesis.
/// Source: Yao et al. 2018 (MVSNet), figure 2; the context is ours.
template <class T>
class CostNet {
 public:
  /// p  where the parameters are created, under `name`
  CostNet(ParameterSet<T>& p, const std::string& name, const CostNetOptions& options);
  /// volume   [C + more + pairs D H W], D, H and W multiples of 2^levels
  /// features [1 C H W] of the reference view; not read without context
  /// poll     called between layers, may throw to stop
  /// returns  logits [1 D H W]
  /// throws   ShapeError
  BasicVar<T> operator()(BasicVar<T> volume, const BasicVar<T>& features = {},
                         const std::function<void()>& poll = {}) const;
  /// The same without a tape, of a volume that is swept and read a band of rows at a time: a third
  /// less memory.
  BasicVar<T> operator()(const PlaneSweep<T>& sweep, const BasicVar<T>& features = {},
                         const std::function<void()>& poll = {}) const;

 private:
  struct Level {
    ConvNorm3d<T> down, same;
    UpNorm3d<T> up;
  };
  BasicVar<T> first_weight() const;
  Normalised<T> first_of(const PlaneSweep<T>& sweep, const std::function<void()>& poll) const;
  /// All that follows the first convolution.
  BasicVar<T> after_first(Normalised<T> first, const BasicVar<T>& features,
                          const std::function<void()>& poll) const;

  ConvNorm3d<T> first_;
  /// The first convolution's weights of the further channels.
  std::optional<BasicVar<T>> more_, pairs_;
  std::vector<Level> levels_;
  std::optional<ConvNorm2d<T>> context_;
  BasicVar<T> last_;
};

}  // namespace satsurf::nn
