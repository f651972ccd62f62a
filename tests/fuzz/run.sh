#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds the fuzz targets, makes what they begin with and runs them one after the other; as root on Debian 12 it installs
# clang first. Prints a line for each and fails if there was any finding.
#   run.sh [SECONDS | -runs=N] [TARGET...]     10 seconds and all targets if left out; `readers` and `others`
#                                           are its halves, the first the cheaper one
# Inputs that reached something new are kept in build/fuzz/corpus/TARGET and are where the next run begins;
# those that failed lie in build/fuzz/findings. Run one again: build/fuzz/bin/fuzz_TARGET FILE
# SATSURF_FUZZ_TIMEOUT: seconds that an input may take, if not 2: more where the machine has other work
set -euo pipefail
cd "$(dirname "$0")/../.."
here=tests/fuzz build=build/fuzz

length=-max_total_time=10
case ${1:-} in
  -runs=*) length="$1 -seed=1" && shift ;; # the same inputs each time, as long as the corpus is the same
  [0-9]*) length=-max_total_time=$1 && shift ;;
esac
# Those that need readers alone, and those that make something of what was read.
readers='safetensors surfels_ply mesh_ply pointing camera_file satnerf raster sidecar dfc_grid area picture'
others='weights json tile dataset cameras scene'
known=$readers\ $others
targets=${*:-$known}
[ "$targets" = readers ] && targets=$readers
[ "$targets" = others ] && targets=$others
makers=make_files
for target in $targets; do
  [[ " $others " == *" $target "* ]] && makers='make_files make_networks'
  if [[ " $known " != *" $target "* ]]; then
    echo "run.sh: there is no target '$target', expected some of:" $known >&2
    exit 2
  fi
done

if ! command -v clang++-16 >/dev/null || [ ! -e /usr/lib/llvm-16/lib/clang/16/lib/linux/libclang_rt.fuzzer-x86_64.a ]; then
  if [ "$(id -u)" -ne 0 ]; then
    echo "run.sh: packages are missing; as root: apt-get install --no-install-recommends clang-16 libclang-rt-16-dev" >&2
    exit 2
  fi
  export DEBIAN_FRONTEND=noninteractive
  apt-get update -q
  apt-get install -q -y --no-install-recommends clang-16 libclang-rt-16-dev llvm-16
fi
if [ -z "${SATSURF_FUZZ_BUILT:-}" ]; then
  tests/build.sh fuzz $(printf 'fuzz_%s ' $makers $targets)
fi

TMPDIR=$(mktemp -d -p "$([ -w /dev/shm ] && echo /dev/shm || echo /tmp)" satsurf-fuzz.XXXXXX)
export TMPDIR
trap 'rm -rf "$TMPDIR"' EXIT
export ASAN_OPTIONS=allocator_may_return_null=0:handle_abort=1:detect_stack_use_after_return=0
export UBSAN_OPTIONS=print_stacktrace=1
export LSAN_OPTIONS=suppressions=$PWD/$here/lsan.supp:print_suppressions=0
[ -x "$(command -v llvm-symbolizer-16)" ] && export ASAN_SYMBOLIZER_PATH=$(command -v llvm-symbolizer-16)

mkdir -p $build/findings $build/logs
rm -rf $build/seeds && mkdir -p $build/seeds
for maker in $makers; do "$build/bin/fuzz_$maker" $build/seeds; done
failed=0
printf '%-12s %10s %8s %7s %8s\n' target runs runs/s edges findings
for target in $targets; do
  mkdir -p "$build/corpus/$target" "$build/seeds/$target"
  log=$build/logs/$target.log
  timeout=${SATSURF_FUZZ_TIMEOUT:-2} # s
  code=0
  "$build/bin/fuzz_$target" $length -timeout=$timeout -rss_limit_mb=2048 -malloc_limit_mb=200 -dict=$here/words.dict \
    -print_final_stats=1 -artifact_prefix="$build/findings/$target-" "$build/corpus/$target" "$build/seeds/$target" \
    >"$log" 2>&1 || code=$?
  runs=$(sed -n 's/^stat::number_of_executed_units: *//p' "$log" | tail -1)
  rate=$(sed -n 's/^stat::average_exec_per_sec: *//p' "$log" | tail -1)
  edges=$(grep -a -o ' cov: [0-9]*' "$log" | tail -1 | grep -o '[0-9]*' || true)
  found=0
  [ "$code" -eq 0 ] || found=1
  printf '%-12s %10s %8s %7s %8s\n' "$target" "${runs:-?}" "${rate:-?}" "${edges:-?}" "$found"
  if [ "$code" -ne 0 ]; then
    failed=1
    grep -a -m 3 -E 'FINDING|SUMMARY|runtime error|ERROR: |Test unit written' "$log" | sed 's/^/  /' | cut -c1-300
    grep -a 'Test unit written to' "$log" | sed 's/^/  /' || true
  fi
done
exit $failed
