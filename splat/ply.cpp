// SPDX-License-Identifier: Apache-2.0
#include "satsurf/splat/ply.h"

#include "satsurf/core/atomic_file.h"
#include "satsurf/core/dims.h"
#include "satsurf/core/files.h"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <optional>
#include <sstream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace satsurf::splat {
namespace {

static_assert(std::endian::native == std::endian::little);  // numbers are copied as they lie

/// The constant spherical harmonic, to the digits others write.
constexpr double kDegreeZero = 0.28209479;
constexpr double kThickness = 1e-6;      // m; a flat disc for viewers that want three scales
constexpr double kOpacityMargin = 1e-7;  // keeps the logit finite

constexpr std::array<const char*, 17> kNames = {
    "x",       "y",       "z",       "nx",      "ny",    "nz",    "f_dc_0", "f_dc_1", "f_dc_2",
    "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2",  "rot_3"};
enum Property : std::size_t {
  kMean = 0,
  kNormal = 3,
  kColour = 6,
  kOpacity = 9,
  kScale = 10,
  kThird = 12,
  kQuat = 13
};

/// m from the origin, and across; farther out a float has no centimetres.
constexpr float kFarthest = 1e5F;

constexpr std::size_t kMostHeaderLine = 65536;
constexpr std::size_t kMostProperties = 4096;

/// Words of one header line.
std::vector<std::string_view> words(std::string_view line) {
  std::vector<std::string_view> out;
  while (true) {
    const std::size_t begin = line.find_first_not_of(" \t");
    if (begin == std::string_view::npos) return out;
    line.remove_prefix(begin);
    const std::size_t end = std::min(line.find_first_of(" \t"), line.size());
    out.push_back(line.substr(0, end));
    line.remove_prefix(end);
  }
}

class Reader {
 public:
  explicit Reader(const std::filesystem::path& path) : path_(path) {
    require_file(path, "a PLY file");
    in_.open(path, std::ios::binary);
    if (!in_.is_open()) fail("cannot be opened");
  }

  /// How many surfels a file holds that has exactly the properties of `write_ply`.
  std::uintmax_t count_alike() {
    read_header();
    if (!std::equal(properties_.begin(), properties_.end(), kNames.begin(), kNames.end()))
      fail("other properties, expected those that write_ply writes");
    check_size();
    return count_;
  }

  /// The next surfels of such a file as they lie there, of which every number is checked; none at
  /// the end. They live until the next call.
  std::string_view next_rows() {
    constexpr std::uintmax_t kTogether = 1 << 14;  // surfels; some 1 MB
    rows_.resize(std::min(kTogether, count_ - copied_) * kNames.size());
    const std::size_t bytes = rows_.size() * sizeof(float);
    auto* const to = reinterpret_cast<char*>(rows_.data());
    if (!in_.read(to, static_cast<std::streamsize>(bytes)))
      fail("vertex " + std::to_string(copied_) + " cannot be read");
    for (const float* row = rows_.data(); row != rows_.data() + rows_.size(); row += kNames.size())
      check_row(static_cast<Index>(copied_++), row);
    return {to, bytes};
  }

  PlyContent read() {
    read_header();
    std::array<std::optional<std::size_t>, kNames.size()> column;
    for (std::size_t n = 0; n < kNames.size(); ++n) {
      const auto found = std::find(properties_.begin(), properties_.end(), kNames[n]);
      if (found != properties_.end())
        column[n] = static_cast<std::size_t>(found - properties_.begin());
      const bool optional = n == kThird || (n >= kNormal && n < kColour);
      if (!column[n] && !optional)
        fail(std::string("property ") + kNames[n] + " is missing, expected all of a splat's");
    }
    check_size();
    const auto P = static_cast<Index>(count_);
    Tensor means({P, 3}), quats({P, 4}), scales({P, 2}), opacity({P}), colours({P, 3});
    std::vector<float> row(properties_.size());
    for (Index p = 0; p < P; ++p) {
      if (!in_.read(reinterpret_cast<char*>(row.data()),
                    static_cast<std::streamsize>(row.size() * sizeof(float))))
        fail("vertex " + std::to_string(p) + " cannot be read");
      const auto value = [&](std::size_t property) {
        const double v = row[*column[property]];
        check_finite(p, property, v);
        return v;
      };
      const auto fill = [&](Tensor& t, Index n, std::size_t first, auto&& meaning) {
        for (Index i = 0; i < n; ++i) t[p * n + i] = static_cast<float>(meaning(value(first + i)));
      };
      fill(means, 3, kMean, [](double v) { return v; });
      fill(quats, 4, kQuat, [](double v) { return v; });
      fill(scales, 2, kScale, [](double v) { return std::exp(v); });
      check(p, means.data() + 3 * p, quats.data() + 4 * p, scales.data() + 2 * p);
      fill(opacity, 1, kOpacity, [](double v) { return 1 / (1 + std::exp(-v)); });
      fill(colours, 3, kColour, [](double v) { return 0.5 + kDegreeZero * v; });
    }
    return {{Var(means), Var(quats), Var(scales), Var(opacity), Var(colours), {}}, comments_};
  }

 private:
  [[noreturn]] void fail(const std::string& what) const {
    throw IoError("read_ply: " + path_.string() + ": " + what);
  }

  /// throws  IoError unless the file goes on for as long as the header says
  void check_size() {
    const auto at = static_cast<std::uintmax_t>(in_.tellg());
    const std::uintmax_t want = count_ * properties_.size() * sizeof(float);
    std::error_code error;
    const std::uintmax_t size = std::filesystem::file_size(path_, error);
    if (error) fail("its size is unknown: " + error.message());
    if (size < at || size - at != want)
      fail(std::to_string(size - at) + " bytes behind the header, expected " +
           std::to_string(want) + " for " + std::to_string(count_) + " vertices of " +
           std::to_string(properties_.size()) + " floats");
  }

  void check_finite(Index p, std::size_t property, double v) const {
    if (!std::isfinite(v))
      fail(std::string("property ") + kNames[property] + " of vertex " + std::to_string(p) +
           " is " + std::to_string(v) + ", expected a finite number");
  }

  /// Refuses a row of all properties that `read` would refuse.
  void check_row(Index p, const float* row) const {
    for (std::size_t n = 0; n < kNames.size(); ++n) check_finite(p, n, static_cast<double>(row[n]));
    const auto scale = [&](std::size_t n) {
      return static_cast<float>(std::exp(static_cast<double>(row[kScale + n])));
    };
    check(p, row + kMean, row + kQuat, std::array{scale(0), scale(1)}.data());
  }

  /// Refuses what can be written down but is no surfel.
  void check(Index p, const float* mean, const float* quat, const float* scale) const {
    const auto refuse = [&](const char* what, double came, const char* expected) {
      std::ostringstream text;
      text << what << " of vertex " << p << " is " << came << ", expected " << expected;
      fail(text.str());
    };
    for (int i = 0; i < 3; ++i)
      if (!(std::abs(mean[i]) <= kFarthest))
        refuse("a coordinate", mean[i],
               "at most 100000 m either way: relative to an origin near the scene");
    double square = 0;
    for (int i = 0; i < 4; ++i) square += static_cast<double>(quat[i]) * quat[i];
    if (!(square > 1e-12 && square < 1e12))
      refuse("the length of the quaternion", std::sqrt(square), "a rotation");
    for (int i = 0; i < 2; ++i)
      if (!(scale[i] >= std::numeric_limits<float>::min() && scale[i] <= kFarthest))
        refuse("a scale", scale[i], "one above 0 and at most 100000 m");
  }

  std::string line() {
    std::string text;
    for (char c; in_.get(c);) {
      if (c == '\n') {
        if (!text.empty() && text.back() == '\r') text.pop_back();
        return text;
      }
      text += c;
      if (text.size() > kMostHeaderLine) break;
    }
    fail("the header does not end; is this a PLY file?");
  }

  void read_header() {
    if (line() != "ply") fail("does not begin with 'ply'");
    if (const std::string format = line(); format != "format binary_little_endian 1.0")
      fail("'" + format.substr(0, 60) + "', expected 'format binary_little_endian 1.0'");
    bool has_vertices = false;
    while (true) {
      const std::string text = line();
      const auto word = words(text);
      if (word.empty()) fail("empty line in the header");
      if (word[0] == "end_header") break;
      if (word[0] == "comment") {
        comments_.push_back(text.substr(std::min<std::size_t>(text.size(), 8)));
      } else if (word[0] == "obj_info") {
        continue;
      } else if (word[0] == "element" && word.size() == 3 && word[1] == "vertex" && !has_vertices) {
        const auto [end, error] =
            std::from_chars(word[2].data(), word[2].data() + word[2].size(), count_);
        // 2^31 vertices are the most the rasteriser draws; this also keeps the products below from
        // overflowing.
        if (error != std::errc() || end != word[2].data() + word[2].size() || count_ > 0x7fffffff)
          fail("'" + text + "', expected a number of vertices below 2^31");
        has_vertices = true;
      } else if (word[0] == "property" && has_vertices && word.size() == 3 &&
                 (word[1] == "float" || word[1] == "float32")) {
        if (std::find(properties_.begin(), properties_.end(), word[2]) != properties_.end())
          fail("property " + std::string(word[2]) + " comes twice");
        if (properties_.size() >= kMostProperties)
          fail("more than " + std::to_string(kMostProperties) + " properties");
        properties_.emplace_back(word[2]);
      } else {
        fail("'" + text.substr(0, 60) +
             "', expected surfels, one vertex element of float properties");
      }
    }
    if (!has_vertices) fail("no vertex element");
  }

  std::filesystem::path path_;
  std::ifstream in_;
  std::vector<std::string> comments_, properties_;
  std::uintmax_t count_ = 0, copied_ = 0;
  std::vector<float> rows_;
};

/// The header of a file.
std::string header_of(const std::filesystem::path& path, std::uintmax_t count,
                      const std::vector<std::string>& comments, bool two_scales) {
  std::string bytes = "ply\nformat binary_little_endian 1.0\n";
  for (const std::string& c : comments) {
    if (c.find_first_of("\r\n") != std::string::npos)
      throw IoError("write_ply: " + path.string() + ": comment '" + c + "' has more than one line");
    bytes += "comment " + c + "\n";
  }
  bytes += "element vertex " + std::to_string(count) + "\n";
  for (std::size_t n = 0; n < kNames.size(); ++n)
    if (n != kThird || !two_scales) bytes += std::string("property float ") + kNames[n] + "\n";
  return bytes + "end_header\n";
}

}  // namespace

void write_ply(const std::filesystem::path& path, const Surfels& surfels,
               const std::vector<std::string>& comments, bool two_scales) {
  const auto fail = [&](const std::string& what) {
    throw IoError("write_ply: " + path.string() + ": " + what);
  };
  for (const Var* v :
       {&surfels.means, &surfels.quats, &surfels.scales, &surfels.opacity, &surfels.colours})
    if (v->empty())
      throw ShapeError("write_ply: a tensor of the surfels is missing, expected all but aux");
  Dims dim("write_ply");
  dim.match("means", surfels.means, "P 3")
      .match("quats", surfels.quats, "P 4")
      .match("scales", surfels.scales, "P 2")
      .match("opacity", surfels.opacity, "P")
      .match("colours", surfels.colours, "P 3");
  const Index P = dim["P"];
  const auto written = [&](std::size_t n) { return n != kThird || !two_scales; };

  std::array<float, kNames.size()> row{};
  const auto append = [&](Index p, std::string& bytes) {
    const auto at = [&](const Var& v, Index n, Index i) -> double { return v.value()[p * n + i]; };
    const auto put = [&](std::size_t property, double v) {
      if (!std::isfinite(v))
        fail(std::string("property ") + kNames[property] + " of surfel " + std::to_string(p) +
             " is " + std::to_string(v) + ", expected a finite number");
      row[property] = static_cast<float>(v);
    };
    double q[4], square = 0;
    for (Index i = 0; i < 4; ++i) q[i] = at(surfels.quats, 4, i), square += q[i] * q[i];
    for (std::size_t i = 0; i < 4; ++i) put(kQuat + i, q[i] /= std::sqrt(square));
    // a disc is the same from both sides; what is outside of a surface seen from above is up
    const double up = 1 - 2 * (q[1] * q[1] + q[2] * q[2]), outwards = up < 0 ? -1 : 1;
    put(kNormal, outwards * 2 * (q[1] * q[3] + q[0] * q[2]));
    put(kNormal + 1, outwards * 2 * (q[2] * q[3] - q[0] * q[1]));
    put(kNormal + 2, outwards * up);
    for (std::size_t i = 0; i < 3; ++i) {
      put(kMean + i, at(surfels.means, 3, i));
      put(kColour + i, (at(surfels.colours, 3, i) - 0.5) / kDegreeZero);
    }
    for (std::size_t i = 0; i < 2; ++i) put(kScale + i, std::log(at(surfels.scales, 2, i)));
    put(kThird, std::log(kThickness));
    const double o = at(surfels.opacity, 1, 0);
    if (!(o >= 0 && o <= 1))
      fail("opacity of surfel " + std::to_string(p) + " is " + std::to_string(o) +
           ", expected 0 to 1");
    const double inner = std::clamp(o, kOpacityMargin, 1 - kOpacityMargin);
    put(kOpacity, std::log(inner / (1 - inner)));
    for (std::size_t n = 0; n < row.size(); ++n)
      if (written(n)) bytes.append(reinterpret_cast<const char*>(&row[n]), sizeof(float));
  };
  constexpr Index kTogether = 1 << 16;  // surfels written together, some 4 MB
  std::string bytes = header_of(path, static_cast<std::uintmax_t>(P), comments, two_scales);
  bool begun = false;
  Index p = 0;
  atomic_write(path, [&]() -> std::string_view {
    if (std::exchange(begun, true)) bytes.clear();
    for (const Index end = std::min(P, p + kTogether); p < end; ++p) append(p, bytes);
    return bytes;
  });
}

std::vector<Index> join_ply(const std::filesystem::path& path,
                            const std::vector<std::filesystem::path>& parts,
                            const std::vector<std::string>& comments) {
  std::vector<Index> counts;
  std::uintmax_t all = 0;
  for (const std::filesystem::path& part : parts) {
    const std::uintmax_t count = Reader(part).count_alike();
    counts.push_back(static_cast<Index>(count)), all += count;
  }
  const std::string header = header_of(path, all, comments, false);
  bool begun = false;
  std::size_t next = 0;
  std::optional<Reader> reader;  // one at a time: there may be more than files that may be open
  atomic_write(path, [&]() -> std::string_view {
    if (!std::exchange(begun, true)) return header;
    while (true) {
      if (reader)
        if (const std::string_view rows = reader->next_rows(); !rows.empty()) return rows;
      if (next == parts.size()) return {};
      reader.emplace(parts[next++]).count_alike();
    }
  });
  return counts;
}

PlyContent read_ply(const std::filesystem::path& path) { return Reader(path).read(); }

}  // namespace satsurf::splat
