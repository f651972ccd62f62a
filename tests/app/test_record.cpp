// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/output_folder.h"
#include "satsurf/app/record.h"
#include "satsurf/app/sha256.h"
#include "satsurf/core/error.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/core/version.h"

#include <cstdlib>
#include <fstream>
#include <regex>
#include <vector>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::app;
using test::error_of, test::read_bytes, test::write_bytes;
namespace fs = std::filesystem;

namespace {

/// Makes a folder look like one that a run has left.
void leave_run(const fs::path& folder) {
  fs::create_directories(folder);
  write_bytes(folder / "run.json", R"({"program": "satsurf", "command": "reconstruct"})");
}

std::ptrdiff_t entries(const fs::path& folder) {
  return std::distance(fs::directory_iterator(folder), {});
}

}  // namespace

TEST_CASE("sha256: the published examples") {
  CHECK(sha256("") == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  CHECK(sha256("abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  CHECK(sha256("abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq") ==
        "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
  CHECK(sha256(std::string(1'000'000, 'a')) ==
        "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
}

TEST_CASE("sha256: files give the hash of their bytes, whatever the size of the pieces") {
  const test::TempFolder folder("sha256");
  for (const std::size_t n : {0U, 55U, 64U, 1U << 20, (1U << 20) + 1}) {
    const std::string bytes(n, 'x');
    write_bytes(folder / "f", bytes);
    CHECK(sha256_of_file(folder / "f") == sha256(bytes));
  }
  const std::string missing = (folder / "none").string();
  CHECK(error_of<IoError>([&] { sha256_of_file(missing); }) ==
        missing + ": no such file, expected a file");
  CHECK(error_of<IoError>([&] { sha256_of_file(folder.path()); }) ==
        folder.path().string() + ": is a folder, expected a file");
}

namespace {

struct NamesFiles {
  fs::path weights = "nets/w.safetensors", mask;
  std::vector<fs::path> images{"a.tif", "/data/b.tif"};
  std::string crs = "auto";
  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("weights", s.weights, Field{.help = "a file"});
    v("mask", s.mask, Field{.help = "another", .automatic = "none"});
    v("images", s.images, Field{.help = "some files"});
    v("crs", s.crs, Field{.help = "no file"});
  }
};

}  // namespace

TEST_CASE("record: files of a configuration are named in full, so that any folder repeats it") {
  const std::string here = fs::current_path().string();
  const NamesFiles config;
  CHECK(recorded_config(config) == nlohmann::json{{"weights", here + "/nets/w.safetensors"},
                                                  {"mask", ""},
                                                  {"images", {here + "/a.tif", "/data/b.tif"}},
                                                  {"crs", "auto"}});
  CHECK(to_json(config)["weights"] == "nets/w.safetensors");
}

TEST_CASE("record: holds what a run depended on") {
  const test::TempFolder folder("record");
  fs::create_directories(folder / "data/sub");
  write_bytes(folder / "data/b.tif", "abc");
  write_bytes(folder / "data/sub/a.tif", "");
  write_bytes(folder / "one.tif", "xy");

  RunRecord record("train", {{"lr", 0.5}}, 18446744073709551615U);
  record.add_input(folder / "data");
  record.add_input(folder / "one.tif");
  record.results()["mae"] = 1.25;
  record.add_warning("large_gaps", "41 % has a height");
  record.save(folder / "out/run.json");

  const auto j = load_json_file(folder / "out/run.json");
  CHECK(j["program"] == "satsurf");
  CHECK(std::regex_match(j["version"].get<std::string>(), std::regex(R"(\d+\.\d+\.\d+)")));
  CHECK(std::regex_match(j["git"].get<std::string>(), std::regex("[0-9a-f]{40}(-dirty)?|unknown")));
  CHECK(j["command"] == "train");
  CHECK(j["config"] == nlohmann::json{{"lr", 0.5}});
  CHECK(j["seed"] == 18446744073709551615U);
  CHECK(!j["host"].get<std::string>().empty());
  CHECK(std::regex_match(j["isa"].get<std::string>(), std::regex("baseline|avx2|avx512")));
  CHECK(j["threads"] >= 1);
  CHECK(std::regex_match(j["started"].get<std::string>(),
                         std::regex(R"(20\d\d-\d\d-\d\dT\d\d:\d\d:\d\dZ)")));
  CHECK(j["wall_seconds"] >= 0.0);
  CHECK(j["wall_seconds"] < 60.0);
  CHECK(j["peak_memory_bytes"] > 1'000'000);
  CHECK(j["peak_tensor_bytes"].is_number_unsigned());
  REQUIRE(j["inputs"].size() == 3);
  CHECK(j["inputs"][0] == nlohmann::json{{"path", (folder / "data/b.tif").string()},
                                         {"bytes", 3},
                                         {"sha256", sha256("abc")}});
  CHECK(j["inputs"][1]["path"] == (folder / "data/sub/a.tif").string());
  CHECK(j["inputs"][1]["bytes"] == 0);
  CHECK(j["inputs"][2]["sha256"] == sha256("xy"));
  CHECK(j["warnings"] == nlohmann::json{{{"code", "large_gaps"}, {"text", "41 % has a height"}}});
  CHECK(j["results"] == nlohmann::json{{"mae", 1.25}});

  std::vector<std::string> keys;
  for (const auto& [key, meaning] : record_keys()) {
    CHECK(!meaning.empty());
    keys.push_back(key);
  }
  std::vector<std::string> written;
  const nlohmann::ordered_json again = record.json();
  for (const auto& [key, value] : again.items()) written.push_back(key);
  CHECK(written == keys);

  CHECK(load_config(folder / "out/run.json", "train") == nlohmann::json{{"lr", 0.5}});
  write_bytes(folder / "plain.json", R"({"lr": 0.25, "config": 1})");
  CHECK(load_config(folder / "plain.json", "train") == nlohmann::json{{"lr", 0.25}, {"config", 1}});
  CHECK(error_of<ConfigError>([&] { load_config(folder / "out/run.json", "simulate"); }) ==
        (folder / "out/run.json").string() +
            ": the record of \"train\", expected one of \"simulate\"");
  CHECK(error_of<IoError>([&] { record.add_input(folder / "none"); }) ==
        (folder / "none").string() + ": no such file, expected a file");
}

TEST_CASE("output folder: staged files appear together, or not at all") {
  const test::TempFolder folder("staged");
  const fs::path out = folder / "new/out";
  SUBCASE("dropped") {
    {
      const OutputFolder staged = OutputFolder::staged(out, false);
      write_bytes(staged / "dsm.tif", "half");
      CHECK(!fs::exists(out));
      CHECK(staged.path().parent_path() == fs::weakly_canonical(out.parent_path()));
    }
    CHECK(fs::is_empty(folder.path()));
  }
  SUBCASE("dropped by an exception after a move") {
    CHECK(error_of<Error>([&] {
            OutputFolder first = OutputFolder::staged(out, false);
            const OutputFolder second = std::move(first);
            write_bytes(second / "dsm.tif", "half");
            throw Error("stop");
          }) == "stop");
    CHECK(fs::is_empty(folder.path()));
  }
  SUBCASE("committed, also into a folder that is there and empty, or named with a slash") {
    fs::create_directories(out);
    {
      OutputFolder staged = OutputFolder::staged(out.string() + "/", false);
      write_bytes(staged / "dsm.tif", "whole");
      CHECK(fs::is_empty(out));
      staged.commit();
      CHECK(staged.path() == fs::weakly_canonical(out));
      staged.commit();  // a second time changes nothing
    }
    CHECK(read_bytes(out / "dsm.tif") == "whole");
    CHECK(entries(folder / "new") == 1);
  }
}

TEST_CASE("output folder: what exists is replaced only when asked, and only when done") {
  const test::TempFolder folder("existing");
  const fs::path out = folder / "out";
  leave_run(out);
  write_bytes(out / "old.tif", "old");
  const std::string refusal =
      "--out: " + out.string() + " exists and is not empty; use --overwrite";
  CHECK(error_of<IoError>([&] { OutputFolder::staged(out, false); }) == refusal);
  CHECK(entries(folder.path()) == 1);

  { const OutputFolder dropped = OutputFolder::staged(out, true); }
  CHECK(read_bytes(out / "old.tif") == "old");
  {
    OutputFolder staged = OutputFolder::staged(out, true);
    leave_run(staged.path());
    write_bytes(staged / "new.tif", "new");
    CHECK(fs::exists(out / "old.tif"));
    staged.commit();
  }
  CHECK(!fs::exists(out / "old.tif"));
  CHECK(read_bytes(out / "new.tif") == "new");
  CHECK(entries(folder.path()) == 1);

  SUBCASE("a link keeps pointing to its folder") {
    fs::create_directory_symlink(out, folder / "link");
    OutputFolder staged = OutputFolder::staged(folder / "link", true);
    write_bytes(staged / "linked.tif", "x");
    staged.commit();
    CHECK(fs::is_symlink(folder / "link"));
    CHECK(fs::exists(out / "linked.tif"));
  }
  SUBCASE("a file is no folder") {
    const fs::path file = out / "new.tif";
    CHECK(error_of<IoError>([&] { OutputFolder::staged(file, true); }) ==
          "--out: " + file.string() + " is a file, expected a folder");
  }
  SUBCASE("the working folder and those around it are safe") {
    for (const fs::path& dangerous : {fs::path("."), fs::path(".."), fs::path("/")})
      CHECK(error_of<IoError>([&] { OutputFolder::staged(dangerous, true); }) ==
            "--out: " + dangerous.string() +
                " holds the working or the home folder, which --overwrite would remove");
  }
}

TEST_CASE("output folder: only a run of the program is overwritten, and no input") {
  const test::TempFolder folder("overwrite");
  const fs::path out = folder / "out";
  fs::create_directories(out);
  write_bytes(out / "thesis.txt", "years");
  const auto refused = [&](const std::vector<fs::path>& inputs = {}) {
    const std::string text = error_of<IoError>([&] { OutputFolder::staged(out, true, inputs); });
    CHECK(read_bytes(out / "thesis.txt") == "years");
    CHECK(!fs::exists(out.string() + ".partial-" + std::to_string(::getpid())));
    return text;
  };
  const std::string no_run = "--out: " + out.string() +
                             " holds no run.json of an earlier run, expected one for --overwrite; "
                             "name another folder";
  CHECK(refused() == no_run);
  for (const char* other : {"{}", "[1]", "{", R"({"program": "another", "command": "train"})",
                            R"({"program": "satsurf", "command": "evaluate"})"}) {
    write_bytes(out / "run.json", other);
    CHECK(refused() == no_run);
  }
  leave_run(out);
  write_bytes(folder / "elsewhere.tif", "");
  fs::create_symlink(out / "thesis.txt", folder / "to-inside");
  fs::create_symlink(folder / "elsewhere.tif", out / "to-outside");
  for (const fs::path& input : {out, out / "thesis.txt", out / "to-outside", out / "missing.tif",
                                folder / "to-inside", folder / "elsewhere.tif/../out/thesis.txt"})
    CHECK(refused({folder / "elsewhere.tif", {}, input}) ==
          "--out: " + out.string() + " holds the input " + input.string() +
              ", expected a folder of its own");
  { const OutputFolder apart = OutputFolder::staged(out, true, {folder / "elsewhere.tif", {}}); }

  SUBCASE("a folder that others fill meanwhile stays theirs") {
    const fs::path fresh = folder / "fresh";
    OutputFolder staged = OutputFolder::staged(fresh, false);
    fs::create_directories(fresh);
    write_bytes(fresh / "theirs", "x");
    CHECK(error_of<IoError>([&] { staged.commit(); }) ==
          "--out: " + fresh.string() + " exists and is not empty; use --overwrite");
    CHECK(read_bytes(fresh / "theirs") == "x");
  }
}

TEST_CASE("output folder: what a killed process has left goes with the next run") {
  const test::TempFolder folder("killed");
  const fs::path out = folder / "out";
  for (const char* name : {"out.partial-7", "out.partial-123", "out.partial-x", "out.partial-",
                           "other.partial-7", "out.replaced-8"})
    fs::create_directories(folder / name);
  write_bytes(folder / "out.partial-7/dsm.tif", "half");
  write_bytes(folder / "out.partial-9", "a file");
  fs::create_directory_symlink(folder / "other.partial-7", folder / "out.partial-10");
  SUBCASE("nothing is there") {
    fs::remove_all(folder / "out.replaced-8");
    { const OutputFolder dropped = OutputFolder::staged(out, false); }
    CHECK(fs::exists(folder / "out.partial-7"));
    OutputFolder::staged(out, false).commit();
  }
  SUBCASE("what was to be replaced is there still") {
    leave_run(out);
    CHECK(error_of<IoError>([&] { OutputFolder::staged(out, false); }).ends_with("--overwrite"));
    CHECK(fs::exists(folder / "out.partial-7"));
    OutputFolder::staged(out, true).commit();
    CHECK(fs::is_empty(out));
  }
  SUBCASE("what was to be replaced has been moved away") {
    leave_run(folder / "out.replaced-8");
    write_bytes(folder / "out.replaced-8/old.tif", "old");
    CHECK(error_of<IoError>([&] { OutputFolder::staged(out, false); }) ==
          "--out: " + out.string() + " exists and is not empty; use --overwrite");
    CHECK(read_bytes(out / "old.tif") == "old");
    OutputFolder::staged(out, true).commit();
  }
  SUBCASE("in place") {
    leave_run(out);
    write_bytes(out / ".checkpoint.partial-7-0", "half");
    write_bytes(out / ".checkpoint.partial-7", "not ours");
    OutputFolder place = OutputFolder::in_place(out);
    CHECK(fs::exists(out / ".checkpoint.partial-7-0"));
    place.commit();
    CHECK(!fs::exists(out / ".checkpoint.partial-7-0"));
    CHECK(fs::exists(out / ".checkpoint.partial-7"));
  }
  for (const char* name : {"out.partial-7", "out.partial-123", "out.replaced-8"}) {
    CAPTURE(name);
    CHECK(!fs::exists(folder / name));
  }
  for (const char* name :
       {"out.partial-x", "out.partial-", "other.partial-7", "out.partial-9", "out.partial-10"}) {
    CAPTURE(name);
    CHECK(fs::exists(folder / name));
  }
}

TEST_CASE("output folder: a place that a living process works on is refused") {
  const test::TempFolder folder("living");
  const fs::path out = folder / "out";
  const auto refusal = [&](const fs::path& busy) {
    return "--out: " + out.string() + " is being worked on by another process (" +
           fs::weakly_canonical(busy).string() + "), expected to have it alone";
  };
  const auto staged = [&] { OutputFolder::staged(out, true); };
  const auto in_place = [&] { OutputFolder::in_place(out); };
  OutputFolder first = OutputFolder::staged(out, false);
  leave_run(first.path());
  CHECK(error_of<IoError>(staged) == refusal(first.path()));
  CHECK(error_of<IoError>(in_place) == refusal(first.path()));
  first.commit();  // and goes on there, as a training does
  CHECK(error_of<IoError>(staged) == refusal(out));
  CHECK(error_of<IoError>(in_place) == refusal(out));
  { const OutputFolder gone = std::move(first); }
  { const OutputFolder second = OutputFolder::staged(out, true); }
  const OutputFolder third = OutputFolder::in_place(out);
  CHECK(error_of<IoError>(in_place) == refusal(out));
}

TEST_CASE("output folder: folders made around it go with it") {
  const test::TempFolder folder("around");
  fs::create_directories(folder / "kept");
  { const OutputFolder dropped = OutputFolder::staged(folder / "kept/new/deep/out", false); }
  CHECK(fs::is_empty(folder / "kept"));
  {
    const OutputFolder dropped = OutputFolder::staged(folder / "kept/new/deep/out", false);
    write_bytes(folder / "kept/new/theirs", "x");
  }
  CHECK(entries(folder / "kept/new") == 1);
  OutputFolder::staged(folder / "kept/new/deep/out", false).commit();
  CHECK(fs::is_directory(folder / "kept/new/deep/out"));
}

TEST_CASE("output folder: in place, whatever is there stays") {
  const test::TempFolder folder("in-place");
  const fs::path out = folder / "out";
  { const OutputFolder nothing = OutputFolder::in_place(out); }
  CHECK(!fs::exists(out));
  fs::create_directories(out);
  write_bytes(out / "checkpoint", "1");
  {
    OutputFolder place = OutputFolder::in_place(out);
    CHECK(place.in_its_place());
    CHECK(read_bytes(place / "checkpoint") == "1");
    place.commit();
  }
  CHECK(read_bytes(out / "checkpoint") == "1");
  CHECK(error_of<IoError>([&] { OutputFolder::in_place(out / "checkpoint"); }) ==
        "--out: " + (out / "checkpoint").string() + " is a file, expected a folder");
  CHECK(error_of<IoError>([&] { OutputFolder::staged("", true); }) ==
        "--out: the name is empty, expected a folder");
}
