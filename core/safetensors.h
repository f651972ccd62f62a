// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <filesystem>
#include <map>
#include <string>

namespace satsurf {

/// Named tensors and string metadata, as one safetensors file holds them.
struct TensorFile {
  std::map<std::string, Tensor> tensors;               ///< F32 entries, and F16 ones when read
  std::map<std::string, BasicTensor<double>> doubles;  ///< F64 entries
  std::map<std::string, std::string> metadata;
  bool half = false;  ///< write `tensors` as F16, rounded to the nearest
};

/// Reads a safetensors file and trusts nothing in it: header length, JSON, types, shapes, offsets,
/// gaps, overlaps and file size are checked before a byte is used.
/// throws  IoError naming the file, what came and what was expected
TensorFile load_safetensors(const std::filesystem::path& path);

/// Writes to a temporary name in the same folder, then renames: the old file or the new one, never
/// half. Same content, same bytes.
/// throws  IoError; also for a finite number above 65504 that is to be written as F16
void save_safetensors(const std::filesystem::path& path, const TensorFile& file);

}  // namespace satsurf
