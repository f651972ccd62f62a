// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/parallel.h"
#include "satsurf/core/rng.h"
#include "satsurf/core/shape.h"

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <exception>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

namespace satsurf::train {

/// Things that are made up while a training runs, used for some samples and thrown away: no number
/// of files or gigabytes bounds what a network sees. Sample i is taken from one of the `pool` things
/// from number i / uses on, so every one is drawn `uses` times on average, spread over pool x uses
/// samples.
template <class Item>
class Stream {
 public:
  /// uses  samples per thing, on average
  /// pool  things to draw from at any time
  /// make  the thing of a number: a pure function
  Stream(Index uses, Index pool, std::function<Item(Index)> make)
      : uses_(uses), pool_(pool), make_(std::move(make)), makers_(most_makers(threads())) {}

  /// The number of the first of those that a sample may be taken from.
  Index first(Index sample) const { return sample / uses_; }
  /// A random one of those that a sample may be taken from. Meanwhile threads of their own, one for
  /// each, make those that the next samples will want, where there is more than one thread: where
  /// making them takes longer than using them, no thread stands still.
  /// throws  what `make` throws
  std::shared_ptr<const Item> draw(Index sample, Rng& rng) {
    constexpr Index kAhead = 2;  // one to hand out, one in the making
    prepare(first(sample), first(sample) + pool_ + kAhead);
    return item(first(sample) + rng.below(pool_));
  }
  /// A thing by its number: the same one whenever it is asked for, by any thread. It is made by the
  /// first who asks, on the threads that one has; those that no sample of its step wants any more
  /// are forgotten.
  /// throws  what `make` throws
  std::shared_ptr<const Item> item(Index number) {
    std::optional<Promise> promise;
    Made made;
    {
      const std::lock_guard lock(mutex_);
      // A sample of the same step may still want one that the newest sample no longer does.
      items_.erase(items_.begin(), items_.lower_bound(number - pool_ - kMostOfAStep / uses_));
      if (!items_.contains(number)) promise = promised(number);
      made = items_[number];
    }
    if (promise) keep(*promise, number);
    return made.get();  // at once, or when whoever makes it is done
  }

 private:
  using Promise = std::promise<std::shared_ptr<const Item>>;
  using Made = std::shared_future<std::shared_ptr<const Item>>;
  using Maker = std::future<void>;
  static constexpr Index kMostOfAStep = 64;  ///< samples

  /// How many make things ahead of need: each needs the memory of what is being made.
  static std::size_t most_makers(int threads) {
    constexpr int kMost = 4;
    return threads > 1 ? static_cast<std::size_t>(std::min(threads, kMost)) : 0;
  }

  /// Under the mutex: from now on everyone waits for this promise.
  Promise promised(Index number) {
    Promise promise;
    items_[number] = promise.get_future().share();
    return promise;
  }

  void keep(Promise& promise, Index number) {
    try {
      promise.set_value(std::make_shared<const Item>(make_(number)));
    } catch (...) {
      promise.set_exception(std::current_exception());
    }
  }

  /// Begins to make those of [begin, end) that nobody has begun, as many as there are idle makers.
  void prepare(Index begin, Index end) {
    const std::lock_guard lock(mutex_);
    for (Maker& maker : makers_) {
      if (maker.valid() && maker.wait_for(std::chrono::seconds(0)) != std::future_status::ready)
        continue;
      while (begin < end && items_.contains(begin)) ++begin;
      if (begin == end) return;
      maker = std::async(std::launch::async, [this, begin, promise = promised(begin)]() mutable {
        const OnOneThread alone;
        keep(promise, begin);
      });
    }
  }

  Index uses_, pool_;
  std::function<Item(Index)> make_;
  std::mutex mutex_;
  std::map<Index, Made> items_;
  std::vector<Maker> makers_;  ///< last: they are waited for, and what they make needs the others
};

}  // namespace satsurf::train
