// SPDX-License-Identifier: Apache-2.0
#pragma once

// What all targets share. A target is one function, `run(bytes)`; a finding is a sanitizer's report, a time-out, a limit of
// memory, an exception of another type than the reader documents, or one whose text is not one line.

#include "satsurf/core/error.h"
#include "satsurf/core/parallel.h"

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>
#include <typeinfo>

#include <unistd.h>

#if defined(__has_feature)
#if __has_feature(address_sanitizer)
#define SATSURF_FUZZ_COUNTS
#include <sanitizer/allocator_interface.h>
#endif
#endif

namespace satsurf::fuzz {

/// Ends the program with a line that says what is wrong, which libFuzzer takes for a finding.
[[noreturn]] inline void finding(const std::string& text) {
  std::fprintf(stderr, "FINDING: %s\n", text.c_str());
  std::abort();
}

/// Runs what may throw one of the documented types and nothing else.
/// returns  whether it threw nothing
template <class... Documented, class F>
bool only(const F& f) {
  try {
    f();
    return true;
  } catch (const std::exception& e) {
    if (!(... || (typeid(e) == typeid(Documented))))
      finding(std::string("an exception that is not documented, ") + typeid(e).name() + ": " +
              e.what());
    const std::string_view text = e.what();
    if (text.empty() || text.find('\n') != std::string_view::npos)
      finding("an error text that is not one line: " + std::string(text));
    return false;
  } catch (...) {
    finding("something thrown that is no std::exception");
  }
}

/// Stops a target whose promise to its caller is broken.
inline void require(bool holds, const char* promise) {
  if (!holds) finding(std::string("does not hold: ") + promise);
}

/// While one lives, what is allocated may be 200 MB and twenty times the input more than before.
/// Counted under the address sanitizer alone.
class MemoryLimit {
 public:
  explicit MemoryLimit(std::size_t input) {
#ifdef SATSURF_FUZZ_COUNTS
    [[maybe_unused]] static const int installed =
        __sanitizer_install_malloc_and_free_hooks(&allocated, [](const volatile void*) {});
    most = __sanitizer_get_current_allocated_bytes() + 200'000'000 + 20 * input;
#else
    static_cast<void>(input);
#endif
  }
  ~MemoryLimit() { most = 0; }
  MemoryLimit(const MemoryLimit&) = delete;
  MemoryLimit& operator=(const MemoryLimit&) = delete;

 private:
#ifdef SATSURF_FUZZ_COUNTS
  static void allocated(const volatile void*, std::size_t bytes) {
    constexpr std::size_t kEvery = std::size_t{1} << 20;  // counting takes longer than allocating
    thread_local std::size_t since = 0;
    since += bytes;
    if (since < kEvery || most == 0) return;
    since = 0;
    if (__sanitizer_get_current_allocated_bytes() > most)
      finding("more memory than 200 MB and twenty times the input");
  }
#endif
  static inline std::size_t most = 0;
};

/// A folder of this process below TMPDIR, which run.sh lets lie in memory.
class Folder {
 public:
  Folder()
      : path_(std::filesystem::temp_directory_path() /
              ("satsurf-fuzz-" + std::to_string(::getpid()))) {
    std::filesystem::remove_all(path_);
    std::filesystem::create_directories(path_);
  }
  ~Folder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

  const std::filesystem::path& path() const { return path_; }
  /// Writes a file of the folder.
  /// returns  its path
  std::filesystem::path put(const std::string& name, std::string_view bytes) const {
    const std::filesystem::path file = path_ / name;
    if (std::FILE* out = std::fopen(file.c_str(), "wb")) {
      std::fwrite(bytes.data(), 1, bytes.size(), out);
      std::fclose(out);
    }
    return file;
  }

 private:
  std::filesystem::path path_;
};

/// The folder of this process.
inline const Folder& folder() {
  static const Folder folder;
  return folder;
}

/// Takes values from the front of the input; zeros once it is used up.
class Bytes {
 public:
  explicit Bytes(std::string_view bytes) : left_(bytes) {}

  template <class T>
  T take() {
    T value{};
    const std::size_t n = left_.size() < sizeof value ? left_.size() : sizeof value;
    std::memcpy(&value, left_.data(), n);
    left_.remove_prefix(n);
    return value;
  }
  bool empty() const { return left_.empty(); }
  std::string_view rest() const { return left_; }
  /// The bytes before the next of a kind, which is dropped; all that is left where there is none.
  std::string_view until(char end) {
    const std::size_t at = left_.find(end);
    const std::string_view part = left_.substr(0, at);
    left_.remove_prefix(at == std::string_view::npos ? left_.size() : at + 1);
    return part;
  }

 private:
  std::string_view left_;
};

/// One input; to be defined by the target.
void run(std::string_view bytes);

}  // namespace satsurf::fuzz

#ifndef SATSURF_FUZZ_SEEDS
extern "C" int LLVMFuzzerInitialize(int*, char***) {
  satsurf::set_threads(1);  // an input takes the same way whenever it is run
  satsurf::fuzz::folder();
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const satsurf::fuzz::MemoryLimit limit(size);
  satsurf::fuzz::run({reinterpret_cast<const char*>(data), size});
  return 0;
}
#endif
