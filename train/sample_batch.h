// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/parallel.h"
#include "satsurf/train/training.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <functional>
#include <utility>
#include <vector>

namespace satsurf::train {

/// The means of the terms of samples over those that know them, and of their totals.
StepLoss mean_of(const std::vector<StepLoss>& losses);

/// The samples of a step side by side: each on one thread with a copy of the network. Their
/// gradients are added in order, so that they do not depend on who was first.
template <class Network>
class SampleBatch {
 public:
  /// network  outlives this object
  /// batch    samples of a step
  /// seed     any
  SampleBatch(Network& network, Index batch, std::uint64_t seed) : network_(network) {
    for (Index b = 0; b < batch; ++b) copies_.emplace_back(network.config(), seed);
  }

  /// As `TrainingTask::descend`.
  /// loss  of a sample, with a network
  StepLoss descend(Index step, const std::function<StepLoss(const Network&, Index)>& loss) {
    const Index batch = std::ssize(copies_);
    std::vector<StepLoss> losses(copies_.size());
    for_each_index(batch, [&](Index b) {
      const OnOneThread alone;
      Network& copy = copies_[static_cast<std::size_t>(b)];
      take_values(copy);
      copy.parameters().clear_grads();
      StepLoss one = loss(copy, step * batch + b);
      if (std::isfinite(one.total.value().item())) one.total.backward();
      losses[static_cast<std::size_t>(b)] = {Var(one.total.value()), std::move(one.terms)};
    });
    add_gradients();
    return mean_of(losses);
  }

 private:
  void take_values(Network& copy) const {
    for (std::size_t i = 0; i < copy.parameters().entries().size(); ++i) {
      Var to = copy.parameters().entries()[i].var;
      std::ranges::copy(network_.parameters().entries()[i].var.value().values(),
                        to.mutable_value().values().begin());
    }
  }

  /// The mean of the copies' gradients; none where no sample has any.
  void add_gradients() {
    const auto share = 1.f / static_cast<float>(copies_.size());
    for (std::size_t i = 0; i < network_.parameters().entries().size(); ++i) {
      Var to = network_.parameters().entries()[i].var;
      for (Network& copy : copies_) {
        const Tensor& grad = copy.parameters().entries()[i].var.grad();
        if (grad.empty()) continue;
        if (to.grad().empty()) to.mutable_grad() = Tensor(to.shape());
        for (Index k = 0; k < grad.count(); ++k) to.mutable_grad()[k] += share * grad[k];
      }
    }
  }

  Network& network_;
  std::vector<Network> copies_;
};

}  // namespace satsurf::train
