#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Drives the satsurf program as a user would: the whole path on tiny made-up data, then every kind of bad input.
#   run.sh PROGRAM
set -uo pipefail
satsurf=$(realpath "$1")
shared=${SATSURF_DATA:-$(realpath "$(dirname "$0")")/../../../shared/data} # published LPIPS weights, if there
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work" || exit 1
unset SATSURF_WEIGHTS
checks=0 failures=0

fail() {
  failures=$((failures + 1))
  echo "FAIL: $*"
  sed 's/^/  | /' stderr | head -n 5
}

# succeeds NAME COMMAND...: exit code 0
succeeds() {
  checks=$((checks + 1))
  local name=$1 code
  shift
  "$@" >stdout 2>stderr
  code=$?
  [ "$code" -eq 0 ] || fail "$name: exit code $code, expected 0"
}

# refuses NAME CODE PATTERN COMMAND...: that exit code, one line on stderr that matches, nothing on stdout, and no
# file made, changed or left behind
refuses() {
  checks=$((checks + 1))
  local name=$1 expected=$2 pattern=$3 code before after
  shift 3
  before=$(listing)
  "$@" >stdout 2>stderr
  code=$?
  after=$(listing)
  [ "$code" -eq "$expected" ] || fail "$name: exit code $code, expected $expected"
  [ "$(wc -l <stderr)" -eq 1 ] || fail "$name: $(wc -l <stderr) lines on stderr, expected 1"
  grep -q '^satsurf: ' stderr || fail "$name: the line does not begin with the program's name"
  grep -qE -- "$pattern" stderr || fail "$name: no match for '$pattern'"
  [ ! -s stdout ] || fail "$name: something on stdout"
  [ "$before" = "$after" ] || fail "$name: files were made, changed or left behind: $(diff <(echo "$before") <(echo "$after") | grep '^[<>]' | head -n 2)"
}
listing() { find . -not -name stdout -not -name stderr -not -name held -not -path . -printf '%p %s %T@\n' | sort; }

# holds NAME COMMAND...: the command says yes
holds() {
  checks=$((checks + 1))
  local name=$1
  shift
  "$@" >/dev/null 2>held && return  # what the command before said stays in stderr
  cp held stderr
  fail "$name"
}

# --- the whole path ------------------------------------------------------------------------------------------------
succeeds "simulate" "$satsurf" simulate --out data --scenes 2 --views 4 --pixels 96 --seed 5 --quiet
succeeds "simulate on a surface" "$satsurf" simulate --out relit --scenes 1 --views 2 --pixels 64 --seed 1 --quiet \
  --surface data/Track3-Truth/SIM_001_DSM.tif --classes data/Track3-Truth/SIM_001_CLS.tif
succeeds "simulate again" "$satsurf" simulate --out again --scenes 2 --views 4 --pixels 96 --seed 5 --quiet --threads 1
holds "same seed, same images" diff -r -x run.json data again
rm -rf again
images=(data/Track3-RGB/SIM_001_00{1,2,3}_RGB.tif)
truth=data/Track3-Truth/SIM_001_DSM.tif

succeeds "info" "$satsurf" info "${images[@]}"
holds "info names the camera's source" grep -q "RPC (TIFF tag)" stdout
holds "info tells overlap and parallax" grep -qE "overlap [0-9.]+ %, parallax [0-9.]+ px/m" stdout
holds "info tells how the cameras agree" grep -qE "^  correction    " stdout
succeeds "info as JSON" "$satsurf" info "${images[@]}" --json
for key in '"kind": "image"' '"source": "TIFF tag"' '"off_nadir_deg": [0-9]' '"parallax_px_per_m": [0-9]' '"verdict": "'; do
  holds "it has $key" grep -qE "$key" stdout
done
"$satsurf" info "${images[0]}" gone.tif "${images[1]}" nowhere.tif >stdout 2>stderr
code=$?
cp stderr bad.txt
holds "bad files among good ones fail" test $code -eq 1
holds "with one line for each" test "$(wc -l <bad.txt)" -eq 2
holds "which names it" grep -q "^satsurf: nowhere.tif: " bad.txt
holds "the good ones are told all the same" grep -q "^pairs" stdout
"$satsurf" info "${images[0]}" gone.tif --json >stdout 2>stderr
holds "JSON names what could not be read" grep -qE '"error": "gone.tif: ' stdout

# What was cut off on its way is told, and the rest all the same.
head -c $(($(stat -c %s "${images[1]}") * 2 / 3)) "${images[1]}" >cut.tif
"$satsurf" info "${images[0]}" cut.tif "${images[2]}" >stdout 2>stderr
holds "an image that was cut off fails" test $? -eq 1
holds "it is named" grep -q "^satsurf: cut.tif: " stderr
holds "the other images are a pair" grep -qE "001_RGB.tif . .*003_RGB.tif: overlap" stdout
rm cut.tif
holds "no georeference is told in words" grep -qE "^  georeference  none" stdout

tiny=(--preset tiny --crop 32 --steps 24 --checkpoint_every 4 --seed 9 --quiet)
succeeds "train" "$satsurf" train --data data --out whole "${tiny[@]}"
holds "one line per step" test "$(wc -l <whole/train.jsonl)" -eq 24
# The same run, stopped by Ctrl-C on the way and resumed on another number of threads.
"$satsurf" train --data data --out parts "${tiny[@]}" --threads 1 >stdout 2>stderr &
job=$!
for _ in $(seq 600); do
  [ "$(cat parts/train.jsonl 2>/dev/null | wc -l)" -ge 3 ] && break
  sleep 0.05
done
kill -INT "$job" 2>/dev/null
wait "$job"
code=$?
checks=$((checks + 1))
[ "$code" -eq 130 ] || fail "Ctrl-C: exit code $code, expected 130"
for signal in TERM HUP; do
  "$satsurf" simulate --out stopped --scenes 1000 --views 4 --pixels 96 --quiet >stdout 2>stderr &
  job=$!
  for _ in $(seq 600); do
    [ -n "$(find stopped.partial-* -name '*_RGB.tif' 2>/dev/null | head -n 1)" ] && break
    sleep 0.05
  done
  kill -$signal "$job" 2>/dev/null
  wait "$job"
  code=$?
  checks=$((checks + 1))
  [ "$code" -eq $((128 + $(kill -l $signal))) ] || fail "SIG$signal: exit code $code"
  holds "SIG$signal leaves nothing behind" test -z "$(ls -d stopped* 2>/dev/null)"
done
# What stopped runs have left is put back or removed by the next one, which says so.
moved=("$satsurf" simulate --out moved --scenes 1 --views 2 --pixels 64)
succeeds "what will be moved away" "${moved[@]}" --quiet
mv moved moved.replaced-1
mkdir moved.partial-1 moved.replaced-2
"${moved[@]}" >stdout 2>stderr
holds "a place that was moved away is not empty" grep -q '^satsurf: --out: moved exists and is not empty; use --overwrite' stderr
holds "as it was put back" grep -q '/moved put back, which a stopped run had moved to .*/moved.replaced-1$' stderr
succeeds "making it anew" "${moved[@]}" --overwrite
for left in moved.partial-1 moved.replaced-2; do
  holds "$left is removed" test ! -e $left
  holds "and spoken of" grep -q "/$left removed, left by a stopped run" stderr
done
rm -rf moved

holds "Ctrl-C stopped the run early" test "$(wc -l <parts/train.jsonl)" -lt 24
succeeds "resume" "$satsurf" train --data data --out parts "${tiny[@]}" --resume --threads 2
holds "resumed weights are those of the uninterrupted run" cmp whole/weights.safetensors parts/weights.safetensors
holds "resumed checkpoint is that of the uninterrupted run" cmp whole/checkpoint.safetensors parts/checkpoint.safetensors
weights=whole/weights.safetensors
succeeds "info of weights" "$satsurf" info $weights
holds "it says what they were trained on" grep -qE "training +24 steps on 2 scenes, seed 9; .*\"crop\":32" stdout
holds "and by which program" grep -qE "program +satsurf [0-9.]+ \(.+\)" stdout

# The whole method brings its monocular branch along; a smaller one needs its own.
succeeds "train the whole method" "$satsurf" train --data data --out method --preset base8 --crop 32 --steps 1 --quiet
holds "the branch is in it" grep -q '"mono":"own"' <("$satsurf" info method/weights.safetensors)
holds "the record has the branch's file" grep -qE '"path": ".*mono12.safetensors"' method/run.json
succeeds "train without perceptual loss" "$satsurf" train --data data --out plain --preset tiny --crop 32 --steps 1
cp stderr notes.txt
holds "it says so" grep -qE "^no perceptual loss: lpips_weights names no file$" notes.txt
refuses "training from nothing, in one line" 1 "gone.safetensors: no such file" "$satsurf" train --data data --out no --preset tiny --crop 32 --steps 1 --init gone.safetensors
refuses "windows that no memory holds" 1 "windows of 100000 px of 4 images need about .* give a smaller crop" \
  "$satsurf" train --data data --out no --preset tiny --crop 100000 --steps 1
refuses "a branch of another size" 1 "mono12.safetensors" "$satsurf" train --data data --out no --preset tiny_full --crop 32 --steps 1 --quiet

# The monocular network: the same program, another task.
mono=(--task mono --mono.base 2 --crop 32 --steps 8 --seed 9 --quiet)
succeeds "train mono" "$satsurf" train --data data --out mono "${mono[@]}"
holds "it says how well heights correlate" grep -qE "^correlation -?[0-9.]+, mean of the last [0-9]+ steps" stdout
holds "one line per step of mono" test "$(wc -l <mono/train.jsonl)" -eq 8
succeeds "mono from its record" "$satsurf" train --data data --out mono2 --config mono/run.json --seed 9 --quiet --threads 1
holds "same seed, same network" cmp mono/weights.safetensors mono2/weights.safetensors
cp mono2/run.json before.json
succeeds "mono again, nothing left to do" "$satsurf" train --data data --out mono2 "${mono[@]}" --resume
holds "and nothing done" cmp mono/checkpoint.safetensors mono2/checkpoint.safetensors
holds "and the record of what was done is left" cmp before.json mono2/run.json
succeeds "info of mono weights" "$satsurf" info mono/weights.safetensors
holds "it says what they are" grep -qE "network +monocular, [0-9]+ weights; .\"base\":2" stdout
holds "and what they were trained on" grep -qE "training +8 steps on 2 scenes, seed 9; .*\"task\":\"mono\"" stdout
refuses "reconstructing with mono weights" 1 "mono/weights.safetensors: not a satsurf model" \
  "$satsurf" reconstruct "${images[@]}" --out no --weights mono/weights.safetensors --quiet
refuses "resuming another task" 2 "mono/checkpoint.safetensors: made with another configuration" \
  "$satsurf" train --data data --out mono "${tiny[@]}" --resume

succeeds "dry run" "$satsurf" reconstruct "${images[@]}" --dry-run --out out --weights $weights --quiet
holds "it says what would be done" grep -qE "^surface +about [0-9]+ x [0-9]+ cells" stdout
holds "it says what that takes" grep -qE "memory +about [0-9.]+ [MG]B" stdout
holds "and what each part of it takes" grep -qE "^  volumes 3 +[0-9.]+ [MG]B" stdout
holds "and how long that takes, about" grep -qE "^time +about [0-9]+ (s|min)" stdout
read -r columns rows < <(sed -nE 's/^surface +about ([0-9]+) x ([0-9]+) cells.*/\1 \2/p' stdout)
holds "it writes nothing" test ! -e out
succeeds "reconstruct" "$satsurf" reconstruct "${images[@]}" --out out --weights $weights --quiet
holds "its cells are about those of the plan" awk -v w="$columns" -v h="$rows" '
  /^surface/ { found = 1; if ($2 < 0.8 * w || $2 > 1.2 * w || $4 < 0.8 * h || $4 > 1.2 * h) exit 1 } END { exit !found }' stdout
holds "it records how well the cameras were fitted" grep -qE '"camera_fit_max_px": [0-9]' out/run.json
for file in dsm.tif confidence.tif ortho.tif views.tif surfels.ply mesh.ply run.json report.html height.png hillshade.png confidence.png \
  views/SIM_001_001_RGB_render.png views/SIM_001_003_RGB_source.png; do
  holds "reconstruct writes $file" test -s "out/$file"
done
holds "it records the mesh and how long it took" grep -qE '"voxel": [0-9.]+,?$' out/run.json
holds "it says what the mesh is" grep -qE "^mesh +[0-9]+ faces, voxels of [0-9.]+ m$" stdout
# with the shipped weights: those of here find no lake
succeeds "simulating a lake" "$satsurf" simulate --out lake --scenes 1 --water 1 --kinds suburb --pixels 288 --views 3 --gsd 0.5 --seed 4 --quiet
succeeds "water" "$satsurf" reconstruct lake/Track3-RGB/*.tif --out lake_level --mesh none --report none --quiet
holds "it is as level as its shore" grep -qE "^water +[0-9]{5} m² made level with the shore$" stdout
holds "it records how much" grep -qE '"levelled_area": [0-9]{5}' lake_level/run.json
succeeds "water as it is found" "$satsurf" reconstruct lake/Track3-RGB/*.tif --water found --out lake_found --mesh none --report none --quiet
holds "nothing is made level" grep -qE '"levelled_area": 0.0' lake_found/run.json
holds "and nothing said of it" test -z "$(grep ^water stdout)"
succeeds "simulating a hall" "$satsurf" simulate --out hall --scenes 1 --water 0 --kinds industrial --pixels 288 --views 3 --gsd 0.5 --seed 4 --quiet
succeeds "a roof of one colour" "$satsurf" reconstruct hall/Track3-RGB/*.tif --out hall_even --mesh none --report none --quiet
holds "it goes along with its rim" grep -qE "^untextured +[0-9]{4} m² in doubt go along with their rims$" stdout
holds "it records how much" grep -qE '"evened_area": [0-9]{4}' hall_even/run.json
succeeds "a roof as it is found" "$satsurf" reconstruct hall/Track3-RGB/*.tif --untextured found --out hall_found --mesh none --report none --quiet
holds "nothing is evened out" grep -qE '"evened_area": 0.0' hall_found/run.json
holds "and nothing said of it" test -z "$(grep ^untextured stdout)"
hall_error() { "$satsurf" evaluate --dsm $1/dsm.tif --truth hall/Track3-Truth/SIM_001_DSM.tif | sed -n 's/^raw  *MAE  *\([0-9.]*\) m.*/\1/p'; }
holds "evened out it is nearer the truth" awk "BEGIN { exit !($(hall_error hall_even) + 0.05 < $(hall_error hall_found)) }"
succeeds "shifts from a file" "$satsurf" reconstruct "${images[@]}" --out shifted --weights $weights --mesh none --pointing out/pointing.json --quiet
holds "its shifts are those of the file" \
  diff <(grep shift_ out/pointing.json) <(grep shift_ shifted/pointing.json)
holds "they are applied" grep -q '"verdict": "as given"' shifted/pointing.json
slopes_of() { grep -A 2 -E 'shift_|slope_|"at"' "$1/pointing.json" | sed -E 's/(\.[0-9]{6})[0-9]*/\1/'; }
succeeds "shifts that change within images" "$satsurf" reconstruct "${images[@]}" --out sloped --weights $weights --mesh none --pointing affine --quiet
holds "their slopes are told" grep -q '"slope_y": \[' sloped/pointing.json
succeeds "shifts and slopes from a file" "$satsurf" reconstruct "${images[@]}" --out again --weights $weights --mesh none --pointing sloped/pointing.json --quiet
holds "the same slopes" \
  diff <(slopes_of sloped) <(slopes_of again)
succeeds "cameras as they are" "$satsurf" reconstruct "${images[@]}" --out shifted --overwrite --weights $weights --mesh none --pointing off --quiet
holds "nothing is said of shifts" test ! -e shifted/pointing.json
refuses "shifts from nowhere" 1 "nowhere.json" "$satsurf" reconstruct "${images[@]}" --out no --weights $weights --pointing nowhere.json
echo '{"images": []}' >none.json
refuses "a mistyped word for shifts" 2 "pointing is .afine., did you mean .affine." "$satsurf" reconstruct "${images[@]}" --out no --weights $weights --pointing afine
refuses "shifts of other images" 2 "no shift for SIM_001_001_RGB" "$satsurf" reconstruct "${images[@]}" --out no --weights $weights \
  --pointing none.json --quiet
succeeds "no mesh" "$satsurf" reconstruct "${images[@]}" --out bare --weights $weights --mesh none --quiet
holds "the rest is the same without" diff -r -x run.json -x report.html -x mesh.ply out bare
holds "the report is a page of its own" grep -qE '<canvas id="view"' out/report.html
holds "it names no other place" bash -c '! grep -qE "(src|href)=.?(https?:)?//|url\(|@import" out/report.html'
holds "and there is no mesh" test ! -e bare/mesh.ply
holds "and none in the record" grep -qE '"mesh": null' bare/run.json
cp "${images[0]}" twin.tif
succeeds "one image twice beside two others" "$satsurf" reconstruct "${images[@]}" twin.tif --out twins --weights $weights --mesh none --report none --quiet
holds "is left out" grep -q "same direction as" twins/run.json
holds "and changes nothing" cmp twins/dsm.tif bare/dsm.tif
succeeds "names that mean one image" "$satsurf" reconstruct "${images[@]}" ./${images[1]} $(realpath ${images[0]}) --out once --weights $weights --mesh none --report none
holds "are told" grep -qE "^2 of 5 names of images mean one that came before" stderr
holds "and count once" cmp once/dsm.tif bare/dsm.tif
refuses "an image and itself" 1 "SIM_.*is the only image" "$satsurf" reconstruct ${images[0]} ./${images[0]} --out no --weights $weights --quiet
cp ${images[0]} $'\xff.tif'
succeeds "a name that is no UTF-8" "$satsurf" reconstruct $'\xff.tif' "${images[@]:1}" --out odd --weights $weights --mesh none --quiet
holds "which its record writes with what stands for the byte" grep -q $'\xef\xbf\xbd.tif' odd/run.json
succeeds "and so does its plan" "$satsurf" reconstruct $'\xff.tif' "${images[@]:1}" --print-config
rm $'\xff.tif'
succeeds "no more images than wanted" "$satsurf" reconstruct "${images[@]}" --max-views 2 --out two --weights $weights --mesh none --report none --quiet
holds "the third is told of" grep -q "others go better together" two/run.json
succeeds "heights above the geoid" "$satsurf" reconstruct "${images[@]}" --geoid egm96 --out geoid --weights $weights --mesh none --report none --quiet
holds "say so" grep -q '"vertical_datum": "EGM96 geoid"' geoid/run.json
holds "and are others than those above the ellipsoid" bash -c '! cmp -s geoid/dsm.tif bare/dsm.tif'
"$satsurf" evaluate --dsm geoid/dsm.tif --truth bare/dsm.tif >stdout 2>stderr
holds "evaluate tells how high the geoid lies" grep -qE "differ by .* above the geoid. .the geoid lies [0-9.]+ m (below|above) the ellipsoid here" stderr
holds "surfels stay above the ellipsoid" cmp geoid/surfels.ply bare/surfels.ply
refuses "a geoid without a grid" 1 "EGM2008 geoid, expected its grid" "$satsurf" reconstruct "${images[@]}" --geoid egm2008 --out no --weights $weights --quiet
rm -rf twins twin.tif two geoid
# The file of surfels holds as many as asked for, and nothing else knows.
surfels_of() { sed -nE 's/^element vertex ([0-9]+)$/\1/p;/^end_header/q' <(head -c 2000 "$1/surfels.ply"); }
succeeds "few surfels" "$satsurf" reconstruct "${images[@]}" --max-surfels 500 --out thin --weights $weights --mesh none --report none --quiet
holds "are 500 at most" test "$(surfels_of thin)" -le 500 -a "$(surfels_of thin)" -gt 300 -a "$(surfels_of bare)" -gt 5000
holds "and the surface is made of all" cmp thin/dsm.tif bare/dsm.tif
rm -rf thin

# How the images' heights become one surface, and what only a surface network can say.
succeeds "train the surface network" "$satsurf" train --data data --out surface --task surface --cascades $weights --surface.base 2 \
  --batch 1 --crop 32 --steps 1 --seed 9 --quiet
refining=("$satsurf" reconstruct "${images[@]}" --weights surface/weights.safetensors --mesh none --report none --quiet)
succeeds "a refined surface" "${refining[@]}" --out refined
for file in dsm.tif confidence.tif height_sigma.tif ortho.tif views.tif surfels.ply; do
  holds "the refined one has $file" test -s refined/$file
done
for pair in "height_sigma dsm" "dsm height_sigma"; do
  read -r one other <<<"$pair"
  "$satsurf" evaluate --dsm refined/$one.tif --truth refined/$other.tif >stdout 2>stderr
  holds "$one knows all cells of $other" grep -qF "(completeness 100.0 %)" stdout
done
for kind in plain splat; do
  succeeds "a surface that is $kind" "${refining[@]}" --surface $kind --out surface_$kind
  holds "$kind is not refined" bash -c "! cmp -s surface_$kind/dsm.tif refined/dsm.tif"
  holds "$kind expects no errors" test ! -e surface_$kind/height_sigma.tif
done
holds "without a network it is the splatted one" cmp surface_splat/dsm.tif bare/dsm.tif
holds "and not the plain one" bash -c "! cmp -s surface_plain/dsm.tif bare/dsm.tif"
refuses "refining without a network" 2 "surface is refined, expected weights with a surface network" \
  "$satsurf" reconstruct "${images[@]}" --surface refined --out no --weights $weights --quiet
rm -rf refined surface_plain surface_splat

# The rasters in another system: all on one grid, and nothing else changes.
succeeds "rasters in another system" "$satsurf" reconstruct "${images[@]}" --crs EPSG:3857 --geoid egm96 --out moved --weights $weights --mesh none --quiet
holds "say which" grep -q '^surface .*, EPSG:3857, ' stdout
holds "and the record too" grep -q '"crs": "EPSG:3857",' moved/run.json
holds "the report tells it" grep -q 'what the rasters are in; this page is in EPSG:32' moved/report.html
holds "surfels stay where they are" cmp moved/surfels.ply bare/surfels.ply
holds "and pictures" cmp moved/height.png bare/height.png
for file in dsm confidence ortho views; do holds "$file has moved" bash -c "test -s moved/$file.tif && ! cmp -s moved/$file.tif bare/$file.tif"; done
holds "nothing is left over" test -z "$(ls moved/*.rows moved/*.part moved/.*.partial-* 2>/dev/null)"
succeeds "a coloured mesh of them" "$satsurf" export --dsm moved/dsm.tif --ortho moved/ortho.tif --to moved.glb --quiet
rm -rf moved moved.glb
succeeds "the plan in another system" "$satsurf" reconstruct "${images[@]}" --crs EPSG:3857 --dry-run --weights $weights --quiet
holds "says so" grep -q '^rasters  *EPSG:3857, by resampling' stdout
refuses "rasters in degrees" 2 "EPSG:4326 counts in degrees, expected a projected system in metres" "$satsurf" reconstruct "${images[@]}" --crs EPSG:4326 --out no --weights $weights --quiet
refuses "rasters in feet" 2 "EPSG:2263 counts in US survey foot" "$satsurf" reconstruct "${images[@]}" --crs EPSG:2263 --out no --weights $weights --quiet
refuses "rasters in a system of heights too" 2 "EPSG:7415 .*--geoid" "$satsurf" reconstruct "${images[@]}" --crs EPSG:7415 --out no --weights $weights --quiet
refuses "rasters in a system of elsewhere" 2 "EPSG:5041 is for .*the images lie at lon" "$satsurf" reconstruct "${images[@]}" --crs EPSG:5041 --out no --weights $weights --quiet
# A part of the ground: inside a triangle in the zone of the images, and between meridians and parallels.
"$satsurf" reconstruct "${images[@]}" --dry-run --weights $weights --quiet >plan.txt 2>stderr
read -r epsg x0 x1 y0 y1 < <(sed -nE 's/^ground +EPSG:([0-9]+), east ([0-9]+) to ([0-9]+), north ([0-9]+) to ([0-9]+) .*/\1 \2 \3 \4 \5/p' plan.txt)
cat >area.geojson <<END
{"type": "FeatureCollection", "crs": {"type": "name", "properties": {"name": "EPSG:$epsg"}}, "features": [{"type": "Feature",
 "properties": {}, "geometry": {"type": "Polygon", "coordinates": [[[$((x0 + 8)), $((y0 + 8))], [$((x1 - 8)), $((y0 + 8))],
 [$((x0 + 8)), $((y1 - 8))], [$((x0 + 8)), $((y0 + 8))]]]}}]}
END
succeeds "an area of interest" "$satsurf" reconstruct "${images[@]}" --out part --weights $weights --mesh none --aoi area.geojson --quiet
for file in dsm confidence views ortho; do holds "the part has $file.tif" test -s part/$file.tif; done
holds "the record has a table of tiles" grep -q '"status": "done"' part/run.json
"$satsurf" evaluate --dsm part/dsm.tif --truth bare/dsm.tif >stdout 2>stderr
share() { sed -nE 's/^ *"completeness": ([0-9.]+),?$/\1/p' "$1/run.json" | head -1; }
holds "it knows of the triangle what the whole knows" awk -v part="$(share part)" -v whole="$(share bare)" 'BEGIN { exit !(part > 0.8 * whole) }'
holds "surfels lie there alone" test "$(stat -c %s part/surfels.ply)" -lt "$(($(stat -c %s bare/surfels.ply) * 6 / 10))"
holds "it lies in the triangle" grep -qE "completeness ([5-9]|[1-4][0-9])\.[0-9] %" stdout
holds "no tiles are left" test ! -e part.tiles
read -r lon lat < <("$satsurf" info "${images[0]}" | sed -nE 's/^  centre +lon ([-0-9.]+), lat ([-0-9.]+) .*/\1 \2/p')
box=$(awk -v x="$lon" -v y="$lat" 'BEGIN { printf "%.6f,%.6f,%.6f,%.6f", x - 0.0001, y - 0.0001, x + 0.0001, y + 0.0001 }')
succeeds "a box in degrees" "$satsurf" reconstruct "${images[@]}" --out box --weights $weights --mesh none --bbox="$box" --quiet
holds "it is smaller than the whole" test "$(stat -c %s box/surfels.ply)" -lt "$(stat -c %s bare/surfels.ply)"
succeeds "few surfels of a box" "$satsurf" reconstruct "${images[@]}" --out thin --weights $weights --mesh none --bbox="$box" --max-surfels 500 --report none --quiet
holds "are 500 at most there, too" test "$(surfels_of thin)" -le 500 -a "$(surfels_of thin)" -gt 300 -a "$(surfels_of box)" -gt 2000
holds "and the box is made of all" cmp thin/dsm.tif box/dsm.tif
rm -rf part box thin
refuses "an area elsewhere" 1 "outside of what two images see" "$satsurf" reconstruct "${images[@]}" --out no --weights $weights --bbox 1,1,1.1,1.1 --quiet
refuses "a box of three numbers" 2 "--bbox: 3 numbers, expected 4" "$satsurf" reconstruct "${images[@]}" --out no --bbox 1,1,2
refuses "a box and an area" 2 "--bbox and --aoi came" "$satsurf" reconstruct "${images[@]}" --out no --bbox 1,1,2,2 --aoi area.geojson
refuses "an area whose driver is not trusted" 1 "area.gml: of the format GML.*--gdal-drivers GML allows it" \
  "$satsurf" reconstruct "${images[@]}" --out no --weights $weights --quiet --aoi \
  "$(echo '<ogr:FeatureCollection xmlns:ogr="http://ogr.maptools.org/" xmlns:gml="http://www.opengis.net/gml"/>' >area.gml; echo area.gml)"
refuses "an area that is none" 1 "area.txt: not a vector file" "$satsurf" reconstruct "${images[@]}" --out no --weights $weights --aoi "$(echo none >area.txt; echo area.txt)" --quiet
refuses "no size of memory" 2 "max_memory: .much., expected a size" "$satsurf" reconstruct "${images[@]}" --out no --weights $weights --max-memory much --quiet
refuses "too little memory" 2 "max_memory: 1 MB, expected .* or more for 3 images" "$satsurf" reconstruct "${images[@]}" --out no --weights $weights --max-memory 1MB --quiet

# Of four images each tile has the best two.
succeeds "tiles of the best two" "$satsurf" reconstruct data/Track3-RGB/SIM_001_00{1,2,3,4}_RGB.tif --out best --weights $weights --max-views 2 --bbox="$(awk -v x="$lon" -v y="$lat" 'BEGIN { printf "%.4f,%.4f,%.4f,%.4f", x - 0.01, y - 0.01, x + 0.01, y + 0.01 }')" --mesh none --quiet
holds "the record has their names" bash -c "tr -d '\\n ' <best/run.json | grep -qE '\"images\":\\[\"SIM_001_00._RGB\",\"SIM_001_00._RGB\"\\]'"
holds "and knows of all four" test "$(grep -c '"name": "SIM_001_00._RGB"' best/run.json)" -eq 4
rm -rf best

# Ground that is not wanted, and terrain that says the heights.
succeeds "a mask of polygons" "$satsurf" reconstruct "${images[@]}" --out masked --weights $weights --mask area.geojson --quiet
holds "it is an input of the record" grep -qE '"path": "(.*/)?area.geojson"' masked/run.json
"$satsurf" evaluate --dsm masked/dsm.tif --truth bare/dsm.tif >stdout 2>stderr
holds "the rest has heights" grep -qE "completeness ([3-9][0-9])\.[0-9] %" stdout
holds "what is not wanted has neither surfels" test "$(stat -c %s masked/surfels.ply)" -lt "$(stat -c %s bare/surfels.ply)"
holds "nor faces" test "$(stat -c %s masked/mesh.ply)" -lt "$(stat -c %s out/mesh.ply)"
succeeds "the same in tiles" "$satsurf" reconstruct "${images[@]}" --out masked2 --weights $weights --mask area.geojson --max-memory 300MB --bbox="$(awk -v x="$lon" -v y="$lat" 'BEGIN { printf "%.4f,%.4f,%.4f,%.4f", x - 0.01, y - 0.01, x + 0.01, y + 0.01 }')" --mesh none --quiet
"$satsurf" evaluate --dsm masked2/dsm.tif --truth masked/dsm.tif >stdout 2>stderr
holds "it is unknown in the same cells" grep -qE "completeness (9[5-9]|100)\.[0-9] %" stdout
# The network hardly knows anything, so that single heights differ by what else a tile's windows show.
holds "and neither higher nor lower" awk '/^raw/ { mae = $3; median = $9 } END { exit !(mae > 0 && mae < 3 && median > -0.5 && median < 0.5) }' stdout
refuses "a mask that is none" 1 "area.txt: " "$satsurf" reconstruct "${images[@]}" --out no --weights $weights --mask area.txt --quiet
rm -rf masked masked2
classes=data/Track3-Truth/SIM_001_CLS.tif
refuses "classes none of which is 0" 1 "SIM_001_CLS.tif: the mask leaves 0 % of the ground .*--mask-values" "$satsurf" reconstruct "${images[@]}" --out no --weights $weights --mask $classes --quiet
succeeds "classes that are named" "$satsurf" reconstruct "${images[@]}" --out masked --weights $weights --mask $classes --mask-values=6,9,17 --mesh none --report none --quiet
holds "they are in the record" bash -c "tr -d '\\n ' <masked/run.json | grep -qF '\"mask_values\":[6.0,9.0,17.0]'"
holds "and leave less" test "$(stat -c %s masked/surfels.ply)" -lt "$(stat -c %s bare/surfels.ply)"
refuses "values of polygons" 2 "mask_values came for the polygons of area.geojson" "$satsurf" reconstruct "${images[@]}" --out no --mask area.geojson --mask-values 9 --weights $weights
refuses "values of nothing" 2 "mask_values came without mask" "$satsurf" reconstruct "${images[@]}" --out no --mask-values=9 --weights $weights
rm -rf masked
succeeds "terrain" "$satsurf" reconstruct "${images[@]}" --out terrain --weights $weights --mesh none --dem $truth --quiet
holds "says the heights" grep -q '"height_range_source": "from the terrain"' terrain/run.json
holds "and is an input" grep -qE '"path": "(.*/)?SIM_001_DSM.tif"' terrain/run.json
succeeds "terrain of elsewhere" "$satsurf" reconstruct "${images[@]}" --out terrain --overwrite --weights $weights --mesh none --dem data/Track3-Truth/SIM_002_DSM.tif --quiet
holds "is told" grep -q '^warning: .*SIM_002_DSM.tif: it knows 0 % of the images. ground, expected 90 % or more' stderr
holds "and in the record" grep -q '"code": "dem_unused"' terrain/run.json
holds "and changes nothing else" cmp terrain/dsm.tif bare/dsm.tif
refuses "terrain and heights" 2 "height_range and dem came, expected one of them" "$satsurf" reconstruct "${images[@]}" --out no --weights $weights --dem $truth --height-range 0 50 --quiet
refuses "terrain that is none" 1 "area.txt: not a raster" "$satsurf" reconstruct "${images[@]}" --out no --weights $weights --dem area.txt --quiet
rm -rf terrain

# Images in tiles: a run that is killed leaves its tiles, and goes on with them to the same bytes.
succeeds "simulate for tiles" "$satsurf" simulate --out large --scenes 1 --views 2 --pixels 420 --seed 3 --kinds village --quiet
tiled=("$satsurf" reconstruct large/Track3-RGB/*.tif --weights $weights --pointing off --max-memory 300MB --quiet)
succeeds "the plan of tiles" "${tiled[@]}" --dry-run
holds "it tells tiles, memory and time" grep -zqE "tiles +[2-9] x [2-9].*memory +about .*time +about " stdout
succeeds "in tiles" "${tiled[@]}" --out tiles
holds "with a mesh" grep -qE "^mesh +[0-9]+ faces, voxels of" stdout
holds "and pictures of every image and its render" test "$(ls tiles/views/*_source.png tiles/views/*_render.png | wc -l)" -eq 4
holds "the report has the orthophoto and how many images see the cells" bash -c 'grep -q "Orthophoto" tiles/report.html && grep -q "see" tiles/report.html'
succeeds "a coarser mesh of tiles" "${tiled[@]}" --out coarser --voxel 4 --report none
holds "is smaller" test "$(stat -c %s coarser/mesh.ply)" -lt "$(stat -c %s tiles/mesh.ply)"
holds "and all else is the same" diff -r -x run.json -x report.html -x mesh.ply tiles coarser
rm -rf coarser
setsid "${tiled[@]}" --out killed >stdout 2>stderr &
job=$!
while kill -0 "$job" 2>/dev/null && [ "$(ls killed.tiles/tile_*.json 2>/dev/null | wc -l)" -lt 2 ]; do
  sleep 0.02
done
kill -KILL "$job" 2>/dev/null
wait "$job" 2>/dev/null
holds "a killed run leaves its tiles" test "$(ls killed.tiles/tile_*.json 2>/dev/null | wc -l)" -ge 2
holds "and no surface" test ! -e killed
refuses "tiles in the way" 1 "killed.tiles holds the tiles of a stopped run" "${tiled[@]}" --out killed
refuses "tiles of another run" 2 "resume: .*/config/resolution was 0.0 and is 2.0" "${tiled[@]}" --out killed --resume --resolution 2
succeeds "going on with them" "${tiled[@]}" --out killed --resume --threads 1
holds "to the same bytes" diff -r -x run.json -x report.html tiles killed
holds "with a report that tells of the tiles" grep -q "Searched" killed/report.html
holds "and nothing is left beside it" test -z "$(ls -d killed.* 2>/dev/null)"
fine=("$satsurf" reconstruct large/Track3-RGB/*.tif --out fine --weights $weights --resolution 0.1 --pointing off --dry-run)
succeeds "the plan of a surface of fine cells" "${fine[@]}"
holds "it is made at once" grep -qE "^tiles +1, " stdout
succeeds "the same with less memory" "${fine[@]}" --max-memory 400MB
holds "it is made in tiles" grep -qE "^tiles +([2-9] x|[0-9]+ x [2-9])" stdout
rm -rf tiles killed large

succeeds "a coarse mesh" "$satsurf" reconstruct "${images[@]}" --out coarse --weights $weights --voxel 3 --report none --quiet
holds "without a report where none is wanted" test ! -e coarse/report.html
holds "it is smaller" test "$(stat -c %s coarse/mesh.ply)" -lt "$(stat -c %s out/mesh.ply)"
succeeds "a mesh that cannot be made" "$satsurf" reconstruct "${images[@]}" --out failing --weights $weights --voxel 900 --quiet
cp stderr failed.txt
holds "its failure is told" grep -q "^warning: no mesh: " failed.txt
holds "and recorded" grep -q '"code": "mesh_failed"' failing/run.json
holds "and the surface is the same" cmp out/dsm.tif failing/dsm.tif
bounded() { (ulimit -v 6000000 && exec "$@"); } # KiB
if bounded "$satsurf" --version >/dev/null 2>&1; then # a sanitizer takes more
  finest=(bounded "$satsurf" reconstruct "${images[@]}" --out failing --overwrite --weights $weights --voxel 0.01)
  succeeds "a plan with a mesh that memory does not hold" "${finest[@]}" --dry-run
  holds "it says so" grep -q "mesh .* GB, which it would not get: give a larger --voxel or --mesh none" stdout
  succeeds "a mesh that memory does not hold" "${finest[@]}" --quiet
  cp stderr failed.txt
  holds "its size is told" grep -qE "^warning: no mesh: voxels of 0.01 m need about .* GB of memory, expected .* at most; give a larger --voxel; --mesh none" failed.txt
  holds "and it takes nothing with it" test -s failing/report.html -a -s failing/surfels.ply -a ! -e failing/mesh.ply
  holds "the surface least of all" cmp out/dsm.tif failing/dsm.tif
fi
succeeds "a mesh that the limit does not hold" "$satsurf" reconstruct "${images[@]}" --out failing --overwrite --weights $weights --voxel 0.01 --max-memory 2GB --report none --quiet
cp stderr failed.txt
holds "the limit is named" grep -qE "^warning: no mesh: voxels of 0.01 m need .* GB, more than --max-memory; give a larger --voxel" failed.txt
holds "and nothing else is missing" cmp out/dsm.tif failing/dsm.tif
refuses "cells so fine that no tile of them fits" 2 "max_memory: .*, expected .* MB or more for 3 images and cells" "$satsurf" reconstruct "${images[@]}" --out no --weights $weights --resolution 0.015 --max-memory 500MB --quiet
"$satsurf" reconstruct "${images[@]}" --out failing --overwrite --weights $weights --mesh none --min-coverage 1 --quiet >stdout 2>failed.txt
holds "too few cells are a failure" test $? -eq 1
holds "which says how many there are" grep -q "common ground has a height, expected 100.0 % by --min-coverage" failed.txt
holds "and leaves the surface" cmp out/dsm.tif failing/dsm.tif
rm -rf failing
succeeds "reconstruct on one thread" "$satsurf" reconstruct "${images[@]}" --out one --weights $weights --threads 1 --quiet
holds "threads do not change a byte" diff -r -x run.json -x report.html out one
succeeds "weights from the environment" env SATSURF_WEIGHTS=$weights "$satsurf" reconstruct "${images[@]}" --out one --overwrite --quiet
holds "overwriting gives the same" diff -r -x run.json -x report.html out one

succeeds "evaluate a surface" "$satsurf" evaluate --dsm out/dsm.tif --truth $truth --register xyz \
  --seen-by "${images[@]}" --json scores.json --error-map error.png
holds "it prints the error" grep -qE "registered +MAE +[0-9.]+ m" stdout
holds "it records the error" grep -q '"mae"' scores.json
for read in $truth out/dsm.tif "${images[@]}"; do
  holds "it records that it read $read" grep -qF "\"path\": \"$read\"" scores.json
done
succeeds "evaluate the truth" "$satsurf" evaluate --dsm $truth --truth $truth
holds "the truth is right" grep -qE "raw +MAE +0.000 m" stdout
grid() { printf 'ncols 4\nnrows 3\nxllcorner 500000\nyllcorner 4000000\ncellsize 1\n%s\n' "$2" >"$1.asc"; }
grid ground $'10 11 12 13\n14 15 16 17\n18 19 20 21'
grid flooded $'10 61 62 13\n14 65 16 17\n18 69 20 21'
grid kinds $'2 9 9 2\n2 9 6 2\n2 9 2 5'
succeeds "evaluate with water" "$satsurf" evaluate --dsm flooded.asc --truth ground.asc --classes kinds.asc
holds "water counts unless told" grep -q "^12 of 12 true cells" stdout
succeeds "evaluate without water" "$satsurf" evaluate --dsm flooded.asc --truth ground.asc --classes kinds.asc --mask-water
holds "its cells do not count" grep -q "^8 of 8 true cells" stdout
holds "nor do its errors" grep -qE "raw +MAE +0.000 m" stdout
refuses "leaving out water that nobody knows" 2 "^satsurf: --mask-water: no --classes, expected the class raster as well" \
  "$satsurf" evaluate --dsm flooded.asc --truth ground.asc --mask-water
succeeds "evaluate a data set" "$satsurf" evaluate --data data --weights $weights --json all.json --csv all.csv \
  --confidence-csv confidence.csv --confidence-figure confidence.svg --register z --quiet
holds "it prints means" grep -qE "^DSM, filled +[0-9.]+ +[0-9.]+ +[0-9.]+%.* 100.0%$" stdout
holds "it prints where the error is" grep -qE "^open_ground +[0-9.]+% +[0-9.]+ +-?[0-9.]+ +[0-9.]+% +[0-9.]+% +2$" stdout
holds "it says why there is no LPIPS" grep -qE "^no LPIPS: no --lpips-weights given$" stdout
holds "it says how the error goes with confidence" grep -qE "^Source views +MAE [0-9.]+ m at confidence [0-9.]+, .*fall" stdout
succeeds "evaluate a data set, tables only, one thread" "$satsurf" evaluate --data data --weights $weights --csv only.csv \
  --confidence-csv only.confidence.csv --register z --threads 1 --quiet
untimed() { sed 's/,[^,]*$//' "$1"; } # the last column is seconds
holds "seconds come last" grep -qE "^scene,.*,seconds$" all.csv
holds "the same table" cmp <(untimed all.csv) <(untimed only.csv)
holds "the same confidences" cmp confidence.csv only.confidence.csv
holds "each row as many cells" test "$(awk -F, '{ print NF }' all.csv | sort -u | wc -l)" -eq 1
for column in dsm_mae dsm_none_rmse dsm_z_pag2.5 dsm_xyz_completeness dsm_xyz_east dsm_filled_xyz_mae mvs_source_rmse \
  mvs_source_rmse_per_view render_target_pag7.5 render_target_psnr render_target_ssim_conv render_target_lpips render_target_covered \
  cause_hidden_share cause_rim_error_share oracle_mae lost_stage2; do
  holds "the table has $column" grep -qE "^scene,(.*,)?$column," all.csv
done
for key in dsm_by_registration holes_filled causes open_ground lost window mean_scenes render_target_ssim equal_width equal_count monotone; do
  holds "the record has $key" grep -qF "\"$key\": " all.json
done
holds "ten bins of equal width each" test "$(grep -c ',equal_width,' confidence.csv)" -eq 20
holds "the figure is one" grep -qE "^<svg .*</svg>$" <(tr -d '\n' <confidence.svg)
for read in $weights $truth data/Track3-RGB/SIM_002_004_RGB.tif; do
  holds "it records that it read $read" grep -qF "\"path\": \"$read\"" all.json
done
holds "one row per scene, a heading and the mean" test "$(wc -l <all.csv)" -eq 4
column() { awk -F, -v name="$2" 'NR == 1 { for (i = 1; i <= NF; i++) if ($i == name) k = i } { print $k }' "$1"; }
holds "no errors are expected without a surface network" test -z "$(column all.csv sigma_within_1 | tail -n +2 | tr -d '\n')"
succeeds "evaluate refined surfaces" "$satsurf" evaluate --data data --weights surface/weights.safetensors --csv refined.csv \
  --no-meshes --register z --quiet
holds "it prints how true the expected errors are" grep -qE "^expected errors +[0-9.]+% of the cells within one, +[0-9.]+% within two$" stdout
holds "and so says the table, of all scenes and the mean" awk 'NR > 1 && $1 > 0 && $1 < $2 && $2 <= 1 { good++ } END { exit good != 3 }' \
  <(paste <(column refined.csv sigma_within_1) <(column refined.csv sigma_within_2))
succeeds "evaluate with a generous range" "$satsurf" evaluate --data data --weights $weights --csv above.csv --json above.json \
  --range-above 40 --no-meshes --register z --quiet
holds "it is in the record" grep -q '"range_above": 40.0' above.json
holds "surfaces are others" bash -c '! cmp -s "$0" "$1"' <(column above.csv dsm_mae) <(column all.csv dsm_mae)
holds "and the views' heights are not" cmp <(column above.csv mvs_source_rmse) <(column all.csv mvs_source_rmse)
succeeds "evaluate a mesh" "$satsurf" evaluate --mesh coarse/mesh.ply --reference-mesh out/mesh.ply --json mesh.json
holds "it prints the distance" grep -qE "^surfaces +chamfer +[0-9.]+ m" stdout
holds "it prints F1" grep -qE "within 1.0 m  F1 [01]\.[0-9]{3}  precision [01]\.[0-9]{3}  recall [01]\.[0-9]{3}$" stdout
for key in chamfer f1 precision recall without_walls 0.5 2.5; do
  holds "the record has $key" grep -qF "\"$key\": " mesh.json
done
for read in coarse/mesh.ply out/mesh.ply; do
  holds "it records that it read $read" grep -qF "\"path\": \"$read\"" mesh.json
done
succeeds "evaluate a mesh against itself" "$satsurf" evaluate --mesh out/mesh.ply --reference-mesh out/mesh.ply
holds "nothing lies between" grep -qE "^surfaces +chamfer +0\.000 m" stdout
sed 's/^comment crs EPSG:32\([67]\)../comment crs EPSG:32\160/' out/mesh.ply >elsewhere.ply
sed 's/^comment \(crs\|origin\) .*/comment none/' out/mesh.ply >nowhere.ply
pictures=(--image out/views/SIM_001_001_RGB_render.png --reference out/views/SIM_001_001_RGB_source.png)
succeeds "evaluate a picture" "$satsurf" evaluate "${pictures[@]}" --json picture.json
holds "it prints the similarity" grep -qE "^SSIM +0\.[0-9]{5}$" stdout
holds "it says why there is no LPIPS" grep -qE "^LPIPS +- +no --lpips-weights given$" stdout
holds "it records the scores at the top" grep -qE '^  "(psnr|ssim|ssim_conv)": -?[0-9.e-]+,$' picture.json
holds "LPIPS is null" grep -qE '^  "lpips": null,$' picture.json
for key in psnr_infinite lpips_backbone version isa config; do
  holds "the record has $key" grep -q "^  \"$key\": " picture.json
done
for read in out/views/SIM_001_001_RGB_render.png out/views/SIM_001_001_RGB_source.png; do
  holds "it records that it read $read" grep -qF "\"path\": \"$read\"" picture.json
done
# 96 x 96 pixels of a palette's green
base64 -d >green.png <<<iVBORw0KGgoAAAANSUhEUgAAAGAAAABgAQMAAADYVuV7AAAABlBMVEUAAAAA/wA2Q0S9AAAAFklEQVR42mP4jwQYRjmjnFHOKGf4cACww3u9TGk0owAAAABJRU5ErkJggg==
succeeds "evaluate under a green mask" "$satsurf" evaluate "${pictures[@]}" --mask green.png --json green.json
holds "it hides nothing" cmp <(grep '"psnr"' picture.json) <(grep '"psnr"' green.json)
succeeds "evaluate a picture against itself" "$satsurf" evaluate --image out/height.png --reference out/height.png --json same.json
holds "PSNR is infinite" grep -qE "^PSNR +infinite" stdout
holds "which JSON says with null" grep -qE '^  "psnr": null,$' same.json
holds "and true" grep -qE '^  "psnr_infinite": true,$' same.json
holds "similarity is 1" grep -qE '^  "ssim": 1.0,$' same.json
succeeds "evaluate under a mask" "$satsurf" evaluate "${pictures[@]}" --mask out/views/SIM_001_001_RGB_source.png
if [ -d "$shared/lpips" ]; then
  for backbone in alex squeeze; do
    succeeds "LPIPS ($backbone)" "$satsurf" evaluate --image "$shared/lpips/ex_p0.png" \
      --reference "$shared/lpips/ex_ref.png" --lpips-weights "$shared/lpips/lpips_$backbone.safetensors" --json lpips.json --overwrite
    holds "its name is told" grep -qE "^LPIPS +0\.7[0-9]{4} $backbone$" stdout
    holds "and recorded" grep -qE "^  \"lpips_backbone\": \"$backbone\",$" lpips.json
    holds "with the published value" grep -qE '^  "lpips": 0\.7(110|111|218|219)[0-9]*,$' lpips.json
  done
  succeeds "LPIPS of rendered views" "$satsurf" evaluate --data data --weights $weights --json lpips.json --overwrite \
    --lpips-weights "$shared/lpips/lpips_squeeze.safetensors" --quiet
  holds "by which network" grep -qE "^LPIPS by squeeze$" stdout
  holds "recorded too" grep -qF '"lpips_backbone": "squeeze"' lpips.json
  holds "with the numbers" grep -qE '"render_target_lpips": 0\.[0-9]+' lpips.json
else
  echo "SKIPPED: no LPIPS weights at $shared/lpips (set SATSURF_DATA)"
fi
succeeds "render from above" "$satsurf" render --surfels out/surfels.ply --nadir --out above.png
succeeds "render heights" "$satsurf" render --surfels out/surfels.ply --nadir --out above.tif
succeeds "render heights in cells of 2 m" "$satsurf" render --surfels out/surfels.ply --nadir --resolution 2 --out above2.tif
holds "of which there are fewer" test "$(stat -c %s above2.tif)" -lt "$(stat -c %s above.tif)"
succeeds "render heights on the grid of the surface" "$satsurf" render --surfels out/surfels.ply --nadir --grid out/dsm.tif --out grid.tif
holds "which it has by itself" cmp above.tif grid.tif
succeeds "they can be compared with it" "$satsurf" evaluate --dsm grid.tif --truth out/dsm.tif
succeeds "render colours on it" "$satsurf" render --surfels out/surfels.ply --nadir --grid out/dsm.tif --show colours --out colours.tif
succeeds "they have its system" "$satsurf" info colours.tif
holds "namely UTM" grep -qE "georeference +EPSG:32[67]" stdout
holds "a picture from above has a world file" test "$(wc -l <above.pgw)" -eq 6
cp above.pgw lone.pgw
refuses "a world file in the way" 1 "--out: lone.pgw exists; use --overwrite" "$satsurf" render --surfels out/surfels.ply --nadir --out lone.png
holds "so have the maps of a surface" test -s out/confidence.png.aux.xml
refuses "a grid without a place" 1 "SIM_001_001_RGB.tif" "$satsurf" render --surfels out/surfels.ply --nadir --grid "${images[0]}" --out no.tif
succeeds "export a mesh" "$satsurf" export --mesh out/mesh.ply --to mesh.glb
holds "it is binary glTF" test "$(head -c 4 mesh.glb)" = glTF
succeeds "export fewer faces" "$satsurf" export --mesh out/mesh.ply --to few.glb --max-faces 500
holds "as many as allowed" bash -c 'read -r faces _ <stdout; [ "$faces" -le 500 ] && [ "$faces" -gt 100 ]'
succeeds "export heights with colours" "$satsurf" export --dsm out/dsm.tif --ortho out/ortho.tif --to dsm.glb
holds "they have colours" grep -qa COLOR_0 dsm.glb
succeeds "export surfels" "$satsurf" export --surfels out/surfels.ply --to surfels.glb --resolution 1
holds "they have colours too" grep -qa COLOR_0 surfels.glb
succeeds "export surfels as PLY" "$satsurf" export --surfels out/surfels.ply --to surfels_mesh.ply --resolution 1
holds "it names its place" grep -qa "^comment origin" surfels_mesh.ply
succeeds "a mesh made of surfels is where that of the reconstruction is" "$satsurf" evaluate --mesh surfels_mesh.ply --reference-mesh out/mesh.ply
refuses "a resolution of a mesh" 2 "requires --surfels" "$satsurf" export --mesh out/mesh.ply --resolution 1 --to no.glb
refuses "another format" 2 "expected a name ending in .glb or .ply" "$satsurf" export --mesh out/mesh.ply --to mesh.obj
refuses "a raster of surfels" 2 "expected a name ending in .glb or .ply; satsurf render --nadir makes rasters" "$satsurf" export --surfels out/surfels.ply --to dsm.tif
refuses "an existing file" 1 "--to: mesh.glb exists; use --overwrite" "$satsurf" export --mesh out/mesh.ply --to mesh.glb
refuses "colours of another grid" 1 "another grid, expected that of $truth" "$satsurf" export --dsm $truth --ortho out/ortho.tif --to no.glb
refuses "no face left" 2 "--max-faces: 1 leaves none of [0-9]+ faces" "$satsurf" export --mesh out/mesh.ply --to no.glb --max-faces 1
refuses "nothing to export" 2 "--mesh, --dsm or --surfels is required" "$satsurf" export --to no.glb
succeeds "render a view" "$satsurf" render --surfels out/surfels.ply --image "${images[0]}" --out view.tif
succeeds "a rendered view has a camera" "$satsurf" info view.tif
holds "namely the image's" grep -q "RPC (TIFF tag)" stdout

# --- what is told, and where -----------------------------------------------------------------------------------------
told=("$satsurf" reconstruct "${images[@]}" --weights $weights --overwrite --out told)
succeeds "log to a file" "${told[@]}" --log-level debug --log-file log.txt --quiet
holds "nothing but warnings on stderr" bash -c '! grep -v "^warning: " stderr'
holds "the file names the command" grep -qE "^[0-9-]+T[0-9:.]+[+-][0-9:]+ debug +.*reconstruct.* --out told" log.txt
holds "the height range" grep -qE " info +height range" log.txt
holds "and the time of each stage" grep -qE " debug +write: [0-9.]+ s" log.txt
cp log.txt before.txt
succeeds "log after what is there" "${told[@]}" --log-level warning --log-file log.txt
cp stderr told.txt
holds "nothing below a warning on stderr" bash -c '! grep -v "^warning: " told.txt'
holds "or in the file" bash -c '! tail -n +$(($(wc -l <before.txt) + 1)) log.txt | grep -v " warning "'
"$satsurf" info gone.tif --log-file log.txt 2>stderr
holds "errors go to the file too" grep -qE " error +gone.tif" log.txt
refuses "unknown level" 2 "log-level is .loud., expected one of error, warning, info, debug" "$satsurf" info "${images[0]}" --log-level loud
refuses "log in a missing folder" 1 "gone/log.txt.*no folder gone" "$satsurf" info "${images[0]}" --log-file gone/log.txt
refuses "scores over a file of the data set" 1 "json: $truth is a file of the input data" \
  "$satsurf" evaluate --data data --weights $weights --json $truth --overwrite

# --- configuration: flags over file over defaults --------------------------------------------------------------------
echo '{"steps": 7, "lr": 0.5, "preset": "tiny"}' >config.json
succeeds "print-config" "$satsurf" train --config config.json --lr 0.25 --print-config
holds "the file beats the default" grep -q '"steps": 7' stdout
holds "the flag beats the file" grep -q '"lr": 0.25' stdout
succeeds "a run's record is a configuration" "$satsurf" train --config whole/run.json --print-config
holds "with its values" grep -q '"crop": 32' stdout
succeeds "mono has its own defaults" "$satsurf" train --task mono --lr 0.25 --print-config
holds "its crop" grep -q '"crop": 256' stdout
holds "the flag beats them" grep -q '"lr": 0.25' stdout
succeeds "a configuration names its task" "$satsurf" train --config mono/run.json --print-config
holds "with the task's fields" grep -q '"batch": 2' stdout
succeeds "a file's flag with dashes" "$satsurf" train --lpips-weights alex.safetensors --print-config
holds "is the field with underscores" grep -q '"lpips_weights": "alex.safetensors"' stdout
succeeds "help of train" "$satsurf" train --help
holds "it says how to write a list" grep -qE -- "--model.hypotheses 3 comma-separated integers=[0-9]+,[0-9]+,[0-9]+" stdout
holds "which fields are files" grep -qE -- "--(init|mono_weights,--mono-weights) FILE" stdout
holds "and what must be there" grep -qE -- "--out DIR .*\(required unless --print-config\)" stdout
succeeds "help of reconstruct" "$satsurf" reconstruct --help
cp stdout help.txt
holds "it says how to write a range" grep -qE -- "--height-range LOW HIGH in m  " stdout
holds "and what is taken where nothing is asked for" grep -qE "two pixels on the ground" stdout
succeeds "the same by the command help" "$satsurf" help reconstruct
holds "word for word" cmp stdout help.txt
succeeds "help" "$satsurf" help
holds "it lists the commands" grep -qE "^  reconstruct +the surface two or more images show$" stdout
refuses "help of what is none" 2 "unknown command paint, expected one of info" "$satsurf" help paint
succeeds "the manual page" "$satsurf" help --man
holds "it has the commands" grep -qF ".SH SATSURF RECONSTRUCT" stdout
succeeds "completion" "$satsurf" help --completion bash
cp stdout completion.bash
complete_line() ( # WORDS...: what bash would offer for the last one
  source ./completion.bash
  COMP_WORDS=(satsurf "$@") COMP_CWORD=$#
  _satsurf
  echo "${COMPREPLY[*]}"
)
holds "of commands" test "$(complete_line rec)" = reconstruct
holds "of flags" test "$(complete_line reconstruct --height)" = --height-range
holds "of values" test "$(complete_line reconstruct --mesh n)" = none
holds "of files" test "$(complete_line info complet)" = completion.bash
succeeds "the reference" "$satsurf" help --markdown
for told in "### satsurf evaluate" '| `--height-range` | 2 numbers |' '| `mesh_without_walls` |'; do
  holds "it has $told" grep -qF -- "$told" stdout
done

# A record brings all that made its surface; flags change it, and results go where they are told.
succeeds "reconstruct from its record" "$satsurf" reconstruct --config out/run.json --out replayed --quiet --threads 1
holds "the same surface" diff -r -x run.json -x report.html out replayed
config() { sed -n '/^  "config": {/,/^  }/p' "$1"; }
holds "from the same configuration" cmp <(config out/run.json) <(config replayed/run.json)
mkdir far
succeeds "from any folder, as the report says it" bash -c "cd out && $(sed -n 's:</*span>::g; s:^<pre>satsurf \(.*\)</pre>$:"$0" \1:p' out/report.html) --quiet --threads 1" "$satsurf"
holds "the same surface again" diff -r -x run.json -x report.html out/again replayed
mv out/again far/
succeeds "shifts from a file, in the record" "$satsurf" reconstruct "${images[@]}" --weights $weights --mesh none --quiet \
  --pointing out/pointing.json --out far/shifted
succeeds "are found from any folder" bash -c 'cd far && "$0" reconstruct --config shifted/run.json --out shifted2 --quiet' "$satsurf"
holds "the same shifted surface" diff -r -x run.json -x report.html far/shifted far/shifted2
rm -r far
succeeds "a record and a flag" "$satsurf" reconstruct --config out/run.json --mesh none --print-config
holds "the flag wins" grep -q '"mesh": "none"' stdout
holds "the images are the record's, named in full" grep -qF "\"$PWD/${images[2]}\"" stdout
holds "what is automatic stays so" grep -qE '"voxel": 0.0' stdout
succeeds "a record and other images" "$satsurf" reconstruct x.tif y.tif --config out/run.json --print-config
holds "which take their place" cmp <(grep -A 3 '"images"' stdout) <(printf '  "images": [\n    "x.tif",\n    "y.tif"\n  ],\n')
succeeds "a range in the configuration" "$satsurf" reconstruct --height-range -5 60 --print-config
holds "is there" cmp <(grep -A 3 '"height_range"' stdout) <(printf '  "height_range": [\n    -5.0,\n    60.0\n  ],\n')
cp stdout range.json
succeeds "and read again" "$satsurf" reconstruct --config range.json --print-config
holds "as it was" cmp stdout range.json
echo '{"height_range": [1]}' >bad.json
refuses "a wrong range in the file" 2 "bad.json: height_range is .1., expected 2 x numbers" \
  "$satsurf" reconstruct --config bad.json --print-config
refuses "overwriting the record that is repeated" 1 "replayed holds the input replayed/run.json" \
  "$satsurf" reconstruct --config replayed/run.json --out replayed --overwrite --quiet
refuses "no images" 2 "images is required" "$satsurf" reconstruct --out no
refuses "another command's record" 2 "out/run.json: the record of .reconstruct., expected one of .train." \
  "$satsurf" train --config out/run.json --print-config
succeeds "scores from their record" "$satsurf" evaluate --config scores.json --json again.json
holds "are the same" cmp <(sed -n '/"results"/,$p' scores.json) <(sed -n '/"results"/,$p' again.json)
refuses "scores over their record" 1 "--json: scores.json is an input" \
  "$satsurf" evaluate --config scores.json --json scores.json --overwrite
succeeds "a record of scores and a flag" "$satsurf" evaluate --config scores.json --register none --print-config
holds "the registration is the flag's" grep -q '"register": "none"' stdout
holds "the truth is the record's, named in full" grep -qF "\"truth\": \"$PWD/$truth\"" stdout
succeeds "a data set's scores from their record" "$satsurf" evaluate --config all.json --csv again.csv --threads 1 --quiet
holds "are the same table" cmp <(untimed all.csv) <(untimed again.csv)
succeeds "water and meshes" "$satsurf" evaluate --data data --keep-water --no-meshes --print-config
cp stdout water.json
holds "water counts" grep -q '"mask_water": false' water.json
holds "meshes do not" grep -q '"meshes": false' water.json
succeeds "a switch against the file" "$satsurf" evaluate --config water.json --no-meshes=false --print-config
holds "takes it back" grep -q '"meshes": true' stdout
holds "and nothing else" grep -q '"mask_water": false' stdout
succeeds "a picture's scores from their record" "$satsurf" evaluate --config picture.json
holds "say the same" grep -qE "^SSIM +0\.[0-9]{5}$" stdout
succeeds "a mesh's scores from their record" "$satsurf" evaluate --config mesh.json
holds "say the same" grep -qE "^surfaces +chamfer +[0-9.]+ m" stdout
refuses "a record of something else" 2 "scores.json: unknown key 'classes'" "$satsurf" evaluate --config scores.json --data data
succeeds "what render would do" "$satsurf" render --surfels out/surfels.ply --nadir --resolution 2 --print-config
cp stdout render.json
holds "it is told" grep -q '"resolution": 2.0' render.json
succeeds "render from a file" "$satsurf" render --config render.json --out coarse.png
succeeds "a camera instead of above" "$satsurf" render --config render.json --image "${images[0]}" --print-config
holds "takes its place" grep -q '"nadir": false' stdout
sed 's:"grid"\: "":"grid"\: "out/dsm.tif":' render.json >twice.json
refuses "a record that says the cells twice" 2 "twice.json: both resolution and grid" "$satsurf" render --config twice.json --out no.png
succeeds "a grid instead of the file's cells" "$satsurf" render --config render.json --grid out/dsm.tif --print-config
holds "takes their place" grep -q '"resolution": 0.0' stdout
refuses "cells said twice" 2 "excludes" "$satsurf" render --surfels out/surfels.ply --nadir --grid out/dsm.tif --resolution 1 --out no.tif
refuses "cells of a camera" 2 "render --image: --resolution came, expected only with --nadir" \
  "$satsurf" render --surfels out/surfels.ply --image "${images[0]}" --resolution 5 --out no.png
refuses "heights of a camera" 2 "render --image: --show came, expected only with --nadir" \
  "$satsurf" render --surfels out/surfels.ply --image "${images[0]}" --show heights --out no.png
refuses "a mesh for surfels" 1 "out/mesh.ply: .*expected surfels, one vertex element" "$satsurf" render --surfels out/mesh.ply --nadir --out no.png
refuses "neither camera nor above" 2 "--image or --nadir" "$satsurf" render --surfels out/surfels.ply --out no.png
refuses "both" 2 "excludes" "$satsurf" render --surfels out/surfels.ply --image "${images[0]}" --nadir --out no.png
refuses "no surfels named" 2 "--surfels is required" "$satsurf" render --nadir --out no.png
echo '{"stepz": 7}' >typo.json
refuses "unknown key" 2 "typo.json.*stepz.*steps" "$satsurf" train --config typo.json --data data --out no
echo '{"steps": ' >broken.json
refuses "malformed configuration" 2 "broken.json" "$satsurf" train --config broken.json --data data --out no

# --- wrong usage: exit code 2 ----------------------------------------------------------------------------------------
refuses "no command" 2 "--help" "$satsurf"
refuses "unknown command" 2 "paint" "$satsurf" paint
refuses "a mistyped command" 2 "reconstuct, did you mean reconstruct\?" "$satsurf" reconstuct
refuses "a flag without its value" 2 "help: --completion came without a value, expected bash" "$satsurf" help --completion
refuses "a mistyped flag" 2 "info: unknown flag --jsno, did you mean --json\?; see satsurf help info" "$satsurf" info "${images[0]}" --jsno
refuses "a mistyped flag and no image" 2 "info: unknown flag --jsno" "$satsurf" info --jsno
refuses "a switch that is neither" 2 "--quiet is 'maybe', expected true or false; see satsurf help train" "$satsurf" train --quiet=maybe
refuses "unknown flag" 2 "--colour" "$satsurf" info "${images[0]}" --colour
refuses "a number out of range" 2 "lr.*2" "$satsurf" train --data data --out no --lr 2
refuses "no number" 2 "steps.*many" "$satsurf" train --data data --out no --steps many
refuses "unknown preset" 2 "huge.*base8" "$satsurf" train --data data --out no --preset huge
refuses "crop that does not fit" 2 "crop" "$satsurf" train --data data --out no --preset tiny --crop 33
refuses "unknown task" 2 "task.*mini.*cascade, mono, surface" "$satsurf" train --data data --out no --task mini
refuses "a flag of another task" 2 "task mono: --views" "$satsurf" train --data data --out no --task mono --views 3
refuses "scenes of too few images" 1 "has 4 images, expected at least 5: the 4 of views and one that is rendered" \
  "$satsurf" train --data data --out no --views 4
refuses "a flag of both other tasks" 2 "task surface: --grey_share" "$satsurf" train --out no --task surface --grey_share 0.1
refuses "a flag of the other task" 2 "task cascade: --least_relief" "$satsurf" train --data data --out no --least_relief 3
refuses "crop that does not fit mono" 2 "crop is 48, expected a multiple of 32" "$satsurf" train --data data --out no --task mono --crop 48
refuses "heights the wrong way round" 2 "height.range" "$satsurf" reconstruct "${images[@]}" --out no --weights $weights --height-range 50 10
refuses "unknown registration" 2 "register is .xy., expected one of none, z, xyz" "$satsurf" evaluate --dsm $truth --truth $truth --register xy
refuses "a picture without a reference" 2 "--reference" "$satsurf" evaluate --image out/height.png
refuses "a mesh without a reference" 2 "--reference-mesh" "$satsurf" evaluate --mesh out/mesh.ply
refuses "a mesh and a picture" 2 "--mesh excludes --image|--image excludes --mesh" \
  "$satsurf" evaluate --mesh out/mesh.ply --reference-mesh out/mesh.ply --image out/height.png
refuses "a surface without the truth" 2 "--truth is required" "$satsurf" evaluate --dsm $truth
refuses "the truth without a surface" 2 "--dsm and --truth" "$satsurf" evaluate --truth $truth
refuses "a table of one surface" 2 "evaluate --dsm: --csv came, expected only with --data$" \
  "$satsurf" evaluate --dsm $truth --truth $truth --csv no.csv
refuses "the truth of a data set" 2 "evaluate --data: --truth came, expected only with --dsm$" \
  "$satsurf" evaluate --data data --weights $weights --truth $truth
refuses "a registered picture" 2 "evaluate --image: --register came, expected only with --dsm or --data$" \
  "$satsurf" evaluate "${pictures[@]}" --register z
refuses "LPIPS of a mesh" 2 "evaluate --mesh: --lpips-weights came, expected only with --data or --image$" \
  "$satsurf" evaluate --mesh out/mesh.ply --reference-mesh out/mesh.ply --lpips_weights $weights
refuses "another kind of mesh" 2 "--mesh.*poisson" "$satsurf" reconstruct "${images[@]}" --out no --mesh poisson
refuses "voxels of nothing" 2 "--voxel is .0., expected a number from 0.01" "$satsurf" reconstruct "${images[@]}" --out no --voxel 0
refuses "a picture and a surface" 2 "--image excludes --dsm|--dsm excludes --image" \
  "$satsurf" evaluate --image out/height.png --reference out/height.png --dsm $truth --truth $truth
refuses "no output folder" 2 "--out" "$satsurf" reconstruct "${images[@]}" --weights $weights

refuses "a resolution that is no number" 2 "resolution.*nan" "$satsurf" reconstruct "${images[@]}" --out no --resolution nan
refuses "heights that are no number" 2 "height.range.*nan" "$satsurf" reconstruct "${images[@]}" --out no --height-range 0 nan
refuses "heights without a span" 2 "height.range.*at least 1 m" "$satsurf" reconstruct "${images[@]}" --out no --height-range 20 20.001
refuses "heights of no camera" 2 "height.range.*SIM_001_001_RGB.tif" "$satsurf" reconstruct "${images[@]}" --out no --weights $weights --height-range 8000 8100 --quiet
refuses "angles at odds" 2 "off_nadir_min_deg is 40.*10 of off_nadir_max_deg" "$satsurf" simulate --out no --off_nadir_min_deg 40 --off_nadir_max_deg 10
refuses "weights of kinds at odds" 2 "kind_weights has 1 numbers, expected the 2 of kinds" "$satsurf" simulate --out no --kinds city,rural --kind_weights 1
refuses "classes without a surface" 2 "classes comes without --surface" "$satsurf" simulate --out no --classes data/Track3-Truth/SIM_001_CLS.tif
refuses "parallax at odds" 2 "parallax_min is 50" "$satsurf" simulate --out no --parallax_min 50 --parallax_max 60
echo '{"lr": NaN}' >nan.json
refuses "NaN in a configuration" 2 "nan.json.*expected a JSON value" "$satsurf" train --config nan.json --data data --out no

# --- bad input: exit code 1, the file is named -----------------------------------------------------------------------
reconstruct() { "$satsurf" reconstruct "$@" --quiet; }
good=("${images[0]}" "${images[1]}")

echo "this is not an image" >text.tif
refuses "not a TIFF" 1 "text.tif" reconstruct "${good[0]}" text.tif --out no --weights $weights
refuses "info of what is not a TIFF" 1 "text.tif" "$satsurf" info text.tif
head -c 3000 "${images[2]}" >short.tif
refuses "truncated TIFF" 1 "short.tif.*expected" reconstruct "${good[0]}" short.tif --out no --weights $weights
: >empty.tif
refuses "empty file" 1 "empty.tif" reconstruct "${good[0]}" empty.tif --out no --weights $weights
refuses "no RPC" 1 "dsm.tif.*RPC" reconstruct "${good[0]}" out/dsm.tif --out no --weights $weights
refuses "missing image" 1 "nowhere.tif" reconstruct "${good[0]}" nowhere.tif --out no --weights $weights
refuses "no overlap" 1 "SIM_001_001_RGB.tif and .*SIM_002_001_RGB.tif do not overlap" \
  reconstruct "${good[0]}" data/Track3-RGB/SIM_002_001_RGB.tif --out no --weights $weights
refuses "one image" 1 "SIM_001_001_RGB.tif is the only image, expected two or more" reconstruct "${good[0]}" --out no --weights $weights
refuses "one image twice" 1 "SIM_001_001_RGB.tif is the only image, expected two or more" \
  reconstruct "${good[0]}" "${good[0]}" --out no --weights $weights
refuses "existing output folder" 1 "out .*--overwrite" reconstruct "${good[@]}" --out out --weights $weights
refuses "folders made around a failure" 1 "text.tif" reconstruct "${good[0]}" text.tif --out newd/deep/o --weights $weights
mkdir mydocs indir && echo "years of work" >mydocs/thesis.txt && cp "${good[@]}" indir/
refuses "overwriting a folder of somebody else" 1 "mydocs .*run.json" \
  reconstruct "${good[@]}" --out mydocs --weights $weights --overwrite
refuses "overwriting the images" 1 "indir holds the input indir/SIM_001_001_RGB.tif" \
  reconstruct indir/*.tif --out indir --weights $weights --overwrite
refuses "overwriting the weights" 1 "whole holds the input $weights" \
  reconstruct "${good[@]}" --out whole --weights $weights --overwrite
refuses "overwriting --image-dir" 1 "out holds the input out/views" \
  reconstruct "${good[@]}" --image-dir out/views --out out --weights $weights --overwrite
refuses "output is a file" 1 "above.png" reconstruct "${good[@]}" --out above.png --weights $weights
cp out/surfels.ply surfels.png
echo "a file" >text.txt
scored=(--dsm out/dsm.tif --truth $truth)
scores() { "$satsurf" evaluate "$@" --quiet; }
refuses "existing scores" 1 "^satsurf: --json: scores.json exists; use --overwrite" scores "${scored[@]}" --json scores.json
refuses "an error map that is no PNG" 2 "--error-map: error.jpg, expected a name ending in .png" scores "${scored[@]}" --error-map error.jpg
refuses "existing error map" 1 "--error-map: error.png exists; use --overwrite" scores "${scored[@]}" --error-map error.png
refuses "existing table" 1 "--csv: all.csv exists; use --overwrite" scores --data data --weights $weights --csv all.csv
refuses "existing confidences" 1 "--confidence-csv: confidence.csv exists; use --overwrite" \
  scores --data data --weights $weights --confidence-csv confidence.csv
refuses "existing figure" 1 "--confidence-figure: confidence.svg exists; use --overwrite" \
  scores --data data --weights $weights --confidence-figure confidence.svg
refuses "two tables in one file" 1 "out/../both: named for two" \
  scores --data data --weights $weights --csv out/../both --confidence-figure both
refuses "a network's weights for LPIPS of a data set" 1 "$weights: no net.slice1.0.weight" \
  scores --data data --weights $weights --lpips-weights $weights
refuses "unknown registration of a data set" 2 "register is .xy., expected one of none, z, xyz" scores --data data --weights $weights --register xy
refuses "scores into the truth" 1 "--json: $truth is an input" scores "${scored[@]}" --json $truth --overwrite
refuses "scores into the weights" 1 "--csv: $weights is an input" scores --data data --weights $weights --csv $weights --overwrite
refuses "scores into a folder" 1 "--json: out is a folder" scores "${scored[@]}" --json out --overwrite
refuses "existing picture scores" 1 "--json: picture.json exists; use --overwrite" scores "${pictures[@]}" --json picture.json
refuses "picture scores into the reference" 1 "--json: out/views/SIM_001_001_RGB_source.png is an input" \
  scores "${pictures[@]}" --json out/views/SIM_001_001_RGB_source.png --overwrite
refuses "a picture that is missing" 1 "gone.png: no such file" scores --image gone.png --reference out/height.png
refuses "a picture that is none" 1 "text.tif: .*expected a PNG, JPEG or TIFF" scores --image out/height.png --reference text.tif
head -c 1000 out/height.png >short.png
refuses "a truncated picture" 1 "short.png: .*expected a PNG, JPEG or TIFF" scores --image short.png --reference out/height.png
refuses "pictures of two sizes" 1 "height.png and .*source.png: [0-9]+ x [0-9]+ px in colour and [0-9]+ x [0-9]+ px.*one size" \
  scores --image out/height.png --reference out/views/SIM_001_001_RGB_source.png
refuses "a mask of another size" 1 "out/height.png: .*expected 96 x 96 px" scores "${pictures[@]}" --mask out/height.png
refuses "a network's weights for LPIPS" 1 "$weights: no net.slice1.0.weight" scores "${pictures[@]}" --lpips-weights $weights
meshes() { "$satsurf" evaluate --mesh "$1" --reference-mesh "$2" "${@:3}"; }
refuses "existing mesh scores" 1 "--json: mesh.json exists; use --overwrite" meshes out/mesh.ply out/mesh.ply --json mesh.json
refuses "mesh scores into the reference" 1 "--json: out/mesh.ply is an input" \
  meshes coarse/mesh.ply out/mesh.ply --json out/mesh.ply --overwrite
refuses "a mesh that is missing" 1 "gone.ply: no such file, expected a PLY file" meshes out/mesh.ply gone.ply
refuses "surfels for a mesh" 1 "out/surfels.ply: no faces, expected a mesh" meshes out/surfels.ply out/mesh.ply
refuses "a mesh in another zone" 1 "elsewhere.ply: EPSG:32[67][0-9]{2} and EPSG:32[67]60, expected one system" meshes out/mesh.ply elsewhere.ply
refuses "a mesh without a place" 1 "out/mesh.ply and nowhere.ply: EPSG:32[67][0-9]{2} and no system, expected one system" \
  meshes out/mesh.ply nowhere.ply
refuses "no weights for LPIPS" 1 "gone.safetensors" scores "${pictures[@]}" --lpips-weights gone.safetensors
refuses "two results in one file" 1 "out/../both.png: named for two" scores "${scored[@]}" --error-map out/../both.png --json both.png
refuses "an error map where no file can be" 1 "--error-map: text.txt/e.png cannot be written" \
  scores "${scored[@]}" --error-map text.txt/e.png
succeeds "overwriting scores" scores "${scored[@]}" --json scores.json --error-map error.png --overwrite
refuses "a view into its image" 1 "--out: ${images[0]} is an input" \
  "$satsurf" render --surfels out/surfels.ply --image "${images[0]}" --out "${images[0]}" --overwrite
refuses "surfels into themselves" 1 "is an input" "$satsurf" render --surfels surfels.png --nadir --out surfels.png --overwrite
refuses "existing output file" 1 "above.png.*--overwrite" "$satsurf" render --surfels out/surfels.ply --nadir --out above.png

# Text rasters with a camera in a Sat-NeRF JSON: easy to spoil in known ways. A camera looks north or south of
# straight down by $2 and has 64 x 64 pixels of 0.5 m.
view() { # NAME SLANT
  cat >"$1.json" <<JSON
{"img": "$1.asc", "width": 64, "height": 64, "min_alt": 0, "max_alt": 40, "sun_elevation": "+50.8",
 "sun_azimuth": "+150", "acquisition_date": "20200101", "geojson": {},
 "rpc": {"row_offset": 31.5, "col_offset": 31.5, "lat_offset": 10, "lon_offset": 20, "alt_offset": 20,
  "row_scale": 32, "col_scale": 32, "lat_scale": 1.446e-4, "lon_scale": 1.459e-4, "alt_scale": 100,
  "row_num": [0, 0, -1, $2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
  "row_den": [1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
  "col_num": [0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
  "col_den": [1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]}}
JSON
}
raster() { # NAME WHAT: texture, flat, holes (texture with NaN and nodata), nodata, nan; with a hole painted in zeros, or declared
  awk -v what="$2" 'BEGIN {
    print "ncols 64\nnrows 64\nxllcorner 0\nyllcorner 0\ncellsize 1\nNODATA_value -1"
    for (i = 0; i < 64; i++) for (j = 0; j < 64; j++) {
      v = int(100 + 60 * sin(i / 3) * cos(j / 2.3) + (i * 37 + j * 61) % 29) + 0.5
      if (what == "flat") v = 90
      if (what == "nodata" || (what == "holes" && i > 50)) v = -1
      if (i > 20 && i < 44 && j > 20 && j < 40) v = what == "painted" ? 0 : what == "declared" ? -1 : v
      if (what == "nan" || (what == "holes" && j > 50)) v = "nan"
      printf "%s%s", v, j < 63 ? " " : "\n"
    } }' >"$1.asc"
}
view a 0.9 && raster a texture
view b -0.9 && raster b holes
view c -0.9 && raster c nodata
view d -0.9 && raster d nan
succeeds "NaN and nodata pixels are left out" reconstruct a.json b.json --out holes --weights $weights
holds "the surface is there" test -s holes/dsm.tif
for what in painted declared; do mkdir $what && (cd $what && view b -0.9 && raster b $what); done
succeeds "a painted hole" reconstruct a.json painted/b.json --out hole_seen --weights $weights --mesh none --report none
succeeds "a hole by its value" reconstruct a.json painted/b.json --nodata 0 --out hole_named --weights $weights --mesh none --report none
succeeds "a hole that the file declares" reconstruct a.json declared/b.json --out hole_declared --weights $weights --mesh none --report none
for file in dsm views ortho; do
  holds "what --nodata names says nothing in $file" cmp hole_named/$file.tif hole_declared/$file.tif
  holds "and something where it does not, in $file" bash -c "! cmp -s hole_named/$file.tif hole_seen/$file.tif"
done
rm -rf hole_seen hole_named hole_declared
refuses "all nodata" 1 "c.asc" reconstruct a.json c.json --out no --weights $weights
refuses "all NaN" 1 "d.asc" reconstruct a.json d.json --out no --weights $weights
cat >huge.vrt <<XML
<VRTDataset rasterXSize="300000" rasterYSize="300000"><VRTRasterBand dataType="Byte" band="1"/></VRTDataset>
XML
sed 's/"a.asc", "width": 64, "height": 64/"huge.vrt", "width": 300000, "height": 300000/' a.json >huge.json
refuses "more pixels than the file can hold" 1 "huge.vrt: 300000 x 300000 px.*empty or damaged" reconstruct a.json huge.json --out no --weights $weights
{ printf 'P5 64 64 255\n' && head -c 4096 a.asc; } >a.pgm
sed 's/"a.asc"/"a.pgm"/' a.json >pgm.json
refuses "a format whose driver is not trusted" 1 "a.pgm: of the format PNM.*; --gdal-drivers PNM allows it" "$satsurf" info pgm.json
succeeds "a format whose driver is trusted" "$satsurf" info pgm.json --gdal-drivers PNM
refuses "a driver that GDAL has not" 2 "gdal_drivers: HDF6 is no driver of this GDAL, did you mean HDF4. expected some of .*, PNM," \
  "$satsurf" info pgm.json --gdal-drivers HDF6
refuses "a driver that GDAL has not, in the environment" 2 "HDF6 is no driver" env SATSURF_GDAL_DRIVERS=HDF6 "$satsurf" info pgm.json
raster flat flat && sed 's/"b.asc"/"flat.asc"/' b.json >flat.json
refuses "an image of one grey" 1 "flat.json: the same grey everywhere" reconstruct a.json flat.json --out no --weights $weights
sed 's/"row_num"/"row_nums"/' b.json >key.json
refuses "JSON with a wrong key" 1 "key.json.*row_num" reconstruct a.json key.json --out no --weights $weights
sed 's/"b.asc"/"lost.asc"/' b.json >lost.json
refuses "JSON whose image is missing" 1 "lost.asc" reconstruct a.json lost.json --out no --weights $weights
mkdir elsewhere && mv b.asc elsewhere/
succeeds "JSON whose image is elsewhere" reconstruct a.json b.json --image-dir elsewhere --out found --weights $weights
for read in a.json a.asc b.json elsewhere/b.asc $weights; do
  holds "it records that it read $read" grep -qF "\"path\": \"$read\"" found/run.json
done
head -c 100 b.json >cut.json
refuses "truncated JSON" 1 "cut.json" reconstruct a.json cut.json --out no --weights $weights

refuses "missing weights" 1 "gone.safetensors" reconstruct "${good[@]}" --out no --weights gone.safetensors
head -c 2000 $weights >short.safetensors
refuses "truncated weights" 1 "short.safetensors" reconstruct "${good[@]}" --out no --weights short.safetensors
head -c 100000 $weights >cut.safetensors
refuses "weights cut in the data" 1 "cut.safetensors" reconstruct "${good[@]}" --out no --weights cut.safetensors
hostile() { # NAME LENGTH-BYTES HEADER
  printf '%b%s' "$2" "$3" >"$1.safetensors"
}
hostile huge '\xff\xff\xff\xff\xff\xff\xff\x7f' '{}'
hostile wrap '\x42\x00\x00\x00\x00\x00\x00\x00' \
  '{"a":{"dtype":"F32","shape":[4611686018427387905],"data_offsets":[0,4]}}'
hostile back '\x2f\x00\x00\x00\x00\x00\x00\x00' '{"a":{"dtype":"F32","shape":[1],"data_offsets":[4,0]}}'
hostile deep '\x40\x00\x00\x00\x00\x00\x00\x00' "$(printf '[%.0s' $(seq 64))"
hostile plain '\x02\x00\x00\x00\x00\x00\x00\x00' '{}'
for name in huge wrap back deep plain; do
  refuses "hostile weights ($name)" 1 "$name.safetensors" reconstruct "${good[@]}" --out no --weights $name.safetensors
done
refuses "info of hostile weights" 1 "wrap.safetensors" "$satsurf" info wrap.safetensors
# The header of real weights with another configuration, and with a parameter that is no number.
sed -b 's/\\"volume_levels\\":2/\\"volume_levels\\":4/' $weights >levels.safetensors
refuses "weights of an impossible network" 1 "levels.safetensors: model: 8 hypotheses" \
  reconstruct "${good[@]}" --out no --weights levels.safetensors
head -c -4 $weights >nan.safetensors && printf '\x00\x00\xc0\x7f' >>nan.safetensors
refuses "weights with NaN" 1 "nan.safetensors: parameter .* holds nan" \
  reconstruct "${good[@]}" --out no --weights nan.safetensors
refuses "weights that are none" 1 "text.tif" reconstruct "${good[@]}" --out no --weights text.tif
cp "$satsurf" here # no weights beside it
refuses "no weights at all" 1 "weights: none found.*--weights" ./here reconstruct "${good[@]}" --out no
rm here

mkdir box && cp -r data box/
refuses "missing data folder" 1 "nowhere" "$satsurf" train --data nowhere --out no "${tiny[@]}"
mkdir hollow
refuses "folder without scenes" 1 "hollow" "$satsurf" train --data hollow --out no "${tiny[@]}"
mkdir hollow/scene && touch hollow/scene/train.txt
refuses "Sat-NeRF scene without views" 1 "hollow/scene/train.txt: names no view" "$satsurf" train --data hollow --out no "${tiny[@]}"
refuses "training into a used folder" 1 "whole .*--overwrite, or --resume to go on with its run" "$satsurf" train --data data --out whole "${tiny[@]}"
retrain() { "$satsurf" train "${tiny[@]}" --overwrite "$@"; }
refuses "overwriting, no such --init" 1 "nope.safetensors" retrain --data data --out whole --init nope.safetensors
refuses "overwriting, too few images" 1 "SIM_001 has 4 images" retrain --data data --out whole --views 8
refuses "overwriting --init" 1 "whole holds the input $weights" retrain --data data --out whole --init $weights
refuses "overwriting the data" 1 "data holds the input data" retrain --data data --out data
refuses "overwriting a folder around the data" 1 "^satsurf: --out: data/../box holds the input box/data" \
  retrain --data box/data --out data/../box
refuses "overwriting --config" 1 "data holds the input data/run.json" \
  "$satsurf" simulate --config data/run.json --out data --overwrite
refuses "a full disk" 1 "full.*checkpoint.safetensors.*cannot be written" bash -c \
  'ulimit -f 16; exec "$@"' full "$satsurf" train --data data --out full/new "${tiny[@]}"
refuses "resume with another configuration" 2 \
  "checkpoint.safetensors: made with .* to resume; lr: saved 0.001 vs given 0.1$" "$satsurf" train --data data --out whole "${tiny[@]}" --resume --lr 0.1
refuses "resume on scenes made up on the way" 2 "trained on 2 scenes of hash .* and not on scenes made up on the way, expected the same --data" \
  "$satsurf" train --out whole "${tiny[@]}" --resume
refuses "resume on other scenes" 2 "trained on 2 scenes of hash .* and not on 1 scenes of hash [0-9a-f]*, expected the same --data to resume" \
  "$satsurf" train --data "$(cp -r data fewer; rm fewer/*/SIM_002*; echo fewer)" --out whole "${tiny[@]}" --resume
refuses "resume without a checkpoint" 1 "checkpoint.safetensors" "$satsurf" train --data data --out no "${tiny[@]}" --resume
mkdir -p bare/Track3-RGB && cp data/Track3-RGB/SIM_001* bare/Track3-RGB/
refuses "training without truth" 1 "SIM_001.*_DSM.tif" "$satsurf" train --data bare --out no "${tiny[@]}"
cp -r data tilted && cp out/height.png tilted/Track3-Truth/SIM_001_CLS.tif
refuses "classes of another size" 1 "SIM_001_CLS.tif" "$satsurf" evaluate --data tilted --weights $weights --quiet
refuses "evaluating without truth" 1 "SIM_001_DSM.tif" "$satsurf" evaluate --data bare --weights $weights --quiet
mkdir -p eogs/images && cp -r bare/Track3-RGB eogs/images/S
refuses "EOGS without truth" 1 "eogs/truth/S/S_DSM.tif" "$satsurf" evaluate --data eogs --weights $weights --quiet
mkdir -p whu/image/0 && cp data/Track3-RGB/SIM_001_001_RGB.tif whu/image/0/S.png
refuses "WHU-TLC of one view" 1 "whu/image: holds the folder 0 alone" "$satsurf" evaluate --data whu --weights $weights --quiet
mkdir whu/image/1 && cp data/Track3-RGB/SIM_001_002_RGB.tif whu/image/1/S.png
refuses "WHU-TLC without cameras" 1 "whu/image/0/S.png: no camera .RPC., looked for .*whu/rpc/0/S.rpc" \
  "$satsurf" evaluate --data whu --weights $weights --quiet
refuses "missing truth" 1 "gone.tif" "$satsurf" evaluate --dsm out/dsm.tif --truth gone.tif
refuses "truth of another place" 1 "SIM_002_DSM.tif" "$satsurf" evaluate --dsm out/dsm.tif --truth data/Track3-Truth/SIM_002_DSM.tif
head -c 500 out/surfels.ply >short.ply
refuses "a view of another place" 1 "SIM_002_001_RGB.tif sees nothing of out/surfels.ply" \
  "$satsurf" render --surfels out/surfels.ply --image data/Track3-RGB/SIM_002_001_RGB.tif --out no.png
refuses "truncated surfels" 1 "short.ply" "$satsurf" render --surfels short.ply --nadir --out no.png
refuses "surfels that are none" 1 "text.tif" "$satsurf" render --surfels text.tif --nadir --out no.png

echo "$checks checks, $failures failed"
[ "$failures" -eq 0 ]
