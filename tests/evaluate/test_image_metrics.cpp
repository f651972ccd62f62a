// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/preview.h"
#include "satsurf/core/rng.h"
#include "satsurf/evaluate/image_metrics.h"
#include "satsurf/evaluate/metrics.h"
#include "satsurf/rpc/picture.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include "tests/gradcheck.h"
#include "tests/paths.h"
#include "tests/ref/ssim_ref.h"
#include "tests/small_lpips.h"
#include "tests/temp_folder.h"
#include <OpenImageIO/imageio.h>

using namespace satsurf;
using namespace satsurf::app;
using namespace satsurf::evaluate;

namespace {

Tensor noise(const Shape& shape, std::uint64_t seed) {
  auto t = test::normal(shape, seed, 0.2).cast<float>();
  for (float& v : t.values()) v += 0.5f;
  return t;
}

/// Published weights and images, which the repository does not contain: SATSURF_DATA, or
/// ../shared/data beside the sources. Empty, with a message, where there are none.
std::filesystem::path lpips_folder() {
  const std::filesystem::path folder = test::shared_data() / "lpips";
  if (std::filesystem::is_directory(folder)) return folder;
  MESSAGE("SKIPPED: no LPIPS weights at ", folder.string(), " (set SATSURF_DATA)");
  return {};
}

void write_picture(const std::filesystem::path& path, int W, int H, int C, OIIO::TypeDesc as,
                   const std::vector<float>& pixels) {
  const auto out = OIIO::ImageOutput::create(path.string());
  REQUIRE(out);
  OIIO::ImageSpec spec(W, H, C, as);
  spec.attribute("oiio:UnassociatedAlpha", 1);
  REQUIRE(out->open(path.string(), spec));
  REQUIRE(out->write_image(OIIO::TypeDesc::FLOAT, pixels.data()));
  REQUIRE(out->close());
}

}  // namespace

namespace {

/// A grey TIFF in one strip behind its directory, as cameras write them: cut off, it still opens.
/// zero  1 where it is black, 0 where it is white
std::string plain_tiff(std::uint32_t side, std::uint32_t zero = 1) {
  std::string out("II*\0\x08\0\0\0", 8);
  const auto put = [&](std::uint32_t value, int bytes) {
    for (int i = 0; i < bytes; ++i) out += static_cast<char>(value >> 8 * i & 255);
  };
  constexpr std::uint32_t kTags = 9, kShort = 3, kLong = 4, kData = 8 + 2 + 12 * kTags + 4;
  put(kTags, 2);
  for (const auto& [tag, type, value] :
       std::array<std::array<std::uint32_t, 3>, kTags>{{{256, kLong, side},   // width
                                                        {257, kLong, side},   // height
                                                        {258, kShort, 8},     // bits
                                                        {259, kShort, 1},     // not packed
                                                        {262, kShort, zero},  // black or white
                                                        {273, kLong, kData},  // the strip's place
                                                        {277, kShort, 1},     // channels
                                                        {278, kLong, side},   // rows of the strip
                                                        {279, kLong, side * side}}})
    put(tag, 2), put(type, 2), put(1, 4), put(value, 4);
  put(0, 4);
  return out + std::string(std::size_t{side} * side, '\x55');
}

}  // namespace

TEST_CASE("score_images") {
  const Index H = 21, W = 25, P = H * W;
  const Tensor a = noise({3, H, W}, 1), b = noise({3, H, W}, 2);
  auto clip = [](const Tensor& t) {
    auto d = t.cast<double>();
    for (double& v : d.values()) v = std::min(1.0, std::max(0.0, v));
    return d;
  };
  SUBCASE("values beyond [0, 1] are clipped") {
    REQUIRE(*std::max_element(a.values().begin(), a.values().end()) > 1);
    const ImageScores s = score_images(a, b);
    CHECK(s.psnr == psnr(a, b));
    CHECK(s.ssim ==
          doctest::Approx(test::ssim_ref(clip(a), clip(b), nullptr, 3, H, W, test::kSkimageRef)));
    CHECK(s.ssim_conv ==
          doctest::Approx(test::ssim_ref(clip(a), clip(b), nullptr, 3, H, W, test::kConvRef)));
    CHECK(!s.lpips);
    CHECK(s.lpips_backbone.empty());
  }
  SUBCASE("a mask") {
    Tensor mask({H, W}, 1.f);
    for (Index i = 0; i < P; i += 4) mask[i] = 0;
    const auto m = mask.cast<double>();
    const ImageScores s = score_images(a, b, mask);
    CHECK(s.psnr == psnr(a, b, mask));
    CHECK(s.ssim ==
          doctest::Approx(test::ssim_ref(clip(a), clip(b), m.data(), 3, H, W, test::kSkimageRef)));
    CHECK(s.ssim_conv ==
          doctest::Approx(test::ssim_ref(clip(a), clip(b), m.data(), 3, H, W, test::kConvRef)));
  }
  SUBCASE("after a change of all colours what is left is what no such change explains") {
    // Each colour twice, and the reference a little above its map here and as much below there.
    const Index pairs = 60;
    constexpr double kMap[3][4] = {{0.5, 0.1, 0, 0.2}, {0, 0.4, 0.2, 0.1}, {-0.1, 0.2, 0.6, 0.15}};
    Tensor image({3, 2, pairs}), reference({3, 2, pairs}), mask({2, pairs}, 1.f);
    double left = 0, before = 0;
    Rng rng(3);
    for (Index i = 0; i < pairs; ++i) {
      const double rgb[3] = {rng.uniform(0.2, 0.8), rng.uniform(0.2, 0.8), rng.uniform(0.2, 0.8)};
      for (Index row = 0; row < 2; ++row)
        for (Index c = 0; c < 3; ++c) {
          const double* m = kMap[c];
          const double off = (row == 0 ? 0.01 : -0.01) * static_cast<double>(c + 1),
                       value = m[0] * rgb[0] + m[1] * rgb[1] + m[2] * rgb[2] + m[3] + off;
          const Index at = (c * 2 + row) * pairs + i;
          image[at] = static_cast<float>(rgb[c]), reference[at] = static_cast<float>(value);
          left += off * off, before += (value - rgb[c]) * (value - rgb[c]);
        }
    }
    const auto decibels = [&](double squares) {
      return -10 * std::log10(squares / static_cast<double>(6 * pairs));
    };
    const ImageScores s = score_images(image, reference);
    CHECK(s.psnr_fitted == doctest::Approx(decibels(left)).epsilon(1e-5));
    CHECK(s.psnr == doctest::Approx(decibels(before)).epsilon(1e-5));
    CHECK(s.psnr_fitted > s.psnr + 3);
    // Both pixels of some colours, which do not count, have nothing to say about the map.
    for (Index p = 0; p < 2 * pairs; p += 4) {
      const Index other = (p + pairs) % (2 * pairs);
      mask[p] = mask[other] = 0;
      for (const Index at : {p, other})
        for (Index c = 0; c < 3; ++c) reference[c * 2 * pairs + at] = c == 0 ? 1.f : 0.f;
    }
    CHECK(score_images(image, reference, mask).psnr_fitted ==
          doctest::Approx(decibels(left)).epsilon(1e-5));
  }
  SUBCASE("equal images") {
    const ImageScores s = score_images(a, a);
    CHECK(std::isinf(s.psnr));
    CHECK(s.ssim == 1);
    CHECK(s.ssim_conv == 1);
  }
  SUBCASE("numbers that do not exist are NaN") {
    const ImageScores small = score_images(noise({1, 10, 30}, 3), noise({1, 10, 30}, 4));
    CHECK(std::isnan(small.ssim));
    CHECK(std::isfinite(small.ssim_conv));
    Tensor border({H, W});
    border[3] = 1;
    const ImageScores s = score_images(a, b, border);
    CHECK(std::isnan(s.ssim));
    CHECK(std::isfinite(s.ssim_conv));
    const ImageScores none = score_images(a, b, Tensor({H, W}));
    CHECK(std::isnan(none.psnr));
    CHECK(std::isnan(none.ssim_conv));
    CHECK(!none.lpips);
  }
  SUBCASE("nor has LPIPS a value where no pixel counts, else the two would be equal") {
    const nn::Lpips lpips = test::small_lpips();
    const Index side = lpips.smallest_side() + 1;
    const Tensor p = noise({3, side, side}, 3), q = noise({3, side, side}, 4);
    Tensor mask({side, side});
    const ImageScores none = score_images(p, q, mask, &lpips);
    REQUIRE(none.lpips);
    CHECK(std::isnan(*none.lpips));
    CHECK(none.lpips_backbone == "alex");
    for (Index i = 0; i < side * side / 2; ++i) mask[i] = 1;
    CHECK(*score_images(p, q, mask, &lpips).lpips > 0);
    CHECK(*score_images(p, q, {}, &lpips).lpips > 0);
  }
}

TEST_CASE("read_picture") {
  const test::TempFolder folder("picture");
  SUBCASE("8 and 16 bits, colour and grey, with or without transparency") {
    const std::vector<float> values{0.2f, 0.4f, 0.6f, 0.8f, 1.f, 0.f, 0.6f, 0.2f};
    struct Kind {
      const char* name;
      int channels;
      OIIO::TypeDesc as;
    };
    for (const auto& [name, channels, as] :
         {Kind{"rgba.png", 4, OIIO::TypeDesc::UINT8}, Kind{"grey.png", 1, OIIO::TypeDesc::UINT8},
          Kind{"greya.png", 2, OIIO::TypeDesc::UINT8}, Kind{"deep.png", 1, OIIO::TypeDesc::UINT16},
          Kind{"rgba.tif", 4, OIIO::TypeDesc::UINT16},
          Kind{"grey.tif", 1, OIIO::TypeDesc::FLOAT}}) {
      CAPTURE(name);
      const int W = 8 / channels, keep = channels < 3 ? 1 : 3;
      write_picture(folder / name, W, 1, channels, as, values);
      const Tensor t = rpc::read_picture(folder / name);
      REQUIRE(t.shape() == Shape{keep, 1, W});
      for (int i = 0; i < W; ++i)
        for (int c = 0; c < keep; ++c)
          CHECK(t[c * W + i] ==
                doctest::Approx(values[static_cast<std::size_t>(i * channels + c)]).epsilon(1e-5));
    }
  }
  SUBCASE("an index stands for a colour, few bits for shares") {
    const auto written = [&](const std::string& bytes) {
      test::write_bytes(folder / "t.png", bytes);
      return rpc::read_picture(folder / "t.png");
    };
    using namespace std::string_literals;  // which hold zeros
    const Tensor palette = written(
        "\211PNG\015\012\032\012\000\000\000\015IHDR\000\000\000\003\000\000\000\001"
        "\002\003\000\000\000f\216\374'\000\000\000\011PLTE\377\000\000\0003\000\000"
        "\000f\210|\343\260\000\000\000\012IDATx\332c\220\000\000\000\032\000\031\200"
        "\000\216\273\000\000\000\000IEND\256B`\202"s);
    REQUIRE(palette.shape() == Shape{3, 1, 3});
    for (Index c = 0; c < 3; ++c)
      for (Index x = 0; x < 3; ++x)
        CHECK(palette[3 * c + x] == doctest::Approx(c != x ? 0 : c == 0 ? 1 : c == 1 ? 0.2 : 0.4));
    const Tensor one_bit = written(
        "\211PNG\015\012\032\012\000\000\000\015IHDR\000\000\000\003\000\000\000\001"
        "\001\000\000\000\0003\233)\031\000\000\000\012IDATx\332cX\000\000\000\242\000"
        "\241q\005\313A\000\000\000\000IEND\256B`\202"s);
    REQUIRE(one_bit.shape() == Shape{1, 1, 3});
    CHECK(one_bit[0] == 1);
    CHECK(one_bit[1] == 0);
    CHECK(one_bit[2] == 1);
    const Tensor four_bits = written(
        "\211PNG\015\012\032\012\000\000\000\015IHDR\000\000\000\002\000\000\000\001"
        "\004\000\000\000\000\024\271\315W\000\000\000\012IDATx\332c\210\007\000\000a"
        "\000`\270I\042\203\000\000\000\000IEND\256B`\202"s);
    REQUIRE(four_bits.shape() == Shape{1, 1, 2});
    CHECK(four_bits[0] == doctest::Approx(5.0 / 15));
    CHECK(four_bits[1] == 1);
    for (const std::uint32_t zero : {0U, 1U}) {
      const Tensor grey = written(plain_tiff(4, zero));
      REQUIRE(grey.shape() == Shape{1, 4, 4});
      CHECK(grey[5] == doctest::Approx(zero == 1 ? 85.0 / 255 : 170.0 / 255));
    }
  }
  SUBCASE("what write_png writes") {
    const Tensor t = Tensor::from({3, 1, 2}, {0, 1, 0.2f, 0.4f, 0.6f, 0.8f});
    write_png(folder / "t.png", t);
    const Tensor back = rpc::read_picture(folder / "t.png");
    for (Index i = 0; i < 6; ++i) CHECK(back[i] == doctest::Approx(t[i]));
  }
  SUBCASE("refusals name the file") {
    const auto refusal = [&](const std::string& name) {
      return test::error_of<IoError>([&] { rpc::read_picture(folder / name); });
    };
    const std::string at = (folder / "").string();
    CHECK(refusal("gone.png") ==
          at + "gone.png: no such file, expected a PNG, JPEG or TIFF picture");
    test::write_bytes(folder / "text.png", "this is no picture");
    test::write_bytes(folder / "empty.tif", "");
    write_picture(folder / "six.tif", 2, 1, 6, OIIO::TypeDesc::UINT8, std::vector<float>(12));
    write_png(folder / "whole.png", noise({3, 40, 40}, 5));
    const std::string bytes = test::read_bytes(folder / "whole.png");
    test::write_bytes(folder / "cut.png", bytes.substr(0, bytes.size() / 2));
    std::string huge = bytes;  // says to be 30,000 px a side; the check sum of that is right
    huge.replace(16, 17, std::string("\0\0\x75\x30\0\0\x75\x30\x08\x02\0\0\0\xe9\x45\x6f\xed", 17));
    test::write_bytes(folder / "huge.png", huge);
    CHECK(refusal("huge.png")
              .starts_with(at + "huge.png: 30000 x 30000 px with 3 channels in a file"));
    // A progressive JPEG of 258 bytes, for which libjpeg would take 450 MB while it is opened; what
    // stands before the frame header is a segment, a stuffed zero and fill bytes.
    const std::string frame(
        "\xff\xc2\0\x11\x08\x73\x72\x77\x08\x03\x01\x22\0\x02\x11\x01\x03\x11\x01", 19);
    const std::string jpeg =
        std::string("\xff\xd8\xff\xe0\0\x04\xff\xc2\xff\0\xff\xff", 12) + frame;
    test::write_bytes(folder / "huge.jpg", jpeg + std::string(227, '\0'));
    CHECK(refusal("huge.jpg") ==
          at + "huge.jpg: 30472 x 29554 px with 3 channels in a file of 258 bytes, "
               "expected a PNG, JPEG or TIFF picture");
    for (std::size_t i = 2; i <= jpeg.size(); ++i) {  // cut anywhere it is refused as well
      test::write_bytes(folder / "stump.jpg", jpeg.substr(0, i));
      CHECK(refusal("stump.jpg").starts_with(at + "stump.jpg: "));
    }
    test::write_bytes(folder / "movie.png", "GIF89a" + std::string(100, '\0'));
    CHECK(refusal("movie.png") ==
          at + "movie.png: of another format, expected a PNG, JPEG or TIFF picture");
    for (const std::string name : {"text.png", "empty.tif", "six.tif", "cut.png"}) {
      const std::string text = refusal(name);
      CAPTURE(text);
      CHECK(text.starts_with(at + name + ": "));
      CHECK(text.ends_with(", expected a PNG, JPEG or TIFF picture"));
      CHECK(text.find('\n') == std::string::npos);
    }
    const std::string tiff = plain_tiff(64);
    test::write_bytes(folder / "whole.tif", tiff);
    CHECK(rpc::read_picture(folder / "whole.tif").shape() == Shape{1, 64, 64});
    for (const std::size_t keep : {std::size_t{150}, tiff.size() / 2, tiff.size() - 1}) {
      test::write_bytes(folder / "cut.tif", tiff.substr(0, keep));
      const std::string text = refusal("cut.tif");
      CAPTURE(text);
      CHECK(text.starts_with(at + "cut.tif: "));
      CHECK(text.ends_with(", expected a PNG, JPEG or TIFF picture"));
    }
    CHECK(refusal("cut.png") ==
          at + "cut.png: the file ends too early, expected a PNG, JPEG or TIFF picture");
    CHECK(refusal("six.tif") ==
          at + "six.tif: 2 x 1 px with 6 channels, expected a PNG, JPEG or TIFF picture");
  }
}

TEST_CASE("lpips has the published values") {
  const std::filesystem::path folder = lpips_folder();
  if (folder.empty()) return;
  const Tensor ref = rpc::read_picture(folder / "ex_ref.png"),
               p0 = rpc::read_picture(folder / "ex_p0.png"),
               p1 = rpc::read_picture(folder / "ex_p1.png");
  struct Published {
    const char* backbone;
    double p0, p1;
  };
  for (const auto& [backbone, want0, want1] :
       {Published{"squeeze", 0.71105, 0.14790}, Published{"alex", 0.72188, 0.13757}}) {
    CAPTURE(backbone);
    const auto lpips =
        nn::Lpips::load(folder / ("lpips_" + std::string(backbone) + ".safetensors"));
    const ImageScores s0 = score_images(p0, ref, {}, &lpips);
    CHECK(s0.lpips_backbone == backbone);
    REQUIRE(s0.lpips);
    CHECK(std::abs(*s0.lpips - want0) < 1e-4);
    CHECK(std::abs(*score_images(p1, ref, {}, &lpips).lpips - want1) < 1e-4);
    CHECK(*score_images(ref, ref, {}, &lpips).lpips == 0);

    // grey is three equal channels
    const Tensor grey = ref.reshaped({3, 64, 64}).slice0(0).reshaped({1, 64, 64});
    auto three = Tensor::uninitialised({3, 64, 64});
    for (Index c = 0; c < 3; ++c) std::copy_n(grey.data(), 4096, three.data() + c * 4096);
    const Tensor dark({1, 64, 64}), darks({3, 64, 64});
    CHECK(*score_images(grey, dark, {}, &lpips).lpips ==
          *score_images(three, darks, {}, &lpips).lpips);
  }
}
