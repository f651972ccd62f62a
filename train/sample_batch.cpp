// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/sample_batch.h"

namespace satsurf::train {

StepLoss mean_of(const std::vector<StepLoss>& losses) {
  double total = 0;
  StepLoss out{{}, losses[0].terms};
  for (std::size_t t = 0; t < out.terms.size(); ++t) {
    double sum = 0, count = 0;
    for (const StepLoss& loss : losses)
      if (const double value = loss.terms[t].second; std::isfinite(value)) sum += value, ++count;
    out.terms[t].second = count > 0 ? sum / count : std::nan("");
  }
  for (const StepLoss& loss : losses) total += static_cast<double>(loss.total.value().item());
  out.total = Var(Tensor::scalar(static_cast<float>(total / static_cast<double>(losses.size()))));
  return out;
}

}  // namespace satsurf::train
