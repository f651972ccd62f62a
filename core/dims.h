// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

#include <string>
#include <vector>

namespace satsurf {

/// Checks shapes against named extents and binds each name at its first use across the arguments of
/// one op:
///   Dims dim("op");
///   dim.match("cost", cost, "D H W").match("heights", heights, "D");
///   dim["D"]
/// A number in the pattern stands for itself. The failing argument is named with what came and what
/// was expected.
class Dims {
 public:
  /// `where` begins the error texts: the op's name.
  explicit Dims(std::string where) : where_(std::move(where)) {}

  /// Binds or checks every extent of one argument.
  /// name      of the argument, for the error
  /// argument  anything with `shape()`, or a Shape
  /// pattern   one letter or number per axis, "N C H W"
  /// returns   this object, so that calls may be chained
  /// throws    ShapeError
  template <class A>
  Dims& match(const char* name, const A& argument, const char* pattern) {
    return match_shape(name, shape_of(argument), pattern);
  }
  /// The extent bound to a letter.
  /// throws  ShapeError if the letter was never bound
  Index operator[](const char* letter) const;

 private:
  static const Shape& shape_of(const Shape& s) { return s; }
  template <class A>
  static const Shape& shape_of(const A& a) {
    return a.shape();
  }
  Dims& match_shape(const char* name, const Shape& shape, const char* pattern);

  struct Binding {
    std::string letter;
    Index extent;
    std::string from;
  };
  const Binding* find(const std::string& letter) const;

  std::string where_;
  std::vector<Binding> bound_;
};

}  // namespace satsurf
