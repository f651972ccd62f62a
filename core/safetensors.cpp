// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/safetensors.h"

#include "satsurf/core/atomic_file.h"
#include "satsurf/core/error.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/core/files.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <string_view>
#include <vector>

namespace satsurf {
namespace {

using nlohmann::json;

// The format is little endian and elements are copied as they lie in memory.
static_assert(std::endian::native == std::endian::little);

constexpr std::uint64_t kLengthBytes = 8;
constexpr std::uint64_t kMostHeader = 100'000'000;  // the format's own limit
constexpr const char* kDamaged = "; incomplete download or corrupt file?";

__extension__ using Half = _Float16;

/// The types of elements that are read, and what the format calls them.
enum class Type { f16, f32, f64 };
constexpr std::array<std::string_view, 3> kTypeNames{"F16", "F32", "F64"};
constexpr std::array<std::uint64_t, 3> kTypeBytes{2, 4, 8};

struct Entry {
  std::string name;
  Type type = Type::f32;
  Shape shape;
  std::uint64_t begin = 0, end = 0;  // bytes after the header
};

/// One line of complaint about one file.
class Reader {
 public:
  explicit Reader(const std::filesystem::path& path) : path_(path) {
    require_file(path, "a safetensors file");  // opening a pipe waits
    in_.open(path, std::ios::binary);
  }

  TensorFile load();

 private:
  [[noreturn]] void fail(const std::string& text) const {
    throw IoError(path_.string() + ": " + text);
  }
  json read_header();
  void read_metadata(const json& object, TensorFile& file) const;
  Entry read_entry(const std::string& name, const json& object) const;
  std::uint64_t read_unsigned(const json& value, const std::string& what) const;
  void check_layout(std::vector<Entry>& entries) const;
  void read_bytes(const Entry& entry, void* to);
  template <class T>
  BasicTensor<T> read_tensor(const Entry& entry);

  std::filesystem::path path_;
  std::ifstream in_;
  std::uint64_t data_begin_ = 0, data_bytes_ = 0;
};

json Reader::read_header() {
  if (!in_.is_open()) fail("cannot be read, expected a safetensors file");
  const std::uint64_t bytes = std::filesystem::file_size(path_);
  if (bytes < kLengthBytes)
    fail("the file has " + std::to_string(bytes) + " bytes, expected at least 8" + kDamaged);

  std::uint64_t length = 0;
  in_.read(reinterpret_cast<char*>(&length), kLengthBytes);
  if (length > kMostHeader)
    fail("the header claims " + std::to_string(length) + " bytes, expected at most " +
         std::to_string(kMostHeader) + "; not a safetensors file?");
  if (length > bytes - kLengthBytes)
    fail("the header claims " + std::to_string(length) + " bytes, expected at most the " +
         std::to_string(bytes - kLengthBytes) + " that follow" + kDamaged);
  data_begin_ = kLengthBytes + length;
  data_bytes_ = bytes - data_begin_;

  std::string text(length, '\0');
  in_.read(text.data(), static_cast<std::streamsize>(length));
  if (!in_) fail(std::string("the header cannot be read") + kDamaged);
  if (!text.starts_with('{'))
    fail("the header begins otherwise, expected '{'; not a safetensors file?");
  json header = parse_json(text, path_.string() + ": header");
  if (!header.is_object()) fail("the header is " + header.dump() + ", expected a JSON object");
  return header;
}

void Reader::read_metadata(const json& object, TensorFile& file) const {
  if (!object.is_object()) fail("__metadata__ is " + object.dump() + ", expected an object");
  for (const auto& [key, value] : object.items()) {
    if (!value.is_string())
      fail("__metadata__ entry '" + key + "' is " + value.dump() + ", expected a string");
    file.metadata[key] = value.get<std::string>();
  }
}

std::uint64_t Reader::read_unsigned(const json& value, const std::string& what) const {
  if (!value.is_number_unsigned())
    fail(what + " is " + value.dump() + ", expected a whole number of at least 0");
  return value.get<std::uint64_t>();
}

Entry Reader::read_entry(const std::string& name, const json& object) const {
  const std::string what = "tensor '" + name + "'";
  if (!object.is_object()) fail(what + " is " + object.dump() + ", expected an object");
  for (const char* key : {"dtype", "shape", "data_offsets"})
    if (!object.contains(key))
      fail(what + " has no " + key + ", expected dtype, shape and data_offsets");
  for (const auto& [key, value] : object.items())
    if (key != "dtype" && key != "shape" && key != "data_offsets")
      fail(what + " has the key '" + key + "', expected dtype, shape and data_offsets");

  Entry e;
  e.name = name;
  const json &dtype = object["dtype"], &shape = object["shape"], &offsets = object["data_offsets"];
  const auto known = dtype.is_string() ? std::ranges::find(kTypeNames, dtype.get<std::string>())
                                       : kTypeNames.end();
  if (known == kTypeNames.end())
    fail(what + " has dtype " + dtype.dump() + ", expected \"F16\", \"F32\" or \"F64\"");
  e.type = static_cast<Type>(known - kTypeNames.begin());

  if (!shape.is_array() || shape.size() > static_cast<std::size_t>(Shape::kMaxRank))
    fail(what + " has shape " + shape.dump() + ", expected a list of at most 5 extents");
  std::vector<Index> extents;
  std::uint64_t wanted = kTypeBytes[static_cast<std::size_t>(e.type)];
  bool overflow = false;
  for (const json& value : shape) {
    const std::uint64_t extent =
        read_unsigned(value, what + ": extent " + std::to_string(extents.size()));
    overflow = overflow || extent > static_cast<std::uint64_t>(std::numeric_limits<Index>::max()) ||
               __builtin_mul_overflow(wanted, extent, &wanted);
    extents.push_back(overflow ? 0 : static_cast<Index>(extent));
  }
  try {
    if (!overflow) e.shape = Shape(extents);
  } catch (const ShapeError&) {  // its own limit is lower, and extents of 0 hide nothing from it
    overflow = true;
  }
  if (overflow)
    fail(what + " has shape " + shape.dump() + ", expected no more than a file can hold");

  if (!offsets.is_array() || offsets.size() != 2)
    fail(what + " has data_offsets " + offsets.dump() + ", expected [begin,end]");
  e.begin = read_unsigned(offsets[0], what + ": data_offsets[0]");
  e.end = read_unsigned(offsets[1], what + ": data_offsets[1]");
  if (e.begin > e.end || e.end > data_bytes_)
    fail(what + " has data_offsets " + offsets.dump() + ", expected a range within the " +
         std::to_string(data_bytes_) + " bytes after the header" + kDamaged);
  if (e.end - e.begin != wanted)
    fail(what + " has " + std::to_string(e.end - e.begin) + " bytes, expected " +
         std::to_string(wanted) + " for shape " + shape.dump() + " of " + dtype.get<std::string>());
  return e;
}

/// The tensors must tile the rest of the file: no gap, no overlap, nothing behind the last one.
void Reader::check_layout(std::vector<Entry>& entries) const {
  std::ranges::sort(entries, {}, [](const Entry& e) { return std::pair(e.begin, e.end); });
  std::uint64_t at = 0;
  for (const Entry& e : entries) {
    if (e.begin != at)
      fail("tensor '" + e.name + "' begins at byte " + std::to_string(e.begin) +
           " of the data, expected " + std::to_string(at) +
           (e.begin > at ? " (a gap)" : " (an overlap)"));
    at = e.end;
  }
  if (at != data_bytes_)
    fail(std::to_string(data_bytes_) + " bytes follow the header, expected the " +
         std::to_string(at) + " of its tensors" + kDamaged);
}

void Reader::read_bytes(const Entry& entry, void* to) {
  in_.seekg(static_cast<std::streamoff>(data_begin_ + entry.begin));
  in_.read(static_cast<char*>(to), static_cast<std::streamsize>(entry.end - entry.begin));
  if (!in_) fail("tensor '" + entry.name + "' cannot be read" + kDamaged);
}

template <class T>
BasicTensor<T> Reader::read_tensor(const Entry& entry) {
  auto t = BasicTensor<T>::uninitialised(entry.shape);
  if (entry.type == Type::f16) {
    std::vector<Half> halves(static_cast<std::size_t>(t.count()));
    read_bytes(entry, halves.data());
    std::ranges::transform(halves, t.data(), [](Half h) { return static_cast<T>(h); });
  } else {
    read_bytes(entry, t.data());
  }
  return t;
}

TensorFile Reader::load() {
  const json header = read_header();
  TensorFile file;
  std::vector<Entry> entries;
  for (const auto& [name, value] : header.items()) {
    if (name == "__metadata__")
      read_metadata(value, file);
    else
      entries.push_back(read_entry(name, value));
  }
  check_layout(entries);
  for (const Entry& e : entries) {
    if (e.type == Type::f64)
      file.doubles[e.name] = read_tensor<double>(e);
    else
      file.tensors[e.name] = read_tensor<float>(e);
  }
  return file;
}

}  // namespace

TensorFile load_safetensors(const std::filesystem::path& path) { return Reader(path).load(); }

void save_safetensors(const std::filesystem::path& path, const TensorFile& file) {
  nlohmann::ordered_json header = nlohmann::ordered_json::object();
  if (!file.metadata.empty()) header["__metadata__"] = file.metadata;

  // One list sorted by name, as the header and the data are.
  std::map<std::string_view, std::pair<const char*, Shape>> sorted;
  std::map<std::string_view, std::string_view> bytes;
  const auto add = [&](const auto& tensors, const char* dtype) {
    for (const auto& [name, tensor] : tensors) {
      if (tensor.empty() || name == "__metadata__" ||
          !sorted.try_emplace(name, dtype, tensor.shape()).second)
        throw IoError(path.string() + ": tensor '" + name + "' " +
                      (tensor.empty()           ? "is empty, expected a value"
                       : name == "__metadata__" ? "has the name the format reserves"
                                                : "is there in float and in double, expected one"));
      bytes[name] = {reinterpret_cast<const char*>(tensor.data()),
                     static_cast<std::size_t>(tensor.count()) * sizeof(*tensor.data())};
    }
  };
  std::map<std::string, std::vector<Half>> halves;  // what `bytes` points to
  add(file.tensors, file.half ? "F16" : "F32");
  if (file.half)
    for (const auto& [name, tensor] : file.tensors) {
      std::vector<Half>& rounded = halves[name];
      for (const float v : tensor.values()) {
        rounded.push_back(static_cast<Half>(v));
        if (std::isfinite(v) && !std::isfinite(static_cast<float>(rounded.back())))
          throw IoError(path.string() + ": tensor '" + name + "' holds " + std::to_string(v) +
                        ", expected at most 65504 in half precision");
      }
      bytes[name] = {reinterpret_cast<const char*>(rounded.data()), rounded.size() * sizeof(Half)};
    }
  add(file.doubles, "F64");

  std::uint64_t at = 0;
  std::vector<std::string_view> pieces(2);
  for (const auto& [name, entry] : sorted) {
    const auto& [dtype, shape] = entry;
    const std::string_view data = bytes[name];
    nlohmann::ordered_json extents = nlohmann::ordered_json::array();
    for (const Index e : shape.extents()) extents.push_back(static_cast<std::uint64_t>(e));
    header[std::string(name)] = {
        {"dtype", dtype}, {"shape", extents}, {"data_offsets", {at, at + data.size()}}};
    at += data.size();
    pieces.push_back(data);
  }
  std::string text;
  try {
    text = header.dump();
  } catch (const json::exception&) {
    throw IoError(path.string() + ": a name or the metadata is something else, expected UTF-8");
  }
  text.resize((text.size() + 7) / 8 * 8, ' ');  // the data begin on a multiple of 8
  const std::uint64_t length = text.size();
  if (length > kMostHeader)
    throw IoError(path.string() + ": the header has " + std::to_string(length) +
                  " bytes, expected at most " + std::to_string(kMostHeader));
  pieces[0] = {reinterpret_cast<const char*>(&length), kLengthBytes};
  pieces[1] = text;
  atomic_write(path, pieces);
}

}  // namespace satsurf
