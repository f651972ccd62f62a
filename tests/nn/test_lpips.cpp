// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/core/safetensors.h"
#include "satsurf/nn/lpips.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/resize.h"
#include "satsurf/ops/ssim.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <string>

#include "tests/gradcheck.h"
#include "tests/paths.h"
#include "tests/temp_folder.h"

using namespace satsurf;
using nn::BasicLpips;
using test::error_of;

namespace {

/// What scikit-image and PyTorch make of two images, see golden/make_image_golden.py.
const TensorFile& golden() {
  static const TensorFile file =
      load_safetensors(test::tests_folder() / "golden" / "image_golden.safetensors");
  return file;
}
BasicTensor<double> golden(const std::string& name) {
  return golden().tensors.at(name).cast<double>();
}
double number(const std::string& name) { return golden().doubles.at(name).item(); }

/// The small network of one backbone.
TensorFile network(const std::string& kind) {
  TensorFile file;
  const std::string prefix = "lpips." + kind + ".";
  for (const auto& [name, tensor] : golden().tensors)
    if (name.starts_with(prefix + "net.") || name.starts_with(prefix + "lin") ||
        name.starts_with(prefix + "scaling_layer."))
      file.tensors[name.substr(prefix.size())] = tensor.clone();
  return file;
}

const char* const kKinds[] = {"alex", "squeeze", "vgg"};

/// The error text for a file from which one thing is changed.
template <class F>
std::string refusal(const std::string& kind, const F& change) {
  TensorFile file = network(kind);
  change(file.tensors);
  return error_of<IoError>([&] { BasicLpips<float>(file, "w.safetensors"); });
}

}  // namespace

TEST_CASE("ssim agrees with scikit-image and PyTorch") {
  BasicVar<double> x(golden("ssim.x"), true);
  const auto y = golden("ssim.y");
  CHECK(ssim(x, y, SsimKind::skimage).value().item() ==
        doctest::Approx(number("ssim.skimage")).epsilon(1e-12));
  const auto conv = ssim(x, y, SsimKind::conv);
  CHECK(conv.value().item() == doctest::Approx(number("ssim.conv")).epsilon(1e-12));
  conv.backward();
  const auto dx = golden("ssim.conv.dx");
  for (Index i = 0; i < dx.count(); ++i) REQUIRE(std::abs(x.grad()[i] - dx[i]) < 1e-8);
}

TEST_CASE_TEMPLATE("lpips agrees with PyTorch", T, float, double) {
  const double tolerance = sizeof(T) == 4 ? 2e-5 : 1e-7;  // of the gradients, stored as float
  for (const std::string kind : kKinds) {
    CAPTURE(kind);
    const BasicLpips<T> lpips(network(kind), kind);
    CHECK(nn::lpips_backbone_name(lpips.backbone()) == kind);
    const std::string at = "lpips." + kind + ".";
    BasicVar<T> x(golden(at + "x").cast<T>(), true);
    const auto y = golden(at + "y").cast<T>(), mask = golden(at + "mask").cast<T>();
    const auto d = lpips(x, y);
    CHECK(static_cast<double>(d.value().item()) ==
          doctest::Approx(number(at + "value")).epsilon(sizeof(T) == 4 ? 1e-5 : 1e-12));
    d.backward();
    const auto dx = golden(at + "dx");
    double largest = 0, worst = 0;
    for (Index i = 0; i < dx.count(); ++i) {
      largest = std::max(largest, std::abs(dx[i]));
      worst = std::max(worst, std::abs(static_cast<double>(x.grad()[i]) - dx[i]));
    }
    CHECK(worst < tolerance * largest);
    CHECK(static_cast<double>(lpips(x, y, mask).value().item()) ==
          doctest::Approx(number(at + "masked")).epsilon(sizeof(T) == 4 ? 1e-5 : 1e-12));
    CHECK(lpips(x, x.value()).value().item() == 0);
  }
}

TEST_CASE("lpips gradient") {
  for (const std::string kind : kKinds) {
    CAPTURE(kind);
    const BasicLpips<double> lpips(network(kind), kind);
    const std::string at = "lpips." + kind + ".";
    const Index H = lpips.smallest_side(), W = H + (kind == "alex" ? 0 : 2);
    const Index B = kind == "squeeze" ? 2 : 1;
    const auto x = golden(at + "x"), y = golden(at + "y");
    const auto crop = [&](const BasicTensor<double>& t) {
      auto out = BasicTensor<double>::uninitialised({B, 3, H, W});
      for (Index b = 0; b < B; ++b)
        for (Index c = 0; c < 3; ++c)
          for (Index i = 0; i < H; ++i)
            for (Index j = 0; j < W; ++j)
              out[((b * 3 + c) * H + i) * W + j] = t[(c * t.dim(2) + i + b) * t.dim(3) + j + b];
      return out;
    };
    auto mask = BasicTensor<double>({B, H, W}, 1.0);
    for (Index i = 0; i < mask.count(); i += 3) mask[i] = 0;
    // PyTorch's gradient is compared pixel by pixel above; here a pixel of v stands for a block
    const BasicVar<double> base(crop(x));
    CHECK(test::gradcheck(
        [&](auto& v) { return lpips(base + resize_nearest(v[0], H, W), crop(y), mask); },
        {test::normal({B, 3, 4, 5}, 1, 0.1)}));
  }
}

TEST_CASE("lpips does not see what a mask hides") {
  const BasicLpips<float> lpips(network("squeeze"), "w");
  const auto x = golden("lpips.squeeze.x").cast<float>().reshaped({3, 22, 29});
  const auto y = golden("lpips.squeeze.y").cast<float>().reshaped({3, 22, 29});
  const auto mask = golden("lpips.squeeze.mask").cast<float>();
  auto odd = x.clone(), odd_y = y.clone();
  for (Index i = 0; i < odd.count(); ++i)
    if (mask[i % mask.count()] == 0) {
      odd[i] = std::numeric_limits<float>::quiet_NaN();
      odd_y[i] = 5;
    }
  Var a(x, true), b(odd, true);
  const Var da = lpips(a, y, mask), db = lpips(b, odd_y, mask);
  CHECK(da.value().item() == db.value().item());
  da.backward();
  db.backward();
  for (Index i = 0; i < x.count(); ++i) {
    REQUIRE(a.grad()[i] == b.grad()[i]);
    if (mask[i % mask.count()] == 0) REQUIRE(a.grad()[i] == 0);
  }
}

TEST_CASE("lpips does not depend on the number of threads") {
  const BasicLpips<float> lpips(network("alex"), "w");
  const auto x = golden("lpips.alex.x").cast<float>(), y = golden("lpips.alex.y").cast<float>();
  Var one(x.clone(), true), two(x.clone(), true);
  set_threads(1);
  const Var a = lpips(one, y);
  a.backward();
  set_threads(2);
  const Var b = lpips(two, y);
  b.backward();
  set_threads(0);
  CHECK(a.value().item() == b.value().item());
  for (Index i = 0; i < x.count(); ++i) REQUIRE(one.grad()[i] == two.grad()[i]);
}

TEST_CASE("lpips refuses images that do not fit") {
  const Index least[] = {31, 17, 16};
  for (std::size_t k = 0; k < 3; ++k) {
    const BasicLpips<float> lpips(network(kKinds[k]), "w");
    const Index n = least[k];
    CHECK(lpips.smallest_side() == n);
    CHECK(lpips(Var(Tensor({3, n, n + 1})), Tensor({3, n, n + 1})).value().item() == 0);
    const std::string text = "lpips: image has shape [3," + std::to_string(n + 1) + "," +
                             std::to_string(n - 1) + "], expected H and W of at least " +
                             std::to_string(n) + " for the backbone " + kKinds[k];
    CHECK(error_of<ShapeError>([&] {
            lpips(Var(Tensor({3, n + 1, n - 1})), Tensor({3, n + 1, n - 1}));
          }) == text);
  }
  const BasicLpips<float> lpips(network("vgg"), "w");
  const Var x(Tensor({3, 20, 20}));
  CHECK_THROWS_WITH_AS(lpips(Var(Tensor({1, 20, 20})), Tensor({1, 20, 20})),
                       "lpips: image has shape [1,20,20], expected [3 H W]", ShapeError);
  CHECK_THROWS_WITH_AS(lpips(x, Tensor({3, 20, 21})),
                       "lpips: reference has shape [3,20,21], expected [3 H W] with H=20 from "
                       "image, W=20 from image",
                       ShapeError);
  CHECK_THROWS_WITH_AS(
      lpips(x, Tensor({3, 20, 20}), Tensor({20, 19})),
      "lpips: mask has shape [20,19], expected [H W] with H=20 from image, W=20 from image",
      ShapeError);
}

TEST_CASE("lpips refuses files that do not fit") {
  CHECK(refusal("alex", [](auto& t) { t.clear(); }) ==
        "w.safetensors: no net.slice1.0.weight (F32), expected the state_dict of LPIPS v0.1");
  CHECK(refusal("squeeze", [](auto& t) { t.erase("net.slice5.10.expand3x3.bias"); }) ==
        "w.safetensors: no net.slice5.10.expand3x3.bias (F32), expected the state_dict of LPIPS "
        "v0.1");
  CHECK(
      refusal("squeeze", [](auto& t) { t.erase("net.slice2.3.squeeze.weight"); }) ==
      "w.safetensors: keys of no known backbone, expected the state_dict of LPIPS v0.1 with alex, "
      "squeeze or vgg");
  CHECK(refusal("vgg", [](auto& t) {
          t["net.slice2.7.weight"] = Tensor({5, 4, 3, 3});
        }) == "w.safetensors: net.slice2.7.weight has shape [5,4,3,3], expected [N,3,3,3]");
  CHECK(refusal("vgg", [](auto& t) { t["net.slice2.7.bias"] = Tensor({4}); }) ==
        "w.safetensors: net.slice2.7.bias has shape [4], expected [5]");
  CHECK(refusal("alex", [](auto& t) {
          t["lin4.model.1.weight"] = Tensor({1, 5, 1, 1});
        }) == "w.safetensors: lin4.model.1.weight has shape [1,5,1,1], expected [1,4,1,1]");
  CHECK(refusal("alex", [](auto& t) { t["scaling_layer.shift"] = Tensor({3}); }) ==
        "w.safetensors: scaling_layer.shift has shape [3], expected [1,3,1,1]");
  CHECK(refusal("alex", [](auto& t) {
          t["lin0.model.1.weight"][2] = std::numeric_limits<float>::quiet_NaN();
        }).starts_with("w.safetensors: lin0.model.1.weight holds "));
  CHECK(refusal("alex", [](auto& t) {
          t["lins.0.model.1.weight"] = Tensor({1, 4, 1, 1});
        }) == "no exception");
  CHECK(error_of<IoError>([] {
          nn::Lpips::load("/nowhere/w.safetensors");
        }).starts_with("/nowhere/w.safetensors: "));
}
