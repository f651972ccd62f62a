// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/block_pool.h"
#include "satsurf/core/tensor.h"

#include <doctest/doctest.h>

using namespace satsurf;

TEST_CASE("block pool: bytes in use are counted, and blocks come back") {
  release_tensor_cache();
  const std::size_t before = tensor_bytes();
  reset_peak_tensor_bytes();
  [[maybe_unused]] const void* address = nullptr;
  constexpr Index kCount = 50'000;  // 200 000 bytes: large enough to be kept
  {
    const Tensor t({kCount});
    address = t.data();
    CHECK(tensor_bytes() == before + 200'000);
    const Tensor alias = t;
    CHECK(tensor_bytes() == before + 200'000);
  }
  CHECK(tensor_bytes() == before);
  CHECK(peak_tensor_bytes() == before + 200'000);
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)  // they keep freed blocks aside
  CHECK(Tensor({kCount}).data() == address);
#endif
  release_tensor_cache();
}
