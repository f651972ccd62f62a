// SPDX-License-Identifier: Apache-2.0
#define EIGEN_DONT_PARALLELIZE  // pieces and threads are ours, see core/parallel.h
#include "satsurf/ops/matmul.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <algorithm>

#include <Eigen/Core>

namespace satsurf {
namespace {

template <class T>
using Matrix = Eigen::Matrix<T, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// out [M N] += op(a) op(b), op(a) [M K], op(b) [K N], in pieces of rows that depend on the extents
/// alone.
template <class T>
void add_product(T* out, Index M, Index N, Index K, const T* a, bool transpose_a, const T* b,
                 bool transpose_b) {
  if (M == 0 || N == 0 || K == 0) return;
  constexpr Index kWork = 1 << 18;  // multiply-adds per piece
  constexpr Index kLeastRows = 8;   // op(b) is packed anew for each piece
  const Index rows = std::max(kLeastRows, kWork / std::max<Index>(1, N * K));
  const Eigen::Map<const Matrix<T>> left(a, transpose_a ? K : M, transpose_a ? M : K);
  const Eigen::Map<const Matrix<T>> right(b, transpose_b ? N : K, transpose_b ? K : N);
  for_range(M, rows, [&](Index begin, Index end) {
    Eigen::Map<Matrix<T>> o(out + begin * N, end - begin, N);
    const Index R = end - begin;
    if (transpose_a && transpose_b)
      o.noalias() += left.middleCols(begin, R).transpose() * right.transpose();
    else if (transpose_a)
      o.noalias() += left.middleCols(begin, R).transpose() * right;
    else if (transpose_b)
      o.noalias() += left.middleRows(begin, R) * right.transpose();
    else
      o.noalias() += left.middleRows(begin, R) * right;
  });
}

}  // namespace

template <class T>
BasicVar<T> matmul(const BasicVar<T>& a, const BasicVar<T>& b, bool transpose_a, bool transpose_b) {
  Dims dim("matmul");
  dim.match("a", a, transpose_a ? "K M" : "M K").match("b", b, transpose_b ? "N K" : "K N");
  const Index M = dim["M"], N = dim["N"], K = dim["K"];

  BasicTensor<T> out({M, N});
  add_product(out.data(), M, N, K, a.value().data(), transpose_a, b.value().data(), transpose_b);
  return BasicVar<T>::record("matmul", out, {a, b}, [=](Node<T>& n) {
    const T *g = n.grad.data(), *x = n.in(0), *y = n.in(1);
    if (T* da = n.grad_in(0)) {
      if (transpose_a)
        add_product(da, K, M, N, y, transpose_b, g, true);
      else
        add_product(da, M, K, N, g, false, y, !transpose_b);
    }
    if (T* db = n.grad_in(1)) {
      if (transpose_b)
        add_product(db, N, K, M, g, true, x, transpose_a);
      else
        add_product(db, K, N, M, x, !transpose_a, g, false);
    }
  });
}

template BasicVar<float> matmul(const BasicVar<float>&, const BasicVar<float>&, bool, bool);
template BasicVar<double> matmul(const BasicVar<double>&, const BasicVar<double>&, bool, bool);

}  // namespace satsurf
