// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/module.h"

#include "satsurf/core/hash.h"
#include "satsurf/core/rng.h"
#include "satsurf/nn/parameter_limit.h"

#include <cmath>
#include <set>

namespace satsurf::nn {
namespace {

void append_some(std::string& text, const char* what, const std::vector<std::string>& names) {
  if (names.empty()) return;
  text += "; ";
  text += what;
  constexpr std::size_t kShown = 3;
  for (std::size_t i = 0; i < names.size() && i < kShown; ++i)
    text += (i > 0 ? ", " : " ") + names[i];
  if (names.size() > kShown) text += " and " + std::to_string(names.size() - kShown) + " more";
}

thread_local ParameterLimit* limit = nullptr;

}  // namespace

ParameterLimit::ParameterLimit(Index most, std::string where)
    : left_(most), most_(most), where_(std::move(where)), outer_(limit) {
  limit = this;
}

ParameterLimit::~ParameterLimit() { limit = outer_; }

void ParameterLimit::count(const Shape& shape) {
  if (shape.count() > left_)
    throw IoError(where_ + ": its configuration asks for a network of more than " +
                  std::to_string(most_) + " parameters, expected the size that the file holds");
  left_ -= shape.count();
}

template <class T>
BasicVar<T> ParameterSet<T>::create(const std::string& name, const Shape& shape, const Init& init,
                                    bool decays) {
  for (const Entry& e : entries_)
    if (e.name == name) throw Error("ParameterSet: parameter " + name + " exists already");
  if (limit != nullptr) limit->count(shape);
  BasicTensor<T> value(shape, static_cast<T>(init.value));
  if (init.kind == Init::Kind::kaiming && limit == nullptr) {
    Rng rng(seed_, fnv1a(name));  // a stream of its own for each name
    const double sigma = std::sqrt(2.0 / static_cast<double>(init.fan_in));
    for (T& v : value.values()) v = static_cast<T>(sigma * rng.normal());
  }
  return entries_.emplace_back(Entry{name, BasicVar<T>(std::move(value), true), decays}).var;
}

template <class T>
Index ParameterSet<T>::count() const {
  Index n = 0;
  for (const Entry& e : entries_) n += e.var.count();
  return n;
}

template <class T>
void ParameterSet<T>::clear_grads() {
  for (Entry& e : entries_) e.var.clear_grad();
}

template <class T>
void ParameterSet<T>::store(TensorFile& file, const std::string& prefix) const {
  for (const Entry& e : entries_)
    file.tensors[prefix + e.name] = e.var.value().template cast<float>();
}

template <class T>
void ParameterSet<T>::load(const TensorFile& file, const std::string& prefix,
                           const std::string& where) {
  take(file, prefix, where, true);
}

template <class T>
std::vector<std::string> ParameterSet<T>::load_present(const TensorFile& file,
                                                       const std::string& prefix,
                                                       const std::string& where) {
  return take(file, prefix, where, false);
}

template <class T>
std::vector<std::string> ParameterSet<T>::take(const TensorFile& file, const std::string& prefix,
                                               const std::string& where, bool all) {
  std::vector<std::string> missing, misshaped, extra;
  std::set<std::string> known;
  for (const Entry& e : entries_) {
    known.insert(prefix + e.name);
    const auto it = file.tensors.find(prefix + e.name);
    if (it == file.tensors.end())
      missing.push_back(e.name);
    else if (it->second.shape() != e.var.shape())
      misshaped.push_back(e.name + " (" + it->second.shape().str() + ", expected " +
                          e.var.shape().str() + ")");
  }
  for (const auto& [name, tensor] : file.tensors)
    if (name.starts_with(prefix) && !known.contains(name))
      extra.push_back(name.substr(prefix.size()));
  const bool too_few = all ? !missing.empty() : missing.size() == entries_.size();
  if (too_few || !misshaped.empty() || !extra.empty()) {
    std::string text = where + ": these parameters do not fit the model";
    if (too_few) append_some(text, "missing", missing);
    append_some(text, "of another shape", misshaped);
    append_some(text, "not in the model", extra);
    throw IoError(text);
  }
  std::vector<std::pair<Entry*, const Tensor*>> found;
  for (Entry& e : entries_)
    if (const auto it = file.tensors.find(prefix + e.name); it != file.tensors.end())
      found.emplace_back(&e, &it->second);
  for (const auto& [e, tensor] : found)
    for (const float v : tensor->values())
      if (!std::isfinite(v))
        throw IoError(where + ": parameter " + e->name + " holds " + std::to_string(v) +
                      ", expected finite numbers");
  for (const auto& [e, tensor] : found) e->var.mutable_value() = tensor->template cast<T>();
  return missing;
}

template class ParameterSet<float>;
template class ParameterSet<double>;

}  // namespace satsurf::nn
