// SPDX-License-Identifier: Apache-2.0
#include "satsurf/evaluate/confidence.h"

#include "satsurf/core/dims.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

namespace satsurf::evaluate {
namespace {

constexpr std::size_t kSlices = 100000;  // a multiple of the bins, so that these are exact

}  // namespace

ConfidenceErrors::ConfidenceErrors() : slices_(kSlices) {}

void ConfidenceErrors::add(const Tensor& confidence, const Tensor& error) {
  Dims dim("ConfidenceErrors");
  dim.match("confidence", confidence, "H W").match("error", error, "H W");
  constexpr std::array<double, 3> kThresholds{1, 2.5, 7.5};  // m, those of the field's tables
  for (Index i = 0; i < error.count(); ++i) {
    if (!std::isfinite(confidence[i]) || !std::isfinite(error[i])) continue;
    const double c = std::clamp(static_cast<double>(confidence[i]), 0.0, 1.0),
                 e = std::abs(static_cast<double>(error[i]));
    Slice& s = slices_[std::min(static_cast<std::size_t>(c * kSlices), kSlices - 1)];
    s.pixels += 1, s.confidence += c, s.absolute += e, s.squared += e * e;
    for (std::size_t t = 0; t < 3; ++t) s.below[t] += e < kThresholds[t];
  }
}

Index ConfidenceErrors::pixels() const {
  Index n = 0;
  for (const Slice& s : slices_) n += s.pixels;
  return n;
}

/// Slices [begin, end) as one bin.
ConfidenceBin ConfidenceErrors::joined(std::size_t begin, std::size_t end) const {
  Slice all;
  for (std::size_t k = begin; k < end; ++k) {
    const Slice& s = slices_[k];
    all.pixels += s.pixels, all.confidence += s.confidence;
    all.absolute += s.absolute, all.squared += s.squared;
    for (std::size_t t = 0; t < 3; ++t) all.below[t] += s.below[t];
  }
  const double n =
      all.pixels > 0 ? static_cast<double>(all.pixels) : std::numeric_limits<double>::quiet_NaN();
  const auto share = [n](Index count) { return static_cast<double>(count) / n; };
  return {.low = static_cast<double>(begin) / kSlices,
          .high = static_cast<double>(end) / kSlices,
          .confidence = all.confidence / n,
          .pixels = all.pixels,
          .mae = all.absolute / n,
          .rmse = std::sqrt(all.squared / n),
          .pag1 = share(all.below[0]),
          .pag2_5 = share(all.below[1]),
          .pag7_5 = share(all.below[2])};
}

std::vector<ConfidenceBin> ConfidenceErrors::equal_width() const {
  std::vector<ConfidenceBin> bins;
  for (std::size_t k = 0; k < kBins; ++k)
    bins.push_back(joined(k * kSlices / kBins, (k + 1) * kSlices / kBins));
  return bins;
}

std::vector<ConfidenceBin> ConfidenceErrors::equal_count() const {
  std::vector<ConfidenceBin> bins;
  const Index total = pixels();
  Index seen = 0;
  std::size_t begin = 0;
  for (std::size_t k = 0; k < kSlices; ++k) {
    if (slices_[k].pixels == 0) continue;
    if (seen == 0) begin = k;  // the first bin begins where pixels do
    const Index before = seen * kBins / total;
    seen += slices_[k].pixels;
    if (seen * kBins / total == before) continue;
    bins.push_back(joined(begin, k + 1));
    begin = k + 1;
  }
  return bins;
}

bool ConfidenceErrors::monotone() const {
  const std::vector<ConfidenceBin> bins = equal_count();
  for (std::size_t k = 1; k < bins.size(); ++k)
    if (!(bins[k].mae < bins[k - 1].mae)) return false;
  return bins.size() >= kFewest;
}

std::string confidence_csv(const std::vector<NamedConfidence>& all) {
  std::string text = "of,bins,low,high,confidence,pixels,share,mae,rmse,pag1,pag2.5,pag7.5\n";
  for (const auto& [name, title, of] : all) {
    const double total = static_cast<double>(of->pixels());
    for (const bool width : {true, false})
      for (const ConfidenceBin& b : width ? of->equal_width() : of->equal_count()) {
        text += name + (width ? ",equal_width" : ",equal_count");
        for (const double v :
             {b.low, b.high, b.confidence, static_cast<double>(b.pixels),
              static_cast<double>(b.pixels) / total, b.mae, b.rmse, b.pag1, b.pag2_5, b.pag7_5}) {
          char cell[32];
          std::snprintf(cell, sizeof cell, ",%.10g", v);
          text += std::isfinite(v) ? cell : ",";
        }
        text += "\n";
      }
  }
  return text;
}

}  // namespace satsurf::evaluate
