// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/parallel.h"
#include "satsurf/scene/dataset.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/scene/whu.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "tests/made_view.h"
#include "tests/ref/rpc_dialects.h"
#include "tests/temp_folder.h"
#include <doctest/doctest.h>
#include <gdal_priv.h>

using namespace satsurf;
using namespace satsurf::test;
using namespace satsurf::scene;

namespace {

namespace fs = std::filesystem;

struct Close {
  void operator()(GDALDataset* d) const { GDALClose(d); }
};

/// A grey image as a PNG of 16 bits.
void write_png(const fs::path& path, Index height, Index width, std::vector<std::uint16_t> values) {
  GDALAllRegister();
  const int H = static_cast<int>(height), W = static_cast<int>(width);
  GDALDriverManager& drivers = *GetGDALDriverManager();
  const std::unique_ptr<GDALDataset, Close> raw(
      drivers.GetDriverByName("MEM")->Create("", W, H, 1, GDT_UInt16, nullptr));
  REQUIRE(raw);
  REQUIRE(raw->GetRasterBand(1)->RasterIO(GF_Write, 0, 0, W, H, values.data(), W, H, GDT_UInt16, 0,
                                          0, nullptr) == CE_None);
  const std::unique_ptr<GDALDataset, Close> png(drivers.GetDriverByName("PNG")->CreateCopy(
      path.c_str(), raw.get(), FALSE, nullptr, nullptr, nullptr));
  REQUIRE(png);
}

/// What a PFM file holds behind its header.
std::string pfm_values(const Tensor& heights, bool little) {
  const Index H = heights.dim(0), W = heights.dim(1);
  std::string bytes;
  for (Index y = H - 1; y >= 0; --y)
    for (Index x = 0; x < W; ++x) {
      const auto b = std::bit_cast<std::uint32_t>(heights[y * W + x]);
      for (int k = 0; k < 4; ++k) bytes += static_cast<char>(b >> 8 * (little ? k : 3 - k) & 0xff);
    }
  return bytes;
}

std::string pfm(const Tensor& heights, bool little = true) {
  return "Pf\n" + std::to_string(heights.dim(1)) + " " + std::to_string(heights.dim(0)) +
         (little ? "\n-1.000000\n" : "\n1.000000\n") + pfm_values(heights, little);
}

/// Files of one view of "place", without heights where there are none.
void write_view(const fs::path& folder, int number, const rpc::Rpc& camera, Index height,
                Index width, std::vector<std::uint16_t> values, const Tensor& heights = {}) {
  const std::string view = std::to_string(number);
  for (const char* kind : {"image", "rpc", "height"}) fs::create_directories(folder / kind / view);
  write_png(folder / "image" / view / "place.png", height, width, std::move(values));
  write_bytes(folder / "rpc" / view / "place.rpc", dialects::as_whu(camera));
  if (!heights.empty()) write_bytes(folder / "height" / view / "place.pfm", pfm(heights));
}

/// A plane as a view of `view_from` shows it: 20 m in the middle of the ground, and so many metres
/// more for a metre to the east and to the north.
struct Plane {
  double east, north;

  static constexpr double kPixel = 0.5;  // m
  double at(const rpc::Geodetic& p) const {
    return 20 + east * 109640 * (p.lon - 21) + north * 110575 * (p.lat - 10);
  }
  /// The heights of the pixels: a pixel shows x = to the east + west z, z = height - 20.
  Tensor seen(double west) const {
    Tensor heights({100, 100});
    for (Index i = 0; i < 100; ++i)
      for (Index j = 0; j < 100; ++j) {
        const double x = (static_cast<double>(j) - 49.5) * kPixel,
                     y = (49.5 - static_cast<double>(i)) * kPixel;
        heights[i * 100 + j] = static_cast<float>(20 + (east * x + north * y) / (1 + east * west));
      }
    return heights;
  }
};
constexpr Plane kSlope{0.2, 0.1};

const std::vector<std::uint16_t>& stripes() {
  static const std::vector<std::uint16_t> values = [] {
    std::vector<std::uint16_t> v(100 * 100);
    for (std::size_t i = 0; i < v.size(); ++i) v[i] = static_cast<std::uint16_t>(300 + i % 997);
    return v;
  }();
  return values;
}

/// Two views, west of which the camera stands; `heights` of the first.
void write_pair(const fs::path& folder, double west, const Tensor& heights) {
  write_view(folder, 0, view_from("a", west).rpc, 100, 100, stripes(), heights);
  write_view(folder, 1, view_from("b", -0.4).rpc, 100, 100, stripes());
}

Index known(const Tensor& z) {
  return std::count_if(z.values().begin(), z.values().end(),
                       [](float v) { return std::isfinite(v); });
}

}  // namespace

TEST_CASE("a simulated place comes back from a WHU-TLC folder") {
  const TempFolder folder("whu-1");
  SimulateConfig config;
  config.pixels = 128, config.views = 3, config.gsd = 0.5;
  config.kinds = {SceneKind::village};
  const SimulatedScene made = simulate_scene(config, 3, 0);
  std::vector<std::vector<std::uint16_t>> grey;
  for (std::size_t v = 0; v < 3; ++v) {
    const SimulatedView& view = made.views[v];
    Tensor heights = view.height.clone();
    for (float& h : heights.values()) h += static_cast<float>(made.frame.h0);
    grey.emplace_back();
    for (Index p = 0; p < 128 * 128; ++p)
      grey.back().push_back(static_cast<std::uint16_t>(200 + std::lround(1800 * view.rgb[p])));
    write_view(folder.path(), static_cast<int>(v), view.rpc, 128, 128, grey.back(), heights);
  }
  CHECK(list_scenes(folder.path()) == std::vector<std::string>{"place"});
  const Scene scene = load_scene(folder.path(), "place");

  REQUIRE(scene.views.size() == 3);
  for (std::size_t v = 0; v < 3; ++v) {
    const View& view = scene.views[v];
    const std::string number = std::to_string(v);
    CHECK(view.name == "place_" + number);
    CHECK(view.file == folder.path() / "image" / number / "place.png");
    CHECK(std::count(view.files.begin(), view.files.end(),
                     folder.path() / "rpc" / number / "place.rpc") == 1);
    CHECK(view.dtype == "uint16");
    CHECK(view.bands == 1);
    REQUIRE(view.rgb.shape() == Shape{3, 128, 128});
    const float low = view.colours.low, high = view.colours.high;
    for (Index p = 0; p < 128 * 128; ++p)
      REQUIRE(view.rgb[p] ==
              doctest::Approx(std::clamp(
                  (static_cast<float>(grey[v][static_cast<std::size_t>(p)]) - low) / (high - low),
                  0.0F, 1.0F)));
    const rpc::Geodetic g = made.frame.geodetic_from_local({3, -4, 1});
    const rpc::Pixel a = view.rpc.project(g), b = made.views[v].rpc.project(g);
    CHECK(std::hypot(a.x - b.x, a.y - b.y) < 1e-6);
  }

  const auto steepest = std::min_element(
      made.views.begin(), made.views.end(),
      [](const auto& a, const auto& b) { return a.off_nadir_deg < b.off_nadir_deg; });
  CHECK(scene.truth_file ==
        folder.path() / "height" / std::to_string(steepest - made.views.begin()) / "place.pfm");
  REQUIRE(scene.truth);
  const HeightField &truth = *scene.truth, &dsm = made.dsm;
  CHECK(truth.step == doctest::Approx(0.5).epsilon(0.15));
  CHECK(scene.frame.zone == made.frame.zone);
  // the heights of the truth, and 5 m more either way
  const rpc::HeightRange range = scene.frame.heights_from_z(scene.z_range);
  CHECK(range.low > made.h_min - 5.1);
  CHECK(range.high < made.h_max + 5.1);
  CHECK(range.span() > 10);

  // Against the surface that the heights are of: open ground, and what is near anything else.
  const Index H = dsm.z.dim(0), W = dsm.z.dim(1);
  std::vector<double> open;
  Index cells = 0, between = 0;
  for (Index i = 0; i < truth.z.dim(0); ++i)
    for (Index j = 0; j < truth.z.dim(1); ++j) {
      if (!std::isfinite(truth.z[i * truth.z.dim(1) + j])) continue;
      const double east = truth.x0 + (static_cast<double>(j) + 0.5) * truth.step +
                          scene.frame.easting0 - made.frame.easting0,
                   north = truth.y0 - (static_cast<double>(i) + 0.5) * truth.step +
                           scene.frame.northing0 - made.frame.northing0,
                   z = static_cast<double>(truth.z[i * truth.z.dim(1) + j]) + scene.frame.h0 -
                       made.frame.h0;
      const auto row = static_cast<Index>(std::floor((dsm.y0 - north) / dsm.step)),
                 col = static_cast<Index>(std::floor((east - dsm.x0) / dsm.step));
      if (row < 2 || col < 2 || row + 2 >= H || col + 2 >= W) continue;
      double low = INFINITY, high = -INFINITY;
      for (Index y = row - 2; y <= row + 2; ++y)
        for (Index x = col - 2; x <= col + 2; ++x) {
          low = std::min(low, static_cast<double>(dsm.z[y * W + x]));
          high = std::max(high, static_cast<double>(dsm.z[y * W + x]));
        }
      cells += 1, between += z > low - 0.05 && z < high + 0.05 ? 1 : 0;
      if (made.classes[row * W + col] == 2 && high - low < 0.3)
        open.push_back(std::abs(z - static_cast<double>(dsm.z[row * W + col])));
    }
  REQUIRE(open.size() > 4000);
  std::sort(open.begin(), open.end());
  MESSAGE("of " << cells << " cells " << between << " within the heights about them; open ground, "
                << open.size() << ": median " << open[open.size() / 2] << " m, 95 % "
                << open[open.size() * 95 / 100] << " m");
  CHECK(cells > 128 * 128 * 7 / 10);
  CHECK(static_cast<double>(between) > 0.995 * static_cast<double>(cells));
  CHECK(open[open.size() / 2] < 0.02);
  CHECK(open[open.size() * 95 / 100] < 0.08);
}

TEST_CASE("the truth of a sloping plane is the plane, whatever the byte order and the threads") {
  const TempFolder folder("whu-2");
  for (const double west : {0.0, 0.35}) {
    CAPTURE(west);
    const Tensor heights = kSlope.seen(west);
    write_pair(folder.path(), west, heights);
    const Scene scene = load_scene(folder.path(), "place");
    REQUIRE(scene.truth);
    const HeightField& truth = *scene.truth;
    CHECK(truth.step == doctest::Approx(0.5).epsilon(0.06));  // across a slanting ray a bit less
    const Index H = truth.z.dim(0), W = truth.z.dim(1);
    double worst = 0;
    for (Index i = 0; i < H; ++i)
      for (Index j = 0; j < W; ++j)
        if (const float z = truth.z[i * W + j]; std::isfinite(z)) {
          const rpc::Geodetic p = scene.frame.geodetic_from_local(
              {truth.x0 + (static_cast<double>(j) + 0.5) * truth.step,
               truth.y0 - (static_cast<double>(i) + 0.5) * truth.step, static_cast<double>(z)});
          worst = std::max(worst, std::abs(kSlope.at(p) - p.h));
        }
    CHECK(worst < 0.005);  // half a pixel to the east would be 0.05
    const double area = static_cast<double>(known(truth.z)) * truth.step * truth.step;
    // of the ground between the middles of the outer pixels, which a slope seen aslant makes smaller
    CHECK(area == doctest::Approx(49.5 * 49.5 / (1 + kSlope.east * west)).epsilon(0.03));
    // cells lie where reconstructions have theirs
    const double cells = (truth.x0 + scene.frame.easting0) / truth.step;
    CHECK(std::abs(cells - std::round(cells)) < 1e-6);

    const auto same = [&] {
      const Scene other = load_scene(folder.path(), "place");
      REQUIRE(other.truth->z.shape() == truth.z.shape());
      for (Index i = 0; i < truth.z.count(); ++i)
        REQUIRE(std::bit_cast<std::uint32_t>(other.truth->z[i]) ==
                std::bit_cast<std::uint32_t>(truth.z[i]));
    };
    write_bytes(folder / "height/0/place.pfm", pfm(heights, false));
    same();
    set_threads(1);
    same();
    set_threads(0);
  }
}

TEST_CASE("the truth is of the steepest view that comes with heights") {
  const TempFolder folder("whu-3");
  write_view(folder.path(), 0, view_from("a", 0.3).rpc, 100, 100, stripes());
  write_view(folder.path(), 1, view_from("b", 0.05).rpc, 100, 100, stripes());
  write_view(folder.path(), 2, view_from("c", -0.2).rpc, 100, 100, stripes());
  const auto file = [&](int view) {
    return folder.path() / "height" / std::to_string(view) / "place.pfm";
  };
  const Scene bare = load_scene(folder.path(), "place");
  CHECK_FALSE(bare.truth);
  CHECK(bare.truth_file == file(0));
  CHECK(bare.z_range == rpc::HeightRange{});
  write_bytes(file(0), pfm(kSlope.seen(0.3)));
  CHECK(load_scene(folder.path(), "place").truth_file == file(0));
  write_bytes(file(2), pfm(kSlope.seen(-0.2)));
  CHECK(load_scene(folder.path(), "place").truth_file == file(2));
  write_bytes(file(1), pfm(kSlope.seen(0.05)));
  const Scene scene = load_scene(folder.path(), "place");
  CHECK(scene.truth_file == file(1));
  CHECK(scene.views.size() == 3);
}

TEST_CASE("cells are unknown that touch a pixel of unknown height") {
  const TempFolder folder("whu-4");
  Tensor heights({100, 100}, 30);
  write_pair(folder.path(), 0, heights);
  const Index all = known(load_scene(folder.path(), "place").truth->z);
  for (const float unknown : {std::nanf(""), INFINITY, -999.0F, 221.0F}) {
    CAPTURE(unknown);
    heights[40 * 100 + 60] = unknown;
    write_bytes(folder / "height/0/place.pfm", pfm(heights));
    const Scene scene = load_scene(folder.path(), "place");
    const Tensor& z = scene.truth->z;
    const Index lost = all - known(z);
    CHECK(lost >= 1);
    CHECK(lost <= 9);  // the cells between nine pixels
    for (const float v : z.values())
      if (std::isfinite(v)) REQUIRE(std::abs(v + static_cast<float>(scene.frame.h0) - 30) < 1e-3F);
  }
  // as far beyond the camera's range, -80 to 120 m, as its end is from its middle, heights count
  write_bytes(folder / "height/0/place.pfm", pfm(Tensor({100, 100}, 219)));
  CHECK(load_scene(folder.path(), "place").frame.h0 == 219);
  write_bytes(folder / "height/0/place.pfm", pfm(Tensor({100, 100}, 221)));
  CHECK(error_of<IoError>([&] { load_scene(folder.path(), "place"); }) ==
        (folder / "height/0/place.pfm").string() +
            ": no height within 200 m of its camera's 20 m, expected some");
}

TEST_CASE("ground that the view does not see is unknown, and no height is made up beside it") {
  // A tower of 60 m on columns 30 to 39 of the ground. Seen from the west its wall fills 12 columns,
  // the roof the 10 after them, and the ground on columns 40 to 51 hides behind it.
  const TempFolder folder("whu-5");
  Tensor heights({100, 100}, 20);
  for (Index i = 0; i < 100; ++i)
    for (Index j = 30; j < 52; ++j)
      heights[i * 100 + j] = 20 + 5 * std::min(static_cast<float>(j) - 29.5F, 12.0F);
  write_pair(folder.path(), 0.1, heights);
  const Scene scene = load_scene(folder.path(), "place");
  REQUIRE(scene.truth);
  const HeightField& truth = *scene.truth;
  const Index H = truth.z.dim(0), W = truth.z.dim(1);
  Index ground = 0, roof = 0, hidden = 0, other = 0;
  for (Index i = 0; i < H; ++i)
    for (Index j = 0; j < W; ++j) {
      const float z = truth.z[i * W + j];
      const rpc::Geodetic p = scene.frame.geodetic_from_local(
          {truth.x0 + (static_cast<double>(j) + 0.5) * truth.step,
           truth.y0 - (static_cast<double>(i) + 0.5) * truth.step, 20 - scene.frame.h0});
      const double column = scene.views[0].rpc.project(p).x;
      if (column > 40.5 && column < 50.5) hidden += std::isfinite(z) ? 1 : 0;
      if (!std::isfinite(z)) continue;
      const double h = static_cast<double>(z) + scene.frame.h0;
      const bool inside = column > 29 && column < 40;
      (std::abs(h - 20) < 0.1 && !inside  ? ground
       : std::abs(h - 80) < 0.1 && inside ? roof
                                          : other) += 1;
    }
  MESSAGE("ground " << ground << ", roof " << roof << ", other " << other << ", hidden " << hidden);
  CHECK(ground > 7300);
  CHECK(roof > 800);
  CHECK(hidden == 0);
  CHECK(other < 100);
}

TEST_CASE("folders that are no whole WHU-TLC data sets are refused by name") {
  const TempFolder folder("whu-6");
  const auto listed = [&] { return error_of<IoError>([&] { list_scenes(folder.path()); }); };
  const auto loaded = [&] {
    return error_of<IoError>([&] { load_scene(folder.path(), "place"); });
  };
  const auto at = [&](const char* name) { return (folder / name).string(); };
  CHECK(listed().find("image/0/, rpc/0/ and height/0/ (WHU-TLC)") != std::string::npos);
  fs::create_directories(folder / "image/0");
  const std::string alone =
      at("image") + ": holds the folder 0 alone, expected 0, 1 and so on, one for each view";
  CHECK(listed() == alone);
  CHECK(loaded() == alone);
  fs::create_directories(folder / "image/1");
  CHECK(listed() ==
        folder.path().string() + ": holds no scenes, expected images named image/0/NAME.png");
  write_png(folder / "image/1/place.png", 100, 100, stripes());
  CHECK(list_scenes(folder.path()) == std::vector<std::string>{"place"});
  CHECK(loaded() ==
        at("image/0/place.png") + ": no such file, expected an image of each view of place");
  write_png(folder / "image/0/place.png", 100, 100, stripes());
  CHECK(loaded() ==
        at("image/0/place.png") + ": no camera (RPC), looked for " + at("rpc/0/place.rpc"));
  write_pair(folder.path(), 0, kSlope.seen(0));
  CHECK(loaded() == "no exception");
  fs::remove(folder / "rpc/1/place.rpc");
  CHECK(loaded() ==
        at("image/1/place.png") + ": no camera (RPC), looked for " + at("rpc/1/place.rpc"));
  write_bytes(folder / "rpc/1/place.rpc", "what?");
  CHECK(loaded().starts_with(at("rpc/1/place.rpc") + ": no camera in a known form, expected "));

  rpc::Rpc camera = view_from("b", 0).rpc;
  camera.samp_num[1] = -1;
  write_bytes(folder / "rpc/0/place.rpc", dialects::as_whu(camera));
  write_bytes(folder / "rpc/1/place.rpc", dialects::as_whu(camera));
  CHECK(loaded().starts_with(at("image/0/place.png") + ": view_geometry: "));
  camera = view_from("b", 60).rpc;  // heights of hundreds of metres lie kilometres apart
  write_bytes(folder / "rpc/0/place.rpc", dialects::as_whu(camera));
  Tensor heights({100, 100}, -150);
  heights[0] = 150;
  write_bytes(folder / "height/0/place.pfm", pfm(heights));
  const std::string spread = loaded();
  CAPTURE(spread);
  CHECK(spread.starts_with(at("image/0/place.png") +
                           ": surface_of_view: an image of 100 x 100 px spread over "));
}

TEST_CASE("damaged PFM files are refused by name") {
  const TempFolder folder("whu-7");
  const fs::path file = folder / "a.pfm";
  const Tensor heights = [] {
    Tensor t({3, 2});
    for (Index i = 0; i < 6; ++i) t[i] = static_cast<float>(i) + 0.5F;
    return t;
  }();
  const auto refusal = [&](const std::string& bytes) {
    write_bytes(file, bytes);
    const std::string text = error_of<IoError>([&] { read_pfm(file, 3, 2); });
    CHECK(text.starts_with(file.string() + ": "));
    return text.substr(std::min(text.size(), file.string().size() + 2));
  };
  const std::string values = pfm_values(heights, true);
  for (const char* header : {"Pf\n2 3\n-1\n", "Pf\r\n2  3 \r\n-0.5 \r\n", "Pf\n2 3\n-1.000000\n"}) {
    CAPTURE(header);
    write_bytes(file, header + values);
    const Tensor read = read_pfm(file, 3, 2);
    REQUIRE(read.shape() == Shape{3, 2});
    CHECK(std::equal(read.values().begin(), read.values().end(), heights.values().begin()));
  }
  write_bytes(file, "Pf\n2 3\n+1.0\n" + pfm_values(heights, false));
  CHECK(read_pfm(file, 3, 2)[5] == 5.5F);

  const std::string one = ", expected 'Pf', a PFM file of one channel";
  CHECK(refusal("") == "its first line is ''" + one);
  CHECK(refusal("PF\n2 3\n-1\n" + values + values + values) == "its first line is 'PF'" + one);
  CHECK(refusal(std::string(1000, 'x')) ==
        "its first line is '" + std::string(40, 'x') + "'" + one);
  for (const char* size :
       {"", "2", "2 ", "2 3 1", "-2 3", "0 3", "2 0", "2.5 3", "2 3x", "99999999999999999999 3"}) {
    std::string said = size;
    CAPTURE(said);
    while (!said.empty() && said.back() == ' ') said.pop_back();
    CHECK(refusal("Pf\n" + std::string(size) + "\n-1\n" + values) ==
          "its second line is '" + said + "', expected width and height");
  }
  for (const char* scale : {"", "0", "-0.0", "nan", "inf", "1e999", "one", "-1 2"})
    CHECK(refusal("Pf\n2 3\n" + std::string(scale) + "\n" + values) ==
          "its third line is '" + std::string(scale) + "', expected a positive or negative number");
  CHECK(refusal("Pf\n3 2\n-1\n" + values) == "3 x 2 px, expected 2 x 3 as its image has");
  CHECK(refusal("Pf\n4000000000 4000000000\n-1\n" + values) ==
        "4000000000 x 4000000000 px, expected 2 x 3 as its image has");
  CHECK(refusal("Pf\n2 3\n-1\n" + values.substr(1)) ==
        "23 bytes behind its header, expected 24 of 2 x 3 px");
  CHECK(refusal("Pf\n2 3\n-1\n" + values + "\n") ==
        "25 bytes behind its header, expected 24 of 2 x 3 px");
  CHECK(refusal("Pf\n2 3\n-1") == "0 bytes behind its header, expected 24 of 2 x 3 px");
  fs::remove(file);
  CHECK(error_of<IoError>([&] { read_pfm(file, 3, 2); }) ==
        file.string() + ": no such file, expected a PFM file of heights");
  fs::create_directories(file);
  CHECK(error_of<IoError>([&] { read_pfm(file, 3, 2); }).starts_with(file.string() + ": "));
}
