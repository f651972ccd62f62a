// SPDX-License-Identifier: Apache-2.0
// Weights, configurations, tiles, data sets and changes of cameras, for the targets that make something of files.
//   fuzz_make_networks FOLDER
#include "satsurf/app/tile_store.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/core/safetensors.h"
#include "satsurf/nn/adamw.h"
#include "satsurf/nn/config.h"
#include "satsurf/nn/weights_file.h"

#include "tests/fuzz/seeds.h"
#include "tests/ref/rpc_dialects.h"
#include "tests/ref/synthetic_rpc.h"

namespace satsurf::fuzz {
namespace {

namespace fs = std::filesystem;
using namespace test::dialects;

void networks() {
  const auto put_file = [](const std::string& target, const std::string& name,
                           const TensorFile& file) {
    put(target, name,
        written("f.safetensors", [&](const fs::path& p) { save_safetensors(p, file); }));
  };
  TensorFile mono, surface, configured;
  nn::store_mono(mono, nn::Mono(nn::MonoConfig{1}, 0));
  const nn::SurfaceModel network(nn::SurfaceConfig{1}, 0);
  nn::store_surface(surface, network);
  configured.metadata = {{"format", "satsurf-1"},
                         {"model", to_json(nn::model_preset("tiny")).dump()}};
  put_file("weights", "mono", mono);
  put_file("weights", "surface", surface);
  put_file("weights", "model_without_parameters", configured);
  configured.metadata["model"] = to_json(nn::model_preset("tiny_full")).dump();
  put_file("weights", "full_without_parameters", configured);
  configured.metadata["model"] = R"({"base":1,"volume_base":1,"head_width":[1,1,1]})";
  put_file("weights", "smallest_without_parameters", configured);
  TensorFile checkpoint;
  nn::SurfaceModel trained(nn::SurfaceConfig{1}, 0);
  nn::AdamW(trained.parameters(), {}).store(checkpoint);
  put_file("weights", "optimiser", checkpoint);
}

void configurations() {
  // the first byte says whose it is, in the order of fuzz_json.cpp
  const auto put_config = [](char whose, const std::string& name, const std::string& text) {
    put("json", name, whose + text);
  };
  put_config(
      0, "record",
      R"({"program":"satsurf","command":"reconstruct","config":{"images":["a.tif"],"height_range":[0,50],)"
      R"("surface":"plain","mesh":"none"}})");
  put_config(1, "dsm", R"({"dsm":"a.tif","truth":"b.tif","register":"z"})");
  put_config(2, "data", R"({"views":3,"surface":"splat"})");
  put_config(3, "simulate",
             R"({"scenes":2,"kinds":["city","rural"],"kind_weights":[1,2.5],"gsd":0.5})");
  put_config(
      4, "train",
      R"({"task":"cascade","preset":"base8","steps":10,"model":{"base":8,"hypotheses":[48,16,8]},)"
      R"("simulate":{"pixels":64}})");
  put_config(5, "mono", R"({"task":"mono","steps":10,"lr":1e-3})");
  put_config(6, "surface", R"({"task":"surface","views_most":4})");
  put_config(7, "model", to_json(nn::model_preset("tiny")).dump());
  put_config(8, "surface_net", R"({"base":4})");
  put_config(9, "flag", "height_range 0,50");
  put_config(10, "flag_of_train", "model.hypotheses 48,16,8");
  put_config(11, "flag_of_simulate", "kinds city,rural");
}

void data_sets() {
  const rpc::Rpc camera = test::synthetic_rpc();
  const std::string in_set = as_satnerf(camera, "S_001_RGB.tif", 8, 8).dump();
  put("dataset", "satnerf", std::string("\0S_001_RGB.json\n\0S_001_RGB.json\n\0", 34) + in_set);
  put("dataset", "eogs", '\1' + in_set + '\0' + in_set);
  put("dataset", "dfc",
      "\2"
      "500000.0\n5000000.0\n8\n0.5\n" +
          std::string(1, '\0') + as_text(camera));
  std::string whu = '\3' + as_whu(camera) + '\0' + as_whu(camera) + '\0' + "Pf\n8 8\n-1.0\n";
  for (int pixel = 0; pixel < 8 * 8; ++pixel) {
    const float height = 120 + 0.25F * static_cast<float>(pixel % 7);
    whu.append(reinterpret_cast<const char*>(&height), sizeof height);
  }
  put("dataset", "whu", whu);
}

void tiles_and_changes() {
  const reconstruct::Tile tile{1, 2, {10, 20, 14, 23}, {8, 18, 16, 25}};
  reconstruct::TileSurface surface;
  surface.empty = false;
  surface.heights = ramp({7, 8}), surface.confidence = Tensor({7, 8}, 0.5F);
  surface.sigma = ramp({7, 8}), surface.views = ramp({7, 8}), surface.ortho = ramp({1, 7, 8});
  app::TileRecord record;
  record.status = "done", record.seconds = 1.5, record.window = {256, 192},
  record.z_range = {-3, 17}, record.views = {"a", "b"};
  {
    app::TileStore store(folder().path() / "out", false, true);
    store.save(tile, record, surface);
    const fs::path tiles = store.path();
    put("tile", "plan", std::string(1, '\0') + R"({"a": 2})");
    put("tile", "record", '\1' + bytes_of(tiles / "tile_0001_0002.json"));
    put("tile", "rasters", '\2' + bytes_of(tiles / "tile_0001_0002.safetensors"));
    put("tile", "work", "\3out.partial-123");
    store.remove();
  }
  const auto change = [](int which, int how, double value) {
    std::string out{static_cast<char>(which), static_cast<char>(how)};
    return out.append(reinterpret_cast<const char*>(&value), sizeof value);
  };
  // the first byte says what is asked of the cameras
  const auto changes = [&](const std::string& target, int first, const std::string& name) {
    const std::string kind(1, static_cast<char>(first));
    put(target, name + "as_they_are", kind);
    put(target, name + "shifted", kind + change(1, 2, 3.0) + change(2, 6, 1e-4));
    put(target, name + "no_denominator", kind + std::string("\x1e\3\0", 3));
    put(target, name + "not_finite", kind + std::string("\x0b\7\2", 3));
    put(target, name + "tilted", kind + change(13, 0, 2.5) + change(33, 1, -1));
    put(target, name + "far", kind + change(10, 0, 1e18) + change(30, 4, -1e18));
    put(target, name + "fine",
        kind + change(7, 1, 1e-7) + change(7, 5, 1e-7) + change(8, 1, 1e-7) + change(8, 5, 1e-7));
  };
  for (int asked = 0; asked < 7; ++asked)
    changes("cameras", asked << 5, std::to_string(asked) + "_");
  changes("scene", 0, "two_");
  changes("scene", 4, "three_");
  changes("scene", 1, "searched_");
  changes("scene", 16, "pointed_");
  // at nearly all heights that are searched the first image lies beside the others
  put("scene", "searched_apart", '\5' + change(73, 0, 0));
  put("cameras", "dates",
      "\x10"
      "2015-09-30T10:56:56Z 20160215 " +
          change(1, 2, 3.0));
}

}  // namespace
}  // namespace satsurf::fuzz

int main(int argc, char** argv) {
  using namespace satsurf::fuzz;
  if (!takes_folder(argc, argv)) return 2;
  networks();
  configurations();
  data_sets();
  tiles_and_changes();
}
