// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/memory.h"

#include <string>

#include <doctest/doctest.h>

namespace satsurf {
namespace {

TEST_CASE("what does not fit into the memory is refused, with both sizes and a hint") {
  const auto free = static_cast<double>(available_memory());
  CHECK(free > 1e6);
  CHECK_NOTHROW(check_memory("a byte needs", 1, "need less"));
  CHECK_NOTHROW(check_memory("what is there needs", 4 * free, "need less", 4 * free));
  std::string error;
  try {
    check_memory("all that there is, four times, needs", 4 * free, "need less");
  } catch (const Error& e) {
    error = e.what();
  }
  CHECK(error.starts_with("all that there is, four times, needs about " + memory_text(4 * free)));
  CHECK(error.ends_with("at most; need less"));
}

TEST_CASE("sizes of memory are read as they are written") {
  for (const double bytes : {5e6, 1.5e9, 4e9, 31e9})
    CHECK(memory_from_text(memory_text(bytes), "size") == bytes);
  CHECK(memory_from_text("2GiB", "size") == 2147483648.0);
  CHECK_THROWS_AS(memory_from_text("4 houses", "size"), ConfigError);
}

}  // namespace
}  // namespace satsurf
