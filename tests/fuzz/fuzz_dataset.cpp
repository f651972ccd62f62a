// SPDX-License-Identifier: Apache-2.0
// Data sets in the layouts of Sat-NeRF, EOGS, DFC2019 and WHU-TLC: the lists, cameras and heights are the input, the
// images are there.
#include "satsurf/scene/dataset.h"

#include "tests/fuzz/fuzz.h"
#include "tests/fuzz/small_raster.h"

namespace satsurf::fuzz {

void run(std::string_view bytes) {
  namespace fs = std::filesystem;
  static const bool made = [] {
    for (const char* name :
         {"nerf/S/S_001_RGB.tif", "eogs/images/S/S_001_RGB.tif", "eogs/images/S/S_002_RGB.tif",
          "dfc/Track3-RGB/S_001_RGB.tif", "dfc/Track3-Truth/S_DSM.tif",
          "dfc/Track3-Truth/S_CLS.tif", "whu/image/0/S.png", "whu/image/1/S.png"})
      small_raster(name);
    for (const char* name : {"eogs/rpcs/S", "whu/rpc/0", "whu/rpc/1", "whu/height/0"})
      fs::create_directories(folder().path() / name);
    return true;
  }();
  static_cast<void>(made);
  Bytes in(bytes);
  const int layout = in.take<std::uint8_t>() % 4;
  std::string root;
  if (layout == 0) {
    root = "nerf";
    folder().put("nerf/S/train.txt", in.until('\0'));
    folder().put("nerf/S/test.txt", in.until('\0'));
    folder().put("nerf/S/S_001_RGB.json", in.rest());
  } else if (layout == 1) {
    root = "eogs";
    folder().put("eogs/rpcs/S/S_001_RGB.json", in.until('\0'));
    folder().put("eogs/rpcs/S/S_002_RGB.json", in.rest());
  } else if (layout == 2) {
    root = "dfc";
    folder().put("dfc/Track3-Truth/S_DSM.txt", in.until('\0'));
    folder().put("dfc/Track3-RGB/S_001_RGB_RPC.TXT", in.rest());
  } else {
    root = "whu";
    folder().put("whu/rpc/0/S.rpc", in.until('\0'));
    folder().put("whu/rpc/1/S.rpc", in.until('\0'));
    folder().put("whu/height/0/S.pfm", in.rest());
  }
  std::vector<std::string> scenes;
  only<IoError>([&] { scenes = scene::list_scenes(folder().path() / root); });
  for (const std::string& name : scenes)
    only<IoError>([&] { scene::load_scene(folder().path() / root, name); });
}

}  // namespace satsurf::fuzz
