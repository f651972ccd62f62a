// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/safetensors.h"
#include "satsurf/core/var.h"

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace satsurf::nn {

/// How a new parameter is filled.
struct Init {
  enum class Kind { constant, kaiming } kind = Kind::constant;
  double value = 0;  ///< of a constant
  Index fan_in = 1;  ///< of kaiming: N(0, 2 / fan_in) (He et al. 2015, eq. 10)
  static Init constant(double value) { return {Kind::constant, value, 1}; }
  static Init kaiming(Index fan_in) { return {Kind::kaiming, 0, fan_in}; }
};

/// The named parameters of a model, in creation order. Values depend on the seed and the name
/// alone, so adding a layer does not change the others.
template <class T>
class ParameterSet {
 public:
  struct Entry {
    std::string name;
    BasicVar<T> var;  ///< shared with the layer that uses it
    bool decays;      ///< weight decay applies (weights yes, norms and biases no)
  };

  explicit ParameterSet(std::uint64_t seed) : seed_(seed) {}

  /// Adds a parameter.
  /// name    under which it is stored
  /// init    how it is filled
  /// decays  whether weight decay applies
  /// throws  Error if the name is taken
  BasicVar<T> create(const std::string& name, const Shape& shape, const Init& init, bool decays);

  const std::vector<Entry>& entries() const { return entries_; }
  /// Numbers in all.
  Index count() const;
  void clear_grads();

  /// Adds every parameter under `prefix` + its name.
  void store(TensorFile& file, const std::string& prefix) const;
  /// Takes every parameter from `prefix` + its name, all or none.
  /// where   begins the error texts
  /// throws  IoError listing missing, extra and mis-shaped names, or naming a parameter that holds
  ///         NaN or infinity
  void load(const TensorFile& file, const std::string& prefix, const std::string& where);
  /// The same for a file of a model with fewer parts: those it lacks stay as they are.
  /// returns  their names
  /// throws   IoError as `load`, or if the file has none of the parameters
  std::vector<std::string> load_present(const TensorFile& file, const std::string& prefix,
                                        const std::string& where);

 private:
  std::vector<std::string> take(const TensorFile& file, const std::string& prefix,
                                const std::string& where, bool all);

  std::uint64_t seed_;
  std::vector<Entry> entries_;
};

}  // namespace satsurf::nn
