// SPDX-License-Identifier: Apache-2.0
// A user's images with cameras of which some numbers are wrong: choice of views, overlaps, pointing and range of heights.
#include "satsurf/scene/image_in_memory.h"

#include "tests/fuzz/fuzz.h"
#include "tests/fuzz/hostile_camera.h"
#include "tests/made_view.h"

namespace satsurf::fuzz {

void run(std::string_view bytes) {
  constexpr Index kSide = 40;  // a range of heights is looked for within the time of an input
  static const std::vector<std::uint8_t> texture = [] {
    std::vector<std::uint8_t> out;
    for (Index y = 0; y < kSide; ++y)
      for (Index x = 0; x < kSide; ++x)
        out.push_back(static_cast<std::uint8_t>(20 + (x * 7919 + y * 104729 + x * y * 31) % 200));
    return out;
  }();
  Bytes in(bytes);
  const auto kind = in.take<std::uint8_t>();
  std::optional<rpc::HeightRange> wanted, named;
  if (!(kind & 1)) wanted = rpc::HeightRange{10, 30};
  if (kind & 8) wanted = rpc::HeightRange{in.take<double>(), in.take<double>()};
  if (kind & 2) named = rpc::HeightRange{in.take<double>(), in.take<double>()};
  std::vector<rpc::Rpc> cameras;
  for (const double west : {-0.3, 0.3, 0.6}) cameras.push_back(test::view_from("", west).rpc);
  if (!(kind & 4)) cameras.pop_back();
  spoil(cameras, in);
  std::vector<scene::ImageInMemory> images;
  for (const rpc::Rpc& camera : cameras)
    images.push_back({.name = "image",
                      .rpc = camera,
                      .width = kSide,
                      .height = kSide,
                      .channels = 1,
                      .pixels = std::span<const std::uint8_t>(texture),
                      .height_range = named});
  only<Error, ConfigError, IoError>([&] {
    const scene::UserScene made = scene::scene_from_images(
        images, wanted, {},
        {.pointing = {.measure = (kind & 16) != 0, .affine = (kind & 32) != 0}});
    require(made.scene.views.size() >= 2, "a scene has views");
    require(made.scene.z_range.has_span(), "a scene has a range of heights");
  });
}

}  // namespace satsurf::fuzz
