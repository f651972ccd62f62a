// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/preview.h"

#include "satsurf/core/atomic_file.h"
#include "satsurf/core/dims.h"
#include "satsurf/core/error.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <OpenImageIO/color.h>
#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imagebuf.h>
#include <OpenImageIO/imagebufalgo.h>
#include <OpenImageIO/imageio.h>

namespace satsurf::app {
namespace {

constexpr float kGrey = 0.5f;

/// Value below which `share` of the finite elements lie.
float percentile(std::vector<float>& values, double share) {
  const auto at = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), values.begin() + at, values.end());
  return values[static_cast<std::size_t>(at)];
}

/// Colours [H W] values that are already scaled to [0, 1]. `knots` are evenly spaced RGB triples;
/// with none, the named map of OpenImageIO is used.
Tensor coloured(const char* where, const Tensor& unit, const char* map,
                const std::vector<float>& knots) {
  Dims dim(where);
  dim.match("map", unit, "H W");
  const Index H = dim["H"], W = dim["W"], P = H * W;
  Tensor out({3, H, W}, kGrey);
  if (P == 0) return out;

  Tensor filled = unit.clone();  // the colour map needs numbers everywhere
  for (float& v : filled.values()) v = std::isfinite(v) ? std::clamp(v, 0.f, 1.f) : 0.f;
  OIIO::ImageSpec spec(static_cast<int>(W), static_cast<int>(H), 1, OIIO::TypeDesc::FLOAT);
  const OIIO::ImageBuf source(spec, filled.data());
  const OIIO::ImageBuf rgb =
      knots.empty()
          ? OIIO::ImageBufAlgo::color_map(source, 0, map)
          : OIIO::ImageBufAlgo::color_map(source, 0, static_cast<int>(knots.size() / 3), 3, knots);
  std::vector<float> pixels(static_cast<std::size_t>(3 * P));
  if (rgb.has_error() ||
      !rgb.get_pixels(OIIO::ROI(0, static_cast<int>(W), 0, static_cast<int>(H), 0, 1, 0, 3),
                      OIIO::TypeDesc::FLOAT, pixels.data()))
    throw Error(std::string(where) + ": " + rgb.geterror());
  if (knots.empty())  // the library's maps are linear light, a PNG is not
    for (float& v : pixels) v = OIIO::linear_to_sRGB(v);
  for (Index i = 0; i < P; ++i)
    if (std::isfinite(unit[i]))
      for (Index c = 0; c < 3; ++c) out[c * P + i] = pixels[static_cast<std::size_t>(3 * i + c)];
  return out;
}

constexpr const char *kHeights = "viridis", *kConfidence = "magma", *kSigma = "inferno",
                     *kCounts = "viridis";
// blue - white - red, equally light at both ends
const std::vector<float> kErrors{0.02f, 0.19f, 0.55f, 0.40f, 0.62f, 0.90f, 0.97f, 0.97f,
                                 0.97f, 0.95f, 0.55f, 0.40f, 0.60f, 0.02f, 0.10f};

/// The colours of a map, low to high.
std::vector<std::array<float, 3>> ramp(const char* map, const std::vector<float>& knots = {}) {
  constexpr Index kColours = 33;
  Tensor unit({1, kColours});
  for (Index i = 0; i < kColours; ++i)
    unit[i] = static_cast<float>(i) / static_cast<float>(kColours - 1);
  const Tensor rgb = coloured("ramp", unit, map, knots);
  std::vector<std::array<float, 3>> out;
  for (Index i = 0; i < kColours; ++i)
    out.push_back({rgb[i], rgb[kColours + i], rgb[2 * kColours + i]});
  return out;
}

/// Values as shares of a scale.
Tensor scaled(const Tensor& values, double low, double high) {
  Tensor unit = values.clone();
  const auto from = static_cast<float>(low), span = static_cast<float>(high - low);
  for (float& v : unit.values()) v = (v - from) / span;
  return unit;
}

std::vector<float> known_of(const Tensor& values) {
  std::vector<float> known;
  for (const float v : values.values())
    if (std::isfinite(v)) known.push_back(v);
  return known;
}

/// The bytes of a picture as a format of the library has them.
std::string encoded(const std::string& where, const Tensor& picture, const char* format) {
  const bool one = picture.rank() == 2;
  Dims dim(where);
  dim.match("picture", picture, one ? "H W" : "3 H W");
  const Index H = dim["H"], W = dim["W"], C = one ? 1 : 3, P = H * W;
  if (P == 0)
    throw ShapeError(where + ": picture has shape " + picture.shape().str() + ", expected pixels");
  std::vector<unsigned char> bytes(static_cast<std::size_t>(C * P));
  for (Index i = 0; i < P; ++i)
    for (Index c = 0; c < C; ++c) {
      const float v = picture[c * P + i];
      bytes[static_cast<std::size_t>(i * C + c)] = static_cast<unsigned char>(
          255 * (std::isfinite(v) ? std::clamp(v, 0.f, 1.f) : kGrey) + 0.5f);
    }
  std::vector<unsigned char> made;
  OIIO::Filesystem::IOVecOutput memory(made);
  const std::unique_ptr<OIIO::ImageOutput> out = OIIO::ImageOutput::create(format);
  if (!out) throw IoError(where + ": " + OIIO::geterror());
  OIIO::ImageSpec spec(static_cast<int>(W), static_cast<int>(H), static_cast<int>(C),
                       OIIO::TypeDesc::UINT8);
  if (std::string_view(format) == "png") {
    spec.attribute("png:compressionLevel", 4);  // of a preview time counts more than bytes
  } else {
    spec.attribute("Compression", "jpeg:85");
    spec.attribute("jpeg:subsampling", "4:4:4");
  }
  out->set_ioproxy(&memory);
  if (!out->open(std::string("picture.") + format, spec) ||
      !out->write_image(OIIO::TypeDesc::UINT8, bytes.data()) || !out->close())
    throw IoError(where + ": " + out->geterror());
  return {reinterpret_cast<const char*>(made.data()), made.size()};
}

}  // namespace

ColourScale height_scale(const Tensor& z, double h0) {
  std::vector<float> known = known_of(z);
  ColourScale scale{
      "m above the ellipsoid; 2 % beyond each end", h0, h0 + 1, true, true, ramp(kHeights)};
  if (known.empty()) return scale;
  const auto low = static_cast<double>(percentile(known, 0.02)),
             high = static_cast<double>(percentile(known, 0.98));
  scale.low = low + h0;
  scale.high = std::max(high, low + 1e-3) + h0;  // a flat surface has one colour
  return scale;
}

ColourScale confidence_scale() { return {"confidence", 0, 1, false, false, ramp(kConfidence)}; }

ColourScale sigma_scale(const Tensor& sigma) {
  std::vector<float> known = known_of(sigma);
  const double high = known.empty() ? 1 : static_cast<double>(percentile(known, 0.98));
  return {"expected error, m", 0, std::max(high, 1e-3), false, true, ramp(kSigma)};
}

std::vector<std::array<float, 3>> count_colours(Index most) {
  Tensor counts({1, most + 1});
  for (Index n = 0; n <= most; ++n) counts[n] = static_cast<float>(n);
  const Tensor rgb = count_picture(counts, most);
  std::vector<std::array<float, 3>> out;
  for (Index n = 0; n <= most; ++n)
    out.push_back({rgb[n], rgb[most + 1 + n], rgb[2 * (most + 1) + n]});
  return out;
}

ColourScale error_scale(double limit) {
  return {"error, m: blue too low, red too high", -limit, limit, true, true, ramp("", kErrors)};
}

Tensor block_means(const Tensor& values, Index block) {
  const bool planes = values.rank() == 3;
  const Index C = planes ? values.dim(0) : 1, H = values.dim(planes ? 1 : 0),
              W = values.dim(planes ? 2 : 1), h = (H + block - 1) / block,
              w = (W + block - 1) / block;
  Tensor out(planes ? Shape{C, h, w} : Shape{h, w}, std::numeric_limits<float>::quiet_NaN());
  for (Index c = 0; c < C; ++c)
    for (Index y = 0; y < h; ++y)
      for (Index x = 0; x < w; ++x) {
        double sum = 0, count = 0;
        for (Index v = y * block; v < std::min(H, (y + 1) * block); ++v)
          for (Index u = x * block; u < std::min(W, (x + 1) * block); ++u)
            if (const float value = values[(c * H + v) * W + u]; std::isfinite(value))
              sum += static_cast<double>(value), count += 1;
        if (count > 0) out[(c * h + y) * w + x] = static_cast<float>(sum / count);
      }
  return out;
}

Tensor stretched_picture(const Tensor& picture) {
  constexpr double kLeastSpan = 0.05;  // of a picture of one colour no noise is to be made visible
  std::vector<float> known = known_of(picture);
  if (known.empty()) return picture.clone();
  const auto low = static_cast<double>(percentile(known, 0.01)),
             high = static_cast<double>(percentile(known, 0.99));
  Tensor out = scaled(picture, low, std::max(high, low + kLeastSpan));
  for (float& v : out.values())
    if (std::isfinite(v)) v = std::clamp(v, 0.F, 1.F);
  return out;
}

Tensor height_picture(const Tensor& z) {
  const ColourScale scale = height_scale(z, 0);
  return coloured("height_picture", scaled(z, scale.low, scale.high), kHeights, {});
}

Tensor hillshade_picture(const Tensor& z, double step) {
  Dims dim("hillshade_picture");
  dim.match("z", z, "H W");
  const Index H = dim["H"], W = dim["W"], P = H * W;
  const double elevation = 45 * M_PI / 180, azimuth = 315 * M_PI / 180;
  const double sun[3] = {std::cos(elevation) * std::sin(azimuth),
                         std::cos(elevation) * std::cos(azimuth), std::sin(elevation)};
  Tensor out({3, H, W}, kGrey);
  for (Index i = 0; i < H; ++i)
    for (Index j = 0; j < W; ++j) {
      const float centre = z[i * W + j];
      if (!std::isfinite(centre)) continue;
      double q[3][3];
      for (Index r = 0; r < 3; ++r)
        for (Index c = 0; c < 3; ++c) {
          const Index y = std::clamp<Index>(i + r - 1, 0, H - 1),
                      x = std::clamp<Index>(j + c - 1, 0, W - 1);
          const float v = z[y * W + x];
          q[r][c] = static_cast<double>(std::isfinite(v) ? v : centre);
        }
      const double dx =
          (q[0][2] + 2 * q[1][2] + q[2][2] - q[0][0] - 2 * q[1][0] - q[2][0]) / (8 * step);
      const double dy =
          (q[0][0] + 2 * q[0][1] + q[0][2] - q[2][0] - 2 * q[2][1] - q[2][2]) / (8 * step);
      const double lit = (sun[2] - dx * sun[0] - dy * sun[1]) / std::sqrt(1 + dx * dx + dy * dy);
      const auto shade = static_cast<float>(std::clamp(0.08 + 0.92 * std::max(0.0, lit), 0.0, 1.0));
      for (Index c = 0; c < 3; ++c) out[c * P + i * W + j] = shade;
    }
  return out;
}

Tensor confidence_picture(const Tensor& confidence) {
  return coloured("confidence_picture", confidence, kConfidence, {});
}

Tensor sigma_picture(const Tensor& sigma) {
  return coloured("sigma_picture", scaled(sigma, 0, sigma_scale(sigma).high), kSigma, {});
}

Tensor count_picture(const Tensor& views, Index most) {
  return coloured("count_picture", scaled(views, 0, static_cast<double>(std::max<Index>(most, 1))),
                  kCounts, {});
}

Tensor error_picture(const Tensor& error, double limit) {
  return coloured("error_picture", scaled(error, -limit, limit), "", kErrors);
}

std::string png_bytes(const Tensor& picture) { return encoded("png_bytes", picture, "png"); }

std::string jpeg_bytes(const Tensor& picture) { return encoded("jpeg_bytes", picture, "jpg"); }

void write_png(const std::filesystem::path& path, const Tensor& picture) {
  atomic_write(path, encoded("write_png: " + path.string(), picture, "png"));
}

}  // namespace satsurf::app
