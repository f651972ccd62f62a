// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/flags.h"
#include "satsurf/app/program.h"
#include "satsurf/app/reference.h"
#include "satsurf/core/error.h"
#include "satsurf/evaluate/table.h"

#include <string>
#include <utility>
#include <vector>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::app;
using test::error_of;

namespace {

enum class Season { winter, summer };

}  // namespace

template <>
struct satsurf::EnumNames<Season> {
  static constexpr std::array names{"winter", "summer"};
};

namespace {

struct Walk {
  std::vector<std::filesystem::path> maps, guides;
  OptionalPair heights;
  double pace = 0;
  Season season = Season::summer;
  bool rests = true, alone = false;
  std::vector<int> stops{1, 2};

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("maps", s.maps, Field{.flag = "maps", .placeholder = "MAP"});
    v("guides", s.guides, Field{.flag = "--guide"});
    v("heights", s.heights, Field{.unit = "m", .max = 9000, .placeholder = "LOW HIGH"});
    v("pace", s.pace,
      Field{.help = "how fast", .min = 0.5, .max = 5, .automatic = "as the others do"});
    v("season", s.season);
    v("rests", s.rests, Field{.flag = "--no-rests"});
    v("alone", s.alone, Field{.flag = "--alone"});
    v("stops", s.stops, Field{.flag = "--stops,--halts"});
  }
};

struct Swim {
  double pace = 1;
  int lanes = 2;
  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("pace", s.pace);
    v("lanes", s.lanes);
  }
};

/// The walk that a command line asks for.
Walk walk(std::vector<std::string> line) {
  CLI::App app("", "go");
  Walk w;
  Flags flags(app);
  flags.add_config();
  flags.add(collect_fields(w));
  std::ranges::reverse(line);
  app.parse(line);
  read_config(flags, w);
  return w;
}

}  // namespace

TEST_CASE("flags set the fields they are declared by") {
  const Walk none = walk({});
  CHECK(to_json(none) == to_json(Walk()));
  const Walk w =
      walk({"a b.map", "c,d.map", "--guide", "x", "--guide", "y", "--heights", "-5", "80", "--pace",
            "2.5", "--season", "winter", "--no-rests", "--alone", "--halts", "3,4,5"});
  CHECK(w.maps == std::vector<std::filesystem::path>{"a b.map", "c,d.map"});
  CHECK(w.guides == std::vector<std::filesystem::path>{"x", "y"});
  CHECK(w.heights == OptionalPair({-5, 80}));
  CHECK(w.pace == 2.5);
  CHECK(w.season == Season::winter);
  CHECK(!w.rests);
  CHECK(w.alone);
  CHECK(w.stops == std::vector{3, 4, 5});
}

TEST_CASE("flags win over the file, the file over the defaults") {
  const test::TempFolder folder("flags");
  const std::string file = (folder / "walk.json").string();
  test::write_bytes(folder / "walk.json",
                    R"({"maps": ["m"], "heights": [1, 2], "pace": 0, "rests": false,
                        "season": "winter"})");
  const Walk w = walk({"--config", file});
  CHECK(w.maps == std::vector<std::filesystem::path>{"m"});
  CHECK(w.heights == OptionalPair({1, 2}));
  CHECK(w.pace == 0);
  CHECK(!w.rests);
  const Walk changed = walk({"--config", file, "n", "--no-rests=false", "--season", "summer"});
  CHECK(changed.maps == std::vector<std::filesystem::path>{"n"});
  CHECK(changed.rests);
  CHECK(changed.season == Season::summer);
  CHECK(changed.heights == OptionalPair({1, 2}));
  test::write_bytes(folder / "walk.json", R"({"program": "satsurf", "command": "swim",
                                              "config": {}})");
  CHECK(error_of<ConfigError>([&] {
          walk({"--config", file});
        }) == file + ": the record of \"swim\", expected one of \"go\"");
}

TEST_CASE("values that are refused name the flag") {
  const auto refused = [](const std::vector<std::string>& line) {
    return error_of<ConfigError>([&] { walk(line); });
  };
  CHECK(refused({"--pace", "9"}) == "go: --pace is '9', expected a number from 0.5 to 5");
  CHECK(refused({"--pace", "0"}) == "go: --pace is '0', expected a number from 0.5 to 5");
  CHECK(refused({"--season", "May"}) == "go: --season is 'May', expected one of winter, summer");
  CHECK(refused({"--heights", "1", "nan"}) ==
        "go: --heights is 1 nan, expected 2 x numbers of at most 9000");
  CHECK(refused({"--halts", "1,x"}).starts_with("go: --stops is '1,x', expected a list of"));
  CHECK_THROWS_AS(walk({"--heights", "1"}), CLI::ParseError);
}

TEST_CASE("a flag of two structs is made once, and one of another is refused") {
  CLI::App app("", "go");
  Walk w;
  Swim s;
  Flags flags(app);
  flags.add(collect_fields(w), "On land");
  flags.add(collect_fields(s), "In water", "On land or in water");
  CHECK(app.get_option("--pace")->get_group() == "On land or in water");
  CHECK(app.get_option("--pace")->get_description() ==
        "how fast (0.5 to 5) [as the others do]; In water: 1");
  CHECK(app.get_option("--lanes")->get_group() == "In water");
  const std::vector<Mode> modes{{"walk", collect_fields(w)}, {"swim", collect_fields(s)}};
  std::vector<std::string> line{"3", "--lanes", "2", "--pace"};
  app.parse(line);
  CHECK_NOTHROW(refuse_others(flags, modes, modes[1]));
  CHECK(error_of<ConfigError>([&] { refuse_others(flags, modes, modes[0]); }) ==
        "go walk: --lanes came, expected only with swim");
  flags.read(modes[1].fields);
  CHECK(s.pace == 2);
  CHECK(s.lanes == 3);
  CHECK(w.pace == 0);
}

TEST_CASE("the reference tells of every flag and every column") {
  Program program;
  for (const auto add : {add_info, add_simulate, add_train, add_reconstruct, add_evaluate,
                         add_render, add_export, add_help})
    add(program);
  const std::string text = reference(program);
  for (const Command& command : program.commands) {
    CAPTURE(command.flags.name());
    CHECK(text.find("### satsurf " + command.flags.name() + "\n") != std::string::npos);
    for (const Flag& flag : command.flags.all()) {
      CAPTURE(flag.info.name);
      CHECK(!flag.info.help.empty());
    }
  }
  for (const evaluate::TableColumn& column : evaluate::table_columns()) {
    CAPTURE(column.name);
    CHECK(!column.meaning.empty());
    CHECK(text.find("| `" + column.number + "` |") != std::string::npos);
    CHECK((column.group.empty() || text.find("| `" + column.group + "` |") != std::string::npos));
  }
}
