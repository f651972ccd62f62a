// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/dataset.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/train/augment.h"
#include "satsurf/train/trainer.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <vector>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::train;

namespace {

/// One made-up scene of four small images, as read from disk.
const std::vector<scene::Scene>& scenes() {
  static const std::vector<scene::Scene> all = [] {
    const test::TempFolder folder("augment");
    scene::SimulateConfig c = scene::SimulateConfig();
    c.pixels = 64, c.views = 4, c.gsd = 0.5;
    scene::write_scene(scene::simulate_scene(c, 21, 0), folder.path(), "SIM_001");
    return training_scenes(folder.path(), 4, {});
  }();
  return all;
}

/// Of the third sample, whose images are made to look as little unlike themselves as is asked for.
scene::Crop sample_with(double radiometry, double grey_share, double radiometry_views = 0) {
  TrainConfig c = TrainConfig();
  c.model = nn::model_preset("tiny");
  c.crop = 32;
  c.radiometry = radiometry, c.grey_share = grey_share, c.radiometry_views = radiometry_views;
  return training_sample(c, scenes(), 4, 2);
}

/// Its images, the target last.
std::vector<nn::PosedImage> images_of(const scene::Crop& crop) {
  std::vector<nn::PosedImage> out = crop.input.sources;
  REQUIRE(crop.target);
  out.push_back(*crop.target);
  return out;
}

/// What becomes of the values of valid pixels, and how many values become more than one.
struct ValueMap {
  std::map<float, float> to;
  Index clashes = 0;

  void add(const nn::PosedImage& before, const nn::PosedImage& after) {
    const Index P = before.valid.count();
    for (Index i = 0; i < before.rgb.count(); ++i)
      if (before.valid[i % P] > 0)
        clashes += to.emplace(before.rgb[i], after.rgb[i]).first->second != after.rgb[i];
  }
  bool changes() const {
    return std::ranges::any_of(to, [](const auto& item) { return item.first != item.second; });
  }
};

}  // namespace

TEST_CASE("a view is made to look otherwise where it is valid") {
  const Tensor rgb = Tensor::from({3, 1, 3}, {0.25f, 0.5f, 0.9f,  // red
                                              0.64f, 0.5f, 0.9f,  // green
                                              0, 0.5f, 0.01f});   // blue
  const auto changed = [&](const Radiometry& r) {
    nn::PosedImage view;
    view.rgb = rgb.clone(), view.valid = Tensor::from({1, 3}, {1, 0, 1});
    apply(r, view);
    return view.rgb;
  };
  const Tensor colours = changed({.gain = 1.5, .offset = -0.05, .gamma = 0.5});
  const double red = 1.5 * 0.5 - 0.05;
  CHECK(colours[0] == doctest::Approx(red));
  CHECK(colours[3] == 1);  // 1.5 * 0.8 - 0.05 is more
  CHECK(colours[6] == 0);  // and -0.05 less than there is
  CHECK(colours[2] == 1);
  CHECK(colours[8] == doctest::Approx(1.5 * 0.1 - 0.05));
  for (const Index i : {1, 4, 7}) CHECK(colours[i] == 0.5f);

  // of what it then is, the luminance
  const Tensor grey = changed({.gain = 1.5, .offset = -0.05, .gamma = 0.5, .grey = true});
  for (const Index i : {0, 3, 6}) CHECK(grey[i] == doctest::Approx(0.299 * red + 0.587));
  for (const Index i : {2, 5, 8})
    CHECK(grey[i] == doctest::Approx(0.299 + 0.587 + 0.114 * (1.5 * 0.1 - 0.05)));
  for (const Index i : {1, 4, 7}) CHECK(grey[i] == 0.5f);
}

TEST_CASE("how a sample looks is drawn as far as its settings go") {
  Rng rng(5), same(5);
  Index grey = 0;
  for (int k = 0; k < 400; ++k) {
    const Radiometry r = random_radiometry(0.2, 0.25, rng);
    CHECK(r.gain == doctest::Approx(same.uniform(0.8, 1.2)));
    CHECK(r.offset == doctest::Approx(same.uniform(-0.1, 0.1)));
    CHECK(r.gamma == doctest::Approx(std::exp(same.uniform(-0.2, 0.2))));
    CHECK(r.grey == same.chance(0.25));
    grey += r.grey;
  }
  CHECK(grey > 60);
  CHECK(grey < 140);
  const Radiometry none = random_radiometry(0, 0, rng);
  CHECK(none.gain == 1);
  CHECK(none.offset == 0);
  CHECK(none.gamma == 1);
  CHECK_FALSE(none.grey);
  CHECK(random_radiometry(0, 1, rng).grey);
}

TEST_CASE("the target of a sample looks as its sources do") {
  const std::vector<nn::PosedImage> plain = images_of(sample_with(0, 0));
  const std::vector<nn::PosedImage> other = images_of(sample_with(0.15, 0));
  REQUIRE(plain.size() == 4);
  ValueMap all;
  for (std::size_t i = 0; i < plain.size(); ++i) {
    ValueMap own;
    own.add(plain[i], other[i]);
    CHECK(own.changes());
    all.add(plain[i], other[i]);
  }
  CHECK(all.clashes == 0);
  CHECK(all.to.size() > 30);

  // so it is with grey
  for (const nn::PosedImage& image : images_of(sample_with(0, 1))) {
    const Index P = image.valid.count();
    for (Index p = 0; p < P; ++p) {
      REQUIRE(image.rgb[p] == image.rgb[P + p]);
      REQUIRE(image.rgb[p] == image.rgb[2 * P + p]);
    }
  }
}

TEST_CASE("sources that are to look unlike each other do, and the target stays as it is") {
  const std::vector<nn::PosedImage> plain = images_of(sample_with(0, 0));
  const std::vector<nn::PosedImage> other = images_of(sample_with(0, 0, 0.2));
  ValueMap all;
  for (std::size_t i = 0; i < plain.size(); ++i) {
    CAPTURE(i);
    ValueMap own;
    own.add(plain[i], other[i]);
    CHECK(own.clashes == 0);
    CHECK(own.changes() == (i < 3));
    if (i < 3) all.add(plain[i], other[i]);
  }
  CHECK(all.clashes > 100);
}
