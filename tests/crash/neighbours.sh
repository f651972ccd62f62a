#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What a program meets that is not alone on its machine: limits of file size and of memory, places that cannot be written,
# disks that are full, logs that are, signals, clocks that jump, the same command at the same moment. Every command either
# does its work or says in one line why not, within its limits and within a second of a signal, and leaves nothing behind
# but what the next run goes on with.
#   neighbours.sh PROGRAM [PART...]
# PART  files memory readonly disks logs signals clocks together; without one all of them
# Needs a C compiler; readonly and disks need root. Times of signals are those of an idle machine.
set -uo pipefail
satsurf=$(realpath "$1")
here=$(realpath "$(dirname "$0")")
shift
parts=("$@")
[ $# -eq 0 ] && parts=(files memory readonly disks logs signals clocks together)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work" || exit 1
unset SATSURF_WEIGHTS
cc -shared -fPIC -O2 -o clock_jumps.so "$here/clock_jumps.c" || exit 1
checks=0 failures=0
fail() {
  failures=$((failures + 1))
  echo "FAIL: $*"
  tail -n 3 output | sed 's/^/  | /'
}

"$satsurf" simulate --out data --scenes 1 --views 4 --pixels 96 --seed 5 --quiet >output 2>&1 || { cat output; exit 1; }
"$satsurf" simulate --out place --scenes 1 --views 3 --pixels 192 --seed 3 --kinds village --quiet >output 2>&1 || exit 1
"$satsurf" simulate --out large --scenes 1 --views 2 --pixels 420 --seed 3 --kinds village --quiet >output 2>&1 || exit 1
"$satsurf" train --data data --out tiny --preset tiny --crop 32 --steps 1 --quiet >output 2>&1 || exit 1
"$satsurf" reconstruct place/Track3-RGB/*.tif --out made --quiet >output 2>&1 || { cat output; exit 1; }
images=("$work"/place/Track3-RGB/*.tif)
large=("$work"/large/Track3-RGB/*.tif)
truth=("$work"/place/Track3-Truth/*_DSM.tif)
rendered=(made/views/*_render.png) source=(made/views/*_source.png)
before=$(ls -A)

# The commands, each into `out`, and those that leave something for the next run to go on with when they are stopped.
names=(reconstruct tiles train mono surface simulate evaluate render mesh export score compare)
goes_on='@(tiles|train|mono|surface)'
command_of() {
  case $1 in
    reconstruct) command=("$satsurf" reconstruct "${images[@]}" --out out --quiet) ;;
    tiles) command=("$satsurf" reconstruct "${large[@]}" --weights tiny/weights.safetensors --pointing off --max-memory 300MB --out out --quiet) ;;
    train) command=("$satsurf" train --data data --out out --preset tiny --crop 32 --steps 20 --checkpoint_every 2 --quiet) ;;
    mono) command=("$satsurf" train --task mono --data data --out out --mono.base 2 --crop 32 --steps 20 --checkpoint_every 2 --quiet) ;;
    surface) command=("$satsurf" train --task surface --data data --cascades tiny/weights.safetensors --out out --crop 32 --steps 10 --checkpoint_every 2 --batch 1 --quiet) ;;
    simulate) command=("$satsurf" simulate --out out --scenes 2 --views 3 --pixels 160 --seed 8 --quiet) ;;
    evaluate) command=("$satsurf" evaluate --data data --weights tiny/weights.safetensors --csv out --quiet) ;;
    render) command=("$satsurf" render --surfels made/surfels.ply --nadir --out out.tif) ;;
    mesh) command=("$satsurf" export --mesh made/mesh.ply --to out.glb) ;;
    export) command=("$satsurf" export --dsm made/dsm.tif --to out.glb) ;;
    score) command=("$satsurf" evaluate --dsm made/dsm.tif --truth "${truth[0]}" --json out) ;;
    compare) command=("$satsurf" evaluate --image "${rendered[0]}" --reference "${source[0]}" --json out) ;;
  esac
}
# into FOLDER: has the command write there
into() {
  local i
  for i in "${!command[@]}"; do [[ ${command[i]} == out* ]] && command[i]=$1/${command[i]}; done
}
# told_once CODE: whether a run ended well, or with one line that says why not
told_once() { [ "$1" -eq 0 ] || { [ "$1" -eq 1 ] && [ "$(grep -c '^satsurf: ' output)" -eq 1 ]; }; }
clear_away() { rm -rf out out.* ./*.tiles .??*; }

# refused_or_done NAME WHAT RC: whether it ended well or with one line, and left nothing that is not a result
refused_or_done() {
  checks=$((checks + 1))
  told_once "$3" || fail "$1, $2: ended with $3"
  local left
  left=$(comm -13 <(sort <<<"$before") <(ls -A | sort))
  if [ "$3" -ne 0 ] && [ -n "$left" ] && [[ $1 != $goes_on ]]; then
    fail "$1, $2: left $left"
  fi
  [ -n "$(find . -name '*.partial-*')" ] && fail "$1, $2: left $(find . -name '*.partial-*')"
  ended=$3
  clear_away
}

part_files() {
  local name kb
  for name in "${names[@]}"; do
    command_of "$name"
    for kb in 0 1 4 16 64 256 1024 4096 16384 65536; do
      (ulimit -f $kb; "${command[@]}") 2>&1 | cat >output
      refused_or_done "$name" "files of $kb KiB at most" "${PIPESTATUS[0]}"
    done
    [ "$ended" -eq 0 ] || fail "$name needs files above $kb KiB"
  done
}

# Below 500 MB of addresses a library behind OpenVDB gives up before the program begins.
part_memory() {
  local name mb
  for name in reconstruct tiles train mono surface simulate evaluate render; do
    command_of "$name"
    for mb in 500 600 700 800 1000 1300 1700; do
      (ulimit -v $((mb * 1024)); "${command[@]}") >output 2>&1
      refused_or_done "$name" "$mb MB of addresses" $?
    done
    [ "$ended" -eq 0 ] || fail "$name needs more than $mb MB"
  done
}

part_readonly() {
  [ "$(id -u)" -eq 0 ] || { echo "readonly: SKIPPED, needs root"; return; }
  mkdir locked && mount -t tmpfs -o ro tmpfs locked || { echo "readonly: SKIPPED, cannot mount"; rmdir locked; return; }
  local name
  for name in "${names[@]}"; do
    command_of "$name"
    into locked
    checks=$((checks + 1))
    "${command[@]}" >output 2>&1
    local rc=$?
    { [ $rc -eq 1 ] && [ "$(grep -c '^satsurf: ' output)" -eq 1 ]; } || fail "$name into a read-only place: ended with $rc"
  done
  checks=$((checks + 1))
  "$satsurf" info "${images[0]}" --log-file locked/log >output 2>&1
  [ $? -ne 0 ] && grep -q 'locked' output || fail "a log that cannot be written is not told of"
  umount locked && rmdir locked
}

# Disks of some size, so that what a library keeps in a buffer finds them full, too.
part_disks() {
  [ "$(id -u)" -eq 0 ] || { echo "disks: SKIPPED, needs root"; return; }
  mkdir disk
  local name kb rc left
  for name in "${names[@]}"; do
    for kb in 16 64 256 1024 4096 16384 65536; do
      mount -t tmpfs -o size=${kb}k tmpfs disk || { echo "disks: SKIPPED, cannot mount"; rmdir disk; return; }
      checks=$((checks + 1))
      command_of "$name"
      into disk
      "${command[@]}" 2>&1 | cat >output
      rc=${PIPESTATUS[0]}
      told_once "$rc" || fail "$name, a disk of $kb KiB: ended with $rc"
      left=$(find disk -mindepth 1)
      [ "$rc" -ne 0 ] && [ -n "$left" ] && [[ $name != $goes_on ]] && fail "$name, a disk of $kb KiB: left $left"
      [[ $left != *.partial-* ]] || fail "$name, a disk of $kb KiB: left $left"
      umount disk
    done
    [ "$rc" -eq 0 ] || fail "$name needs a disk above $kb KiB"
  done
  rmdir disk
}

# A log that is full is no reason to stop, and one to say so once.
part_logs() {
  local name rc
  for name in "${names[@]}"; do
    checks=$((checks + 1))
    command_of "$name"
    "${command[@]}" --log-level debug --log-file /dev/full >output 2>&1
    rc=$?
    [ $rc -eq 0 ] || fail "$name with a log that is full: ended with $rc"
    [ "$(grep -c '^warning: /dev/full: ' output)" -eq 1 ] || fail "$name with a log that is full: did not say so once"
    clear_away
  done
}

part_signals() {
  local name signal moment pid start rc took late=0 signals=(TERM HUP)
  if [ $((0x$(awk '/^SigIgn/ { print $2 }' /proc/self/status) & 1)) -ne 0 ]; then
    echo "signals: without SIGHUP, which nohup has everything ignore"
    signals=(TERM)
  fi
  for name in "${names[@]}"; do
    command_of "$name"
    for signal in "${signals[@]}"; do
      for moment in 0.05 0.1 0.15 0.2 0.25 0.3 0.4 0.5 0.7 1.0 1.4 1.9 2.5 3.2; do
        checks=$((checks + 1))
        "${command[@]}" >output 2>&1 &
        pid=$!
        sleep $moment
        start=$EPOCHREALTIME
        kill -$signal $pid 2>/dev/null
        wait $pid 2>/dev/null
        rc=$?
        took=$(awk -v a="$start" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.2f", b - a }')
        late=$(awk -v a="$late" -v b="$took" 'BEGIN { print (a > b ? a : b) }')
        [[ $rc == @(0|129|143) ]] || fail "$name, SIG$signal after $moment s: ended with $rc"
        awk -v t="$took" 'BEGIN { exit t > 1 }' || fail "$name, SIG$signal after $moment s: took $took s"
        [ $rc -ne 0 ] && [[ $name != $goes_on ]] && [ "$(ls -A)" != "$before" ] &&
          fail "$name, SIG$signal after $moment s: left $(comm -13 <(sort <<<"$before") <(ls -A | sort))"
        clear_away
        [ $rc -ne 0 ] || break # later ones come after its end
      done
    done
  done
  echo "slowest answer to a signal: $late s"
}

part_clocks() {
  local name
  for name in reconstruct train surface simulate; do
    checks=$((checks + 1))
    command_of "$name"
    "${command[@]}" >output 2>&1 || fail "$name failed"
    mv out straight
    LD_PRELOAD=$work/clock_jumps.so "${command[@]}" >output 2>&1 || fail "$name failed while clocks jumped"
    diff -r -x run.json -x report.html -x train.jsonl straight out >output || fail "$name: other results while clocks jumped"
    rm -rf straight
    clear_away
  done
}

# Two of them into one place, the second a moment later: one does its work, the other may be refused.
part_together() {
  local name later code codes whole left
  for name in reconstruct tiles train mono surface simulate; do
    command_of "$name"
    "${command[@]}" >output 2>&1 || fail "$name failed"
    mv out straight
    clear_away
    for later in 0 0.02 0.1 0.3; do
      checks=$((checks + 1))
      codes=() whole=0
      "${command[@]}" >output1 2>&1 &
      sleep $later
      "${command[@]}" >output2 2>&1
      codes[2]=$?
      wait $!
      codes[1]=$?
      for code in 1 2; do
        mv output$code output
        if [ "${codes[code]}" -eq 0 ]; then
          whole=$((whole + 1))
        elif [ "${codes[code]}" -ne 1 ] || [ "$(grep -c '^satsurf: ' output)" -ne 1 ]; then
          fail "$name beside another, $later s later: number $code ended with ${codes[code]}"
        fi
      done
      [ $whole -ge 1 ] || fail "$name beside another, $later s later: neither did its work"
      diff -r -x run.json -x report.html -x train.jsonl straight out >output 2>&1 ||
        fail "$name beside another, $later s later: not the results of one alone"
      left=$(comm -13 <(sort <<<"$before") <(ls -A | sort) | grep -vxE 'out|straight|output')
      [ -z "$left" ] || fail "$name beside another, $later s later: left $left"
      clear_away
    done
    rm -rf straight
  done
}

for part in "${parts[@]}"; do
  before=$(ls -A)
  was=$checks
  "part_$part"
  echo "$part: $((checks - was)) checks"
done
echo "$checks checks, $failures failed"
[ "$failures" -eq 0 ]
