// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/var.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <string>
#include <unordered_set>

namespace satsurf {
namespace {

thread_local int no_grad_depth = 0;
thread_local int nan_guard_depth = 0;

std::uint64_t next_order() {
  static std::atomic<std::uint64_t> counter{0};
  return ++counter;
}

template <class T>
void check_finite(const BasicTensor<T>& t, const char* op, const char* what) {
  for (Index i = 0; i < t.count(); ++i)
    if (!std::isfinite(t[i]))
      throw Error(std::string(op) + ": " + what + " element " + std::to_string(i) + " of shape " +
                  t.shape().str() + " is " + std::to_string(t[i]) + ", expected finite numbers");
}

}  // namespace

NoGrad::NoGrad() { ++no_grad_depth; }
NoGrad::~NoGrad() { --no_grad_depth; }
bool NoGrad::active() { return no_grad_depth > 0; }
NanGuard::NanGuard() { ++nan_guard_depth; }
NanGuard::~NanGuard() { --nan_guard_depth; }
bool NanGuard::active() { return nan_guard_depth > 0; }

template <class T>
T* Node<T>::grad_in(std::size_t i) {
  Node* input = inputs[i].get();
  if (input == nullptr || !input->wants_grad) return nullptr;
  if (input->grad.empty()) input->grad = BasicTensor<T>(input->value.shape());
  return input->grad.data();
}

template <class T>
GradientTarget<T> Node<T>::grad_out(std::size_t i) {
  Node* input = inputs[i].get();
  if (input == nullptr || !input->wants_grad) return {};
  if (!input->grad.empty()) return {input->grad.data(), true};
  input->grad = BasicTensor<T>::uninitialised(input->value.shape());
  if (NanGuard::active()) input->grad.fill(std::numeric_limits<T>::quiet_NaN());
  return {input->grad.data(), false};
}

template <class T>
Node<T>::~Node() {
  std::vector<std::shared_ptr<Node>> pending = std::move(inputs);
  while (!pending.empty()) {
    const std::shared_ptr<Node> node = std::move(pending.back());
    pending.pop_back();
    if (node && node.use_count() == 1) {
      for (auto& input : node->inputs) pending.push_back(std::move(input));
      node->inputs.clear();
    }
  }
}

template <class T>
BasicVar<T>::BasicVar(BasicTensor<T> value, bool wants_grad) : node_(std::make_shared<Node<T>>()) {
  node_->value = std::move(value);
  node_->wants_grad = wants_grad;
  node_->order = next_order();
}

template <class T>
BasicTensor<T> BasicVar<T>::reuse_or_new() const {
  const bool last =
      NoGrad::active() && node_.use_count() == 1 && !node_->wants_grad && node_->value.unshared();
  return last ? node_->value : BasicTensor<T>::uninitialised(shape());
}

template <class T>
BasicVar<T> BasicVar<T>::record(const char* op, BasicTensor<T> value, std::vector<BasicVar> inputs,
                                typename Node<T>::Backward backward) {
  if (NanGuard::active()) check_finite(value, op, "value");
  BasicVar out(std::move(value));
  out.node_->op = op;
  if (NoGrad::active() ||
      std::none_of(inputs.begin(), inputs.end(), [](const BasicVar& v) { return v.wants_grad(); }))
    return out;
  out.node_->wants_grad = true;
  out.node_->backward = std::move(backward);
  out.node_->inputs.reserve(inputs.size());
  for (BasicVar& v : inputs) out.node_->inputs.push_back(std::move(v.node_));
  return out;
}

template <class T>
void BasicVar<T>::backward(const BasicTensor<T>& seed) const {
  if (seed.empty() && count() != 1)
    throw ShapeError("backward: value has shape " + shape().str() +
                     ", expected one element or a seed");
  if (!seed.empty() && seed.shape() != shape())
    throw ShapeError("backward: seed has shape " + seed.shape().str() + ", expected " +
                     shape().str());
  if (!wants_grad()) return;

  std::vector<std::shared_ptr<Node<T>>> tape{node_};
  std::unordered_set<const Node<T>*> seen{node_.get()};
  for (std::size_t i = 0; i < tape.size(); ++i) {
    const auto node = tape[i];  // a copy: push_back moves the vector's storage
    for (const auto& input : node->inputs)
      if (input && input->wants_grad && seen.insert(input.get()).second) tape.push_back(input);
  }
  // Ascending, so that the last element is the next one to run and can be popped.
  std::sort(tape.begin(), tape.end(),
            [](const auto& a, const auto& b) { return a->order < b->order; });

  if (node_->grad.empty()) node_->grad = BasicTensor<T>(shape());
  T* grad = node_->grad.data();
  const Index n = count();
  if (seed.empty()) {
    grad[0] += T(1);
  } else {
    for (Index i = 0; i < n; ++i) grad[i] += seed[i];
  }
  while (!tape.empty()) {
    const std::shared_ptr<Node<T>> node = std::move(tape.back());
    tape.pop_back();
    if (!node->backward) continue;  // a leaf keeps its gradient
    if (!node->grad.empty()) {
      node->backward(*node);
      if (NanGuard::active())
        for (const auto& input : node->inputs)
          if (input && input->wants_grad) check_finite(input->grad, node->op, "gradient");
    }
    node->backward = nullptr;
    node->inputs.clear();
    if (node != node_) node->grad = {};
  }
}

template struct Node<float>;
template struct Node<double>;
template class BasicVar<float>;
template class BasicVar<double>;

}  // namespace satsurf
