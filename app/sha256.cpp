// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/sha256.h"

#include "satsurf/core/error.h"
#include "satsurf/core/files.h"

#include <array>
#include <fstream>
#include <memory>
#include <vector>

#include <openssl/evp.h>

namespace satsurf::app {
namespace {

class Hash {
 public:
  Hash() : context_(EVP_MD_CTX_new(), EVP_MD_CTX_free) {
    check(context_ != nullptr && EVP_DigestInit_ex(context_.get(), EVP_sha256(), nullptr) == 1);
  }
  void add(const char* bytes, std::size_t count) {
    check(EVP_DigestUpdate(context_.get(), bytes, count) == 1);
  }
  std::string hex() {
    std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
    unsigned int count = 0;
    check(EVP_DigestFinal_ex(context_.get(), digest.data(), &count) == 1);
    std::string text;
    for (unsigned int i = 0; i < count; ++i)
      for (const int nibble : {digest[i] >> 4, digest[i] & 15}) text += "0123456789abcdef"[nibble];
    return text;
  }

 private:
  static void check(bool done) {
    if (!done) throw Error("sha256: OpenSSL has failed, expected a hash");
  }
  std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context_;
};

}  // namespace

std::string sha256(std::string_view bytes) {
  Hash hash;
  hash.add(bytes.data(), bytes.size());
  return hash.hex();
}

std::string sha256_of_file(const std::filesystem::path& path) {
  require_file(path, "a file");  // opening a pipe waits
  std::ifstream in(path, std::ios::binary);
  if (!in.is_open()) throw IoError(path.string() + ": cannot be read, expected a file");
  Hash hash;
  std::vector<char> piece(1 << 20);
  while (in) {
    in.read(piece.data(), static_cast<std::streamsize>(piece.size()));
    hash.add(piece.data(), static_cast<std::size_t>(in.gcount()));
  }
  if (!in.eof()) throw IoError(path.string() + ": reading stopped before the end of the file");
  return hash.hex();
}

}  // namespace satsurf::app
