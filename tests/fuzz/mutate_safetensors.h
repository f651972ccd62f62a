// SPDX-License-Identifier: Apache-2.0
#pragma once

// A file of tensors begins with the length of its header. Mutations that know nothing of it spoil it with every byte they
// insert, and nothing behind it is ever read. Half of them here change the header alone and put the length right.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size, std::size_t most);

extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size,
                                               std::size_t most, unsigned int seed) {
  constexpr std::size_t kLength = 8;
  std::uint64_t header = 0;
  if (size >= kLength) std::memcpy(&header, data, kLength);
  if (seed % 2 == 0 || size < kLength || header == 0 || header > size - kLength || most < size)
    return LLVMFuzzerMutate(data, size, most);
  const std::vector<std::uint8_t> behind(data + kLength + header, data + size);
  std::vector<std::uint8_t> text(data + kLength, data + kLength + header);
  const std::size_t room = most - kLength - behind.size();
  text.resize(room);
  const std::uint64_t changed = LLVMFuzzerMutate(text.data(), header, room);
  std::memcpy(data, &changed, kLength);
  std::copy_n(text.begin(), changed, data + kLength);
  std::copy(behind.begin(), behind.end(), data + kLength + changed);
  return kLength + changed + behind.size();
}
