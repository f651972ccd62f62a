// SPDX-License-Identifier: Apache-2.0
// Files of tensors: what is read is written and read again, to the same bytes.
#include "satsurf/core/safetensors.h"

#include "tests/fuzz/fuzz.h"
#include "tests/fuzz/mutate_safetensors.h"

namespace satsurf::fuzz {

std::string bytes_of(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void run(std::string_view bytes) {
  const auto path = folder().put("a.safetensors", bytes);
  only<IoError>([&] {
    const TensorFile file = load_safetensors(path);
    const auto again = folder().path() / "b.safetensors";
    save_safetensors(again, file);
    const std::string once = bytes_of(again);
    save_safetensors(again, load_safetensors(again));
    require(bytes_of(again) == once, "the same tensors give the same bytes");
  });
}

}  // namespace satsurf::fuzz
