// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/tensor.h"

#include "satsurf/core/parallel.h"

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <mutex>
#include <new>
#include <unordered_map>

namespace satsurf {
namespace {

constexpr std::size_t kAlignment = 64;  // one cache line, one AVX-512 register

/// Blocks are kept by size and handed out again: a training step asks for the same sizes every
/// time, and fresh pages from the system cost more than most kernels that fill them.
class BlockCache {
 public:
  void* take(std::size_t bytes) {
    bytes = rounded(bytes);
    const std::size_t now = used_.fetch_add(bytes) + bytes;
    std::size_t peak = peak_.load();
    while (now > peak && !peak_.compare_exchange_weak(peak, now)) {
    }
    if (bytes >= kSmallest) {
      const std::lock_guard lock(mutex_);
      if (auto it = free_.find(bytes); it != free_.end() && !it->second.empty()) {
        void* block = it->second.back();
        it->second.pop_back();
        kept_ -= bytes;
        return block;
      }
    }
    void* block = std::aligned_alloc(kAlignment, bytes);
    if (block == nullptr) {
      release();
      block = std::aligned_alloc(kAlignment, bytes);
    }
    if (block == nullptr) {
      used_ -= bytes;
      throw std::bad_alloc();
    }
    return block;
  }

  void give(void* block, std::size_t bytes) noexcept {
    bytes = rounded(bytes);
    used_ -= bytes;
    if (bytes >= kSmallest) {
      const std::lock_guard lock(mutex_);
      if (kept_ + bytes <= kMostKept) {
        try {
          free_[bytes].push_back(block);
          kept_ += bytes;
          return;
        } catch (const std::bad_alloc&) {
          // fall through: not keeping a block is always allowed
        }
      }
    }
    std::free(block);
  }

  void release() noexcept {
    const std::lock_guard lock(mutex_);
    for (auto& [bytes, blocks] : free_)
      for (void* block : blocks) std::free(block);
    free_.clear();
    kept_ = 0;
  }

  std::size_t used() const { return used_; }
  std::size_t peak() const { return peak_; }
  void reset_peak() { peak_ = used_.load(); }

 private:
  static constexpr std::size_t kSmallest = 64 << 10;  // below this malloc keeps blocks itself
  static constexpr std::size_t kMostKept = std::size_t{2}
                                           << 30;  // about one training step at 256x256

  static std::size_t rounded(std::size_t bytes) {
    return std::max(kAlignment, (bytes + kAlignment - 1) / kAlignment * kAlignment);
  }

  std::mutex mutex_;
  std::unordered_map<std::size_t, std::vector<void*>> free_;
  std::size_t kept_ = 0;
  std::atomic<std::size_t> used_{0}, peak_{0};
};

/// Never destroyed: tensors with static lifetime may outlive any order of destruction.
BlockCache& cache() {
  static BlockCache* instance = new BlockCache;
  return *instance;
}

}  // namespace

std::size_t tensor_bytes() { return cache().used(); }
std::size_t peak_tensor_bytes() { return cache().peak(); }
void reset_peak_tensor_bytes() { cache().reset_peak(); }
void release_tensor_cache() { cache().release(); }

template <class T>
BasicTensor<T> BasicTensor<T>::uninitialised(const Shape& shape) {
  BasicTensor t;
  t.shape_ = shape;
  const std::size_t bytes = static_cast<std::size_t>(shape.count()) * sizeof(T);
  t.buffer_ = std::shared_ptr<T>(static_cast<T*>(cache().take(bytes)),
                                 [bytes](T* p) { cache().give(p, bytes); });
  return t;
}

template <class T>
BasicTensor<T>::BasicTensor(const Shape& shape) : BasicTensor(shape, T(0)) {}

template <class T>
BasicTensor<T>::BasicTensor(const Shape& shape, T fill) : BasicTensor(uninitialised(shape)) {
  this->fill(fill);
}

template <class T>
BasicTensor<T> BasicTensor<T>::from(const Shape& shape, std::span<const T> values) {
  if (static_cast<Index>(values.size()) != shape.count())
    throw ShapeError("Tensor::from: " + std::to_string(values.size()) + " values, expected " +
                     std::to_string(shape.count()) + " for shape " + shape.str());
  BasicTensor t = uninitialised(shape);
  std::copy(values.begin(), values.end(), t.data());
  return t;
}

template <class T>
T BasicTensor<T>::item() const {
  if (count() != 1)
    throw ShapeError("Tensor::item: shape " + shape_.str() + ", expected one element");
  return (*this)[0];
}

template <class T>
BasicTensor<T> BasicTensor<T>::clone() const {
  if (empty()) return {};
  BasicTensor t = uninitialised(shape_);
  std::copy_n(data(), count(), t.data());
  return t;
}

template <class T>
BasicTensor<T> BasicTensor<T>::reshaped(const Shape& shape) const {
  if (empty() || shape.count() != shape_.count())
    throw ShapeError("Tensor::reshaped: from " + (empty() ? "empty" : shape_.str()) + " to " +
                     shape.str() + ", expected equal counts");
  BasicTensor t = *this;
  t.shape_ = shape;
  return t;
}

template <class T>
BasicTensor<T> BasicTensor<T>::slice0(Index i) const {
  if (rank() < 1 || i < 0 || i >= dim(0))
    throw ShapeError("Tensor::slice0: index " + std::to_string(i) + " of shape " + shape_.str());
  const Shape rest(shape_.extents().subspan(1));
  return from(
      rest, std::span<const T>(data() + i * rest.count(), static_cast<std::size_t>(rest.count())));
}

template <class T>
void BasicTensor<T>::fill(T value) {
  constexpr Index kPiece = 1 << 16;  // one thread alone does not reach the memory's bandwidth
  T* to = data();
  for_range(count(), kPiece,
            [to, value](Index begin, Index end) { std::fill(to + begin, to + end, value); });
}

template class BasicTensor<float>;
template class BasicTensor<double>;

}  // namespace satsurf
