// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/atomic_file.h"
#include "satsurf/core/error.h"
#include "satsurf/core/rng.h"
#include "satsurf/core/safetensors.h"

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <string>
#include <vector>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>
#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

using namespace satsurf;
using test::error_of, test::read_bytes, test::write_bytes;

namespace {

TensorFile sample() {
  Rng rng(3);
  TensorFile f;
  f.tensors["net.weight"] = normal_tensor<float>({3, 2, 5}, rng);
  f.tensors["net.bias"] = normal_tensor<float>({3}, rng);
  f.tensors["nothing"] = Tensor({0, 4});
  f.doubles["frame"] = BasicTensor<double>::from({2}, {1.0 / 3, -1e300});
  f.doubles["scalar"] = BasicTensor<double>::scalar(0.1);
  f.metadata = {{"format", "satsurf"}, {"note", "quotes \" and \\ and \u00e9"}};
  return f;
}

std::string with_header(const std::string& header, const std::string& data = "") {
  const std::uint64_t length = header.size();
  std::string bytes(8, '\0');
  std::memcpy(bytes.data(), &length, 8);
  return bytes + header + data;
}

/// The complaint about a file of these bytes, without the file's name.
std::string complaint(const std::string& bytes) {
  static const test::TempFolder folder("safetensors-refusals");
  const auto path = folder / "x.safetensors";
  write_bytes(path, bytes);
  const std::string text = error_of<IoError>([&] { load_safetensors(path); });
  const std::string prefix = path.string() + ": ";
  CHECK_MESSAGE(text.starts_with(prefix), text);
  CHECK(text.find('\n') == std::string::npos);
  return text.starts_with(prefix) ? text.substr(prefix.size()) : text;
}

std::string complaint_about(const std::string& entry, const std::string& data = "12345678") {
  return complaint(with_header("{\"t\":" + entry + "}", data));
}

constexpr const char* kDamaged = "; incomplete download or corrupt file?";

}  // namespace

TEST_CASE("safetensors: what is written comes back, bit for bit") {
  const test::TempFolder folder("safetensors");
  const TensorFile a = sample();
  save_safetensors(folder / "a.safetensors", a);
  const TensorFile b = load_safetensors(folder / "a.safetensors");
  CHECK(b.metadata == a.metadata);
  REQUIRE(b.tensors.size() == a.tensors.size());
  REQUIRE(b.doubles.size() == a.doubles.size());
  const auto same = [](const auto& x, const auto& y) {
    return x.shape() == y.shape() &&
           std::memcmp(x.data(), y.data(), static_cast<std::size_t>(x.count()) * sizeof(x[0])) == 0;
  };
  for (const auto& [name, t] : a.tensors) CHECK(same(t, b.tensors.at(name)));
  for (const auto& [name, t] : a.doubles) CHECK(same(t, b.doubles.at(name)));

  save_safetensors(folder / "b.safetensors", b);
  const std::string bytes = read_bytes(folder / "a.safetensors");
  CHECK(bytes == read_bytes(folder / "b.safetensors"));
  std::uint64_t length = 0;
  std::memcpy(&length, bytes.data(), 8);
  CHECK(length % 8 == 0);
  CHECK(std::distance(std::filesystem::directory_iterator(folder.path()), {}) == 2);
}

TEST_CASE("safetensors: the bytes of a small file") {
  const test::TempFolder folder("safetensors-golden");
  TensorFile f;
  f.tensors["b"] = Tensor::from({2}, {1, -2});
  f.doubles["a"] = BasicTensor<double>::scalar(1);
  f.metadata["k"] = "v";
  save_safetensors(folder / "x", f);
  std::string header =
      R"({"__metadata__":{"k":"v"},"a":{"dtype":"F64","shape":[],"data_offsets":[0,8]},)"
      R"("b":{"dtype":"F32","shape":[2],"data_offsets":[8,16]}})";
  header.resize((header.size() + 7) / 8 * 8, ' ');
  using namespace std::string_literals;
  CHECK(read_bytes(folder / "x") ==
        with_header(header, "\0\0\0\0\0\0\xf0\x3f\0\0\x80\x3f\0\0\0\xc0"s));
}

TEST_CASE("safetensors: half precision is rounded to the nearest, and read as float") {
  const test::TempFolder folder("safetensors-half");
  TensorFile f;
  f.half = true;
  f.tensors["b"] = Tensor::from({6}, {1, -2, 1.0003f, 65504, 1e-9f, 0.1f});
  f.doubles["a"] = BasicTensor<double>::scalar(0.1);
  save_safetensors(folder / "x", f);
  std::string header = R"({"a":{"dtype":"F64","shape":[],"data_offsets":[0,8]},)"
                       R"("b":{"dtype":"F16","shape":[6],"data_offsets":[8,20]}})";
  header.resize((header.size() + 7) / 8 * 8, ' ');
  using namespace std::string_literals;
  CHECK(read_bytes(folder / "x").substr(0, 8 + header.size() + 8 + 6) ==
        with_header(header, "\x9a\x99\x99\x99\x99\x99\xb9\x3f\0\x3c\0\xc0\0\x3c"s));
  const TensorFile back = load_safetensors(folder / "x");
  CHECK(back.doubles.at("a")[0] == 0.1);
  const Tensor& b = back.tensors.at("b");
  const std::vector<float> want{1, -2, 1, 65504, 0, 0.0999755859375f};
  for (Index i = 0; i < 6; ++i) CHECK(b[i] == want[static_cast<std::size_t>(i)]);
  f.tensors["b"] = Tensor::from({1}, {70000});
  CHECK_THROWS_AS(save_safetensors(folder / "y", f), IoError);
  CHECK_FALSE(std::filesystem::exists(folder / "y"));
}

TEST_CASE("safetensors: a file without tensors is a file") {
  const test::TempFolder folder("safetensors-empty");
  save_safetensors(folder / "x", {});
  CHECK(load_safetensors(folder / "x").tensors.empty());
}

TEST_CASE("safetensors: broken headers are refused") {
  CHECK(complaint("1234") == std::string("the file has 4 bytes, expected at least 8") + kDamaged);
  CHECK(complaint("12345678") ==
        "the header claims 4050765991979987505 bytes, expected at most "
        "100000000; not a safetensors file?");
  std::string shorter = with_header("{}   ");
  shorter.pop_back();
  CHECK(complaint(shorter) ==
        std::string("the header claims 5 bytes, expected at most the 4 that follow") + kDamaged);
  CHECK(complaint(with_header(" {}")) ==
        "the header begins otherwise, expected '{'; not a safetensors file?");
  CHECK(complaint(with_header("")) ==
        "the header begins otherwise, expected '{'; not a safetensors file?");
  CHECK(complaint(with_header("{\"a\":")).starts_with("header: line 1, column 6: syntax error"));
  CHECK(complaint(with_header("{} {}")).starts_with("header: line 1, column 4: syntax error"));
  std::string deep = "{\"a\":";
  deep.append(100'000, '[');
  CHECK(complaint(with_header(deep)) == "header: nested deeper than 64 levels");
  CHECK(complaint(with_header("{\"a\":1e999}")).starts_with("header: "));
  CHECK(complaint(with_header("{\"\xff\":1}")).starts_with("header: line 1, column 3: "));
}

TEST_CASE("safetensors: broken metadata is refused") {
  CHECK(complaint(with_header(R"({"__metadata__":3})")) == "__metadata__ is 3, expected an object");
  CHECK(complaint(with_header(R"({"__metadata__":{"a":1}})")) ==
        "__metadata__ entry 'a' is 1, expected a string");
}

TEST_CASE("safetensors: broken entries are refused by name") {
  CHECK(complaint_about("7") == "tensor 't' is 7, expected an object");
  CHECK(complaint_about(R"({"shape":[2],"data_offsets":[0,8]})") ==
        "tensor 't' has no dtype, expected dtype, shape and data_offsets");
  CHECK(complaint_about(R"({"dtype":"F32","data_offsets":[0,8]})") ==
        "tensor 't' has no shape, expected dtype, shape and data_offsets");
  CHECK(complaint_about(R"({"dtype":"F32","shape":[2]})") ==
        "tensor 't' has no data_offsets, expected dtype, shape and data_offsets");
  CHECK(complaint_about(R"({"dtype":"F32","shape":[2],"data_offsets":[0,8],"x":1})") ==
        "tensor 't' has the key 'x', expected dtype, shape and data_offsets");
  CHECK(complaint_about(R"({"dtype":"BF16","shape":[4],"data_offsets":[0,8]})") ==
        R"(tensor 't' has dtype "BF16", expected "F16", "F32" or "F64")");
  CHECK(complaint_about(R"({"dtype":4,"shape":[4],"data_offsets":[0,8]})") ==
        R"(tensor 't' has dtype 4, expected "F16", "F32" or "F64")");
  CHECK(complaint_about(R"({"dtype":"F32","shape":[1,1,1,1,1,2],"data_offsets":[0,8]})") ==
        "tensor 't' has shape [1,1,1,1,1,2], expected a list of at most 5 extents");
  CHECK(complaint_about(R"({"dtype":"F32","shape":2,"data_offsets":[0,8]})") ==
        "tensor 't' has shape 2, expected a list of at most 5 extents");
  CHECK(complaint_about(R"({"dtype":"F32","shape":[1,-2],"data_offsets":[0,8]})") ==
        "tensor 't': extent 1 is -2, expected a whole number of at least 0");
  CHECK(complaint_about(R"({"dtype":"F32","shape":[2.0],"data_offsets":[0,8]})") ==
        "tensor 't': extent 0 is 2.0, expected a whole number of at least 0");
  for (const char* shape :
       {"[4294967296,4294967296]", "[18446744073709551615]", "[4611686018427387906]",
        "[4611686018427387904,0]", "[1152921504606846976]", "[1152921504606846976,0]"}) {
    CHECK(complaint_about(std::string(R"({"dtype":"F32","shape":)") + shape +
                          R"(,"data_offsets":[0,8]})") ==
          std::string("tensor 't' has shape ") + shape + ", expected no more than a file can hold");
  }
  CHECK(complaint_about(R"({"dtype":"F32","shape":[2],"data_offsets":[0]})") ==
        "tensor 't' has data_offsets [0], expected [begin,end]");
  CHECK(complaint_about(R"({"dtype":"F32","shape":[2],"data_offsets":[-8,0]})") ==
        "tensor 't': data_offsets[0] is -8, expected a whole number of at least 0");
  CHECK(complaint_about(R"({"dtype":"F32","shape":[2],"data_offsets":[8,0]})") ==
        std::string("tensor 't' has data_offsets [8,0], expected a range within the 8 bytes after "
                    "the header") +
            kDamaged);
  CHECK(complaint_about(R"({"dtype":"F32","shape":[3],"data_offsets":[0,12]})") ==
        std::string("tensor 't' has data_offsets [0,12], expected a range within the 8 bytes after "
                    "the header") +
            kDamaged);
  CHECK(complaint_about(R"({"dtype":"F64","shape":[2],"data_offsets":[0,8]})") ==
        "tensor 't' has 8 bytes, expected 16 for shape [2] of F64");
}

TEST_CASE("safetensors: gaps, overlaps, repetitions and trailing bytes are refused") {
  const auto two = [](const char* first, const char* second) {
    return std::string(R"({"a":{"dtype":"F32","shape":[1],"data_offsets":)") + first +
           R"(},"b":{"dtype":"F32","shape":[1],"data_offsets":)" + second + "}}";
  };
  CHECK(complaint(with_header(two("[0,4]", "[8,12]"), "123456789012")) ==
        "tensor 'b' begins at byte 8 of the data, expected 4 (a gap)");
  CHECK(complaint(with_header(two("[4,8]", "[4,8]"), "12345678")) ==
        "tensor 'a' begins at byte 4 of the data, expected 0 (a gap)");
  CHECK(complaint(with_header(two("[0,4]", "[2,6]"), "123456")) ==
        "tensor 'b' begins at byte 2 of the data, expected 4 (an overlap)");
  CHECK(complaint(with_header(two("[0,4]", "[4,8]"), "123456789")) ==
        std::string("9 bytes follow the header, expected the 8 of its tensors") + kDamaged);
  CHECK(complaint(with_header(R"({"a":{"dtype":"F32","shape":[1],"data_offsets":[0,4]},)"
                              R"("a":{"dtype":"F32","shape":[1],"data_offsets":[4,8]}})",
                              "12345678")) == "header: key \"a\" appears twice");
  CHECK(complaint(with_header(R"({"a":{"dtype":"F32","dtype":"F64"}})")) ==
        "header: key \"dtype\" appears twice");
}

TEST_CASE("safetensors: a file cut at any byte is refused") {
  const test::TempFolder folder("safetensors-cut");
  TensorFile f = sample();
  save_safetensors(folder / "x", f);
  const std::string whole = read_bytes(folder / "x");
  for (std::size_t n = 0; n < whole.size(); ++n) {
    CAPTURE(n);
    write_bytes(folder / "cut", whole.substr(0, n));
    CHECK_THROWS_AS(load_safetensors(folder / "cut"), IoError);
  }
}

TEST_CASE("safetensors: a changed byte is refused or read, never worse") {
  const test::TempFolder folder("safetensors-mutated");
  save_safetensors(folder / "x", sample());
  const std::string whole = read_bytes(folder / "x");
  std::uint64_t header = 0;
  std::memcpy(&header, whole.data(), 8);
  int refused = 0;
  for (std::uint64_t seed = 0; seed < 500; ++seed) {
    CAPTURE(seed);
    Rng rng(seed);
    std::string bytes = whole;
    const auto at = static_cast<std::size_t>(rng.below(static_cast<Index>(8 + header)));
    bytes[at] = static_cast<char>(static_cast<unsigned char>(bytes[at]) ^ (1 + rng.below(255)));
    write_bytes(folder / "y", bytes);
    try {
      load_safetensors(folder / "y");
    } catch (const IoError&) {
      ++refused;  // any other exception fails the test
    }
  }
  CHECK(refused > 250);  // most of a header is structure; a changed name is still a name
}

TEST_CASE("safetensors: what cannot be opened or saved is named") {
  const test::TempFolder folder("safetensors-files");
  const std::string missing = (folder / "missing").string();
  CHECK(error_of<IoError>([&] { load_safetensors(missing); }) ==
        missing + ": no such file, expected a safetensors file");
  CHECK(error_of<IoError>([&] { load_safetensors(folder.path()); }) ==
        folder.path().string() + ": is a folder, expected a safetensors file");
  const std::string pipe = (folder / "pipe").string();
  REQUIRE(::mkfifo(pipe.c_str(), 0600) == 0);  // whoever opened it would wait for a writer
  CHECK(error_of<IoError>([&] { load_safetensors(pipe); }) ==
        pipe + ": is a pipe, expected a safetensors file");
  std::filesystem::remove(pipe);

  const std::string out = (folder / "out").string();
  TensorFile f;
  f.tensors["t"];
  CHECK(error_of<IoError>([&] { save_safetensors(out, f); }) ==
        out + ": tensor 't' is empty, expected a value");
  f.tensors["t"] = Tensor({1});
  f.doubles["t"] = BasicTensor<double>({1});
  CHECK(error_of<IoError>([&] { save_safetensors(out, f); }) ==
        out + ": tensor 't' is there in float and in double, expected one");
  f.doubles.clear();
  f.tensors["__metadata__"] = Tensor({1});
  CHECK(error_of<IoError>([&] { save_safetensors(out, f); }) ==
        out + ": tensor '__metadata__' has the name the format reserves");
  TensorFile g;
  g.metadata["k"] = "\xff";
  CHECK(error_of<IoError>([&] { save_safetensors(out, g); }) ==
        out + ": a name or the metadata is something else, expected UTF-8");
  CHECK(std::filesystem::is_empty(folder.path()));
}

TEST_CASE("remove_partial_files: takes what killed writers have left, and nothing else") {
  const test::TempFolder folder("partial");
  const std::vector<std::string> left{".a.partial-7-0", ".a.partial-123-45", ".b.c.partial-7-1"},
      others{"a",
             ".a",
             "a.partial-7-0",
             ".a.partial-7",
             ".a.partial-7-",
             ".a.partial--1",
             ".partial-7-0",
             ".a.partial-7-x"};
  for (const auto& names : {left, others})
    for (const std::string& name : names) write_bytes(folder / name, "x");
  std::filesystem::create_directory(folder / ".d.partial-7-0");
  const int living = ::open((folder / left[1]).c_str(), O_RDONLY);
  REQUIRE(::flock(living, LOCK_EX) == 0);
  CHECK(remove_partial_files(folder.path(), "b.c") == std::vector{folder / left[2]});
  CHECK(remove_partial_files(folder.path()) == std::vector{folder / left[0]});
  ::close(living);
  CHECK(remove_partial_files(folder.path()) == std::vector{folder / left[1]});
  for (const std::string& name : others) CHECK(std::filesystem::exists(folder / name));
  CHECK(std::filesystem::exists(folder / ".d.partial-7-0"));
  CHECK(remove_partial_files(folder / "none").empty());
}

TEST_CASE("atomic_write: replaces whole files and leaves nothing else") {
  const test::TempFolder folder("atomic");
  const auto path = folder / "new/deep/x.txt";
  atomic_write(path, "one");
  CHECK(read_bytes(path) == "one");
  const std::string_view pieces[] = {"two ", "", "pieces"};
  atomic_write(path, pieces);
  CHECK(read_bytes(path) == "two pieces");
  // small pieces are written together, large ones as they are, all in their order
  const std::string large(3 << 20, 'l'), half(600 << 10, 'h');
  const std::string_view many[] = {"a", half, "b", half, large, "c", "", "d"};
  atomic_write(path, many);
  CHECK(read_bytes(path) == "a" + half + "b" + half + large + "cd");
  // or are asked for one after the other; what asking throws leaves the file as it was
  int asked = 0;
  atomic_write(path,
               [&]() -> std::string_view { return asked++ < 3 ? std::string_view(half) : ""; });
  CHECK(read_bytes(path) == half + half + half);
  CHECK(error_of<IoError>([&] {
          atomic_write(path, [&]() -> std::string_view {
            if (asked++ > 5) throw IoError("no more");
            return large;
          });
        }) == "no more");
  CHECK(read_bytes(path) == half + half + half);
  CHECK(std::distance(std::filesystem::directory_iterator(path.parent_path()), {}) == 1);

  const std::string occupied = (folder / "new").string();  // a folder cannot be replaced by a file
  CHECK(error_of<IoError>([&] { atomic_write(occupied, "x"); }) ==
        occupied + ": cannot be written (Is a directory), expected a place that can be written");
  const std::string below = (path / "y").string();  // nor can a file hold one
  CHECK(error_of<IoError>([&] {
          atomic_write(below, "x");
        }).starts_with(below + ": cannot make its folder"));
  CHECK(std::distance(std::filesystem::directory_iterator(folder.path()), {}) == 1);
}

TEST_CASE("put_in_place: a finished file takes another's place, or both stay") {
  const test::TempFolder folder("place");
  const auto path = folder / "x.txt", made = folder / "x.txt.part";
  atomic_write(path, "old");
  CHECK(error_of<IoError>([&] { put_in_place(made, path); }) ==
        path.string() +
            ": cannot be put in its place (No such file or directory), expected a "
            "place that can be written");
  CHECK(read_bytes(path) == "old");
  atomic_write(made, "new");
  const auto below = path / "y";
  CHECK(error_of<IoError>([&] {
          put_in_place(made, below);
        }).starts_with(below.string() + ": cannot be put in its place"));
  CHECK(read_bytes(made) == "new");
  put_in_place(made, path);
  CHECK(read_bytes(path) == "new");
  CHECK_FALSE(std::filesystem::exists(made));
}
