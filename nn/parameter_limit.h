// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

#include <string>

namespace satsurf::nn {

/// While one lives, this thread makes networks whose parameters are then taken from elsewhere: it
/// refuses to make more than `most`, as a file of some hundred bytes may name a configuration of a
/// gigabyte, and leaves those zero that would be random, as drawing them takes longer than reading.
class ParameterLimit {
 public:
  /// most   numbers in all
  /// where  begins the error text
  ParameterLimit(Index most, std::string where);
  ~ParameterLimit();
  ParameterLimit(const ParameterLimit&) = delete;
  ParameterLimit& operator=(const ParameterLimit&) = delete;

  /// Counts a parameter that is about to be made.
  /// throws  IoError if it is too much
  void count(const Shape& shape);

 private:
  Index left_, most_;
  std::string where_;
  ParameterLimit* outer_;
};

}  // namespace satsurf::nn
