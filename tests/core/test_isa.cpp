// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/isa.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <fstream>
#include <initializer_list>
#include <iostream>
#include <iterator>
#include <set>
#include <sstream>
#include <string>

#include "tests/isa_variants.h"
#include <unistd.h>

using namespace satsurf;
using test::tested_isas;

namespace {

/// What a fresh copy of this program finds under SATSURF_ISA: the choice is fixed within a process.
std::string isa_under(const std::string& variable) {
  std::array<char, 4096> self{};
  const auto length = ::readlink("/proc/self/exe", self.data(), self.size() - 1);
  REQUIRE(length > 0);
  const std::string command = "SATSURF_ISA='" + variable + "' '" + self.data() +
                              "' --no-skip --test-case='isa: child process' | grep '^isa='";
  FILE* pipe = ::popen(command.c_str(), "r");
  REQUIRE(pipe != nullptr);
  std::array<char, 512> line{};
  const bool read = std::fgets(line.data(), line.size(), pipe) != nullptr;
  ::pclose(pipe);
  REQUIRE(read);
  std::string text = line.data();
  return text.substr(4, text.size() - 5);
}

}  // namespace

TEST_CASE("isa: child process" * doctest::skip()) {
  try {
    const char* name = isa_name(active_isa());
    std::cout << "isa=" << name << std::endl;
  } catch (const ConfigError& e) {
    std::cout << "isa=" << e.what() << std::endl;
  }
}

TEST_CASE("isa: SATSURF_ISA picks a set, an unknown one is refused") {
  CHECK(isa_under("baseline") == "baseline");
  CHECK(isa_under("sse9") == "SATSURF_ISA: 'sse9', expected baseline, avx2 or avx512");
  const std::string best = isa_under("");
  const auto available = tested_isas();
  CHECK(best == isa_name(available.back()));  // named from the least to the best
  CHECK(isa_under(best) == best);
  for (const char* name : {"avx2", "avx512"}) {
    const std::string got = isa_under(name);
    CHECK((got == name || got == std::string("SATSURF_ISA: ") + name +
                                     ", expected a set that this processor has"));
  }
}

TEST_CASE("isa: a set is available where the system lists what it is made of") {
  CHECK(isa_available(Isa::baseline));
  CHECK(tested_isas().front() == Isa::baseline);
#if defined(__x86_64__)
  std::ifstream cpus("/proc/cpuinfo");
  std::string line;
  while (std::getline(cpus, line) && !line.starts_with("flags")) {
  }
  if (!cpus) {
    MESSAGE("skipped: /proc/cpuinfo lists no flags");
    return;
  }
  std::istringstream words(line);
  const std::set<std::string> flags{std::istream_iterator<std::string>(words), {}};
  const auto has = [&](std::initializer_list<const char*> wanted) {
    return std::ranges::all_of(wanted, [&](const char* flag) { return flags.contains(flag); });
  };
  CHECK(isa_available(Isa::avx2) == has({"avx2", "fma"}));
  CHECK(isa_available(Isa::avx512) ==
        has({"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "fma"}));
#endif
}

TEST_CASE("isa: names") {
  CHECK(isa_name(Isa::baseline) == std::string("baseline"));
  CHECK(isa_name(Isa::avx2) == std::string("avx2"));
  CHECK(isa_name(Isa::avx512) == std::string("avx512"));
}
