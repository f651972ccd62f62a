// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

#include <exception>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <utility>

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
      : uses_(uses), pool_(pool), make_(std::move(make)) {}

  /// The number of the first of those that a sample may be taken from; there are `pool()`.
  Index first(Index sample) const { return sample / uses_; }
  Index pool() const { return pool_; }
  /// A thing by its number: the same one whenever it is asked for, by any thread. It is made by the
  /// first who asks, on the threads that one has; those that no sample of its step wants any more
  /// are forgotten.
  /// throws  what `make` throws
  std::shared_ptr<const Item> item(Index number) {
    std::promise<std::shared_ptr<const Item>> promise;
    Made made;
    bool is_new = false;
    {
      const std::lock_guard lock(mutex_);
      // A sample of the same step may still want one that the newest sample no longer does.
      items_.erase(items_.begin(), items_.lower_bound(number - pool_ - kMostOfAStep / uses_));
      is_new = !items_.contains(number);
      if (is_new) items_[number] = promise.get_future().share();
      made = items_[number];
    }
    if (!is_new) return made.get();  // made already, or whoever makes it is about to be done
    try {
      promise.set_value(std::make_shared<const Item>(make_(number)));
    } catch (...) {
      promise.set_exception(std::current_exception());
    }
    return made.get();
  }

 private:
  using Made = std::shared_future<std::shared_ptr<const Item>>;
  static constexpr Index kMostOfAStep = 64;  ///< samples

  Index uses_, pool_;
  std::function<Item(Index)> make_;
  std::mutex mutex_;
  std::map<Index, Made> items_;
};

}  // namespace satsurf::train
