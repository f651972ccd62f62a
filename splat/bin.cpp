// SPDX-License-Identifier: Apache-2.0
#include "satsurf/splat/bin.h"

#include "satsurf/core/parallel.h"

#include <array>
#include <bit>
#include <memory>
#include <numeric>
#include <type_traits>

namespace satsurf::splat {
namespace {

constexpr Index kPiece = 16384;  // items per piece of a counting sort
constexpr Index kAhead = 16;     // items by which memory is fetched earlier than it is needed

/// Stable parallel counting sort in which an item may fall into any number of buckets.
///   visit(i, f)    calls f(bucket) for each bucket of item i
///   place(i, at)   stores item i at position `at` of the result
/// The result is unique, so it does not depend on the pieces either. Returns where each bucket
/// begins.
template <class Visit, class Allocate, class Place>
std::vector<Index> counting_sort(Index items, Index buckets, const Visit& visit,
                                 const Allocate& allocate, const Place& place) {
  const auto at = [&](Index piece, Index bucket) { return piece * buckets + bucket; };
  const Index pieces = (items + kPiece - 1) / kPiece;
  std::vector<Index> next(pieces * buckets);
  for_range(items, kPiece, [&](Index begin, Index end) {
    Index* count = next.data() + at(begin / kPiece, 0);
    for (Index i = begin; i < end; ++i) visit(i, [&](Index bucket) { ++count[bucket]; });
  });
  std::vector<Index> first(buckets + 1);
  Index total = 0;
  for (Index b = 0; b < buckets; ++b) {
    first[b] = total;
    for (Index p = 0; p < pieces; ++p) {
      const Index n = next[at(p, b)];
      next[at(p, b)] = total;
      total += n;
    }
  }
  first[buckets] = total;
  allocate(total);
  for_range(items, kPiece, [&](Index begin, Index end) {
    Index* where = next.data() + at(begin / kPiece, 0);
    for (Index i = begin; i < end; ++i) visit(i, [&](Index bucket) { place(i, where[bucket]++); });
  });
  return first;
}

/// Unsigned numbers whose ascending order is the descending order of the heights.
template <class T>
auto descending_key(T height) {
  using Key = std::conditional_t<sizeof(T) == 4, std::uint32_t, std::uint64_t>;
  constexpr Key kSign = Key{1} << (8 * sizeof(T) - 1);
  const Key bits = std::bit_cast<Key>(height + T(0));  // -0 becomes +0: they are equal heights
  return (bits & kSign) != 0 ? bits : static_cast<Key>(~(bits | kSign));
}

}  // namespace

template <class T>
std::vector<std::int32_t> front_to_back(const std::vector<Box>& boxes, const T* heights,
                                        Index stride) {
  using Key = decltype(descending_key(T(0)));
  struct Item {
    Key key;
    std::int32_t surfel;
  };
  // The surfels that show, each piece behind those of the pieces before.
  const Index P = std::ssize(boxes), pieces = (P + kPiece - 1) / kPiece;
  const auto shows = [&](Index i) { return boxes[i].x1 >= boxes[i].x0; };
  std::vector<Index> first(pieces + 1);
  for_range(P, kPiece, [&](Index begin, Index end) {
    Index count = 0;
    for (Index i = begin; i < end; ++i) count += shows(i) ? 1 : 0;
    first[begin / kPiece + 1] = count;
  });
  std::partial_sum(first.begin(), first.end(), first.begin());
  const Index n = first.back();
  auto items = std::make_unique_for_overwrite<Item[]>(n),
       sorted = std::make_unique_for_overwrite<Item[]>(n);
  std::vector<std::array<Key, 2>> any_all(pieces, {Key{0}, static_cast<Key>(~Key{0})});
  for_range(P, kPiece, [&](Index begin, Index end) {
    auto& [any, all] = any_all[begin / kPiece];
    Index at = first[begin / kPiece];
    for (Index i = begin; i < end; ++i) {
      if (!shows(i)) continue;
      const Key key = descending_key(heights[i * stride]);
      any |= key, all &= key;
      items[at++] = {key, static_cast<std::int32_t>(i)};
    }
  });
  Key any = 0, all = static_cast<Key>(~Key{0});
  for (const auto& piece : any_all) any |= piece[0], all &= piece[1];

  // Least significant digit first; bits in which all keys agree need no pass.
  const Key differ = any & static_cast<Key>(~all);
  constexpr int kDigit = 11;
  for (int shift = 0; shift < static_cast<int>(8 * sizeof(Key)) && (differ >> shift) != 0;
       shift += kDigit) {
    constexpr Key kMask = (Key{1} << kDigit) - 1;
    if (((differ >> shift) & kMask) == 0) continue;
    counting_sort(
        n, Index{1} << kDigit,
        [&](Index i, auto&& f) { f(static_cast<Index>((items[i].key >> shift) & kMask)); },
        [](Index) {}, [&](Index i, Index at) { sorted[at] = items[i]; });
    items.swap(sorted);
  }
  std::vector<std::int32_t> order(n);
  for_range(n, kPiece, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) order[i] = items[i].surfel;
  });
  return order;
}

TileLists bin(const std::vector<Box>& boxes, const std::vector<std::int32_t>& order, Index height,
              Index width) {
  TileLists out;
  out.columns = (width + kTile - 1) / kTile;
  out.rows = (height + kTile - 1) / kTile;
  out.first = counting_sort(
      std::ssize(order), out.rows * out.columns,
      [&](Index i, auto&& f) {
        // By height, the boxes lie all over memory.
        if (i + kAhead < std::ssize(order)) __builtin_prefetch(boxes.data() + order[i + kAhead]);
        const TileSpan span = tiles_of(boxes[order[i]]);
        for (Index y = span.y0; y < span.y1; ++y)
          for (Index x = span.x0; x < span.x1; ++x) f(y * out.columns + x);
      },
      [&](Index total) { out.surfels.resize(total); },
      [&](Index i, Index at) { out.surfels[at] = order[i]; });
  return out;
}

template std::vector<std::int32_t> front_to_back(const std::vector<Box>&, const float*, Index);
template std::vector<std::int32_t> front_to_back(const std::vector<Box>&, const double*, Index);

}  // namespace satsurf::splat
