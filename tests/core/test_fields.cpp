// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/fields.h"
#include "satsurf/core/fields_json.h"

#include <cmath>
#include <ctime>
#include <filesystem>
#include <limits>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using nlohmann::json;
using test::error_of;

namespace {

struct Net {
  Index base = 8;
  std::vector<int> widths{1, 2};
  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("base", s.base, Field{.help = "channels | first level", .min = 1, .max = 64});
    v("widths", s.widths, Field{.min = 1});
  }
};

enum class Season { winter, spring, summer };

}  // namespace

template <>
struct satsurf::EnumNames<Season> {
  static constexpr std::array names{"winter", "spring", "summer"};
};

namespace {

struct Calendar {
  Season season = Season::spring;
  std::vector<Season> seen{Season::winter, Season::summer};
  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("season", s.season, Field{.help = "of the year"});
    v("seen", s.seen);
  }
};

struct Request {
  std::vector<std::filesystem::path> images;
  std::filesystem::path weights;
  OptionalPair range;
  double voxel = 0;
  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("images", s.images);
    v("weights", s.weights);
    v("range", s.range, Field{.max = 9000});
    v("voxel", s.voxel,
      Field{.help = "detail", .unit = "m", .min = 0.01, .max = 1000, .automatic = "two pixels"});
  }
};

struct Config {
  double lr = 1e-3;
  float momentum = 0.1F;
  bool resume = false;
  int level = 3;
  std::uint64_t seed = 18446744073709551615U;
  std::string loss = "l1";
  std::string name;
  Net model{};
  std::array<double, 2> heights{0, 100};
  std::vector<std::string> bands{"red", "nir"};
  std::vector<bool> flags{true, false};
  std::array<bool, 2> pair{false, true};
  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("lr", s.lr, Field{.help = "peak learning rate", .unit = "1/step", .min = 0, .max = 1});
    v("momentum", s.momentum);
    v("resume", s.resume);
    v("level", s.level);
    v("seed", s.seed);
    v("loss", s.loss, Field{.choices = {"l1", "l2", "huber"}});
    v("name", s.name);
    v("model", s.model);
    v("heights", s.heights, Field{.unit = "m", .max = 9000});
    v("bands", s.bands, Field{.choices = {"red", "green", "nir"}});
    v("flags", s.flags);
    v("pair", s.pair);
  }
};

struct CountFields {
  int* count;
  template <class X>
  void operator()(const char*, X& x, const Field& = {}) {
    static_assert(std::is_const_v<X>);
    static_cast<void>(x);
    ++*count;
  }
};

std::string json_error(const char* text) {
  Config c;
  const json before = to_json(c);
  std::string error = error_of<ConfigError>([&] { from_json(json::parse(text), c, "train"); });
  CHECK(to_json(c) == before);  // a refused configuration changes nothing
  return error;
}

std::string text_error(const std::string& name, const std::string& text) {
  Config c;
  const json before = to_json(c);
  std::string error = error_of<ConfigError>([&] { set_field(c, name, text); });
  CHECK(to_json(c) == before);
  return error;
}

}  // namespace

TEST_CASE("fields: to JSON and back") {
  const Config a;
  const json j = to_json(a);
  CHECK(
      j.dump() ==
      R"({"bands":["red","nir"],"flags":[true,false],"heights":[0.0,100.0],"level":3,"loss":"l1",)"
      R"("lr":0.001,"model":{"base":8,"widths":[1,2]},"momentum":0.1,"name":"","pair":[false,true],)"
      R"("resume":false,"seed":18446744073709551615})");
  Config b;
  b.lr = 0.5;
  b.momentum = 9;
  b.resume = true;
  b.level = 0;
  b.seed = 1;
  b.loss = "l2";
  b.name = "x";
  b.model = {3, {}};
  b.bands.clear();
  b.flags.clear();
  b.pair = {true, true};
  from_json(j, b, "train");
  CHECK(to_json(b) == j);
  CHECK(b.momentum == 0.1F);
}

TEST_CASE("fields: only the keys that are present change anything") {
  Config c;
  from_json(
      json::parse(
          R"({"lr": 1, "model": {"base": 1e1}, "heights": [-5, 7.5], "pair": [true, false]})"),
      c, "train");
  CHECK(c.lr == 1.0);
  CHECK(c.model.base == 10);
  CHECK(c.model.widths == std::vector{1, 2});
  CHECK(c.heights == std::array{-5.0, 7.5});
  CHECK(c.pair == std::array{true, false});
  CHECK(c.loss == "l1");
}

TEST_CASE("fields: a const struct can be visited") {
  const Config c;
  int count = 0;
  Config::fields(c, CountFields{&count});
  CHECK(count == 12);
}

TEST_CASE("fields: unknown keys name the nearest known one") {
  CHECK(json_error(R"({"lrr": 1})") == "train: unknown key 'lrr', did you mean 'lr'?");
  CHECK(json_error(R"({"model": {"bse": 1}})") ==
        "train: unknown key 'model.bse', did you mean 'model.base'?");
  CHECK(json_error(R"({"model": {"parameters": 1}})") ==
        "train: unknown key 'model.parameters', expected one of model.base, model.widths");
  CHECK(json_error(R"({"heigths": [1, 2]})") ==
        "train: unknown key 'heigths', did you mean 'heights'?");
  CHECK(text_error("base", "1") == "option: unknown key 'base', did you mean 'model.base'?");
  CHECK(text_error("model", "1").starts_with("option: unknown key 'model', expected one of lr,"));
}

TEST_CASE("fields: wrong types, ranges and choices are refused with what was wanted") {
  CHECK(json_error("[1]") == "train: the configuration is [1], expected an object");
  CHECK(json_error(R"({"model": 3})") == "train: model is 3, expected an object");
  CHECK(json_error(R"({"lr": "1e-3"})") == R"(train: lr is "1e-3", expected a number from 0 to 1)");
  CHECK(json_error(R"({"lr": null})") == "train: lr is null, expected a number from 0 to 1");
  CHECK(json_error(R"({"lr": 2})") == "train: lr is 2, expected a number from 0 to 1");
  CHECK(json_error(R"({"lr": [0.5]})") == "train: lr is [0.5], expected a number from 0 to 1");
  CHECK(json_error(R"({"momentum": true})") == "train: momentum is true, expected a number");
  CHECK(json_error(R"({"momentum": 1e39})") == "train: momentum is 1e+39, expected a number");
  CHECK(json_error(R"({"resume": 1})") == "train: resume is 1, expected true or false");
  CHECK(json_error(R"({"level": 2.5})") ==
        "train: level is 2.5, expected an integer from -2147483648 to 2147483647");
  CHECK(json_error(R"({"level": 2147483648})") ==
        "train: level is 2147483648, expected an integer from -2147483648 to 2147483647");
  CHECK(json_error(R"({"seed": -1})") == "train: seed is -1, expected an integer of at least 0");
  CHECK(json_error(R"({"loss": "l3"})") == R"(train: loss is "l3", expected one of l1, l2, huber)");
  CHECK(json_error(R"({"name": 5})") == "train: name is 5, expected a text");
  CHECK(json_error(R"({"model": {"base": 65}})") ==
        "train: model.base is 65, expected an integer from 1 to 64");
  CHECK(json_error(R"({"model": {"widths": [3, 0]}})") ==
        "train: model.widths is [3,0], expected a list of integers of at least 1");
  CHECK(json_error(R"({"model": {"widths": 3}})") ==
        "train: model.widths is 3, expected a list of integers of at least 1");
  CHECK(json_error(R"({"heights": [1]})") ==
        "train: heights is [1], expected 2 x numbers of at most 9000");
  CHECK(json_error(R"({"heights": [1, "a"]})") ==
        "train: heights is [1,\"a\"], expected 2 x numbers of at most 9000");
  CHECK(json_error(R"({"bands": ["red", "blue"]})") ==
        R"(train: bands is ["red","blue"], expected a list of texts out of red, green, nir)");
  CHECK(json_error(R"({"pair": [true]})") == "train: pair is [true], expected 2 x true or false");
  CHECK(json_error(R"({"lr": 0.5, "level": "x"})").starts_with("train: level is"));
}

TEST_CASE("fields: values from text") {
  Config c;
  set_field(c, "lr", "2e-4");
  set_field(c, "resume", "true");
  set_field(c, "level", "-7");
  set_field(c, "seed", "18446744073709551614");
  set_field(c, "loss", "huber");
  set_field(c, "name", "a, b");
  set_field(c, "model.base", "1e1");
  set_field(c, "model.widths", "4,5,6");
  set_field(c, "heights", "-10,250.5");
  set_field(c, "bands", "");
  set_field(c, "flags", "0,1,true");
  CHECK(c.lr == 2e-4);
  CHECK(c.resume);
  CHECK(c.level == -7);
  CHECK(c.seed == 18446744073709551614U);
  CHECK(c.loss == "huber");
  CHECK(c.name == "a, b");
  CHECK(c.model.base == 10);
  CHECK(c.model.widths == std::vector{4, 5, 6});
  CHECK(c.heights == std::array{-10.0, 250.5});
  CHECK(c.bands.empty());
  CHECK(c.flags == std::vector{false, true, true});

  CHECK(text_error("lr", "abc") == "option: lr is 'abc', expected a number from 0 to 1");
  CHECK(text_error("lr", "nan") == "option: lr is 'nan', expected a number from 0 to 1");
  CHECK(text_error("momentum", "inf") == "option: momentum is 'inf', expected a number");
  CHECK(text_error("lr", "") == "option: lr is '', expected a number from 0 to 1");
  CHECK(text_error("lr", "0.5x") == "option: lr is '0.5x', expected a number from 0 to 1");
  CHECK(text_error("resume", "yes") == "option: resume is 'yes', expected true or false");
  CHECK(text_error("level", "1e300") ==
        "option: level is '1e300', expected an integer from -2147483648 to 2147483647");
  CHECK(text_error("heights", "1,2,3") ==
        "option: heights is '1,2,3', expected 2 x numbers of at most 9000");
  CHECK(text_error("model.widths", "1,,2") ==
        "option: model.widths is '1,,2', expected a list of integers of at least 1");
}

TEST_CASE("fields: description and table") {
  const auto rows = describe<Config>();
  REQUIRE(rows.size() == 13);
  CHECK(rows[0] == FieldInfo{"lr", "number", "0.001", "0 to 1", "1/step", "peak learning rate"});
  CHECK(rows[5] == FieldInfo{"loss", "text", "l1", "l1 | l2 | huber", "", ""});
  CHECK(rows[7] ==
        FieldInfo{"model.base", "integer", "8", "1 to 64", "", "channels | first level"});
  CHECK(rows[8] == FieldInfo{"model.widths", "comma-separated integers", "1,2", ">= 1", "", ""});
  CHECK(rows[9] == FieldInfo{"heights", "2 comma-separated numbers", "0,100", "<= 9000", "m", ""});
  CHECK(rows[11].value == "true,false");
  for (const FieldInfo& r : rows) {  // what is described can be set
    Config c;
    set_field(c, r.name, r.value);
    CHECK(to_json(c) == to_json(Config()));
  }
  CHECK(markdown_table({rows[0], rows[5], rows[7]}) ==
        "| Name | Type | Default | Range | Unit | Meaning |\n"
        "| --- | --- | --- | --- | --- | --- |\n"
        "| `lr` | number | `0.001` | 0 to 1 | 1/step | peak learning rate |\n"
        "| `loss` | text | `l1` | l1 \\| l2 \\| huber |  |  |\n"
        "| `model.base` | integer | `8` | 1 to 64 |  | channels \\| first level |\n");
}

TEST_CASE("fields: a struct filled in by code can be checked") {
  Config c;
  CHECK_NOTHROW(check_fields(c, "train"));
  c.model.base = 0;
  CHECK_THROWS_WITH_AS(check_fields(c, "train"),
                       "train: model.base is 0, expected an integer from 1 to 64", ConfigError);
  c = Config();
  c.momentum = std::numeric_limits<float>::quiet_NaN();
  CHECK_THROWS_WITH_AS(check_fields(c, "train"), "train: momentum is nan, expected a number",
                       ConfigError);
  CHECK_THROWS_WITH_AS(to_json(c), "momentum: nan, expected a finite number", ConfigError);
}

TEST_CASE("fields: a long JSON document takes time and memory in proportion") {
  const auto list_of = [](const std::string& element, std::size_t count) {
    std::string text = "{\"x\":[";
    for (std::size_t i = 0; i < count; ++i) text += element + ',';
    return text + "1]}";
  };
  const std::clock_t start = std::clock();
  CHECK(parse_json(list_of("{}", 400'000), "long")["x"].size() == 400'001);
  CHECK(std::clock() - start < 10 * CLOCKS_PER_SEC);  // half a minute, if squared
  CHECK(parse_json(list_of("[]", 1'999'997), "long")["x"].size() == 1'999'998);
  CHECK(error_of<IoError>([&] { parse_json(list_of("[]", 1'999'998), "long"); }) ==
        "long: more than 2000000 values, expected fewer");
}

TEST_CASE("fields: JSON files are read strictly and errors name the line") {
  const test::TempFolder folder("json");
  const auto path = folder / "c.json";
  const auto error = [&](const std::string& text) {
    test::write_bytes(path, text);
    const std::string e = error_of<IoError>([&] { load_json_file(path); });
    const std::string prefix = path.string() + ": ";
    return e.starts_with(prefix) ? e.substr(prefix.size()) : "no prefix: " + e;
  };
  test::write_bytes(path, "{\"lr\": 0.25}\n");
  CHECK(load_json_file(path) == json{{"lr", 0.25}});
  CHECK(error("{\n  \"lr\": 1,\n  oops\n}").starts_with("line 3, column 3: syntax error"));
  CHECK(error("").starts_with("line 1, column 1: "));
  CHECK(error("{\"lr\": NaN}").ends_with(", expected a JSON value (NaN and Infinity are none)"));
  CHECK(error("{\"a\": {\"b\": 1, \"c\": 2, \"b\": 3}}") == "key \"b\" appears twice");
  CHECK(error("{\"a\": [{\"b\": 1}, {\"b\": 2}]}") == "no prefix: no exception");
  CHECK(error(std::string(70000, '[') + std::string(70000, ']')) == "nested deeper than 64 levels");
  CHECK(error("{\"a\": 1e999}") == "number overflow parsing '1e999'");
  CHECK(error_of<IoError>([&] { load_json_file(folder / "none.json"); }) ==
        (folder / "none.json").string() + ": no such file, expected a JSON file");
  CHECK(error_of<IoError>([&] { load_json_file(folder.path()); }) ==
        folder.path().string() + ": is a folder, expected a JSON file");
}

TEST_CASE("an enumeration is spelled by its names in texts, JSON, help and errors") {
  Calendar c;
  CHECK(to_json(c).dump() == R"({"season":"spring","seen":["winter","summer"]})");
  set_field(c, "season", "summer");
  CHECK(c.season == Season::summer);
  set_field(c, "seen", "spring,spring");
  CHECK(c.seen == std::vector{Season::spring, Season::spring});
  from_json(json::parse(R"({"season": "winter", "seen": []})"), c, "file");
  CHECK(c.season == Season::winter);
  CHECK(c.seen.empty());
  check_fields(c, "calendar");

  const auto rows = describe<Calendar>();
  CHECK(rows[0] ==
        FieldInfo{"season", "text", "spring", "winter | spring | summer", "", "of the year"});
  CHECK(rows[1].type == "comma-separated texts");
  CHECK(rows[1].value == "winter,summer");

  const auto refused = [&c](const auto& change) {
    const json before = to_json(c);
    const std::string text = error_of<ConfigError>(change);
    CHECK(to_json(c) == before);
    return text;
  };
  CHECK(refused([&] { set_field(c, "season", "autumn"); }) ==
        "option: season is 'autumn', expected one of winter, spring, summer");
  CHECK(refused([&] { set_field(c, "season", ""); }) ==
        "option: season is '', expected one of winter, spring, summer");
  CHECK(refused([&] { from_json(json::parse(R"({"season": 1})"), c, "file"); }) ==
        "file: season is 1, expected one of winter, spring, summer");
  CHECK(
      refused([&] { from_json(json::parse(R"({"seen": ["spring", "may"]})"), c, "file"); }) ==
      "file: seen is [\"spring\",\"may\"], expected a list of texts out of winter, spring, summer");

  CHECK(enum_name(Season::summer) == "summer");
  CHECK(enum_from<Season>("winter", "flag") == Season::winter);
  CHECK(error_of<ConfigError>([] { enum_from<Season>("May", "flag"); }) ==
        "flag: 'May', expected one of winter, spring, summer");
}

TEST_CASE("files are texts, pairs may be missing, and 0 may stand for what the program finds") {
  Request r;
  CHECK(to_json(r).dump() == R"({"images":[],"voxel":0.0,"weights":""})");
  set_field(r, "weights", "a, b");  // one name
  CHECK(r.weights == "a, b");
  set_field(r, "images", "a.tif,b.tif");
  CHECK(r.images == std::vector<std::filesystem::path>{"a.tif", "b.tif"});
  set_field(r, "range", "-5,20.5");
  CHECK(r.range == OptionalPair({-5, 20.5}));
  set_field(r, "voxel", "2");
  const json j = to_json(r);
  CHECK(j.dump() ==
        R"({"images":["a.tif","b.tif"],"range":[-5.0,20.5],"voxel":2.0,"weights":"a, b"})");
  Request back;
  from_json(j, back, "file");
  CHECK(to_json(back) == j);
  set_field(r, "range", "");
  CHECK(!r.range);
  from_json(json{{"voxel", 0}}, r, "file");
  CHECK(r.voxel == 0);
  CHECK_NOTHROW(check_fields(r, "reconstruct"));

  const auto refused = [](const json& value) {
    Request s;
    return error_of<ConfigError>([&] { from_json(value, s, "file"); });
  };
  CHECK(refused({{"range", {1}}}) == "file: range is [1], expected 2 x numbers of at most 9000");
  CHECK(refused({{"range", {1, 9001}}}) ==
        "file: range is [1,9001], expected 2 x numbers of at most 9000");
  CHECK(refused({{"voxel", 0.001}}) == "file: voxel is 0.001, expected a number from 0.01 to 1000");
  CHECK(refused({{"weights", 3}}) == "file: weights is 3, expected a text");

  const auto rows = describe<Request>();
  CHECK(rows[0].type == "files");
  CHECK(rows[1].type == "file");
  CHECK(rows[2].type == "2 numbers");
  CHECK(rows[2].value.empty());
  CHECK(rows[3].automatic == "two pixels");
  CHECK(markdown_table({rows[3]}).ends_with(
      "| `voxel` | number | two pixels | 0.01 to 1000 | m | detail |\n"));
  const auto fields = collect_fields(r);
  CHECK(fields[0].is_path());
  CHECK(fields[1].is_path());
  CHECK(!fields[2].is_path());
  CHECK(fields[2].is_list());
}

TEST_CASE("names of files that are no UTF-8 are written with what stands for unknown bytes") {
  Request request;
  request.images = {"a\xff.tif", "b.tif"};
  request.weights = "\xc3\xa9";  // e with an acute accent
  const json made = to_json(request);
  CHECK(made["images"] == json{"a\xef\xbf\xbd.tif", "b.tif"});
  CHECK(made["weights"] == "\xc3\xa9");
  CHECK(made.dump().size() > 2);  // throws for others
  CHECK(json_text(json{{"name", "\xff"}}) == "{\"name\":\"\xef\xbf\xbd\"}");
  CHECK(json_text(json{1, 2}, 1) == "[\n 1,\n 2\n]");
}
