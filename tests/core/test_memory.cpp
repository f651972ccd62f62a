// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/memory.h"
#include "satsurf/core/memory_limits.h"

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>
#include <sys/resource.h>
#include <unistd.h>

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

TEST_CASE("a limit on addresses is one on memory") {
  rlimit before{};
  REQUIRE(getrlimit(RLIMIT_AS, &before) == 0);
  std::uint64_t pages = 0;
  std::ifstream("/proc/self/statm") >> pages;
  const auto taken = pages * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
  constexpr std::uint64_t kRoom = 300'000'000, kSlack = 20'000'000;
  if (before.rlim_max != RLIM_INFINITY && before.rlim_max < taken + kRoom) return;
  rlimit tight = before;
  tight.rlim_cur = taken + kRoom;
  REQUIRE(setrlimit(RLIMIT_AS, &tight) == 0);
  const std::uint64_t left = addresses_left(), available = available_memory();
  REQUIRE(setrlimit(RLIMIT_AS, &before) == 0);
  CHECK(left <= kRoom);
  CHECK(left >= kRoom - kSlack);
  CHECK(available <= kRoom);
}

TEST_CASE("the limits of control groups are ones on memory") {
  const test::TempFolder folder("control-groups");
  const auto write = [&](const std::string& name, const std::string& text) {
    const auto file = folder.path() / name;
    std::filesystem::create_directories(file.parent_path());
    std::ofstream(file) << text;
  };
  const auto left = [&](const std::string& groups) {
    write("groups", groups);
    return group_memory_left(folder.path() / "groups", folder.path() / "cgroup");
  };
  CHECK(left("0::/a/b\n") == kUnlimited);
  CHECK(group_memory_left(folder.path() / "none", folder.path()) == kUnlimited);

  // version 2: the group or one that it lies in
  write("cgroup/a/memory.max", "5000\n");
  write("cgroup/a/memory.current", "1200\n");
  write("cgroup/a/b/memory.max", "max\n");
  write("cgroup/a/b/memory.current", "900\n");
  CHECK(left("0::/a/b\n") == 3800);
  write("cgroup/a/b/memory.max", "2000\n");
  CHECK(left("0::/a/b\n") == 1100);
  write("cgroup/a/b/memory.stat", "anon 300\nfile 600\ninactive_file 500\n");
  CHECK(left("0::/a/b\n") == 1600);
  write("cgroup/a/b/memory.current", "2700\n");
  CHECK(left("0::/a/b\n") == 0);
  CHECK(left("0::/a\n") == 3800);
  // a container whose group has another name outside
  write("cgroup/memory.max", "700\n");
  CHECK(left("0::/../elsewhere\n") == 700);

  // version 1
  write("cgroup/memory/c/memory.limit_in_bytes", "9000\n");
  write("cgroup/memory/c/memory.usage_in_bytes", "4000\n");
  write("cgroup/memory/c/memory.stat", "cache 10\ninactive_file 1\ntotal_inactive_file 1000\n");
  CHECK(left("5:devices:/c\n4:cpu,memory:/c\n1:name=systemd:/c\n") == 6000);
}

TEST_CASE("sizes of memory are read as they are written") {
  for (const double bytes : {5e6, 1.5e9, 4e9, 31e9})
    CHECK(memory_from_text(memory_text(bytes), "size") == bytes);
  CHECK(memory_from_text("2GiB", "size") == 2147483648.0);
  CHECK_THROWS_AS(memory_from_text("4 houses", "size"), ConfigError);
}

}  // namespace
}  // namespace satsurf
