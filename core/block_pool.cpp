// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/block_pool.h"

#include "satsurf/core/memory_limits.h"

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <map>
#include <mutex>
#include <new>
#include <utility>
#include <vector>

#include <sys/mman.h>
#include <unistd.h>

namespace satsurf {
namespace {

constexpr std::size_t kAlignment = 64;  // one cache line, one AVX-512 register

// The sanitizers watch each block of malloc's. g++ says that they are there by a macro, clang by a feature.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
constexpr bool kPooled = false;
#elif defined(__has_feature)
constexpr bool kPooled = !__has_feature(address_sanitizer) && !__has_feature(thread_sanitizer);
#else
constexpr bool kPooled = true;
#endif

class BlockPool {
 public:
  void* take(std::size_t asked) {
    const std::size_t bytes = rounded(asked);
    raise_peak(used_.fetch_add(bytes) + bytes);
    void* block = kPooled && bytes >= kSmallest ? from_range(bytes) : nullptr;
    if (block == nullptr) block = std::aligned_alloc(kAlignment, bytes);
    if (block == nullptr) {
      used_ -= bytes;
      throw std::bad_alloc();
    }
    return block;
  }

  void give(void* block, std::size_t asked) noexcept {
    const std::size_t bytes = rounded(asked);
    used_ -= bytes;
    auto* const start = static_cast<std::byte*>(block);
    std::byte* const range = range_.load(std::memory_order_acquire);
    if (range == nullptr || start < range || start >= range + reserved_) return std::free(block);
    const std::lock_guard lock(mutex_);
    // Every block given out leaves room for the gap it may become, so this cannot run out.
    Gaps::node_type node = std::move(spare_.back());
    spare_.pop_back();
    node.key() = static_cast<std::size_t>(start - range);
    node.mapped() = bytes;
    auto gap = gaps_.insert(std::move(node)).position;
    if (auto next = std::next(gap); next != gaps_.end() && gap->first + gap->second == next->first)
      swallow(gap, next);
    if (gap != gaps_.begin())
      if (auto before = std::prev(gap); before->first + before->second == gap->first)
        swallow(before, gap);
  }

  /// Hands the pages of all gaps back to the system.
  void release() noexcept {
    const std::lock_guard lock(mutex_);
    std::byte* const range = range_;
    for (const auto& [offset, bytes] : gaps_) {
      const std::size_t first = (offset + kPage - 1) / kPage * kPage,
                        last = (offset + bytes) / kPage * kPage;
      if (last > first) ::madvise(range + first, last - first, MADV_DONTNEED);
    }
  }

  std::size_t used() const { return used_; }
  std::size_t peak() const { return peak_; }
  void reset_peak() { peak_ = used_.load(); }
  void raise_peak(std::size_t bytes) {
    std::size_t peak = peak_.load();
    while (bytes > peak && !peak_.compare_exchange_weak(peak, bytes)) {
    }
  }
  std::size_t open() {
    const std::lock_guard lock(mutex_);
    return open_;
  }

 private:
  using Gaps = std::map<std::size_t, std::size_t>;  // offset to size

  static constexpr std::size_t kSmallest = 64 << 10;  // below this malloc does it well
  static constexpr std::size_t kPage = 4096;
  static constexpr std::size_t kGrowth = std::size_t{64} << 20;

  static std::size_t rounded(std::size_t bytes) {
    return std::max(kAlignment, (bytes + kAlignment - 1) / kAlignment * kAlignment);
  }

  /// nullptr where the system grants no more.
  void* from_range(std::size_t bytes) {
    const std::lock_guard lock(mutex_);
    if (!std::exchange(asked_, true)) reserve();
    if (spare_.size() == spare_.capacity()) spare_.reserve(2 * spare_.size() + 64);
    auto gap = gaps_.begin();
    while (gap != gaps_.end() && gap->second < bytes) ++gap;
    if (gap == gaps_.end()) {
      gap = grown(bytes);
      if (gap == gaps_.end()) return nullptr;
    }
    const auto [offset, size] = *gap;
    if (size > bytes) gaps_.emplace_hint(std::next(gap), offset + bytes, size - bytes);
    spare_.push_back(gaps_.extract(gap));
    return range_ + offset;
  }

  void reserve() {
    const auto pages = static_cast<std::size_t>(std::max(::sysconf(_SC_PHYS_PAGES), 1L << 18));
    const std::size_t memory = pages * kPage, left = addresses_left();
    // Twice the memory there is leaves room for gaps; addresses alone cost nothing. Where they are
    // limited, as many as there is memory stay for everything else, or the range alone would use
    // the limit up.
    const std::size_t bytes =
        std::min(2 * memory, (left - std::min(left, memory)) / kGrowth * kGrowth);
    if (bytes == 0) return;
    void* const at =
        ::mmap(nullptr, bytes, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (at == MAP_FAILED) return;
    // Only a wish: one page fault instead of 512 where the system has huge pages.
    ::madvise(at, bytes, MADV_HUGEPAGE);
    reserved_ = bytes;
    range_.store(static_cast<std::byte*>(at), std::memory_order_release);
  }

  /// A gap at the end of what is in use, of at least `bytes`; end() where there can be none.
  Gaps::iterator grown(std::size_t bytes) {
    if (range_ == nullptr) return gaps_.end();
    auto last = gaps_.empty() ? gaps_.end() : std::prev(gaps_.end());
    const bool touches = last != gaps_.end() && last->first + last->second == open_;
    const std::size_t missing = bytes - (touches ? last->second : 0);
    const std::size_t more = (missing + kGrowth - 1) / kGrowth * kGrowth;
    if (more > reserved_ - open_) return gaps_.end();
    if (::mprotect(range_ + open_, more, PROT_READ | PROT_WRITE) != 0) return gaps_.end();
    if (touches) {
      last->second += more;
    } else {
      last = gaps_.emplace_hint(gaps_.end(), open_, more);
    }
    open_ += more;
    return last;
  }

  void swallow(Gaps::iterator gap, Gaps::iterator next) noexcept {
    gap->second += next->second;
    gaps_.erase(next);
  }

  std::mutex mutex_;
  // Written once and last, behind `reserved_`: blocks of malloc's are given back without the lock.
  std::atomic<std::byte*> range_{nullptr};
  std::size_t reserved_ = 0, open_ = 0;  // bytes of the range, and those that may be used so far
  bool asked_ = false;                   // for the range, whether or not the system granted it
  Gaps gaps_;
  std::vector<Gaps::node_type> spare_;  // one per block given out
  std::atomic<std::size_t> used_{0}, peak_{0};
};

/// Never destroyed: tensors with static lifetime may outlive any order of destruction.
BlockPool& pool() {
  static BlockPool* instance = new BlockPool;
  return *instance;
}

}  // namespace

std::size_t tensor_bytes() { return pool().used(); }
std::size_t peak_tensor_bytes() { return pool().peak(); }
void reset_peak_tensor_bytes() { pool().reset_peak(); }
void raise_peak_tensor_bytes(std::size_t bytes) { pool().raise_peak(bytes); }
std::size_t reserved_tensor_bytes() { return pool().open(); }
void release_tensor_cache() { pool().release(); }

void* detail::take_block(std::size_t bytes) { return pool().take(bytes); }
void detail::give_block(void* block, std::size_t bytes) noexcept { pool().give(block, bytes); }

}  // namespace satsurf
