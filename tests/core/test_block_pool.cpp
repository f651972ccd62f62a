// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/block_pool.h"
#include "satsurf/core/memory_limits.h"
#include "satsurf/core/tensor.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <string>

#include <doctest/doctest.h>
#include <unistd.h>

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

#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)  // they get blocks of malloc's
TEST_CASE("block pool: a gap is joined with the gaps beside it") {
  // three blocks are more than is open now, so what other tests left cannot hold the large one
  const auto third = static_cast<Index>((reserved_tensor_bytes() + (120U << 20)) / 3 / 64 * 64);
  const auto of = [](Index bytes) { return Tensor::uninitialised({bytes / 4}); };
  Tensor first = of(third), middle = of(third), last = of(third);
  middle = {}, first = {}, last = {};  // joined with the gap behind, then with the one before
  const std::size_t before = reserved_tensor_bytes();
  CHECK(before > 0);
  const Tensor large = of(3 * third);
  CHECK(reserved_tensor_bytes() == before);
}
#endif

namespace {

/// The child's line, without which nobody knows that it ran: no test at all succeeds as well.
constexpr const char* kChildRan = "the child ran";

/// Bytes of memory there are.
std::uint64_t memory() {
  return static_cast<std::uint64_t>(std::max(sysconf(_SC_PHYS_PAGES), 1L << 18)) * 4096;
}

}  // namespace

// The range is reserved once, so this wants a process of its own: the next test starts it.
TEST_CASE("block pool: child process under a limit on addresses" * doctest::skip()) {
  REQUIRE(addresses_left() != kUnlimited);
  const Tensor t({1 << 20});
  CHECK(addresses_left() > memory() - memory() / 8);
  std::cout << kChildRan << std::endl;
}

TEST_CASE("block pool: a limit on addresses is not used up by the range") {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  MESSAGE("skipped: sanitizers take more addresses than there is any limit on");
  return;
#endif
  if (addresses_left() != kUnlimited) {
    MESSAGE("skipped: there is a limit on addresses, which might not be raised");
    return;
  }
  const std::string self = std::filesystem::read_symlink("/proc/self/exe").string();
  const auto run = [&](std::uint64_t limit) {
    const std::string command = "ulimit -v " + std::to_string(limit >> 10) + " && '" + self +
                                "' --no-skip --test-case='block pool: child process*'";
    FILE* pipe = ::popen(command.c_str(), "r");
    REQUIRE(pipe != nullptr);
    std::string said;
    for (std::array<char, 512> part{}; std::fgets(part.data(), part.size(), pipe) != nullptr;)
      said += part.data();
    CHECK(::pclose(pipe) == 0);
    CHECK_MESSAGE(said.find(kChildRan) != std::string::npos, said);
  };
  for (const double times : {1.5, 2.1, 3.0, 5.0}) {
    CAPTURE(times);
    run(static_cast<std::uint64_t>(times * static_cast<double>(memory())));
  }
}
