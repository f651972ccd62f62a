#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Kills the program with SIGKILL wherever it changes files, and at random moments, then runs it again as a user would:
# the results have the bytes of an undisturbed run, what was there before is there whole or replaced whole, nothing else
# is left, and the second run has said what it found of the first. The same with a disk that is full from some call on,
# of which the program has to tell.
#   run.sh PROGRAM [-e EVERY] [-b BEGIN] [-r RANDOM] [-s SEED] [SCENARIO...]
# EVERY     of the calls that change files every EVERY-th is the last one, or the first that finds the disk full; 1 is
#           all of them, the default
# BEGIN     the first of the calls to be killed at, where a campaign that was stopped goes on; default 1
# RANDOM    so many kills at random moments besides, spread over the scenarios; default 0
# SEED      of these moments, default 1
# SCENARIO  of scenarios.sh; without one all of them. Those that an older program has no flags for are passed over
# Needs a C compiler. It prints a line per scenario and part, and each difference as it is found.
set -uo pipefail
satsurf=$(realpath "$1")
here=$(realpath "$(dirname "$0")")
shift
every=1 begin_at=1 random=0 seed=1
while getopts e:b:r:s: option; do
  case $option in
    e) every=$OPTARG ;;
    b) begin_at=$OPTARG ;;
    r) random=$OPTARG ;;
    s) seed=$OPTARG ;;
    *) exit 2 ;;
  esac
done
shift $((OPTIND - 1))
scenarios=("$@")
[ $# -eq 0 ] && scenarios=(train mono surface overwrite tiles reconstruct evaluate score render picture export)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work" || exit 1
unset SATSURF_WEIGHTS
cc -shared -fPIC -O2 -o crash_at.so "$here/crash_at.c" && cc -o calls "$here/calls.c" || exit 1
failures=0
difference() {
  failures=$((failures + 1))
  echo "FAIL: $*"
  tail -n 3 "$work/output" | sed 's/^/  | /'
}
run() { # its words through a pipe, as they would find the disk full, too
  { "$@" 2>&1; } 2>/dev/null | LD_PRELOAD='' cat >"$work/output"
  return "${PIPESTATUS[0]}"
}
launch=() # what `first` is started by
# shellcheck source=tests/crash/scenarios.sh
. "$here/scenarios.sh"

# anew: an empty folder to run in, as the scenario wants it
anew() {
  cd "$work" && rm -rf run && mkdir run && cd run || exit 1
  prepare
}

# every_call_counts: whether each call that changes files is seen, killed at, and finds a full disk where it needs room
every_call_counts() {
  local name room code wanted
  prepare() { echo 123456789 >file && mkdir folder; }
  while read -r name room; do
    anew
    CALL_COUNT="$work/count" LD_PRELOAD="$work/crash_at.so" run ../calls "$name"
    code=$?
    [ "$code $(cat ../count)" = '0 1' ] || difference "$name: ended with $code and $(cat ../count) calls counted, expected 0 and 1"
    anew
    KILL_AT=1 LD_PRELOAD="$work/crash_at.so" run ../calls "$name"
    code=$?
    [ $code -eq 137 ] || difference "$name: a kill at it ended with $code, expected 137"
    anew
    FULL_AT=1 LD_PRELOAD="$work/crash_at.so" run ../calls "$name"
    code=$?
    wanted=$([ "$room" = room ] && echo 28 || echo 0)
    [ $code -eq "$wanted" ] || difference "$name: a full disk ended with $code, expected $wanted"
  done < <(./calls)
  cd "$work" || exit 1
}
every_call_counts
[ $failures -eq 0 ] || exit 1

run "$satsurf" simulate --out data --scenes 1 --views 4 --pixels 96 --seed 5 --quiet || exit 1
run "$satsurf" simulate --out large --scenes 1 --views 2 --pixels 420 --seed 3 --kinds village --quiet || exit 1
run "$satsurf" simulate --out old --scenes 1 --views 2 --pixels 64 --seed 1 --quiet || exit 1
run "$satsurf" train --data data --out tiny --preset tiny --crop 32 --steps 1 --quiet || exit 1

# complained CODE: whether the run before this told in one line that it failed
complained() {
  [ "$1" -eq 1 ] && [ "$(grep -c '^satsurf: ' "$work/output")" -eq 1 ]
}

# left_overs: what a stopped run has left that the next one has to speak of: what it had not finished, what it had moved
# away, and folders of tiles with something in them
left_overs() {
  local found
  find . \( -name '*.partial-*' -o -name '*.replaced-*' -o -name '*.tiles' \) -prune -print | while read -r found; do
    [[ $found != *.tiles ]] || [ -n "$(find "$found" -name '*.partial-*' -o -name 'tile_*.json')" ] && echo "$found"
  done
}

# spoken_of NAME: whether the run before this has said what it did with what was left of that name
spoken_of() {
  grep -F -- "${1##*/}" "$work/output" | grep 'stopped run' >/dev/null ||
    { [[ $1 == *.tiles ]] && grep -E '[0-9]+ tiles are there already' "$work/output" >/dev/null; }
}

# check WHAT: what is there after it happened and after the next run
check() {
  local found left
  intact "$1"
  left=$(left_overs)
  if ! run again; then
    difference "$scenario: the run after $1 failed"
    return
  fi
  for found in $left; do
    spoken_of "$found" || difference "$scenario: the run after $1 did not speak of $found"
  done
  if ! same out ../whole >"$work/output" 2>&1; then
    difference "$scenario: not the bytes of an undisturbed run after $1"
  elif [ "$(ls -A)" != out ] || [ -n "$(find . -name '*.partial-*')" ]; then
    { ls -A && find . -name '*.partial-*'; } >"$work/output"
    difference "$scenario: something is left after $1"
  fi
}

# undisturbed: makes `whole`; says how many seconds it takes and how many calls change files
undisturbed() {
  anew
  run first && mv out ../whole || return
  anew
  local begin=$EPOCHREALTIME
  CALL_COUNT="$work/count" LD_PRELOAD="$work/crash_at.so" run first || return
  seconds=$(awk -v a="$begin" -v b="$EPOCHREALTIME" 'BEGIN { print b - a }')
  calls=$(cat "$work/count")
  same out ../whole >"$work/output" 2>&1
}

kill_at_calls() {
  local at code
  for ((at = begin_at; at <= calls; at += every)); do
    anew
    KILL_AT=$at LD_PRELOAD="$work/crash_at.so" run first
    code=$?
    struck=$((struck + 1))
    [ $code -eq 137 ] || difference "$scenario: the kill at call $at did not strike, the run ended with $code"
    check "a kill at call $at"
  done
}

fill_the_disk() {
  local at code
  for ((at = 1; at <= calls; at += every)); do
    anew
    FULL_AT=$at LD_PRELOAD="$work/crash_at.so" run first
    code=$?
    if [ $code -eq 0 ]; then # what comes after the last write needs no room
      same out ../whole >/dev/null 2>&1 || difference "$scenario: a full disk at call $at went unnoticed"
    else
      struck=$((struck + 1))
      complained $code || difference "$scenario: exit code $code of a full disk at call $at, expected 1 and a word"
      [ -z "$(find . -name '*.partial-*')" ] || difference "$scenario: something is left of a full disk at call $at"
    fi
    check "a full disk at call $at"
  done
}

kill_at_random() {
  local i after
  for ((i = 0; i < random / ${#scenarios[@]}; ++i)); do
    anew
    after=$(awk -v s="$((seed * 100003 + i))" -v t="$seconds" 'BEGIN { srand(s); print 0.01 + rand() * t }')
    launch=(timeout -s KILL "$after")
    run first
    launch=()
    struck=$((struck + 1))
    check "a kill after $after s"
  done
}

for scenario in "${scenarios[@]}"; do
  cd "$work" || exit 1
  rm -rf whole
  . "$here/scenarios.sh" # what one scenario has defined is no part of the next
  declare -F "scenario_$scenario" >/dev/null || { echo "run.sh: $scenario is no scenario"; exit 2; }
  "scenario_$scenario" || continue
  if ! undisturbed; then
    difference "$scenario: the undisturbed run failed, or twice it gave other bytes"
    continue
  fi
  echo "$scenario: $calls calls that change files; a run takes $seconds s"
  for part in kill_at_calls fill_the_disk kill_at_random; do
    struck=0
    before=$failures
    $part
    echo "$scenario, $part: $struck times, $((failures - before)) differences"
  done
done
echo "$failures differences"
[ "$failures" -eq 0 ]
