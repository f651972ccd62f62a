// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/tile_store.h"
#include "satsurf/core/error.h"
#include "satsurf/core/safetensors.h"

#include <cmath>
#include <filesystem>
#include <string>
#include <tuple>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::app;
using test::TempFolder;

namespace {

const reconstruct::Tile kTile{1, 2, {10, 20, 14, 23}, {8, 18, 16, 25}};

reconstruct::TileSurface surface() {
  reconstruct::TileSurface out;
  out.empty = false;
  out.heights = Tensor({7, 8}, 5.f), out.confidence = Tensor({7, 8}, 0.5f);
  out.views = Tensor({7, 8}, 2.f), out.ortho = Tensor({1, 7, 8}, 9.f);
  return out;
}

TileRecord record() {
  TileRecord out;
  out.status = "done", out.seconds = 1.5, out.found = 11, out.expected = 12, out.levelled = 9,
  out.evened = 7, out.compared = 40, out.agreed = 30, out.window = {256, 192};
  out.z_range = {-3.25, 17.125}, out.views = {"a", "b"};
  return out;
}

}  // namespace

TEST_CASE("a finished tile is found again, with all that is known of it") {
  const TempFolder folder("tiles");
  const auto out = folder / "out";
  {
    TileStore store(out, false, false);
    store.begin({{"a", 1.1}});
    CHECK_FALSE(store.find(kTile));
    store.save(kTile, record(), surface());
  }
  TileStore store(out, true, false);
  store.begin({{"a", 1.1}});
  const auto found = store.find(kTile);
  REQUIRE(found);
  CHECK(found->status == "done");
  CHECK(found->found == 11);
  CHECK(found->compared == 40);
  CHECK(found->agreed == 30);
  CHECK(found->levelled == 9);
  CHECK(found->evened == 7);
  CHECK(found->window == scene::WindowSize{256, 192});
  CHECK(found->z_range.high == 17.125);
  const reconstruct::TileSurface loaded = store.load(kTile);
  CHECK(loaded.heights.shape() == Shape{7, 8});
  CHECK(loaded.ortho[3] == 9);
  CHECK(loaded.sigma.empty());
  CHECK_FALSE(store.find({0, 0, {}, {}}));
  store.remove();
  CHECK_FALSE(std::filesystem::exists(folder / "out.tiles"));
}

TEST_CASE("the tiles of another run are named by what differs, and are not touched") {
  const TempFolder folder("tiles");
  const auto out = folder / "out";
  {
    TileStore store(out, false, false);
    store.begin({{"config", {{"resolution", 0.5}}}, {"same", 1}});
    store.save(kTile, record(), surface());
  }
  {
    TileStore store(out, true, false);
    try {
      store.begin({{"config", {{"resolution", 0.7}}}, {"same", 1}});
      FAIL("accepted");
    } catch (const ConfigError& e) {
      const std::string text = e.what();
      CHECK(text.find("/config/resolution was 0.5 and is 0.7") != std::string::npos);
      CHECK(text.find("expected the same") != std::string::npos);
    }
  }
  CHECK_THROWS_AS(TileStore(out, false, false), IoError);
  {
    TileStore store(out, true, false);
    CHECK_THROWS_AS(TileStore(out, true, false), IoError);  // one process at a time
    CHECK(store.find(kTile));
  }
  TileStore store(out, false, true);
  CHECK_FALSE(store.find(kTile));
}

TEST_CASE("what a killed writer has left among the tiles goes with the next run") {
  const TempFolder folder("tiles");
  {
    TileStore store(folder / "out", false, false);
    store.begin({{"a", 1}});
    store.save(kTile, record(), surface());
  }
  const auto left = folder / "out.tiles/.tile_0001_0002.json.partial-7-3";
  test::write_bytes(left, "{");
  TileStore store(folder / "out", true, false);
  CHECK(store.any());
  CHECK_THROWS_AS(store.begin({{"a", 2}}), ConfigError);  // another run touches nothing
  CHECK(std::filesystem::exists(left));
  store.begin({{"a", 1}});
  CHECK_FALSE(std::filesystem::exists(left));
}

TEST_CASE("tiles that a killed run had begun to remove are nobody's") {
  const TempFolder folder("tiles");
  {
    TileStore store(folder / "out", false, false);
    store.begin({{"a", 1}});
    store.save(kTile, record(), surface());
  }
  std::filesystem::remove(folder / "out.tiles/plan.json");
  for (const bool resume : {true, false}) {
    const TileStore store(folder / "out", resume, false);
    CHECK_FALSE(store.any());
  }
}

TEST_CASE("a run that finished no tile leaves nothing") {
  const TempFolder folder("tiles");
  {
    TileStore store(folder / "out", true, false);
    store.begin({{"a", 1}});
  }
  CHECK(std::filesystem::is_empty(folder.path()));
}

TEST_CASE("a damaged record of a tile is named for what is wrong in it") {
  const TempFolder folder("tiles");
  TileStore store(folder / "out", false, false);
  store.save(kTile, record(), surface());
  const auto file = folder / "out.tiles/tile_0001_0002.json";
  const std::string good = test::read_bytes(file);
  const auto error = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    const auto at = text.find(from);
    REQUIRE(at != std::string::npos);
    test::write_bytes(file, text.replace(at, from.size(), to));
    return test::error_of<IoError>([&] { store.find(kTile); });
  };
  const std::string end = "; not the record of a tile?";
  // as a whole number these were undefined
  CHECK(error("\"window_width\":192", "\"window_width\":1e300") ==
        file.string() + ": window_width is 1e+300, expected a count" + end);
  CHECK(error("\"found\":11", "\"found\":-1") ==
        file.string() + ": found is -1, expected a count" + end);
  CHECK(error("\"seconds\":1.5", "\"seconds\":null") ==
        file.string() + ": seconds is null, expected a number" + end);
  CHECK(error("\"done\"", "\"over\"") ==
        file.string() + ": status is \"over\", expected done or empty" + end);
  CHECK(error("[-3.25,17.125]", "[-3.25]") ==
        file.string() + ": z_range is [-3.25], expected two numbers" + end);
  CHECK(error("\"surfels\"", "\"others\"") ==
        file.string() + ": no surfels, expected the record of a tile");
  CHECK(error(good, "[]") == file.string() + ": no status, expected the record of a tile");
  // what no tile can be
  const auto says = [&](const std::string& from, const std::string& to, const std::string& text) {
    CHECK(error(from, to) == file.string() + ": " + text + end);
  };
  says("\"found\":11", "\"found\":9007199254740992", "found is 9007199254740992, expected 0 to 12");
  says("\"expected\":12", "\"expected\":13", "expected is 13, expected 0 to 12");
  says("\"agreed\":30", "\"agreed\":41", "agreed is 41, expected 0 to 40");
  says("\"levelled\":9", "\"levelled\":57", "levelled is 57, expected 0 to 56");
  says("\"evened\":7", "\"evened\":57", "evened is 57, expected 0 to 56");
  says("\"seconds\":1.5", "\"seconds\":-1e300", "seconds is -1e+300, expected 0 to 1e+09");
  says("\"window_height\":256", "\"window_height\":0", "window_height is 0, expected 1 to 1048576");
  says("[-3.25,17.125]", "[1e300,-1e300]",
       "z_range is [1e+300,-1e+300], expected lowest and highest, at most 1000 km either way");
  says("[-3.25,17.125]", "[5,5]",
       "z_range is [5.0,5.0], expected lowest and highest, at most 1000 km either way");
  says("\"camera_fit_max_px\":0.0", "\"camera_fit_max_px\":1e300",
       "camera_fit_max_px is 1e+300, expected 0 to 1e+06");
  says("\"surfels\":0", "\"surfels\":7",
       "surfels is 7, expected as many as the file beside it holds");
  says("[\"a\",\"b\"]", "[\"a\"]", "views is [\"a\"], expected names of two images or more");
  says("\"done\"", "\"empty\"", "status is \"empty\", expected no rasters beside it");
  says("\"done\"", "\"failed\"", "status is \"failed\", expected done or empty");
  test::write_bytes(file, good);
  CHECK_NOTHROW(store.find(kTile));
  TileRecord counted = *store.find(kTile);
  counted.surfels = 3;
  CHECK(test::error_of<IoError>([&] { store.check_surfels(kTile, counted, 2); }) ==
        store.surfels_of(kTile).string() + ": 2 surfels, expected 3 as tile_0001_0002.json says");
  std::filesystem::remove(store.path() / "tile_0001_0002.safetensors");
  CHECK(test::error_of<IoError>([&] { store.find(kTile); }) ==
        file.string() + ": status is \"done\", expected rasters beside it" + end);
}

TEST_CASE("names of images that are no UTF-8 stop no tile") {
  const TempFolder folder("tiles");
  TileRecord named = record();
  named.views = {"a\xff", "b"};
  const nlohmann::json plan{{"images", {"a\xff.tif"}}};
  {
    TileStore store(folder / "out", false, false);
    store.begin(plan);
    store.save(kTile, named, surface());
  }
  TileStore store(folder / "out", true, false);
  CHECK_NOTHROW(store.begin(plan));
  CHECK(store.find(kTile)->views[0] == "a\xef\xbf\xbd");
}

TEST_CASE("values that no surface has are refused by the name of their raster") {
  const TempFolder folder("tiles");
  TileStore store(folder / "out", false, false);
  store.save(kTile, record(), surface());
  const auto file = folder / "out.tiles/tile_0001_0002.safetensors";
  const TensorFile good = load_safetensors(file);
  const auto with = [&](const char* name, float value) {
    TensorFile changed = good;
    changed.tensors[name] = good.tensors.at("heights").clone();
    for (float& v : changed.tensors[name].values()) v = 0.5F;
    changed.tensors[name][7] = value;
    save_safetensors(file, changed);
    return test::error_of<IoError>([&] { store.load(kTile); });
  };
  const std::string front = file.string() + ": ";
  CHECK(with("heights", 1e38F) == front + "heights holds 1e+38, expected -1e+06 to 1e+06 or NaN");
  CHECK(with("heights", INFINITY) == front + "heights holds inf, expected -1e+06 to 1e+06 or NaN");
  CHECK(with("confidence", -1) == front + "confidence holds -1, expected 0 to 1.001 or NaN");
  CHECK(with("sigma", -1) == front + "sigma holds -1, expected 0 to 1e+06 or NaN");
  CHECK(with("views", -1) == front + "views holds -1, expected 0 to 1e+06 or NaN");
  CHECK(with("ortho", -INFINITY).starts_with(front + "ortho holds -inf, expected"));
  CHECK(with("heights", std::nanf("")) == "no exception");
}

TEST_CASE("rasters of other cells than their tile's are refused") {
  const TempFolder folder("tiles");
  TileStore store(folder / "out", false, false);
  store.save(kTile, record(), surface());
  const auto file = folder / "out.tiles/tile_0001_0002.safetensors";
  const TensorFile good = load_safetensors(file);
  for (const auto& [name, shape, expected] : {std::tuple{"heights", Shape{1, 1}, "[7,8]"},
                                              {"confidence", Shape{8, 7}, "[7,8]"},
                                              {"views", Shape{12}, "[7,8]"},
                                              {"sigma", Shape{3, 4}, "[7,8]"},
                                              {"ortho", Shape{1, 3, 3}, "[7,8]"},
                                              {"views", Shape{1, 7, 8}, "[7,8]"}}) {
    TensorFile wrong = good;
    wrong.tensors[name] = Tensor(shape, 1.f);
    save_safetensors(file, wrong);
    CHECK(test::error_of<IoError>([&] { store.load(kTile); }) ==
          file.string() + ": " + name + " has shape " + shape.str() + ", expected " + expected +
              " of this tile");
  }
}
