// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/dims.h"

#include <cctype>
#include <cstdlib>
#include <sstream>

namespace satsurf {

const Dims::Binding* Dims::find(const std::string& letter) const {
  for (const Binding& b : bound_)
    if (b.letter == letter) return &b;
  return nullptr;
}

Dims& Dims::match_shape(const char* name, const Shape& shape, const char* pattern) {
  std::vector<std::string> letters;
  std::istringstream in(pattern);
  for (std::string word; in >> word;) letters.push_back(word);

  std::string expected = "[", why;
  bool ok = std::ssize(letters) == shape.rank();
  for (std::size_t a = 0; a < letters.size(); ++a) {
    const std::string& l = letters[a];
    if (a > 0) expected += ' ';
    expected += l;
    if (std::isdigit(static_cast<unsigned char>(l[0])) != 0) {
      if (ok && shape[a] != std::atol(l.c_str())) ok = false;
    } else if (const Binding* b = find(l)) {
      if (b->from != name)
        why += (why.empty() ? " with " : ", ") + l + "=" + std::to_string(b->extent) + " from " +
               b->from;
      if (ok && shape[a] != b->extent) ok = false;
    } else if (ok) {
      bound_.push_back({l, shape[a], name});
    }
  }
  if (!ok)
    throw ShapeError(where_ + ": " + name + " has shape " + shape.str() + ", expected " + expected +
                     "]" + why);
  return *this;
}

Index Dims::operator[](const char* letter) const {
  if (const Binding* b = find(letter)) return b->extent;
  throw ShapeError(where_ + ": extent " + letter + ", expected one that an argument has bound");
}

}  // namespace satsurf
