// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/image_in_memory.h"

#include "satsurf/core/error.h"
#include "satsurf/core/parallel.h"
#include "satsurf/rpc/camera_check.h"

#include <algorithm>
#include <cmath>

namespace satsurf::scene {
namespace {

/// throws Error unless the values are as many as the sizes say
void check_sizes(const ImageInMemory& image, std::size_t values) {
  const std::string where = "scene_from_images: " + image.name + ": ",
                    size = std::to_string(image.width) + " x " + std::to_string(image.height);
  if (image.width < 1 || image.height < 1 || image.channels < 1)
    throw Error(where + size + " px of " + std::to_string(image.channels) +
                " channels, expected at least one of each");
  const Index pixels = image.width * image.height;
  if (values != static_cast<std::size_t>(pixels * image.channels))
    throw Error(where + std::to_string(values) + " values, expected " +
                std::to_string(pixels * image.channels) + " (" + size + " px of " +
                std::to_string(image.channels) + " channels)");
  if (!image.valid.empty() && image.valid.size() != static_cast<std::size_t>(pixels))
    throw Error(where + "validity of " + std::to_string(image.valid.size()) +
                " pixels, expected none or " + std::to_string(pixels));
}

/// The same values as a file with these pixels would give.
template <class V>
rpc::Image image_of(const ImageInMemory& from, std::span<const V> values, const char* dtype) {
  check_sizes(from, values.size());
  const std::string where = "scene_from_images: " + from.name;
  rpc::check_camera(from.rpc, where);
  if (from.height_range && !rpc::on_earth(*from.height_range))
    throw Error(where + ": heights from " + std::to_string(from.height_range->low) + " to " +
                std::to_string(from.height_range->high) +
                " m, expected at most 1000 km either way");
  const Index C = from.channels, P = from.width * from.height;
  rpc::Image out;
  out.pixels = Tensor::uninitialised({C, from.height, from.width});
  out.valid = Tensor::uninitialised({from.height, from.width});
  for_each_index(from.height, [&](Index row) {
    for (Index i = row * from.width; i < (row + 1) * from.width; ++i) {
      bool ok = from.valid.empty() || from.valid[static_cast<std::size_t>(i)] != 0;
      for (Index c = 0; c < C; ++c) {
        const auto at = static_cast<std::size_t>(from.interleaved ? i * C + c : c * P + i);
        const float v = static_cast<float>(values[at]);
        out.pixels[c * P + i] = v;
        ok = ok && std::isfinite(v);
      }
      out.valid[i] = ok ? 1.f : 0.f;
    }
  });
  if (std::ranges::none_of(out.valid.values(), [](float v) { return v > 0; }))
    throw Error("scene_from_images: " + from.name + ": no valid pixel, expected an image");
  out.info.path = from.name;
  out.info.width = from.width;
  out.info.height = from.height;
  out.info.bands = C;
  out.info.dtype = dtype;
  out.info.rpc = from.rpc;
  out.info.rpc_source = "memory";
  out.info.height_range = from.height_range;
  out.info.rgb_channels = from.rgb_channels;
  return out;
}

rpc::Image image_of(const ImageInMemory& image) {
  if (const auto* bytes = std::get_if<std::span<const std::uint8_t>>(&image.pixels))
    return image_of(image, *bytes, "uint8");
  if (const auto* shorts = std::get_if<std::span<const std::uint16_t>>(&image.pixels))
    return image_of(image, *shorts, "uint16");
  return image_of(image, std::get<std::span<const float>>(image.pixels), "float32");
}

}  // namespace

UserScene scene_from_images(const std::vector<ImageInMemory>& images,
                            const std::optional<rpc::HeightRange>& height_range,
                            const std::function<void()>& poll, const ViewRules& rules) {
  ViewList views(rules);
  for (const ImageInMemory& image : images) {
    if (poll) poll();
    views.add(image_of(image), image.name, {});
  }
  return std::move(views).scene(height_range, poll);
}

}  // namespace satsurf::scene
