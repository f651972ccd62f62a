// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <stdexcept>
#include <string>

namespace satsurf {

/// Base of everything this library throws. The text reads
///   where: what came, expected what[; hint]
/// It is one line whatever a file or its name holds: control characters are spelt as in C (`\n`, `\x1b`), so that they
/// move no terminal's cursor, and of more than 4096 bytes the middle is left out.
struct Error : std::runtime_error {
  explicit Error(const std::string& text);
};

/// A tensor has the wrong shape, or two tensors disagree.
struct ShapeError : Error {
  using Error::Error;
};

/// A file is missing, damaged, or not of the kind expected.
struct IoError : Error {
  using Error::Error;
};

/// A parameter is unknown, malformed or out of its range.
struct ConfigError : Error {
  using Error::Error;
};

}  // namespace satsurf

/// Internal impossibilities only; caller mistakes and bad files throw.
/// Active in debug and sanitizer builds.
#ifdef SATSURF_CHECKED
#include <cstdlib>
#define SATSURF_ASSERT(condition) ((condition) ? void(0) : std::abort())
#else
#define SATSURF_ASSERT(condition) void(0)
#endif
