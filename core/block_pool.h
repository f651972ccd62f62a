// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

/// Where the memory of tensors comes from, and how much of it there is.
///
/// Blocks of 64 KiB and more are cut from one range of addresses, reserved at the first use and
/// twice as large as the machine's memory, or smaller, down to none, so that a limit on addresses
/// (`ulimit -v`) leaves as many as the machine's memory to everything else. A block that is given
/// back becomes a gap, joined with the gaps beside it, and the next block goes into the lowest gap
/// that is large enough. Gaps keep the pages they have: filling a fresh page costs more than most
/// kernels that fill it, so work that is repeated asks the system for nothing. They keep them until
/// `release_tensor_cache()` or the end of the program. The range is opened in steps of 64 MiB and
/// never closed.
///
/// Smaller blocks are malloc's, and so are those for which the range has no room, and all blocks
/// under the sanitizers. Every block is aligned to 64 bytes and rounded up to a multiple of that.
/// All functions may be called from any thread.
namespace satsurf {

/// Bytes in blocks that are in use now.
std::size_t tensor_bytes();
/// The most there were at one time since the last `reset_peak_tensor_bytes()`.
std::size_t peak_tensor_bytes();
/// Starts `peak_tensor_bytes()` again from what there is now.
void reset_peak_tensor_bytes();
/// Makes the peak at least `bytes`, for whoever resets it in between and wants to undo that.
void raise_peak_tensor_bytes(std::size_t bytes);
/// Bytes of the range that have been opened so far. Stays as it is when work is repeated.
std::size_t reserved_tensor_bytes();
/// Hands the pages of all gaps back to the system.
void release_tensor_cache();

namespace detail {

/// throws  std::bad_alloc
void* take_block(std::size_t bytes);
/// bytes  as they were asked for
void give_block(void* block, std::size_t bytes) noexcept;

}  // namespace detail
}  // namespace satsurf
