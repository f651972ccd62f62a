// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"

#include <string>

#include <doctest/doctest.h>

using namespace satsurf;

TEST_CASE("error: the text is one line, whatever a file holds") {
  CHECK(std::string(Error("a.tif: as it is, expected \xC3\xA4").what()) ==
        "a.tif: as it is, expected \xC3\xA4");
  CHECK(std::string(IoError("key 'a\nb\r\t\x1b[2J\x7f'").what()) ==
        "key 'a\\nb\\r\\t\\x1b[2J\\x7f'");
  CHECK(std::string(ConfigError(std::string("a\0b", 3)).what()) == "a\\x00b");
  // U+009B begins a sequence as ESC [ does; what lies beside the controls U+0080 to U+009F stays
  CHECK(std::string(IoError("k\xC2\x9B"
                            "2J")
                        .what()) == "k\\x9b2J");
  CHECK(std::string(Error("\xC2\x80\xC2\x9F\xC2\xA0\xC2\xA9\xC3\x9B\xC2").what()) ==
        "\\x80\\x9f\xC2\xA0\xC2\xA9\xC3\x9B\xC2");
}

TEST_CASE("error: of a long text beginning and hint are left, in whole characters") {
  std::string umlauts;
  for (int i = 0; i < 10000; ++i) umlauts += "\xC3\xA4";
  for (const char* shift : {"", "x"}) {
    const std::string text =
        IoError(std::string(shift) + "a.json: " + umlauts + ", expected less; name it").what();
    CHECK(text.size() < 4200);
    CHECK(text.starts_with(std::string(shift) + "a.json: \xC3\xA4"));
    CHECK(text.ends_with("\xC3\xA4, expected less; name it"));
    const auto cut = text.find(" ... ");
    REQUIRE(cut != std::string::npos);
    CHECK(text[cut - 1] == '\xA4');
    CHECK(text[cut + 5] == '\xC3');
  }
}
