// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/lpips.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/feature_distance.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace satsurf::nn {
namespace {

/// One layer of a backbone. The numbers are torchvision's, which the keys contain.
struct Plan {
  enum class Kind { conv, fire, pool } kind;
  int number;  ///< of conv and fire
  Index kernel, stride, padding;
  bool ceil_mode;
};
using SlicePlan = std::vector<Plan>;

Plan conv(int number, Index kernel, Index stride, Index padding) {
  return {Plan::Kind::conv, number, kernel, stride, padding, false};
}
Plan conv3(int number) { return conv(number, 3, 1, 1); }
Plan fire(int number) { return {Plan::Kind::fire, number, 3, 1, 1, false}; }
Plan pool(Index kernel, bool ceil_mode) { return {Plan::Kind::pool, 0, kernel, 2, 0, ceil_mode}; }

std::vector<SlicePlan> plan_of(LpipsBackbone backbone) {
  switch (backbone) {
    case LpipsBackbone::alex:
      return {{conv(0, 11, 4, 2)},
              {pool(3, false), conv(3, 5, 1, 2)},
              {pool(3, false), conv3(6)},
              {conv3(8)},
              {conv3(10)}};
    case LpipsBackbone::squeeze:
      return {{conv(0, 3, 2, 0)},
              {pool(3, true), fire(3), fire(4)},
              {pool(3, true), fire(6), fire(7)},
              {pool(3, true), fire(9)},
              {fire(10)},
              {fire(11)},
              {fire(12)}};
    case LpipsBackbone::vgg:
      break;
  }
  return {{conv3(0), conv3(2)},
          {pool(2, false), conv3(5), conv3(7)},
          {pool(2, false), conv3(10), conv3(12), conv3(14)},
          {pool(2, false), conv3(17), conv3(19), conv3(21)},
          {pool(2, false), conv3(24), conv3(26), conv3(28)}};
}

/// The least extent of an image that leaves something of it to the last layer.
Index smallest_side_of(const std::vector<SlicePlan>& slices) {
  Index need = 1;
  for (auto slice = slices.rbegin(); slice != slices.rend(); ++slice)
    for (auto layer = slice->rbegin(); layer != slice->rend(); ++layer) {
      const Index whole = (need - 1) * layer->stride + layer->kernel - 2 * layer->padding;
      need = std::max<Index>(1, layer->ceil_mode ? whole - layer->stride + 1 : whole);
    }
  return need;
}

/// Takes tensors out of a file, checked.
class Reader {
 public:
  Reader(const TensorFile& file, std::string where) : file_(file), where_(std::move(where)) {}

  bool has(const std::string& key) const { return file_.tensors.contains(key); }
  /// expected  extents; 0 for any, which the error calls N
  const Tensor& get(const std::string& key, std::initializer_list<Index> expected) const {
    const auto it = file_.tensors.find(key);
    if (it == file_.tensors.end())
      throw IoError(where_ + ": no " + key + " (F32), expected the state_dict of LPIPS v0.1");
    const Tensor& t = it->second;
    bool fits = t.rank() == static_cast<Index>(expected.size()) && t.count() > 0;
    std::string text;
    Index axis = 0;
    for (const Index extent : expected) {
      text += (axis == 0 ? "" : ",") + (extent == 0 ? "N" : std::to_string(extent));
      fits = fits && (extent == 0 || t.dim(axis) == extent);
      ++axis;
    }
    if (!fits)
      throw IoError(where_ + ": " + key + " has shape " + t.shape().str() + ", expected [" + text +
                    "]");
    for (const float v : t.values())
      if (!std::isfinite(v))
        throw IoError(where_ + ": " + key + " holds " + std::to_string(v) +
                      ", expected finite numbers");
    return t;
  }

  LpipsBackbone backbone() const {
    const Tensor& first = get("net.slice1.0.weight", {0, 3, 0, 0});
    if (first.dim(2) == 11) return LpipsBackbone::alex;
    if (has("net.slice2.3.squeeze.weight")) return LpipsBackbone::squeeze;
    if (has("net.slice1.2.weight")) return LpipsBackbone::vgg;
    throw IoError(where_ +
                  ": keys of no known backbone, expected the state_dict of LPIPS v0.1 with alex, "
                  "squeeze or vgg");
  }

 private:
  const TensorFile& file_;
  std::string where_;
};

/// [C H W] as [1 C H W].
Shape as_batch(const Shape& s) { return s.rank() == 3 ? Shape{1, s[0], s[1], s[2]} : s; }

}  // namespace

const char* lpips_backbone_name(LpipsBackbone backbone) {
  switch (backbone) {
    case LpipsBackbone::alex:
      return "alex";
    case LpipsBackbone::squeeze:
      return "squeeze";
    case LpipsBackbone::vgg:
      break;
  }
  return "vgg";
}

template <class T>
BasicLpips<T>::BasicLpips(const TensorFile& file, const std::string& where) {
  const Reader in(file, where);
  backbone_ = in.backbone();
  const std::vector<SlicePlan> plan = plan_of(backbone_);
  smallest_side_ = smallest_side_of(plan);

  // [0, 1] to [-1, 1], then the colours' mean and spread
  const Tensor& shift = in.get("scaling_layer.shift", {1, 3, 1, 1});
  const Tensor& scale = in.get("scaling_layer.scale", {1, 3, 1, 1});
  for (std::size_t c = 0; c < 3; ++c) {
    const T by = static_cast<T>(scale[static_cast<Index>(c)]);
    factor_[c] = T(2) / by;
    offset_[c] = (T(-1) - static_cast<T>(shift[static_cast<Index>(c)])) / by;
  }

  Index channels = 3;
  const auto convolution = [&](const std::string& name, Index from, Index kernel, Index stride,
                               Index padding) {
    const Tensor& weight = in.get(name + ".weight", {0, from, kernel, kernel});
    const Tensor& bias = in.get(name + ".bias", {weight.dim(0)});
    return Convolution{BasicVar<T>(weight.template cast<T>()),
                       BasicVar<T>(bias.template cast<T>()),
                       {{stride, stride}, {padding, padding}}};
  };
  for (std::size_t s = 0; s < plan.size(); ++s) {
    Slice slice;
    for (const Plan& p : plan[s]) {
      const std::string name = "net.slice" + std::to_string(s + 1) + "." + std::to_string(p.number);
      if (p.kind == Plan::Kind::pool) {
        slice.steps.emplace_back(PoolOptions{p.kernel, p.stride, p.ceil_mode});
      } else if (p.kind == Plan::Kind::conv) {
        Convolution c = convolution(name, channels, p.kernel, p.stride, p.padding);
        channels = c.weight.dim(0);
        slice.steps.emplace_back(std::move(c));
      } else {
        Fire f;
        f.squeeze = convolution(name + ".squeeze", channels, 1, 1, 0);
        f.expand1 = convolution(name + ".expand1x1", f.squeeze.weight.dim(0), 1, 1, 0);
        f.expand3 = convolution(name + ".expand3x3", f.squeeze.weight.dim(0), 3, 1, 1);
        channels = f.expand1.weight.dim(0) + f.expand3.weight.dim(0);
        slice.steps.emplace_back(std::move(f));
      }
    }
    const std::string key = "lin" + std::to_string(s) + ".model.1.weight";
    slice.weight = in.get(key, {1, channels, 1, 1}).template cast<T>().reshaped({channels});
    slices_.push_back(std::move(slice));
  }
}

template <class T>
BasicLpips<T> BasicLpips<T>::load(const std::filesystem::path& path) {
  return BasicLpips(load_safetensors(path), path.string());
}

template <class T>
BasicVar<T> BasicLpips<T>::Convolution::operator()(const BasicVar<T>& x) const {
  return relu(conv2d(x, weight, bias, options));
}

/// What the network wants of an image [B 3 H W].
template <class T>
BasicVar<T> BasicLpips<T>::prepared(const BasicVar<T>& image, const BasicTensor<T>& mask) const {
  const Index B = image.dim(0), P = image.dim(2) * image.dim(3);
  const auto factor = factor_, offset = offset_;
  const auto mask_of = [mask, P](Index plane) -> const T* {
    if (mask.empty()) return nullptr;
    return mask.data() + (mask.rank() == 3 ? plane / 3 * P : 0);
  };
  auto out = BasicTensor<T>::uninitialised(as_batch(image.shape()));
  const T* x = image.value().data();
  T* y = out.data();
  for_each_index(B * 3, [&](Index plane) {
    const auto c = static_cast<std::size_t>(plane % 3);
    const T* m = mask_of(plane);
    for (Index i = 0; i < P; ++i)
      y[plane * P + i] =
          m == nullptr || m[i] != 0 ? factor[c] * x[plane * P + i] + offset[c] : offset[c];
  });
  return BasicVar<T>::record("lpips", out, {image}, [=](Node<T>& n) {
    T* dx = n.grad_in(0);
    if (dx == nullptr) return;
    const T* g = n.grad.data();
    for_each_index(B * 3, [&](Index plane) {
      const auto c = static_cast<std::size_t>(plane % 3);
      const T* m = mask_of(plane);
      for (Index i = 0; i < P; ++i)
        if (m == nullptr || m[i] != 0) dx[plane * P + i] += factor[c] * g[plane * P + i];
    });
  });
}

/// One map per slice.
template <class T>
std::vector<BasicVar<T>> BasicLpips<T>::features(BasicVar<T> x) const {
  std::vector<BasicVar<T>> found;
  for (const Slice& slice : slices_) {
    for (const Step& step : slice.steps) {
      if (const auto* p = std::get_if<PoolOptions>(&step)) {
        x = max_pool2d(x, *p);
      } else if (const auto* c = std::get_if<Convolution>(&step)) {
        x = (*c)(x);
      } else {
        const Fire& f = std::get<Fire>(step);
        x = f.squeeze(x);
        x = concat<T>({f.expand1(x), f.expand3(x)}, 1);
      }
    }
    found.push_back(x);
  }
  return found;
}

template <class T>
BasicVar<T> BasicLpips<T>::operator()(const BasicVar<T>& image, const BasicTensor<T>& reference,
                                      const BasicTensor<T>& mask) const {
  Dims dim("lpips");
  const bool batch = image.shape().rank() == 4;
  const char* const pattern = batch ? "B 3 H W" : "3 H W";
  dim.match("image", image, pattern).match("reference", reference, pattern);
  if (!mask.empty()) dim.match("mask", mask, batch && mask.rank() == 3 ? "B H W" : "H W");
  if (std::min(dim["H"], dim["W"]) < smallest_side_ || image.count() == 0)
    throw ShapeError("lpips: image has shape " + image.shape().str() +
                     ", expected H and W of at least " + std::to_string(smallest_side_) +
                     " for the backbone " + lpips_backbone_name(backbone_));
  const Shape whole = as_batch(image.shape());
  std::vector<BasicVar<T>> expected;
  {
    const NoGrad no_grad;
    expected = features(prepared(BasicVar<T>(reference.reshaped(whole)), mask));
  }
  const std::vector<BasicVar<T>> found = features(prepared(reshape(image, whole), mask));
  BasicVar<T> total;
  for (std::size_t s = 0; s < slices_.size(); ++s) {
    auto d = feature_distance(found[s], expected[s].value(), slices_[s].weight);
    total = total.empty() ? std::move(d) : add(std::move(total), std::move(d));
  }
  return total;
}

template class BasicLpips<float>;
template class BasicLpips<double>;

}  // namespace satsurf::nn
