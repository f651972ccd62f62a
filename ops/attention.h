// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// Scaled dot-product attention, head by head:
///   out = softmax(query key^T / sqrt(d)) value, softmax over the keys
/// Source: Vaswani et al. 2017, eq. 1.
/// query    [H N d] H heads, of all images together
/// key      [H M d]
/// value    [H M e]
/// returns  [H N e]
/// throws   ShapeError, also where there is no key
/// memory   no [N M] weights are kept: they are made by blocks of queries, and again for backward
template <class T>
BasicVar<T> attention(const BasicVar<T>& query, const BasicVar<T>& key, const BasicVar<T>& value);

}  // namespace satsurf
