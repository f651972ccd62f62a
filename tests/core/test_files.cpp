// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/files.h"

#include <filesystem>
#include <string>
#include <vector>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>
#include <sys/stat.h>

using namespace satsurf;
using test::error_of;

TEST_CASE("files: what is no file is named for what it is, and nobody waits for it") {
  const test::TempFolder folder("files");
  const std::string file = (folder / "file").string(), pipe = (folder / "pipe").string(),
                    link = (folder / "link").string(),
                    long_name = (folder / std::string(300, 'n')).string();
  test::write_bytes(file, "text\n");
  std::filesystem::create_symlink(file, link);
  REQUIRE(::mkfifo(pipe.c_str(), 0600) == 0);

  CHECK(read_text_file(file, "a text") == "text\n");
  CHECK(read_text_file(link, "a text") == "text\n");
  const auto error = [&](const std::string& path) {
    return error_of<IoError>([&] { read_text_file(path, "a text"); });
  };
  CHECK(error(file + "2") == file + "2: no such file, expected a text");
  CHECK(error(file + "/x") == file + "/x: no such file, expected a text");
  CHECK(error(pipe) == pipe + ": is a pipe, expected a text");
  CHECK(error("/dev/zero") == "/dev/zero: is a device, expected a text");
  CHECK(error(folder.path().string()) == folder.path().string() + ": is a folder, expected a text");
  CHECK(error(long_name).starts_with(long_name + ": cannot be found ("));
  std::filesystem::resize_file(file, kMostText + 1);
  CHECK(error(file) == file + ": larger than 64 MiB, expected a text");

  const auto names = entries_of(folder.path(), "a folder");
  CHECK(names == std::vector<std::filesystem::path>{file, link, pipe});
  CHECK(error_of<IoError>([&] {
          entries_of(file, "images");
        }).starts_with(file + ": cannot be listed ("));
  CHECK(
      error_of<IoError>([&] { entries_of(long_name, "images"); }).ends_with("), expected images"));

  CHECK(is_file(link));
  CHECK_FALSE(is_file(pipe));
  CHECK(path_exists(pipe));
  CHECK(is_folder(folder.path()));
  CHECK_FALSE(path_exists(long_name));
  CHECK_FALSE(is_file(long_name));
  CHECK_FALSE(is_folder(long_name));
}

TEST_CASE("files: what lies beside a file is listed, and none of its companions is a pipe") {
  const test::TempFolder folder("beside");
  const std::string image = (folder / "Img.tif").string();
  for (const char* name : {"Img.tif", "Img_RPC.TXT", "other.txt"})
    test::write_bytes(folder / name, "x");
  std::filesystem::create_directory(folder / "folder");
  // Pipes of nothing, of another image, of a program.
  for (const char* name : {"other", "Img2.RPB", "Img"})
    REQUIRE(::mkfifo((folder / name).c_str(), 0600) == 0);
  CHECK(names_beside(image) ==
        std::vector<std::string>{"Img.tif", "Img_RPC.TXT", "folder", "other.txt"});
  CHECK(names_beside(folder / "nowhere/x.tif").empty());
  for (const std::string name : {"Img.tif.ovr", "Img.tif.msk", "Img.RPB", "img_metadata.txt"}) {
    const std::string pipe = (folder / name).string();
    REQUIRE(::mkfifo(pipe.c_str(), 0600) == 0);
    CHECK(error_of<IoError>([&] { names_beside(image); }) ==
          pipe + ": is a pipe, expected a file or nothing under this name beside " + image);
    std::filesystem::remove(pipe);
    std::filesystem::create_symlink(folder / "other", pipe);  // a link to one is no better
    CHECK(error_of<IoError>([&] { names_beside(image); }).starts_with(pipe + ": is a pipe"));
    std::filesystem::remove(pipe);
  }
}
