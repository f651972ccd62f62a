// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"
#include "satsurf/splat/rasterize_kernels.h"
#include "satsurf/splat/surfel_kernels.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>
#include <vector>

#include "tests/gradcheck.h"
#include "tests/isa_variants.h"
#include "tests/ref/splat_ref.h"

namespace satsurf::test {
namespace {

using namespace splat;

template <class T>
struct Drawn {
  BasicTensor<T> maps, median;
  std::vector<BasicTensor<T>> grads;  // means, quats, scales, opacity, colours, aux
};

/// What rasterize does, one tile after the other, with kernels of one's choice.
template <class T>
Drawn<T> draw(Isa isa, const BasicSurfels<T>& s, const BasicProjection<T>& camera,
              const RasterOptions& o, const BasicTensor<T>& g) {
  const Index P = s.means.dim(0), K = s.aux.dim(1), H = o.height, W = o.width;
  const auto surfels = kernels_for<SurfelKernels<T>>(isa);
  const auto pixels = kernels_for<TileKernels<T>>(isa);
  BasicTensor<T> records({P, kRecord});
  std::vector<Box> boxes(static_cast<std::size_t>(P));
  const SurfelArrays<T> in{
      s.means.value().data(),   s.quats.value().data(),   s.scales.value().data(),
      s.opacity.value().data(), s.colours.value().data(), s.aux.value().data(),
      camera.pixels.data(),     camera.jacobians.data(),  K};
  surfels.prepare(in, H, W, o.smooth_cutoffs, 0, P, records.data(), boxes.data());
  const TileLists tiles = bin(boxes, front_to_back(boxes, records.data() + kHeight, kRecord), H, W);
  const Scene<T> scene{records.data(),  boxes.data(), s.aux.value().data(), K, H, W, {},
                       o.smooth_cutoffs};
  std::vector<Index> first(static_cast<std::size_t>(P + 1));
  for (std::size_t p = 0; p < boxes.size(); ++p)
    first[p + 1] = first[p] + tiles_of(boxes[p]).count();
  // Every slot must be written: NaN would be seen.
  BasicTensor<T> slots({first.back(), kSlot + K}, std::numeric_limits<T>::quiet_NaN());
  Drawn<T> out{BasicTensor<T>({kMaps + K, H, W}), BasicTensor<T>({H, W}), {}};
  for (Index t = 0; t < tiles.rows * tiles.columns; ++t) {
    const TileJob job{t % tiles.columns * kTile, t / tiles.columns * kTile,
                      tiles.surfels.data() + tiles.first[static_cast<std::size_t>(t)],
                      tiles.count(t)};
    BasicTensor<T> scratch({kBackwardPlanes + 2 * K, kTile, kTile});
    pixels.forward(scene, job, scratch.data(), out.maps.data(), out.median.data());
    pixels.backward(scene, job, out.maps.data(), g.data(), first.data(), scratch.data(),
                    slots.data());
  }
  for (const auto* v : {&s.means, &s.quats, &s.scales, &s.opacity, &s.colours, &s.aux})
    out.grads.push_back(BasicTensor<T>(v->shape()));
  auto& d = out.grads;
  surfels.gather(in, first.data(), slots.data(), 0, P,
                 {d[0].data(), d[1].data(), d[2].data(), d[3].data(), d[4].data(), d[5].data()});
  return out;
}

/// Surfels in double whose numbers are exactly those in float.
BasicSurfels<double> widened(const BasicSurfels<float>& s) {
  const auto wide = [](const Var& v) { return BasicVar<double>(v.value().cast<double>(), true); };
  return {wide(s.means),   wide(s.quats),   wide(s.scales),
          wide(s.opacity), wide(s.colours), wide(s.aux)};
}

RasterOptions image(Index height, Index width) {
  RasterOptions o;
  o.height = height, o.width = width;
  return o;
}

}  // namespace

TEST_CASE(
    "rasterize in float, every instruction set: the oracle's values but for pixels in doubt") {
  for (const auto& [height, width, P, K] :
       {std::array<Index, 4>{45, 38, 700, 2}, {1, 1, 40, 1}, {7, 51, 150, 3}, {16, 16, 400, 1}}) {
    const auto s = random_surfels<float>(P, K, height, width, 100 + static_cast<std::uint64_t>(P));
    const auto o = image(height, width);
    const auto camera = project(s.means.value(), oblique_camera(0, 0));
    const auto want = splat_reference(s, camera, o);
    const BasicTensor<float> g({kMaps + K, height, width}, 1.f);
    for (const Isa isa : tested_isas()) {
      CAPTURE(isa_name(isa));
      CAPTURE(P);
      const auto got = draw(isa, s, camera, o, g);
      Index doubtful = 0, flips = 0;
      double worst = 0;
      for (Index i = 0; i < height * width; ++i) {
        double error = 0;
        for (Index m = 0; m < kMaps + K; ++m) {
          const Index at = m * height * width + i;
          error = std::max(error, std::abs(static_cast<double>(got.maps[at]) - want.maps[at]));
        }
        const bool crosses =
            std::isnan(want.median[i]) == std::isnan(static_cast<double>(got.median[i]));
        if (!std::isnan(want.median[i]) && crosses)
          error = std::max(error, std::abs(static_cast<double>(got.median[i]) - want.median[i]));
        if (!crosses) error = 1;
        doubtful += want.doubtful[i] != 0;
        if (error > 1e-4) ++flips;
        if (want.doubtful[i] == 0) worst = std::max(worst, error);
      }
      CHECK(worst < 1e-4);  // heights up to some metres on steep discs, else of the order of one
      CHECK(flips <= height * width / 100 + 1);
      CHECK(doubtful < height * width);
    }
  }
}

TEST_CASE("rasterize in float and double, every instruction set: one gradient") {
  const Index H = 45, W = 38, P = 700, K = 2;
  const auto s = random_surfels<float>(P, K, H, W, 17);
  const auto wide = widened(s);
  const auto o = image(H, W);
  const auto g = normal({kMaps + K, H, W}, 4);
  const auto camera = project(wide.means.value(), oblique_camera(0, 0));
  const auto narrow =
      BasicProjection<float>{camera.pixels.cast<float>(), camera.jacobians.cast<float>()};
  const auto r = rasterize(wide, camera, o);
  concat<double>(
      {r.colour, reshape(r.height, {1, H, W}), reshape(r.alpha, {1, H, W}), r.normal, r.aux}, 0)
      .backward(g);
  const BasicTensor<double>* want[] = {&wide.means.grad(),   &wide.quats.grad(),
                                       &wide.scales.grad(),  &wide.opacity.grad(),
                                       &wide.colours.grad(), &wide.aux.grad()};
  const auto compare = [&](const auto& grads, double tolerance, Index outliers) {
    for (std::size_t k = 0; k < 6; ++k) {
      CAPTURE(k);
      double square = 0;
      for (const double v : want[k]->values()) square += v * v;
      const double scale = std::sqrt(square / static_cast<double>(want[k]->count()));
      CHECK(scale > 0);
      Index off = 0;
      for (Index i = 0; i < want[k]->count(); ++i)
        off += !(std::abs(static_cast<double>(grads[k][i]) - (*want[k])[i]) <=
                 tolerance * (scale + std::abs((*want[k])[i])));
      CHECK(off <= outliers);
    }
  };
  for (const Isa isa : tested_isas()) {
    CAPTURE(isa_name(isa));
    compare(draw(isa, wide, camera, o, g).grads, 1e-10, 0);
  }
  for (const Isa isa : tested_isas()) {
    CAPTURE(isa_name(isa));
    // A contribution at the edge of a cutoff may be in or out: a few elements may differ more.
    compare(draw(isa, s, narrow, o, g.cast<float>()).grads, 1e-3, 10);
  }
}

TEST_CASE("front_to_back: descending, stable, without culled surfels") {
  const std::vector<float> heights{1.f, -0.f, 3e5f, 0.f, -2.f, 1.f, 1e-30f, -1e30f, 7.f};
  std::vector<Box> boxes(heights.size(), Box{0, 0, 0, 0});
  boxes[8] = Box{};
  CHECK(front_to_back(boxes, heights.data(), 1) ==
        std::vector<std::int32_t>{2, 0, 5, 6, 1, 3, 4, 7});
  const std::vector<double> fine{1.0, 1.0 + 1e-15, 1.0 - 1e-15};
  CHECK(front_to_back(std::vector<Box>(3, Box{0, 0, 0, 0}), fine.data(), 1) ==
        std::vector<std::int32_t>{1, 0, 2});
}

TEST_CASE_TEMPLATE("front_to_back and bin of several pieces of work, on one thread and two", T,
                   float, double) {
  const Index P = 40'000, H = 70, W = 150;
  Rng rng(23);
  std::vector<Box> boxes(static_cast<std::size_t>(P));
  std::vector<T> heights(2 * static_cast<std::size_t>(P));
  for (std::size_t p = 0; p < boxes.size(); ++p) {
    // many heights are equal, and every third surfel is culled
    heights[2 * p] = static_cast<T>(std::floor(rng.uniform(-300, 300)) / 3);
    heights[2 * p + 1] = static_cast<T>(rng.uniform());
    if (rng.chance(0.33)) continue;
    const auto x = static_cast<std::int32_t>(rng.uniform(0, static_cast<double>(W))),
               y = static_cast<std::int32_t>(rng.uniform(0, static_cast<double>(H))),
               side = static_cast<std::int32_t>(rng.uniform(0, 40));
    boxes[p] = {x, y, std::min(x + side, static_cast<std::int32_t>(W - 1)),
                std::min(y + side, static_cast<std::int32_t>(H - 1))};
  }
  std::vector<std::int32_t> want;
  for (std::int32_t p = 0; p < P; ++p)
    if (boxes[static_cast<std::size_t>(p)].x1 >= 0) want.push_back(p);
  std::ranges::stable_sort(want, std::greater{}, [&](std::int32_t p) {
    return heights[2 * static_cast<std::size_t>(p)];
  });
  REQUIRE(want.size() > 20'000);
  std::vector<Index> first{0};
  std::vector<std::int32_t> lists;
  for (Index y = 0; y < H; y += kTile)
    for (Index x = 0; x < W; x += kTile) {
      for (const std::int32_t p : want) {
        const Box& b = boxes[static_cast<std::size_t>(p)];
        if (b.x0 < x + kTile && b.x1 >= x && b.y0 < y + kTile && b.y1 >= y) lists.push_back(p);
      }
      first.push_back(std::ssize(lists));
    }
  for (const int threads : {1, 2}) {
    CAPTURE(threads);
    set_threads(threads);
    const auto order = front_to_back(boxes, heights.data(), 2);
    const TileLists tiles = bin(boxes, order, H, W);
    set_threads(0);
    CHECK((order == want));
    CHECK((tiles.first == first));
    CHECK((tiles.surfels == lists));
  }
}

TEST_CASE("bin: every tile that a box touches, in the order given") {
  const std::vector<Box> boxes{
      {0, 0, 15, 15}, {15, 15, 16, 16}, {33, 2, 39, 19}, {}, {0, 0, 39, 19}};
  const auto lists = bin(boxes, {4, 2, 0, 1}, 20, 40);
  CHECK(lists.columns == 3);
  CHECK(lists.rows == 2);
  CHECK(lists.surfels == std::vector<std::int32_t>{4, 0, 1, 4, 1, 4, 2, 4, 1, 4, 1, 4, 2});
  CHECK(lists.first == std::vector<Index>{0, 3, 5, 7, 9, 11, 13});
}

}  // namespace satsurf::test
