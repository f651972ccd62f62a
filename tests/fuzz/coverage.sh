#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Which lines of the readers the inputs in build/fuzz/corpus and build/fuzz/seeds reach: run.sh has to have made them.
#   coverage.sh [TARGET...]     those of the readers if left out
# Prints a line for each file of the project that the targets have; what is not reached: add --show FILE after `--`.
#   coverage.sh safetensors -- --show core/safetensors.cpp
set -euo pipefail
cd "$(dirname "$0")/../.."
build=build/fuzz-coverage
targets=() show=
while [ $# -gt 0 ]; do
  case $1 in
    --) ;;
    --show) show=$2 && shift ;;
    *) targets+=("$1") ;;
  esac
  shift
done
[ ${#targets[@]} -gt 0 ] ||
  targets=(safetensors surfels_ply mesh_ply pointing camera_file satnerf raster sidecar dfc_grid area)
[ -n "${SATSURF_FUZZ_BUILT:-}" ] || tests/build.sh fuzz-coverage "${targets[@]/#/fuzz_}"

mkdir -p $build/profiles
objects=() profiles=()
for target in "${targets[@]}"; do
  folders=()
  for folder in build/fuzz/corpus/"$target" build/fuzz/seeds/"$target"; do [ -d "$folder" ] && folders+=("$folder"); done
  LLVM_PROFILE_FILE=$build/profiles/$target.raw $build/bin/fuzz_"$target" -runs=0 -timeout=60 "${folders[@]}" \
    >$build/profiles/"$target".log 2>&1
  profiles+=("$build/profiles/$target.raw") objects+=(-object "$build/bin/fuzz_$target")
done
llvm-profdata-16 merge -sparse -o $build/all.profdata "${profiles[@]}"
if [ -n "$show" ]; then
  llvm-cov-16 show "${objects[@]:1}" -instr-profile=$build/all.profdata -sources "$PWD/$show" "$PWD/$build/include/satsurf/$show"
else
  # file, lines, lines not reached, share of lines reached
  llvm-cov-16 report "${objects[@]:1}" -instr-profile=$build/all.profdata -ignore-filename-regex='/usr/|tests/|generated' |
    awk '/\.(cpp|h) / || /^TOTAL/ { printf "%-34s %6s %6s %8s\n", $1, $8, $9, $10 }'
fi
