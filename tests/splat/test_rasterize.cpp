// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"

#include <cmath>
#include <limits>

#include "tests/gradcheck.h"
#include "tests/ref/splat_ref.h"

namespace satsurf::test {
namespace {

using splat::BasicProjection;
using splat::BasicRender;
using splat::BasicSurfels;
using splat::RasterOptions;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

RasterOptions image(Index height, Index width) {
  RasterOptions o;
  o.height = height, o.width = width;
  o.background[0] = 0.3, o.background[1] = 0.6, o.background[2] = 0.1;
  return o;
}

/// All maps on top of each other, as the oracle has them.
template <class T>
BasicVar<T> stack(const BasicRender<T>& r) {
  const Index H = r.alpha.dim(0), W = r.alpha.dim(1);
  std::vector<BasicVar<T>> maps{r.colour, reshape(r.height, {1, H, W}), reshape(r.alpha, {1, H, W}),
                                r.normal};
  if (!r.aux.empty()) maps.push_back(r.aux);
  return concat(maps, 0);
}

template <class T>
BasicRender<T> render(const BasicSurfels<T>& s, const RasterOptions& o,
                      const Quadratic& camera = oblique_camera(0, 0)) {
  return splat::rasterize(s, splat::project(s.means.value(), camera), o);
}

double worst(const BasicTensor<double>& a, const BasicTensor<double>& b) {
  REQUIRE(a.shape() == b.shape());
  double w = 0;
  for (Index i = 0; i < a.count(); ++i) {
    if (std::isnan(a[i]) && std::isnan(b[i])) continue;
    const double d = std::abs(a[i] - b[i]);
    if (!(d <= w)) w = d;
  }
  return w;
}

std::vector<BasicTensor<double>> inputs_of(const BasicSurfels<double>& s) {
  return {s.means.value(),   s.quats.value(),   s.scales.value(),
          s.opacity.value(), s.colours.value(), s.aux.value()};
}
BasicSurfels<double> surfels_of(const DoubleVars& v) {
  return {v[0], v[1], v[2], v[3], v[4], v[5]};
}

/// Surfels that must leave no trace, before those that are seen: a rasteriser that mixes up the
/// order of the list with the order of what it keeps gets everything after them wrong.
BasicSurfels<double> with_culled_first(BasicSurfels<double> s) {
  s.scales.mutable_value()[0] = s.scales.mutable_value()[1] =
      1e-7;  // below a determinant of 1e-8 px^2
  s.means.mutable_value()[3 * 1] = kNan;
  s.quats.mutable_value()[4 * 2 + 3] = kInf;
  s.colours.mutable_value()[3 * 3 + 1] = kNan;
  for (Index i = 0; i < 4; ++i) s.quats.mutable_value()[4 * 4 + i] = 0;
  s.aux.mutable_value()[s.aux.dim(1) * 5] = -kInf;
  return s;
}

}  // namespace

TEST_CASE("rasterize: values are the oracle's") {
  struct Case {
    Index surfels, aux, height, width;
  };
  for (const Case c : {Case{60, 2, 21, 37}, Case{25, 0, 1, 1}, Case{40, 1, 33, 5},
                       Case{300, 3, 16, 48}, Case{7, 5, 3, 18}}) {
    CAPTURE(c.surfels);
    const auto s = random_surfels<double>(c.surfels, c.aux, c.height, c.width,
                                          5 + static_cast<std::uint64_t>(c.surfels));
    const auto o = image(c.height, c.width);
    const auto camera = splat::project(s.means.value(), oblique_camera(0, 0));
    const auto got = splat::rasterize(s, camera, o);
    const auto want = splat_reference(s, camera, o);
    CHECK(worst(stack(got).value(), want.maps) < 1e-12);
    CHECK(worst(got.median_height, want.median) < 1e-12);
    for (Index i = 0; i < got.alpha.count(); ++i)
      CHECK(got.alpha.value()[i] + want.transmittance[i] == doctest::Approx(1).epsilon(1e-12));
  }
}

TEST_CASE("rasterize: gradient without cutoffs") {
  auto o = image(18, 21);  // four tiles
  o.smooth_cutoffs = true;
  const auto s = with_culled_first(random_surfels<double>(13, 2, 18, 21, 3));
  CHECK(gradcheck([&](const DoubleVars& v) { return stack(render(surfels_of(v), o)); },
                  inputs_of(s)));
}

TEST_CASE("rasterize: gradient with all cutoffs is the oracle's difference quotient") {
  const auto o = image(19, 34);  // six tiles
  auto s = with_culled_first(random_surfels<double>(18, 3, 19, 34, 8));
  s.opacity.mutable_value()[7] = 1 - 1e-9;  // saturates in the middle
  s.opacity.mutable_value()[8] = 0.003;     // below 1/255: culled
  const auto f = [&](const DoubleVars& v) {
    const auto surfels = surfels_of(v);
    const auto camera = splat::project(surfels.means.value(), oblique_camera(0, 0));
    if (NoGrad::active()) return BasicVar<double>(splat_reference(surfels, camera, o).maps);
    return stack(splat::rasterize(surfels, camera, o));
  };
  CHECK(gradcheck(f, inputs_of(s)));
}

TEST_CASE("rasterize: one output alone, without aux") {
  const auto o = image(9, 23);
  const auto s = random_surfels<double>(9, 0, 9, 23, 21);
  const std::vector<BasicTensor<double>> inputs{s.means.value(), s.quats.value(), s.scales.value(),
                                                s.opacity.value(), s.colours.value()};
  GradcheckOptions opt;
  const auto with = [&](auto pick) {
    return gradcheck(
        [&](const DoubleVars& v) {
          return pick(render(BasicSurfels<double>{v[0], v[1], v[2], v[3], v[4], {}}, o));
        },
        inputs, opt);
  };
  CHECK(with([](const auto& r) { return r.colour; }));
  opt.zero_ok = {4};  // the rest does not depend on colours
  CHECK(with([](const auto& r) { return r.height; }));
  CHECK(with([](const auto& r) { return r.alpha; }));
  CHECK(with([](const auto& r) { return r.normal; }));
}

TEST_CASE(
    "rasterize: surfels with numbers that are not finite change nothing and get no gradient") {
  const auto o = image(20, 20);
  const auto all = random_surfels<double>(20, 1, 20, 20, 4);
  const Index dropped = 6;
  const auto keep = [&](const BasicVar<double>& v) {
    return slice(v.detach(), 0, dropped, v.dim(0));
  };
  const BasicSurfels<double> rest{keep(all.means),   keep(all.quats),   keep(all.scales),
                                  keep(all.opacity), keep(all.colours), keep(all.aux)};
  const auto bad = with_culled_first(all);
  const auto out = stack(render(bad, o));
  CHECK(worst(out.value(), stack(render(rest, o)).value()) == 0);
  out.backward(BasicTensor<double>(out.shape(), 1.0));
  for (const auto* v :
       {&bad.means, &bad.quats, &bad.scales, &bad.opacity, &bad.colours, &bad.aux}) {
    const Index n = v->count() / v->dim(0);
    for (Index i = 0; i < v->count(); ++i) {
      CHECK(std::isfinite(v->grad()[i]));
      if (i < n * dropped) CHECK(v->grad()[i] == 0);
    }
  }
  for (const double evil : {kNan, kInf, -kInf}) {
    auto pixels = splat::project(all.means.value(), oblique_camera(0, 0));
    pixels.pixels[1] = evil;
    pixels.jacobians[6 + 4] = evil;
    const auto alpha = splat::rasterize(all, pixels, o).alpha;
    for (const double a : alpha.value().values()) CHECK(std::isfinite(a));
  }
}

TEST_CASE("rasterize: nothing to draw") {
  const auto o = image(2, 19);
  for (const Index K : {Index{0}, Index{2}}) {
    const auto s = random_surfels<double>(0, K, 2, 19, 1);
    const auto r = render(s, o);
    for (Index i = 0; i < 38; ++i) {
      CHECK(r.colour.value()[38 + i] == 0.6);
      CHECK(r.alpha.value()[i] == 0);
      CHECK(r.height.value()[i] == 0);
      CHECK(std::isnan(r.median_height[i]));
    }
    CHECK(r.aux.empty() == (K == 0));
    const auto out = stack(r);
    out.backward(BasicTensor<double>(out.shape(), 1.0));
    CHECK(s.means.grad().count() == 0);
  }
}

TEST_CASE("rasterize: huge, edge-on and extreme surfels") {
  const auto o = image(17, 18);
  auto s = random_surfels<double>(6, 1, 17, 18, 2);
  auto& scales = s.scales.mutable_value();
  scales[0] = scales[1] = 1e6;                      // covers everything evenly
  s.opacity.mutable_value()[1] = 1 - 1e-12;         // saturated
  s.opacity.mutable_value()[2] = 1.0 / 255 + 1e-9;  // only at its very centre, if at all
  scales[6] = 1e-3, scales[7] = 3;                  // a needle, seen through the pixel filter
  const auto camera = splat::project(s.means.value(), oblique_camera(0, 0));
  // A disc that contains the line of sight, but for a thousandth of a degree.
  const double sight[3] = {0.2 * -0.7 - 0.5 * -2.0, 0.5 * 0.15 - 1.9 * -0.7,
                           1.9 * -2.0 - 0.2 * 0.15};
  const double angle = std::atan2(sight[2], std::hypot(sight[0], sight[1])),
               heading = std::atan2(sight[1], sight[0]);
  const double half = -angle / 2 + 1e-5;
  auto& q = s.quats.mutable_value();
  q[16] = std::cos(half) * std::cos(heading / 2), q[17] = -std::sin(half) * std::sin(heading / 2);
  q[18] = std::sin(half) * std::cos(heading / 2), q[19] = std::cos(half) * std::sin(heading / 2);
  const auto got = splat::rasterize(s, camera, o);
  const auto want = splat_reference(s, camera, o);
  CHECK(worst(stack(got).value(), want.maps) < 1e-9);
  for (const double a : got.alpha.value().values()) CHECK((a > 0 && a < 1));
  const auto out = stack(got);
  out.backward(BasicTensor<double>(out.shape(), 1.0));
  for (const double g : s.quats.grad().values()) CHECK(std::isfinite(g));
}

TEST_CASE("rasterize: the order of the list does not matter") {
  const auto o = image(25, 30);
  const Index P = 80;
  const auto s = random_surfels<double>(P, 1, 25, 30, 6);
  const auto reversed = [&](const BasicVar<double>& v) {
    auto t = v.value().clone();
    const Index n = t.count() / P;
    for (Index p = 0; p < P; ++p)
      for (Index i = 0; i < n; ++i) t[p * n + i] = v.value()[(P - 1 - p) * n + i];
    return BasicVar<double>(t);
  };
  const BasicSurfels<double> back{reversed(s.means),   reversed(s.quats),   reversed(s.scales),
                                  reversed(s.opacity), reversed(s.colours), reversed(s.aux)};
  CHECK(worst(stack(render(s, o)).value(), stack(render(back, o)).value()) == 0);
}

TEST_CASE("rasterize: equal heights are drawn in the order of the list") {
  const auto o = image(4, 4);
  auto s = random_surfels<float>(2, 0, 4, 4, 6);
  for (Index i = 0; i < 6; ++i) s.means.mutable_value()[i] = i % 3 == 2 ? 0.f : 0.5f;
  s.means.mutable_value()[2] = -0.f;
  s.means.mutable_value()[5] = 0.f;
  for (Index i = 0; i < 4; ++i) s.scales.mutable_value()[i] = 1e4f;
  s.opacity.mutable_value().fill(0.9f);
  for (Index i = 0; i < 6; ++i) s.colours.mutable_value()[i] = i < 3 ? 1.f : 0.f;
  CHECK(render(s, o).colour.value()[0] == doctest::Approx(0.9 + 0.01 * 0.3).epsilon(1e-5));
}

TEST_CASE("rasterize: moving camera and image together changes nothing") {
  const auto s = random_surfels<double>(60, 1, 30, 40, 12);
  const auto big = stack(render(s, image(30, 40))).value();
  const Index dx = 7, dy = 5;
  const auto part = stack(render(s, image(25, 33), oblique_camera(-7, -5))).value();
  double w = 0;
  for (Index c = 0; c < 9; ++c)
    for (Index y = 0; y < 25; ++y)
      for (Index x = 0; x < 33; ++x)
        w = std::max(w,
                     std::abs(part[(c * 25 + y) * 33 + x] - big[(c * 30 + y + dy) * 40 + x + dx]));
  CHECK(w < 1e-12);
}

TEST_CASE("rasterize: a tilted plane of surfels has the plane's height") {
  // z = 0.3 x - 0.2 y + 4, surfels 0.4 m apart that lie in the plane, wide enough to be seen as
  // discs
  const double gx = 0.3, gy = -0.2, z0 = 4;
  const Index n = 64, P = n * n;
  BasicSurfels<float> s{Var(Tensor({P, 3}), true), Var(Tensor({P, 4})),
                        Var(Tensor({P, 2}, 0.8f)), Var(Tensor({P}, 0.8f)),
                        Var(Tensor({P, 3}, 0.5f)), {}};
  // the rotation that takes (0, 0, 1) to the normal (-gx, -gy, 1) / |.|
  const double length = std::sqrt(gx * gx + gy * gy + 1);
  const double q[4] = {1 + 1 / length, gy / length, -gx / length, 0};
  for (Index p = 0; p < P; ++p) {
    const double x = 0.4 * static_cast<double>(p % n) - 6,
                 y = -0.4 * static_cast<double>(p / n) + 6;
    const double xyz[3] = {x, y, z0 + gx * x + gy * y};
    for (Index i = 0; i < 3; ++i) s.means.mutable_value()[3 * p + i] = static_cast<float>(xyz[i]);
    for (Index i = 0; i < 4; ++i) s.quats.mutable_value()[4 * p + i] = static_cast<float>(q[i]);
  }
  const auto o = image(20, 20);
  const auto r = render(s, o);
  // pixel = a x + b y + c z + ..., together with the plane: two equations for the point seen
  double worst_mean = 0, worst_median = 0;
  for (Index i = 0; i < 400; ++i) {
    const double px = static_cast<double>(i % 20) - 0.5 * z0,
                 py = static_cast<double>(i / 20) + 0.7 * z0;
    const double a = 1.9 + 0.5 * gx, b = 0.2 + 0.5 * gy, c = 0.15 - 0.7 * gx, d = -2.0 - 0.7 * gy;
    const double x = (d * px - b * py) / (a * d - b * c), y = (a * py - c * px) / (a * d - b * c);
    const double z = z0 + gx * x + gy * y;
    CHECK(r.alpha.value()[i] > 0.99f);
    worst_mean = std::max(worst_mean, std::abs(static_cast<double>(r.height.value()[i]) - z));
    worst_median = std::max(worst_median, std::abs(static_cast<double>(r.median_height[i]) - z));
    for (Index k = 0; k < 3; ++k) {
      const double want = (k == 2 ? 1 : k == 0 ? -gx : -gy) / length;
      CHECK(r.normal.value()[400 * k + i] / r.alpha.value()[i] ==
            doctest::Approx(want).epsilon(1e-4));
    }
  }
  CHECK(worst_mean < 1e-3);
  CHECK(worst_median < 1e-3);
}

TEST_CASE("rasterize: one thread and two give the same bits") {
  const auto o = image(70, 65);
  const auto run = [&](int n) {
    set_threads(n);
    const auto s = random_surfels<float>(5000, 1, 70, 65, 31);
    const auto r = render(s, o);
    const auto out = stack(r);
    out.backward(Tensor(out.shape(), 0.7f));
    set_threads(0);
    std::vector<Tensor> all{out.value(), r.median_height};
    for (const auto* v : {&s.means, &s.quats, &s.scales, &s.opacity, &s.colours, &s.aux})
      all.push_back(v->grad());
    return all;
  };
  const auto one = run(1), two = run(2);
  for (std::size_t k = 0; k < one.size(); ++k) {
    CAPTURE(k);
    REQUIRE(one[k].count() > 0);
    CHECK(std::equal(reinterpret_cast<const char*>(one[k].data()),
                     reinterpret_cast<const char*>(one[k].data() + one[k].count()),
                     reinterpret_cast<const char*>(two[k].data())));
  }
}

TEST_CASE("project: values and derivatives of the quadratic") {
  Quadratic q = oblique_camera(3, 4);
  q.offset = {1, 2, 3};
  q.scale = {10, 20, 30};
  q.coeff[0][4] = 0.1, q.coeff[1][8] = -0.3, q.coeff[1][9] = 0.2;
  const auto means = normal({5, 3}, 3, 4.0);
  const auto p = splat::project(means, q);
  const double h = 1e-5;
  for (Index i = 0; i < 5; ++i)
    for (Index c = 0; c < 3; ++c) {
      double up[3], down[3];
      for (Index k = 0; k < 3; ++k) up[k] = down[k] = means[3 * i + k];
      up[c] += h, down[c] -= h;
      const auto a = q(up[0], up[1], up[2]), b = q(down[0], down[1], down[2]);
      for (std::size_t k = 0; k < 2; ++k) {
        const Index row = 2 * i + static_cast<Index>(k);
        CHECK(p.jacobians[3 * row + c] == doctest::Approx((a[k] - b[k]) / (2 * h)).epsilon(1e-8));
        CHECK(p.pixels[row] == q(means[3 * i], means[3 * i + 1], means[3 * i + 2])[k]);
      }
    }
  CHECK_THROWS_WITH_AS(splat::project(normal({5, 2}, 1), q),
                       "project: means has shape [5,2], expected [P 3]", ShapeError);
}

TEST_CASE("rasterize: wrong shapes are refused by name") {
  const auto o = image(4, 5);
  const auto good = random_surfels<double>(3, 2, 4, 5, 1);
  const auto camera = splat::project(good.means.value(), oblique_camera(0, 0));
  auto s = good;
  s.quats = BasicVar<double>(normal({3, 3}, 1));
  CHECK_THROWS_WITH_AS(splat::rasterize(s, camera, o),
                       "rasterize: quats has shape [3,3], expected [P 4] with P=3 from means",
                       ShapeError);
  s = good;
  s.aux = BasicVar<double>(normal({4, 2}, 1));
  CHECK_THROWS_WITH_AS(splat::rasterize(s, camera, o),
                       "rasterize: aux has shape [4,2], expected [P K] with P=3 from means",
                       ShapeError);
  s = good;
  s.opacity = {};
  CHECK_THROWS_WITH_AS(splat::rasterize(s, camera, o),
                       "rasterize: opacity is missing, expected all but aux", ShapeError);
  CHECK_THROWS_WITH_AS(splat::rasterize(good, camera, image(0, 5)),
                       "rasterize: image of 0 x 5 pixels, expected 1 to 1048576 each way",
                       ShapeError);
  auto few = camera;
  few.pixels = BasicTensor<double>({2, 2});
  CHECK_THROWS_WITH_AS(splat::rasterize(good, few, o),
                       "rasterize: pixels has shape [2,2], expected [P 2] with P=3 from means",
                       ShapeError);
}

}  // namespace satsurf::test
