#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# From nothing to a surface: builds the program (as root on a fresh Debian 12 it installs the packages first), makes
# up a scene of three satellite images, reconstructs it with the shipped weights and scores it against the truth.
#   demo.sh [SEED]
set -euo pipefail
cd "$(dirname "$0")"
tests/build.sh release satsurf
satsurf=build/release/bin/satsurf
out=out/demo
$satsurf simulate --out $out/scene --scenes 1 --views 3 --seed "${1:-2026}" \
  --kinds city,suburb,village --water 0 --overwrite
images=("$out"/scene/Track3-RGB/SIM_001_*_RGB.tif)
truth=$out/scene/Track3-Truth/SIM_001_DSM.tif
$satsurf info "${images[@]}"
$satsurf reconstruct "${images[@]}" --out $out/surface --overwrite
echo
echo "Against the true surface:"
$satsurf evaluate --dsm $out/surface/dsm.tif --truth $truth --seen-by "${images[@]}" --json $out/scores.json \
  --error-map $out/error.png --overwrite
# image, heights, hillshade and errors side by side
views=("$out"/surface/views/SIM_001_*_source.png)
panels=()
for picture in "${views[0]}" $out/surface/height.png $out/surface/hillshade.png $out/error.png; do
  panels+=("$picture" --ch 0,1,2 --fit:pad=1 480x480)
done
oiiotool "${panels[@]}" --mosaic:pad=8 4x1 --attrib CompressionQuality 85 -o $out/strip.jpg
cat <<END

Pictures:
  $PWD/$out/strip.jpg               image, heights, hillshade and errors side by side
  $PWD/$out/surface/height.png      heights in colour
  $PWD/$out/surface/hillshade.png   the surface lit from the north-west
  $PWD/$out/surface/confidence.png  how sure the network is
  $PWD/$out/surface/views/          the images, and the surface rendered into their cameras
  $PWD/$out/error.png               errors, blue too low, red too high
The surface itself: $PWD/$out/surface/dsm.tif (GeoTIFF) and surfels.ply
END
