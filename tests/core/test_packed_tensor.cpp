// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/packed_tensor.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include <doctest/doctest.h>

using namespace satsurf;

TEST_CASE("the levels of an image are kept in a byte each, exactly") {
  Tensor t({2, 128});
  for (Index i = 0; i < 256; ++i) t[i] = static_cast<float>(i) * (1.0f / 255.0f);
  const PackedTensor packed = PackedTensor::levels(t, 1.0f / 255.0f);
  CHECK(packed.bytes() == 256);
  CHECK(packed.shape() == t.shape());
  const Tensor back = packed.tensor();
  CHECK(std::ranges::equal(back.values(), t.values()));
  float part[3];
  packed.read(126, 3, part);
  CHECK(std::ranges::equal(part, std::span(t.data() + 126, 3)));
}

TEST_CASE("what is no level is kept as it is") {
  for (const float odd :
       {0.5f, -1.0f, 256.0f, std::nanf(""), std::numeric_limits<float>::infinity()}) {
    CAPTURE(odd);
    const Tensor t = Tensor::from({3}, {0, odd, 7});
    const PackedTensor packed = PackedTensor::levels(t, 1);
    CHECK(packed.bytes() == 12);
    CHECK(packed.tensor().data() == t.data());
    float part[2];
    packed.read(1, 2, part);
    CHECK(std::bit_cast<std::uint32_t>(part[0]) == std::bit_cast<std::uint32_t>(odd));
    CHECK(part[1] == 7);
  }
  CHECK(PackedTensor().empty());
  CHECK(PackedTensor::levels({}, 1).tensor().empty());
  CHECK(PackedTensor::halves({}).tensor().empty());
}

TEST_CASE("every number of half precision comes back as it was") {
  __extension__ using Half = _Float16;
  Tensor t({1 << 16});
  for (Index i = 0; i < t.count(); ++i)
    t[i] = static_cast<float>(std::bit_cast<Half>(static_cast<std::uint16_t>(i)));
  const PackedTensor packed = PackedTensor::halves(t);
  CHECK(packed.bytes() == std::size_t{2} << 16);
  const Tensor back = packed.tensor();
  Index wrong = 0;
  for (Index i = 0; i < t.count(); ++i)
    wrong += std::isnan(t[i])
                 ? !std::isnan(back[i])
                 : std::bit_cast<std::uint32_t>(back[i]) != std::bit_cast<std::uint32_t>(t[i]);
  CHECK(wrong == 0);
}

TEST_CASE("half precision rounds to the nearest") {
  const Tensor t = Tensor::from({5}, {1.0004f, 1.0006f, -70000, 1e-9f, 0.1f});
  const Tensor back = PackedTensor::halves(t).tensor();
  CHECK(back[0] == 1);
  CHECK(back[1] == 1 + 0x1p-10f);
  CHECK(back[2] == -std::numeric_limits<float>::infinity());
  CHECK(back[3] == 0);
  CHECK(std::abs(back[4] - 0.1f) < 0.1f * 0x1p-11f);
}
