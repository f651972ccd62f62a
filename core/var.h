// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

namespace satsurf {

/// Where a backward pass puts the gradient of one input.
template <class T>
struct GradientTarget {
  T* data = nullptr;       ///< nullptr if nobody wants it
  bool accumulate = true;  ///< add to what is there; else every element must be stored

  explicit operator bool() const { return data != nullptr; }
};

/// One recorded value of the tape. Ops see it in their backward closure; nobody else needs it.
template <class T>
struct Node {
  using Backward = std::function<void(Node&)>;

  BasicTensor<T> value;
  BasicTensor<T> grad;  ///< empty until somebody adds to it
  std::vector<std::shared_ptr<Node>> inputs;
  Backward backward;  ///< empty for leaves and for values that want no gradient
  const char* op = "leaf";
  std::uint64_t order = 0;  ///< creation number: descending order is a valid reverse order
  bool wants_grad = false;

  /// Where to add the gradient of input i (zeroed at its first use), or nullptr if nobody wants it.
  T* grad_in(std::size_t i);
  /// As `grad_in`, but not zeroed for the first that asks: it stores every element instead, which
  /// spares memory-bound ops two passes. One value may be several inputs: write the gradients in
  /// the order they are asked for here. Under NanGuard elements left out are found.
  GradientTarget<T> grad_out(std::size_t i);
  /// The value of input i.
  const T* in(std::size_t i) const { return inputs[i]->value.data(); }

  Node() = default;
  Node(const Node&) = delete;
  Node& operator=(const Node&) = delete;
  ~Node();  // iterative: a chain of a million nodes must not overflow the stack
};

/// A tensor on the reverse-mode tape. Copies share the node.
template <class T>
class BasicVar {
 public:
  BasicVar() = default;
  explicit BasicVar(BasicTensor<T> value, bool wants_grad = false);

  const BasicTensor<T>& value() const { return node_->value; }
  /// For the owner of a parameter (optimiser, loader): writes in place, visible to every copy.
  BasicTensor<T>& mutable_value() { return node_->value; }
  const Shape& shape() const { return node_->value.shape(); }
  Index dim(Index axis) const { return shape()[axis]; }
  Index count() const { return node_->value.count(); }
  bool wants_grad() const { return node_ && node_->wants_grad; }
  bool empty() const { return node_ == nullptr; }

  /// d(objective)/d(this); an empty tensor if nothing has been added.
  const BasicTensor<T>& grad() const { return node_->grad; }
  BasicTensor<T>& mutable_grad() { return node_->grad; }
  void clear_grad() { node_->grad = {}; }
  /// A tensor of this shape for an op's elementwise result: uninitialised or, where nobody could
  /// read this value again (nothing is recorded, and this is its last copy), its own buffer.
  /// For ops that take the argument by value.
  BasicTensor<T> reuse_or_new() const;
  /// The same value, cut from the tape.
  BasicVar detach() const { return BasicVar(node_->value); }

  /// Runs the tape backwards from this value and adds into the gradients of all leaves that want
  /// one. Nodes on the way drop their inputs, saved values and gradients as soon as they have run,
  /// so a tape can be run once.
  /// seed    d(objective)/d(this), this value's shape; 1 if left out, for a single element only
  /// throws  ShapeError
  void backward(const BasicTensor<T>& seed = {}) const;

  /// Puts an op's result on the tape.
  /// op        its name, for errors; must outlive the tape
  /// value     the result
  /// inputs    what it was made from; may hold empty Vars (optional arguments)
  /// backward  reads `n.grad` and adds into `n.grad_in(i)`, which is nullptr where nobody wants it,
  ///           or fills `n.grad_out(i)`; dropped at once if no input wants a gradient or under
  ///           NoGrad
  static BasicVar record(const char* op, BasicTensor<T> value, std::vector<BasicVar> inputs,
                         typename Node<T>::Backward backward);

 private:
  std::shared_ptr<Node<T>> node_;
};

using Var = BasicVar<float>;

/// While one lives, this thread records nothing.
class NoGrad {
 public:
  NoGrad();
  ~NoGrad();
  NoGrad(const NoGrad&) = delete;
  NoGrad& operator=(const NoGrad&) = delete;
  static bool active();
};

/// While one lives, every value and gradient recorded by this thread is checked and the first op
/// that produced a NaN or an infinity is named by an Error.
class NanGuard {
 public:
  NanGuard();
  ~NanGuard();
  NanGuard(const NanGuard&) = delete;
  NanGuard& operator=(const NanGuard&) = delete;
  static bool active();
};

}  // namespace satsurf
