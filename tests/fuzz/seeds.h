// SPDX-License-Identifier: Apache-2.0
#pragma once

// What the programs share that write what targets begin with: FOLDER/TARGET/NAME, made by the project's own writers.

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#define SATSURF_FUZZ_SEEDS
#include "satsurf/core/tensor.h"

#include "tests/fuzz/fuzz.h"

namespace satsurf::fuzz {

/// FOLDER of the command line.
inline std::filesystem::path root;

inline void put(const std::string& target, const std::string& name, const std::string& bytes) {
  std::filesystem::create_directories(root / target);
  std::ofstream(root / target / name, std::ios::binary) << bytes;
}

inline std::string bytes_of(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

/// The bytes of a file that a function writes.
template <class F>
std::string written(const std::string& name, const F& write) {
  write(folder().path() / name);
  return bytes_of(folder().path() / name);
}

/// Numbers that suit everything.
inline Tensor ramp(const Shape& shape) {
  Tensor t(shape);
  for (Index i = 0; i < t.count(); ++i) t[i] = 0.25F + 0.125F * static_cast<float>(i % 6);
  return t;
}

/// Takes the command line.
inline bool takes_folder(int argc, char** argv) {
  if (argc != 2)
    std::fprintf(stderr, "%s: expected one folder\n", argv[0]);
  else
    root = argv[1];
  return argc == 2;
}

}  // namespace satsurf::fuzz
