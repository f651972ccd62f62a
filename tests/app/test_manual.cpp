// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/completion.h"
#include "satsurf/app/manual.h"
#include "satsurf/app/program.h"

#include <string>

#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::app;

namespace {

bool has(const std::string& text, const std::string& what) {
  return text.find(what) != std::string::npos;
}

void add_two(Program& program) {
  add_reconstruct(program);
  add_help(program);
}

}  // namespace

TEST_CASE("the manual page tells of every flag") {
  Program program;
  add_two(program);
  const std::string page = man_page(program);
  CHECK(page.starts_with(".TH SATSURF 1 "));
  CHECK(has(page, ".SH SATSURF RECONSTRUCT\n"));
  CHECK(has(page, ".B satsurf reconstruct\n\\fIIMG\\fR... [\\fIoptions\\fR]\n"));
  CHECK(has(page, "\\fB\\-\\-height\\-range\\fR \\fILOW HIGH in m\\fR\n"));
  CHECK(has(page, "\\fIreport.html\\fR"));
  for (const Command& command : program.commands)
    for (const Flag& flag : command.flags.all()) {
      std::string name;
      for (const char c : flag.option->get_name()) name += c == '-' ? "\\-" : std::string(1, c);
      CAPTURE(name);
      CHECK(has(page, name));
    }
}

TEST_CASE("completion offers commands, flags and choices") {
  Program program;
  add_two(program);
  const std::string script = bash_completion(program);
  CHECK(has(script, "compgen -W \"reconstruct help --help --version\""));
  CHECK(has(script, "    \"reconstruct --report\") words=\"html none\" ;;\n"));
  CHECK(has(script, " --height-range "));
  CHECK(!has(script, " images "));  // an argument without dashes is a file
}

TEST_CASE("what was meant is named") {
  Program program;
  add_two(program);
  CHECK(unknown_command(program, "reconstuct") ==
        "unknown command reconstuct, did you mean reconstruct? expected one of reconstruct, help");
  CHECK(unknown_command(program, "paint") ==
        "unknown command paint, expected one of reconstruct, help");
  const auto refused = [&](std::vector<std::string> line) {
    std::ranges::reverse(line);
    try {
      program.app.parse(line);
    } catch (const CLI::ExtrasError&) {
      return unexpected_arguments(program, program.app.remaining(true));
    } catch (const CLI::ParseError& e) {
      return wrong_value(program, e.what()) + help_hint(program);
    }
    return std::string("no error");
  };
  CHECK(refused({"reconstruct", "a.tif", "--heigth-range", "1", "2"}) ==
        "reconstruct: unknown flag --heigth-range, did you mean --height-range?; see satsurf help "
        "reconstruct");
  CHECK(refused({"reconstruct", "a.tif", "--colour=3"}) ==
        "reconstruct: unknown flag --colour; see satsurf help reconstruct");
  CHECK(refused({"help", "info", "render"}) == "help: unexpected render; see satsurf help help");
  CHECK(refused({"help", "--completion"}) ==
        "help: --completion came without a value, expected bash; see satsurf help help");
  CHECK(refused({"reconstruct", "a.tif", "--report"}) ==
        "reconstruct: --report came without a value, expected one of html, none; see satsurf help "
        "reconstruct");
  CHECK(refused({"reconstruct", "a.tif", "--quiet=maybe"}) ==
        "--quiet is 'maybe', expected true or false; see satsurf help reconstruct");
  CHECK(refused({"reconstruct", "a.tif", "b.tif"}) ==
        "--out is required; see satsurf help reconstruct");
  CHECK(refused({"reconstruct", "a.tif", "--out"}) ==
        "reconstruct: --out came without a value, expected DIR; see satsurf help reconstruct");
  CHECK(with_flag("a.json: no image; name its folder", true).ends_with(" with --image-dir"));
  CHECK(with_flag("a.json: no image; name its folder", false).ends_with(" its folder"));
  CHECK(with_flag("a.pgm: of the format PNM; SATSURF_GDAL_DRIVERS=PNM in the environment allows it",
                  false) == "a.pgm: of the format PNM; --gdal-drivers PNM allows it");
  CHECK(with_flag("else", true) == "else");
}
