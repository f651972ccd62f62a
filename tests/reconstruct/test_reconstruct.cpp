// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/nn/weights_file.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/scene/crop.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <string>
#include <vector>

#include "tests/reconstruct/simulated.h"
#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;

namespace {

bool same_bits(const Tensor& a, const Tensor& b) {
  return a.shape() == b.shape() &&
         std::memcmp(a.data(), b.data(), static_cast<std::size_t>(a.count()) * sizeof(float)) == 0;
}

void check_same(const Reconstruction& a, const Reconstruction& b) {
  CHECK(a.frame == b.frame);
  CHECK(same_bits(a.dsm.z, b.dsm.z));
  CHECK(a.dsm.x0 == b.dsm.x0);
  CHECK(a.dsm.y0 == b.dsm.y0);
  CHECK(same_bits(a.confidence, b.confidence));
  CHECK(same_bits(a.surfels.means.value(), b.surfels.means.value()));
  CHECK(same_bits(a.surfels.colours.value(), b.surfels.colours.value()));
}

}  // namespace

TEST_CASE("images in memory give the same surface as their files") {
  const test::TempFolder folder("reconstruct");
  scene::write_scene(test::village(96, 3), folder.path(), "SIM_001");
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder / "Track3-RGB"))
    files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  REQUIRE(files.size() == 3);
  test::HeldImages held;
  for (const auto& file : files) {
    const rpc::Image image = rpc::open_view(file);
    held.add(file.stem().string(), image.pixels, 1, *image.info.rpc);
  }
  const nn::Model model(nn::model_preset("tiny"), 3);
  const rpc::HeightRange range = test::range_of(test::village(96, 3));
  const scene::UserScene read = scene::scene_from_views(files, {}, range);
  const Reconstruction from_files = reconstruct::reconstruct(model, read.scene, {});
  CHECK(from_files.surfels.means.dim(0) > 100);

  std::vector<scene::ImageInMemory> images = held.images();
  const scene::UserScene user = scene::scene_from_images(images, range);
  CHECK(user.scene.views[1].label() == files[1].stem().string());
  CHECK(user.scene.views[1].files.empty());
  check_same(reconstruct::reconstruct(model, user.scene, {}), from_files);

  SUBCASE("in whatever order and type the values lie") {
    std::vector<std::uint16_t> shorts(held.bytes(0).size());
    std::vector<std::uint8_t> mixed(held.bytes(1).size());
    std::vector<float> floats(held.bytes(2).size());
    const std::size_t pixels = mixed.size() / 3;
    for (std::size_t p = 0; p < pixels; ++p)
      for (std::size_t c = 0; c < 3; ++c) mixed[3 * p + c] = held.bytes(1)[c * pixels + p];
    images[1].pixels = std::span<const std::uint8_t>(mixed);
    images[1].interleaved = true;
    check_same(reconstruct::reconstruct(model, scene::scene_from_images(images, range).scene, {}),
               from_files);
    // other types are stretched, so the surface is another one, but one of the same ground
    std::copy(held.bytes(0).begin(), held.bytes(0).end(), shorts.begin());
    std::copy(held.bytes(2).begin(), held.bytes(2).end(), floats.begin());
    images[0].pixels = std::span<const std::uint16_t>(shorts);
    images[2].pixels = std::span<const float>(floats);
    const Reconstruction other =
        reconstruct::reconstruct(model, scene::scene_from_images(images, range).scene, {});
    CHECK(other.dsm.z.shape() == from_files.dsm.z.shape());
    CHECK_FALSE(same_bits(other.dsm.z, from_files.dsm.z));
  }
  SUBCASE("what is not valid says nothing") {
    std::vector<std::uint8_t> valid(96 * 96, 1);
    std::fill(valid.begin(), valid.begin() + 96 * 48, std::uint8_t{0});
    images[2].valid = valid;
    const scene::Scene half = scene::scene_from_images(images, range).scene;
    double sum = 0;
    for (const float v : half.views[2].valid.values()) sum += static_cast<double>(v);
    CHECK(sum == 96 * 48);
  }
}

TEST_CASE("images in memory that do not fit are refused by name") {
  const test::HeldImages held(test::village(64, 2));
  std::vector<scene::ImageInMemory> images = held.images();
  images[1].width = 63;
  CHECK_THROWS_WITH_AS(scene::scene_from_images(images),
                       "scene_from_images: view_1: 12288 values, expected 12096 (63 x 64 px of 3 "
                       "channels)",
                       Error);
  images = held.images();
  const std::vector<std::uint8_t> none(64 * 64, 0), few(5, 1);
  images[0].valid = few;
  CHECK_THROWS_WITH_AS(scene::scene_from_images(images),
                       "scene_from_images: view_0: validity of 5 pixels, expected none or 4096",
                       Error);
  images[0].valid = none;
  CHECK_THROWS_WITH_AS(scene::scene_from_images(images),
                       "scene_from_images: view_0: no valid pixel, expected an image", Error);
  images[0].valid = {};
  CHECK_THROWS_WITH_AS(scene::scene_from_images(images, rpc::HeightRange{40, 20}),
                       "height range: 40 20, expected the lower height first and a span of at "
                       "least 1 m",
                       ConfigError);
  images.resize(1);
  CHECK_THROWS_WITH_AS(scene::scene_from_images(images),
                       "view_0 is the only image, expected two or more", Error);
}

TEST_CASE("a caller's own exception cancels a reconstruction") {
  struct Stop {
    int at;
  };
  const scene::SimulatedScene made = test::village(64, 2);
  const test::HeldImages held(made);
  int calls = 0;
  const auto poll = [&] {
    if (++calls == 2) throw Stop{calls};
  };
  CHECK_THROWS_AS(scene::scene_from_images(held.images(), test::range_of(made), poll), Stop);

  const scene::Scene scene = scene::scene_from_images(held.images(), test::range_of(made)).scene;
  const nn::Model model(nn::model_preset("tiny"), 3);
  std::vector<std::string> stages;
  ReconstructOptions options;
  double last = -1;
  options.progress = [&](const std::string& stage, double fraction) {
    if (stages.empty() || stages.back() != stage) stages.push_back(stage), last = -1;
    CHECK(fraction >= last);
    last = fraction;
  };
  const Reconstruction whole = reconstruct::reconstruct(model, scene, options);
  CHECK(stages == std::vector<std::string>{"network", "surface"});
  for (const char* where : {"network", "surface"}) {
    calls = 0;
    options.progress = [&](const std::string& stage, double) {
      if (stage == where && ++calls == 2) throw Stop{calls};
    };
    CHECK_THROWS_AS(reconstruct::reconstruct(model, scene, options), Stop);
  }
  // and leaves nothing behind that the next run could notice
  check_same(reconstruct::reconstruct(model, scene, {}), whole);
}

TEST_CASE("every image keeps the camera its window was given") {
  const scene::SimulatedScene made = test::village(96, 3);
  const scene::Scene scene =
      scene::scene_from_images(test::HeldImages(made).images(), test::range_of(made)).scene;
  const nn::Model model(nn::model_preset("tiny"), 3);
  for (const Index tile : {Index{0}, Index{64}}) {
    CAPTURE(tile);
    ReconstructOptions options;
    options.tile = tile;
    const Reconstruction out = reconstruct::reconstruct(model, scene, options);
    REQUIRE(out.images.size() == 3);
    for (std::size_t i = 0; i < 3; ++i) {
      const nn::PosedImage& image = out.images[i];
      CHECK(same_bits(image.rgb, scene.views[i].rgb));
      for (const double x : {0.0, 95.0})
        for (const double y : {0.0, 95.0})
          for (const double z : {scene.z_range.low, scene.z_range.high}) {
            const auto p = scene.frame.local_from_geodetic(
                scene.views[i].rpc.localize({x, y}, z + scene.frame.h0));
            const auto ground = image.local_from_pixel(x, y, z);
            const auto pixel = image.pixel_from_local(p[0], p[1], z);
            CHECK(std::hypot(ground[0] - p[0], ground[1] - p[1]) < 1e-3);
            CHECK(std::hypot(pixel[0] - x, pixel[1] - y) < 1e-3);
          }
    }
  }
}

TEST_CASE("an image turned with its camera gives the same surface") {
  const scene::SimulatedScene made = test::village(96, 3);
  const scene::Scene scene =
      scene::scene_from_images(test::HeldImages(made).images(), test::range_of(made)).scene;
  const nn::Model model(nn::model_preset("tiny"), 3);
  const Reconstruction upright = reconstruct::reconstruct(model, scene, {});
  const auto to_north = [](const scene::Scene& of) {
    return scene::quarters_to_north(of.views[1].rpc,
                                    of.frame.geodetic_from_local({0, 0, of.z_range.middle()}));
  };
  for (const int quarters : {1, 2, 3}) {
    CAPTURE(quarters);
    scene::Scene other = scene;
    scene::View& view = other.views[1];
    view.rpc = view.rpc.turned(quarters, 96, 96);
    for (int q = 0; q < quarters; ++q) {
      Tensor rgb(view.rgb.shape()), valid(view.valid.shape());
      for (Index y = 0; y < 96; ++y)
        for (Index x = 0; x < 96; ++x) {  // clockwise: (x, y) goes to (95 - y, x)
          for (Index c = 0; c < 3; ++c)
            rgb[(c * 96 + x) * 96 + 95 - y] = view.rgb[(c * 96 + y) * 96 + x];
          valid[x * 96 + 95 - y] = view.valid[y * 96 + x];
        }
      view.rgb = rgb, view.valid = valid;
    }
    CHECK(to_north(other) == (to_north(scene) + 4 - quarters) % 4);
    const Reconstruction turned = reconstruct::reconstruct(model, other, {});
    REQUIRE(turned.dsm.z.shape() == upright.dsm.z.shape());
    double sum = 0, both = 0, one = 0;
    for (Index i = 0; i < turned.dsm.z.count(); ++i) {
      const double a = static_cast<double>(turned.dsm.z[i]),
                   b = static_cast<double>(upright.dsm.z[i]);
      one += std::isfinite(a) != std::isfinite(b) ? 1 : 0;
      if (std::isfinite(a) && std::isfinite(b)) sum += std::abs(a - b), both += 1;
    }
    CHECK(both > 1000);
    CHECK(sum / both < 0.01);
    CHECK(one < 0.002 * both);
    // the images come out as they went in
    CHECK(same_bits(turned.images[1].rgb, view.rgb));
    const auto ground = turned.images[1].local_from_pixel(20, 30, 0);
    const auto p = other.frame.local_from_geodetic(view.rpc.localize({20, 30}, other.frame.h0));
    CHECK(std::hypot(ground[0] - p[0], ground[1] - p[1]) < 1e-2);
  }
}

TEST_CASE("images wider than high have windows of their shape, whichever way one is turned") {
  const scene::SimulatedScene made = test::village(128, 3);
  scene::Scene scene =
      scene::scene_from_images(test::HeldImages(made).images(), test::range_of(made)).scene;
  constexpr Index kTop = 30, kHigh = 60, kWide = 128;
  const auto rows = [&](const Tensor& image) {
    const Index C = image.rank() == 3 ? image.dim(0) : 1;
    auto out =
        Tensor::uninitialised(image.rank() == 3 ? Shape{C, kHigh, kWide} : Shape{kHigh, kWide});
    for (Index c = 0; c < C; ++c)
      std::copy_n(image.data() + (c * kWide + kTop) * kWide, kHigh * kWide,
                  out.data() + c * kHigh * kWide);
    return out;
  };
  for (scene::View& view : scene.views) {
    view.rgb = rows(view.rgb), view.valid = rows(view.valid);
    view.rpc = view.rpc.cropped(0, kTop);
  }
  const nn::Model model(nn::model_preset("tiny"), 3);
  const Index multiple = nn::size_multiple(model.config());
  const ReconstructPlan plan = plan_reconstruction(model.config(), scene, {});
  CHECK(plan.window.height <= (kHigh + 2 * multiple) / multiple * multiple);
  CHECK(plan.window.height % multiple == 0);
  CHECK(plan.window.width >= 96);
  ReconstructOptions square;
  square.tile = kWide;
  CHECK(plan.memory_bytes < plan_reconstruction(model.config(), scene, square).memory_bytes);
  const Reconstruction upright = reconstruct::reconstruct(model, scene, {});
  CHECK(upright.completeness > 0.8);

  scene::Scene other = scene;
  scene::View& view = other.views[1];
  view.rpc = view.rpc.turned(1, kWide, kHigh);
  const auto turned = [&](const Tensor& image) {  // clockwise: from the bottom up
    const Index C = image.rank() == 3 ? image.dim(0) : 1;
    auto out =
        Tensor::uninitialised(image.rank() == 3 ? Shape{C, kWide, kHigh} : Shape{kWide, kHigh});
    for (Index c = 0; c < C; ++c)
      for (Index y = 0; y < kWide; ++y)
        for (Index x = 0; x < kHigh; ++x)
          out[(c * kWide + y) * kHigh + x] = image[(c * kHigh + kHigh - 1 - x) * kWide + y];
    return out;
  };
  view.rgb = turned(view.rgb), view.valid = turned(view.valid);
  CHECK(plan_reconstruction(model.config(), other, {}).window == plan.window);
  const Reconstruction again = reconstruct::reconstruct(model, other, {});
  REQUIRE(again.dsm.z.shape() == upright.dsm.z.shape());
  double sum = 0, both = 0;
  for (Index i = 0; i < again.dsm.z.count(); ++i)
    if (std::isfinite(again.dsm.z[i]) && std::isfinite(upright.dsm.z[i]))
      sum += std::abs(static_cast<double>(again.dsm.z[i] - upright.dsm.z[i])), both += 1;
  CHECK(both > 1000);
  CHECK(sum / both < 0.01);
}

TEST_CASE("the plain surface is made of surfels that the splatted one is made of, too") {
  for (const Index views : {Index{2}, Index{4}})
    for (const Index tile : {Index{0}, Index{64}}) {
      CAPTURE(views);
      CAPTURE(tile);
      const scene::SimulatedScene made = test::village(96, views);
      const scene::Scene scene =
          scene::scene_from_images(test::HeldImages(made).images(), test::range_of(made)).scene;
      const nn::Model model(nn::model_preset("tiny"), 3);
      ReconstructOptions options;
      options.tile = tile;
      const Reconstruction splat = reconstruct::reconstruct(model, scene, options);
      options.surface = Surface::plain;
      const Reconstruction plain = reconstruct::reconstruct(model, scene, options);
      CHECK(plain.tiles == splat.tiles);
      CHECK(plain.dsm.z.shape() == splat.dsm.z.shape());
      CHECK_FALSE(same_bits(plain.dsm.z, splat.dsm.z));
      CHECK(std::abs(plain.completeness - splat.completeness) < 0.15);
      for (Index i = 0; i < plain.dsm.z.count(); ++i) {
        CHECK(std::isnan(plain.dsm.z[i]) == std::isnan(plain.confidence[i]));
        if (std::isfinite(plain.confidence[i]))
          CHECK((plain.confidence[i] >= 0 && plain.confidence[i] <= 1.0001f));
      }
      // An untrained network's views agree on little, so some go, and the rest keep their order.
      const Tensor &few = plain.surfels.means.value(), &many = splat.surfels.means.value();
      CHECK(few.dim(0) < many.dim(0));
      Index at = 0;
      for (Index k = 0; k < many.dim(0) && at < few.dim(0); ++k)
        if (std::equal(few.data() + 3 * at, few.data() + 3 * at + 3, many.data() + 3 * k)) ++at;
      CHECK(at == few.dim(0));
    }
}

TEST_CASE("unwanted ground has neither heights nor surfels, and the rest is what it was") {
  const scene::SimulatedScene made = test::village(96, 3);
  const scene::Scene scene =
      scene::scene_from_images(test::HeldImages(made).images(), test::range_of(made)).scene;
  const nn::Model model(nn::model_preset("tiny"), 3);
  const nn::SurfaceModel network({.base = 3}, 5);
  ReconstructOptions options;
  SUBCASE("splatted") {}
  SUBCASE("refined") { options.network = &network; }
  const Reconstruction whole = reconstruct::reconstruct(model, scene, options);
  options.unwanted = [](const Grid& grid) {  // the east
    Tensor out({grid.height, grid.width});
    for (Index i = 0; i < out.count(); ++i)
      out[i] = grid.east + (static_cast<double>(i % grid.width) + 0.5) * grid.step > 0 ? 1.F : 0.F;
    return out;
  };
  const Reconstruction part = reconstruct::reconstruct(model, scene, options);
  REQUIRE(part.dsm.z.shape() == whole.dsm.z.shape());
  const Index W = part.dsm.z.dim(1);
  Index west = 0;
  REQUIRE(part.sigma.empty() == (options.network == nullptr));
  for (Index i = 0; i < part.dsm.z.count(); ++i) {
    if (!part.sigma.empty()) CHECK(std::isnan(part.sigma[i]) == std::isnan(part.dsm.z[i]));
    const bool unwanted = part.dsm.x0 + (static_cast<double>(i % W) + 0.5) * part.dsm.step > 0;
    if (unwanted) {
      CHECK(std::isnan(part.dsm.z[i]));
      CHECK(std::isnan(part.confidence[i]));
    } else {
      CHECK(std::memcmp(&part.dsm.z[i], &whole.dsm.z[i], sizeof(float)) == 0);
      west += std::isfinite(part.dsm.z[i]) ? 1 : 0;
    }
  }
  CHECK(west > 100);
  const Tensor& means = part.surfels.means.value();
  CHECK(means.dim(0) > 100);
  CHECK(means.dim(0) < whole.surfels.means.dim(0));
  for (Index k = 0; k < means.dim(0); ++k)
    CHECK(static_cast<double>(means[3 * k]) < part.dsm.step);  // to the end of the last cell
  // cells that are not wanted are no gaps
  CHECK(part.completeness > 0.8 * whole.completeness);
}

TEST_CASE("tiles give the surface of the whole, without seams") {
  const scene::SimulatedScene made = test::village(256, 3);
  const scene::Scene scene =
      scene::scene_from_images(test::HeldImages(made).images(), test::range_of(made)).scene;
  const nn::Model model = nn::load_model(SATSURF_TEST_WEIGHTS);
  ReconstructOptions options;
  options.resolution = 0.5;
  const Reconstruction whole = reconstruct::reconstruct(model, scene, options);
  options.tile = 128;
  const ReconstructPlan plan = plan_reconstruction(model.config(), scene, options);
  const Reconstruction tiled = reconstruct::reconstruct(model, scene, options);
  REQUIRE(whole.tiles == 1);
  REQUIRE(tiled.tiles == static_cast<Index>(plan.tiles.size()));
  REQUIRE(tiled.tiles >= 4);
  // of heights that differ a little come cells that do at the rim
  for (const std::size_t side : {0, 1})
    REQUIRE(std::abs(tiled.dsm.z.shape()[side] - whole.dsm.z.shape()[side]) <= 4);
  // a tile of 128 px shows the network less around each pixel than the whole does
  CHECK(std::abs(tiled.completeness - whole.completeness) < 0.05);

  // How far a cell is from the nearest edge between two tiles, m.
  const auto to_seam = [&](double x, double y) {
    double nearest = INFINITY;
    for (const Ground& t : plan.tiles) {
      if (t.x0 > plan.ground.x0) nearest = std::min(nearest, std::abs(x - t.x0));
      if (t.y0 > plan.ground.y0) nearest = std::min(nearest, std::abs(y - t.y0));
    }
    return nearest;
  };
  struct Mean {
    double sum = 0, n = 0;
    void add(double v) { sum += v, n += 1; }
    double value() const { return sum / n; }
  };
  // Against the truth, at the seams and away from them: one window, and tiles.
  Mean whole_seam, whole_inner, tiled_seam, tiled_inner;
  Index both = 0, near = 0, close = 0;
  const Index W = whole.dsm.z.dim(1);
  for (Index i = 0; i < whole.dsm.z.count(); ++i) {
    const double x = whole.dsm.x0 + (static_cast<double>(i % W) + 0.5) * whole.dsm.step,
                 y = whole.dsm.y0 - (static_cast<double>(i / W) + 0.5) * whole.dsm.step;
    const Index there = scene::cell_at(tiled.dsm, x, y);
    if (there < 0) continue;
    const double a = static_cast<double>(whole.dsm.z[i]),
                 b = static_cast<double>(tiled.dsm.z[there]);
    if (!std::isfinite(a) || !std::isfinite(b)) continue;
    both += 1, near += std::abs(a - b) < 0.1, close += std::abs(a - b) < 0.5;
    const double east = x + scene.frame.easting0 - made.frame.easting0,
                 north = y + scene.frame.northing0 - made.frame.northing0;
    const Index known = scene::cell_at(made.dsm, east, north);
    if (known < 0) continue;
    const double truth = static_cast<double>(made.dsm.z[known]) + made.frame.h0 - scene.frame.h0;
    const bool seam = to_seam(x, y) < 2;
    (seam ? whole_seam : whole_inner).add(std::abs(a - truth));
    (seam ? tiled_seam : tiled_inner).add(std::abs(b - truth));
  }
  const double n = static_cast<double>(both);
  CAPTURE(static_cast<double>(near) / n);
  CAPTURE(static_cast<double>(close) / n);
  CHECK(static_cast<double>(near) > 0.4 * n);
  CHECK(static_cast<double>(close) > 0.8 * n);
  CAPTURE(whole_seam.value());
  CAPTURE(tiled_seam.value());
  CAPTURE(whole_inner.value());
  CAPTURE(tiled_inner.value());
  REQUIRE(tiled_seam.n > 0.1 * n);
  // The features look some 200 px around; a window of 128 px does not hold that.
  CHECK(tiled_inner.value() < 1.1 * whole_inner.value());
  // Where tiles meet, tiling costs less than a twentieth of the error that is there anyway.
  CHECK(tiled_seam.value() < 1.05 * whole_seam.value());
  CHECK(tiled_seam.value() < 1.15 * tiled_inner.value());
}

TEST_CASE("the surface reaches as far as two images show its heights") {
  const scene::SimulatedScene made = test::village(192, 3);
  const nn::Model model = nn::load_model(SATSURF_TEST_WEIGHTS);
  // the middle of the range is high above the village, where the images show other ground
  const scene::Scene scene =
      scene::scene_from_images(test::HeldImages(made).images(),
                               rpc::HeightRange{made.h_min - 2, made.h_max + 150})
          .scene;
  ReconstructOptions options;
  options.look = false;
  const Ground planned = plan_reconstruction(model.config(), scene, options).ground;
  const Reconstruction run = reconstruct::reconstruct(model, scene, options);
  double seen = 0, beyond = 0, held = 0;
  for (Index i = 0; i < made.dsm.z.count(); i += 3) {
    const double z = static_cast<double>(made.dsm.z[i]) + made.frame.h0 - scene.frame.h0;
    const double x = made.dsm.x0 +
                     (static_cast<double>(i % made.dsm.z.dim(1)) + 0.5) * made.dsm.step +
                     made.frame.easting0 - scene.frame.easting0;
    const double y = made.dsm.y0 -
                     (static_cast<double>(i / made.dsm.z.dim(1)) + 0.5) * made.dsm.step +
                     made.frame.northing0 - scene.frame.northing0;
    if (views_showing(scene, {x, y, z}) < 2) continue;
    seen += 1;
    beyond += planned.contains(x, y) ? 0 : 1;
    held += scene::cell_at(run.dsm, x, y) >= 0 ? 1 : 0;
  }
  CAPTURE(seen);
  CHECK(beyond > 0.03 * seen);
  CHECK(held > 0.995 * seen);
  // and not much further
  CHECK(static_cast<double>(run.dsm.z.count()) * run.dsm.step * run.dsm.step <
        1.4 * seen * 3 * made.dsm.step * made.dsm.step);
}
