// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/isa.h"

#include <array>
#include <cstdio>
#include <iostream>
#include <string>

#include <doctest/doctest.h>
#include <unistd.h>

using namespace satsurf;

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
  CHECK(isa_under(best) == best);
  for (const char* name : {"avx2", "avx512"}) {
    const std::string got = isa_under(name);
    CHECK((got == name || got == std::string("SATSURF_ISA: ") + name +
                                     ", expected a set that this processor has"));
  }
}

TEST_CASE("isa: names") {
  CHECK(isa_name(Isa::baseline) == std::string("baseline"));
  CHECK(isa_name(Isa::avx2) == std::string("avx2"));
  CHECK(isa_name(Isa::avx512) == std::string("avx512"));
}
