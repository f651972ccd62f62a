// SPDX-License-Identifier: Apache-2.0
#include "satsurf/splat/ply.h"

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "tests/gradcheck.h"
#include "tests/ref/splat_ref.h"
#include "tests/temp_folder.h"
#include <unistd.h>

namespace satsurf::test {
namespace {

namespace fs = std::filesystem;

/// A file name of this test run alone, removed at the end.
struct TemporaryFile {
  fs::path path;
  explicit TemporaryFile(const std::string& name)
      : path(fs::temp_directory_path() / ("satsurf-" + std::to_string(::getpid()) + "-" + name)) {}
  ~TemporaryFile() {
    std::error_code ignored;
    fs::remove(path, ignored);
  }
  std::string bytes() const {
    std::ifstream in(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  void write(const std::string& bytes) const { std::ofstream(path, std::ios::binary) << bytes; }
};

std::string floats(const std::vector<float>& values) {
  std::string out(values.size() * sizeof(float), '\0');
  std::memcpy(out.data(), values.data(), out.size());
  return out;
}

double worst(const Var& a, const Var& b) {
  REQUIRE(a.shape() == b.shape());
  double w = 0;
  for (Index i = 0; i < a.count(); ++i)
    w = std::max(w,
                 std::abs(static_cast<double>(a.value()[i]) - static_cast<double>(b.value()[i])));
  return w;
}

std::string complaint(const fs::path& path) {
  try {
    splat::read_ply(path);
  } catch (const IoError& e) {
    const std::string text = e.what(), front = "read_ply: " + path.string() + ": ";
    REQUIRE(text.substr(0, front.size()) == front);
    return text.substr(front.size());
  }
  return "read without complaint";
}

}  // namespace

TEST_CASE("ply: what is written is read back") {
  auto s = random_surfels<float>(23, 0, 30, 40, 4);
  auto& q = s.quats.mutable_value();
  for (Index p = 0; p < 23; ++p) {
    float square = 0;
    for (Index i = 0; i < 4; ++i) square += q[4 * p + i] * q[4 * p + i];
    for (Index i = 0; i < 4; ++i) q[4 * p + i] /= std::sqrt(square);
  }
  for (const bool two_scales : {false, true}) {
    const TemporaryFile file("round.ply");
    splat::write_ply(file.path, s, {"crs EPSG:32617", "origin 435525.12345678901 3354071.5"},
                     two_scales);
    const auto back = splat::read_ply(file.path);
    CHECK(back.comments ==
          std::vector<std::string>{"crs EPSG:32617", "origin 435525.12345678901 3354071.5"});
    CHECK(worst(back.surfels.means, s.means) == 0);
    CHECK(worst(back.surfels.quats, s.quats) < 1e-6);
    CHECK(worst(back.surfels.scales, s.scales) < 1e-6);
    CHECK(worst(back.surfels.opacity, s.opacity) < 1e-6);
    CHECK(worst(back.surfels.colours, s.colours) < 1e-6);
    CHECK((file.bytes().find("scale_2") == std::string::npos) == two_scales);
  }
}

TEST_CASE("ply: the bytes are what viewers expect") {
  const auto one = [](std::initializer_list<float> v) {
    return Var(Tensor::from({1, static_cast<Index>(v.size())}, v));
  };
  splat::Surfels s{one({1, 2, 3}),    one({0, 2, 0, 0}),
                   one({0.5f, 2}),    Var(Tensor::from({1}, {0.75f})),
                   one({0.5f, 1, 0}), {}};
  const TemporaryFile file("bytes.ply");
  splat::write_ply(file.path, s, {});
  std::string want = "ply\nformat binary_little_endian 1.0\nelement vertex 1\n";
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity",
                           "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"})
    want += std::string("property float ") + name + "\n";
  want += "end_header\n";
  const std::string got = file.bytes();
  REQUIRE(got.size() == want.size() + 17 * 4);
  CHECK(got.substr(0, want.size()) == want);
  float v[17];
  std::memcpy(v, got.data() + want.size(), sizeof(v));
  // half a turn about x: the disc lies on its face, and its normal is told upwards all the same
  const double expected[17] = {1,
                               2,
                               3,
                               0,
                               0,
                               1,
                               0,
                               0.5 / 0.28209479,
                               -0.5 / 0.28209479,
                               std::log(3.0),
                               std::log(0.5),
                               std::log(2.0),
                               std::log(1e-6),
                               0,
                               1,
                               0,
                               0};
  for (std::size_t i = 0; i < 17; ++i)
    CHECK(static_cast<double>(v[i]) == doctest::Approx(expected[i]).epsilon(1e-6));
  // 150 degrees about x
  const double half = 75 * std::numbers::pi / 180;
  s.quats = one({static_cast<float>(std::cos(half)), static_cast<float>(std::sin(half)), 0, 0});
  splat::write_ply(file.path, s, {});
  std::memcpy(v, file.bytes().data() + want.size(), sizeof(v));
  CHECK(std::abs(v[3]) < 1e-6F);
  CHECK(static_cast<double>(v[4]) == doctest::Approx(0.5));
  CHECK(static_cast<double>(v[5]) == doctest::Approx(std::cos(std::numbers::pi / 6)));
}

TEST_CASE("ply: another order of properties, further ones, and a header of another program") {
  const TemporaryFile file("other.ply");
  file.write(
      "ply\r\nformat binary_little_endian 1.0\r\ncomment by somebody\r\nobj_info x\r\nelement "
      "vertex 2\r\n"
      "property float rot_3\r\nproperty float rot_2\r\nproperty float rot_1\r\nproperty float "
      "rot_0\r\n"
      "property float32 f_rest_0\r\nproperty float scale_1\r\nproperty float scale_0\r\nproperty "
      "float opacity\r\n"
      "property float z\r\nproperty float y\r\nproperty float x\r\nproperty float f_dc_0\r\n"
      "property float f_dc_1\r\nproperty float f_dc_2\r\nend_header\r\n" +
      floats({4,      3, 2, 1, 99, 0, 1, 0,   30, 20, 10, 0, 1, 2,
              /**/ 8, 7, 6, 5, 99, 2, 3, -50, 33, 22, 11, 0, 0, 0}));
  const auto got = splat::read_ply(file.path);
  CHECK(got.comments == std::vector<std::string>{"by somebody"});
  CHECK(got.surfels.means.value()[3] == 11);
  CHECK(got.surfels.means.value()[5] == 33);
  CHECK(got.surfels.quats.value()[1] == 2);
  CHECK(got.surfels.quats.value()[4] == 5);
  CHECK(got.surfels.scales.value()[0] == doctest::Approx(std::exp(1.0)));
  CHECK(got.surfels.scales.value()[3] == doctest::Approx(std::exp(2.0)));
  CHECK(got.surfels.opacity.value()[0] == 0.5f);
  CHECK(got.surfels.opacity.value()[1] < 1e-20f);
  CHECK(got.surfels.colours.value()[2] == doctest::Approx(0.5 + 2 * 0.28209479));
}

TEST_CASE("ply: nothing at all is a valid set") {
  const TemporaryFile file("empty.ply");
  splat::write_ply(file.path, random_surfels<float>(0, 0, 3, 3, 1), {"none"});
  CHECK(splat::read_ply(file.path).surfels.means.shape() == Shape{0, 3});
}

TEST_CASE("ply: damaged files are refused in one line") {
  const TemporaryFile good("good.ply"), bad("bad.ply");
  splat::write_ply(good.path, random_surfels<float>(3, 0, 9, 9, 1), {});
  const std::string bytes = good.bytes();
  const auto after = [&](const std::string& from, const std::string& to) {
    const std::size_t at = bytes.find(from);
    REQUIRE(at != std::string::npos);
    bad.write(bytes.substr(0, at) + to + bytes.substr(at + from.size()));
    return complaint(bad.path);
  };
  CHECK(error_of<IoError>([&] { splat::read_ply(bad.path); }) ==
        bad.path.string() + ": no such file, expected a PLY file");
  CHECK(after("ply\n", "plx\n") == "does not begin with 'ply'");
  CHECK(after("binary_little", "binary_big") ==
        "'format binary_big_endian 1.0', expected 'format binary_little_endian 1.0'");
  CHECK(after("vertex 3", "vertex 4") ==
        "204 bytes behind the header, expected 272 for 4 vertices of 17 floats");
  CHECK(after("vertex 3", "vertex 2") ==
        "204 bytes behind the header, expected 136 for 2 vertices of 17 floats");
  CHECK(after("vertex 3", "vertex 99999999999") ==
        "'element vertex 99999999999', expected a number of vertices below 2^31");
  CHECK(after("vertex 3", "vertex -3") ==
        "'element vertex -3', expected a number of vertices below 2^31");
  CHECK(after("vertex 3", "face 3") ==
        "'element face 3', expected surfels, one vertex element of float properties");
  CHECK(after("property float rot_2", "property uchar rot_2") ==
        "'property uchar rot_2', expected surfels, one vertex element of float properties");
  CHECK(after("property float rot_2", "property float rot_1") == "property rot_1 comes twice");
  CHECK(after("rot_2", "rot_9") == "property rot_2 is missing, expected all of a splat's");
  CHECK(after("end_header", "") == "empty line in the header");
  for (const std::size_t cut :
       {std::size_t{0}, std::size_t{3}, std::size_t{50}, bytes.size() - 1}) {
    bad.write(bytes.substr(0, cut));
    const std::string text = complaint(bad.path);
    CHECK(text == (cut < 100
                       ? "the header does not end; is this a PLY file?"
                       : "203 bytes behind the header, expected 204 for 3 vertices of 17 floats"));
  }
  std::string nan = bytes;
  const float value = std::numeric_limits<float>::quiet_NaN();
  std::memcpy(nan.data() + nan.size() - 4, &value, 4);
  bad.write(nan);
  CHECK(complaint(bad.path) == "property rot_3 of vertex 2 is nan, expected a finite number");
}

TEST_CASE("ply: numbers that are no surfel's are refused") {
  const TemporaryFile good("good.ply"), bad("bad.ply");
  splat::write_ply(good.path, random_surfels<float>(3, 0, 9, 9, 1), {});
  const std::string bytes = good.bytes();
  // of the last vertex, properties counted from its first
  const auto with = [&](std::size_t first, std::initializer_list<float> values) {
    std::string changed = bytes;
    std::memcpy(changed.data() + changed.size() - 4 * (17 - first), values.begin(),
                4 * values.size());
    bad.write(changed);
    return complaint(bad.path);
  };
  CHECK(with(0, {1e5F}) == "read without complaint");
  CHECK(with(1, {1e38F}) ==
        "a coordinate of vertex 2 is 1e+38, expected at most 100000 m either way: relative to an "
        "origin near the scene");
  CHECK(with(10, {1000}) ==
        "a scale of vertex 2 is inf, expected one above 0 and at most 100000 m");
  CHECK(with(11, {-1000}) == "a scale of vertex 2 is 0, expected one above 0 and at most 100000 m");
  CHECK(with(13, {0, 0, 0, 0}) ==
        "the length of the quaternion of vertex 2 is 0, expected a rotation");
  CHECK(with(13, {1e30F, 0, 0, 0})
            .starts_with("the length of the quaternion of vertex 2 is 1e+30, expected"));
}

TEST_CASE("ply: files are joined if every surfel of theirs can be read") {
  const TempFolder folder("join-ply");
  const TemporaryFile one("one.ply"), two("two.ply");
  const fs::path all = folder / "all.ply";
  splat::write_ply(one.path, random_surfels<float>(3, 0, 9, 9, 1), {});
  splat::write_ply(two.path, random_surfels<float>(40000, 0, 9, 9, 2), {});
  CHECK(splat::join_ply(all, {one.path, two.path}, {"c"}) == std::vector<Index>{3, 40000});
  const splat::PlyContent joined = splat::read_ply(all);
  CHECK(joined.comments == std::vector<std::string>{"c"});
  CHECK(joined.surfels.means.dim(0) == 40003);
  CHECK(joined.surfels.means.value()[3 * 40002] ==
        splat::read_ply(two.path).surfels.means.value()[3 * 39999]);
  const std::string bytes = two.bytes(), before = read_bytes(all);
  const auto names = [&] {
    std::vector<fs::path> out;
    for (const auto& entry : fs::directory_iterator(folder.path()))
      out.push_back(entry.path().filename());
    return out;
  };
  CHECK(names() == std::vector<fs::path>{"all.ply"});
  const auto refusal = [&](std::size_t first, float value) {  // in the last surfel's row
    std::string changed = bytes;
    std::memcpy(changed.data() + changed.size() - 4 * (17 - first), &value, 4);
    two.write(changed);
    const std::string error = test::error_of<IoError>([&] {
      splat::join_ply(all, {one.path, two.path}, {});
    });
    CHECK(names() == std::vector<fs::path>{"all.ply"});  // as it was
    return error;
  };
  const std::string front = "read_ply: " + two.path.string() + ": ";
  CHECK(refusal(4, std::numeric_limits<float>::quiet_NaN()) ==
        front + "property ny of vertex 39999 is nan, expected a finite number");
  CHECK(refusal(0, 1e38F).starts_with(front + "a coordinate of vertex 39999 is 1e+38"));
  CHECK(refusal(10, 1000).starts_with(front + "a scale of vertex 39999 is inf"));
  two.write(bytes.substr(0, bytes.size() - 16) + std::string(16, '\0'));
  CHECK(test::error_of<IoError>([&] { splat::join_ply(all, {two.path}, {}); }) ==
        front + "the length of the quaternion of vertex 39999 is 0, expected a rotation");
  // as long and as finite as they should be, but with other numbers in the same places
  std::string turned = one.bytes();
  const std::size_t rot = turned.find("rot_1\nproperty float rot_2\n");
  REQUIRE(rot != std::string::npos);
  turned[rot + 4] = '2', turned[rot + 25] = '1';
  two.write(turned);
  CHECK(splat::read_ply(two.path).surfels.means.dim(0) == 3);
  for (const bool two_scales : {false, true}) {
    if (two_scales) splat::write_ply(two.path, random_surfels<float>(17, 0, 9, 9, 2), {}, true);
    CHECK(test::error_of<IoError>([&] {
            splat::join_ply(all, {one.path, two.path}, {});
          }) == front + "other properties, expected those that write_ply writes");
  }
  CHECK(names() == std::vector<fs::path>{"all.ply"});
  CHECK(read_bytes(all) == before);
  fs::create_directory(folder / "taken");
  CHECK(test::error_of<IoError>([&] { splat::join_ply(folder / "taken", {one.path}, {}); }) ==
        (folder / "taken").string() +
            ": cannot be written (Is a directory), expected a place that can be written");
  CHECK(names().size() == 2);
  // parts without surfels, and no part at all
  splat::write_ply(two.path, random_surfels<float>(0, 0, 9, 9, 2), {});
  CHECK(splat::join_ply(all, {two.path, one.path, two.path}, {}) == std::vector<Index>{0, 3, 0});
  CHECK(splat::read_ply(all).surfels.means.dim(0) == 3);
  CHECK(splat::join_ply(all, {}, {}).empty());
  CHECK(splat::read_ply(all).surfels.means.dim(0) == 0);
}

TEST_CASE("ply: what cannot be written is refused and leaves no file") {
  const TemporaryFile file("refused.ply");
  const auto text = [&](const splat::Surfels& s,
                        const std::vector<std::string>& comments) -> std::string {
    try {
      splat::write_ply(file.path, s, comments);
    } catch (const Error& e) {
      return e.what();
    }
    return "written";
  };
  const std::string front = "write_ply: " + file.path.string() + ": ";
  auto s = random_surfels<float>(3, 0, 9, 9, 1);
  CHECK(text(s, {"two\nlines"}) == front + "comment 'two\\nlines' has more than one line");
  s.means.mutable_value()[5] = std::numeric_limits<float>::quiet_NaN();
  CHECK(text(s, {}) == front + "property z of surfel 1 is nan, expected a finite number");
  s = random_surfels<float>(3, 0, 9, 9, 1);
  s.scales.mutable_value()[4] = 0;
  CHECK(text(s, {}) == front + "property scale_0 of surfel 2 is -inf, expected a finite number");
  s = random_surfels<float>(3, 0, 9, 9, 1);
  s.opacity.mutable_value()[0] = 1.5f;
  CHECK(text(s, {}) == front + "opacity of surfel 0 is 1.500000, expected 0 to 1");
  s.opacity = Var(Tensor({2}));
  CHECK(text(s, {}) == "write_ply: opacity has shape [2], expected [P] with P=3 from means");
  CHECK(!fs::exists(file.path));
}

}  // namespace satsurf::test
