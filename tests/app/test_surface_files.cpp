// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/surface_files.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/rpc/read.h"

#include <cmath>
#include <string>
#include <vector>

#include "tests/affine_scene.h"
#include "tests/made_view.h"
#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::app;
using test::TempFolder;

namespace {

constexpr Index kPixels = 20, kRows = 10, kColumns = 12;

/// Views whose images are stored in such types.
scene::Scene stored_as(const std::vector<std::string>& types) {
  scene::Scene scene;
  for (const std::string& type : types) {
    scene.views.push_back(test::view_from(type, 0));
    scene.views.back().dtype = type;
  }
  return scene;
}

/// An image whose channels begin at 100, 200 and so on, one more from pixel to pixel of a row.
Tensor picture(Index channels) {
  Tensor out({channels, kPixels, kPixels});
  for (Index i = 0; i < out.count(); ++i)
    out[i] = static_cast<float>(100 * (i / (kPixels * kPixels) + 1) + i % kPixels);
  return out;
}

/// A camera straight above that sees one pixel in each cell, or in those of some columns.
nn::PosedImage above(Index first_column, Index last_column) {
  const test::AffineCamera camera{.gsd = 1, .centre = static_cast<double>(kPixels - 1) / 2};
  nn::PosedImage image{Tensor({3, kPixels, kPixels}), Tensor({kPixels, kPixels}),
                       camera.local_from_pixel(), camera.pixel_from_local()};
  for (Index i = 0; i < image.valid.count(); ++i)
    image.valid[i] = i % kPixels >= first_column && i % kPixels < last_column ? 1.F : 0.F;
  return image;
}

}  // namespace

TEST_CASE("an orthophoto is stored as all of its images can be") {
  const auto tags = [](const std::vector<std::string>& types) {
    return surface_tags(stored_as(types), rpc::HeightDatum::ellipsoid).ortho;
  };
  CHECK(tags({"uint8", "uint8"}).type == rpc::CellType::uint8);
  CHECK(tags({"uint8", "uint16"}).type == rpc::CellType::uint16);
  CHECK(tags({"int16", "uint16"}).type == rpc::CellType::uint16);
  CHECK(tags({"uint8", "float32"}).type == rpc::CellType::float32);
  CHECK(tags({"uint8", "int32"}).type == rpc::CellType::float32);
  CHECK(tags({"uint8"}).nodata == 0);
  CHECK(tags({"uint16"}).nodata == 0);
  CHECK(tags({"float32"}).nodata == rpc::kNodata);

  // where 0 says that nothing is known, black is the next darkest
  const float nan = std::nanf("");
  Tensor whole = Tensor::from({1, 4}, {0, 1, 7, nan}), real = Tensor::from({1, 2}, {0, -3});
  keep_off_nodata(whole, tags({"uint16"}));
  CHECK(whole[0] == 1);
  CHECK(whole[1] == 1);
  CHECK(whole[2] == 7);
  CHECK(std::isnan(whole[3]));
  keep_off_nodata(real, tags({"float32"}));
  CHECK(real[0] == 0);
  CHECK(real[1] == -3);
}

TEST_CASE("an orthophoto has the images' own red, green and blue, and its black is no hole") {
  const TempFolder folder("ortho");
  // In the west an image of four channels, blue first, in the east a grey one of another type.
  scene::Scene scene = stored_as({"uint16", "uint8"});
  Tensor colours = picture(4);
  for (Index c = 0; c < 4; ++c) colours[c * kPixels * kPixels + 6 * kPixels + 5] = 0;
  rpc::write_rpc_geotiff(folder / "colours.tif", colours, rpc::PixelType::uint16,
                         scene.views[0].rpc);
  rpc::write_rpc_geotiff(folder / "grey.tif", picture(1), rpc::PixelType::uint8,
                         scene.views[1].rpc);
  scene.views[0].file = folder / "colours.tif", scene.views[1].file = folder / "grey.tif";
  scene.views[0].bands = 4, scene.views[0].colours.channels = {2, 1, 0};
  scene.views[1].bands = 1, scene.views[1].colours.channels = {0, 0, 0};

  reconstruct::Reconstruction made;
  made.dsm = {Tensor({kRows, kColumns}), -6, 5, 1};
  made.dsm.z[3] = std::nanf("");
  made.images = {above(0, 10), above(10, kPixels)};
  write_ortho(folder / "ortho.tif", made, scene,
              reconstruct::find_visibility(made.dsm, made.images), {});
  CHECK(rpc::read_info(folder / "ortho.tif").dtype == "uint16");
  const Tensor ortho = rpc::read_geo_raster(folder / "ortho.tif").values;
  REQUIRE(ortho.shape() == Shape{3, kRows, kColumns});
  for (Index i = 0; i < kRows * kColumns; ++i)
    for (Index band = 0; band < 3; ++band) {
      CAPTURE(i);
      CAPTURE(band);
      const float value = ortho[band * kRows * kColumns + i];
      const Index x = i % kColumns + 4, y = i / kColumns + 5;  // the pixel in the cell's middle
      if (i == 3)
        CHECK(std::isnan(value));
      else if (x == 5 && y == 6)
        CHECK(value == 1);
      else
        CHECK(value == static_cast<float>(x < 10 ? 100 * (3 - band) + x : 100 + x));
    }

  // of grey images alone it is grey, and of bytes it has bytes
  scene.views.erase(scene.views.begin());
  made.images = {above(0, kPixels)};
  write_ortho(folder / "grey_ortho.tif", made, scene,
              reconstruct::find_visibility(made.dsm, made.images), {});
  CHECK(rpc::read_info(folder / "grey_ortho.tif").dtype == "uint8");
  const Tensor grey = rpc::read_geo_raster(folder / "grey_ortho.tif").values;
  REQUIRE(grey.shape() == Shape{kRows, kColumns});
  CHECK(grey[0] == 104);
}
