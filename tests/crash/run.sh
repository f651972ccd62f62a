#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Kills the program with SIGKILL wherever it changes files, and at random moments, then runs it again as a user would:
# the results have the bytes of an undisturbed run, what was there before is there whole or replaced whole, and nothing
# else is left. The same with a disk that is full from some write on, of which the program has to tell.
#   run.sh PROGRAM [-e EVERY] [-b BEGIN] [-r RANDOM] [-s SEED] [SCENARIO...]
# EVERY     of the calls that change files every EVERY-th is the last one, or the first that finds the disk full; 1 is
#           all of them, the default
# BEGIN     the first of the calls to be killed at, where a campaign that was stopped goes on; default 1
# RANDOM    so many kills at random moments besides, spread over the scenarios; default 0
# SEED      of these moments, default 1
# SCENARIO  train mono surface tiles overwrite; without one all of them
# Needs a C compiler. It prints a line per scenario, and each difference as it is found.
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
[ $# -eq 0 ] && scenarios=(train mono surface tiles overwrite)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work" || exit 1
unset SATSURF_WEIGHTS
cc -shared -fPIC -O2 -o crash_at.so "$here/crash_at.c" || exit 1
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

# --- scenarios: `first` runs as if nothing had happened, `again` after a kill, `same A B` compares results -----------
train_with() { # FLAGS...: of a run that goes on where it stopped
  first() { "${launch[@]}" "$satsurf" train --out out --seed 9 --quiet "${how[@]}"; }
  again() {
    if [ -e out/checkpoint.safetensors ]; then
      "$satsurf" train --out out --seed 9 --quiet "${how[@]}" --resume
    elif [ -e out ]; then
      "$satsurf" train --out out --seed 9 --quiet "${how[@]}" --overwrite
    else
      first
    fi
  }
  same() {
    cmp "$1/weights.safetensors" "$2/weights.safetensors" && cmp "$1/checkpoint.safetensors" "$2/checkpoint.safetensors" &&
      cmp <(sed 's/"seconds.*//' "$1/train.jsonl") <(sed 's/"seconds.*//' "$2/train.jsonl") &&
      diff <(ls -A "$1") <(ls -A "$2")
  }
  how=("$@")
  prepare() { :; }
  intact() { :; }
}
scenario_train() {
  train_with --data ../data --preset tiny --crop 32 --steps 6 --checkpoint_every 2 --average 0.9 --half true
}
scenario_mono() { train_with --task mono --data ../data --mono.base 2 --crop 32 --steps 6 --checkpoint_every 2; }
scenario_surface() {
  train_with --task surface --data ../data --cascades ../tiny/weights.safetensors --crop 32 --steps 4 --checkpoint_every 2 --batch 1
}
scenario_tiles() {
  local images=("$work"/large/Track3-RGB/*.tif)
  how=("$satsurf" reconstruct "${images[@]}" --weights ../tiny/weights.safetensors --pointing off --max-memory 300MB --quiet)
  prepare() { :; }
  intact() { :; }
  first() { "${launch[@]}" "${how[@]}" --out out; }
  again() { # a finished one is made once more
    if [ -e out ]; then "${how[@]}" --out out --overwrite; else "${how[@]}" --out out --resume; fi
  }
  same() { diff -r -x run.json -x report.html "$1" "$2"; }
}
scenario_overwrite() {
  prepare() { cp -r ../old out; }
  first() { "${launch[@]}" "$satsurf" simulate --out out --scenes 1 --views 2 --pixels 64 --seed 2 --overwrite --quiet; }
  again() { first; }
  same() { diff -r -x run.json "$1" "$2"; }
  intact() { # the name is never without a whole run
    if [ -e out ]; then
      diff -r out ../old >/dev/null || same out ../whole >/dev/null || difference "$scenario: neither old nor new after a kill $1"
    else
      difference "$scenario: nothing there after a kill $1"
    fi
  }
}

run "$satsurf" simulate --out data --scenes 1 --views 4 --pixels 96 --seed 5 --quiet || exit 1
run "$satsurf" simulate --out large --scenes 1 --views 2 --pixels 420 --seed 3 --kinds village --quiet || exit 1
run "$satsurf" simulate --out old --scenes 1 --views 2 --pixels 64 --seed 1 --quiet || exit 1
run "$satsurf" train --data data --out tiny --preset tiny --crop 32 --steps 1 --quiet || exit 1

# complained: whether the run before this told in one line that it failed
complained() {
  [ "$1" -eq 1 ] && [ "$(grep -c '^satsurf: ' "$work/output")" -eq 1 ]
}

# check NAME: what is there after the kill of that name and after the next run
check() {
  intact "$1"
  if ! run again; then
    difference "$scenario: the run after a kill $1 failed"
  elif ! same out ../whole >"$work/output" 2>&1; then
    difference "$scenario: not the bytes of an undisturbed run after a kill $1"
  elif [ "$(ls -A)" != out ] || [ -n "$(find . -name '*.partial-*')" ]; then
    ls -A >"$work/output"
    difference "$scenario: something is left after a kill $1"
  fi
}

for scenario in "${scenarios[@]}"; do
  "scenario_$scenario" || exit 2
  rm -rf whole run && mkdir run && cd run || exit 1
  prepare
  begin=$(date +%s.%N)
  if ! CALL_COUNT="$work/count" LD_PRELOAD="$work/crash_at.so" run first; then
    difference "$scenario: the undisturbed run failed"
    exit 1
  fi
  seconds=$(awk -v a="$begin" -v b="$(date +%s.%N)" 'BEGIN { print b - a }')
  calls=$(cat "$work/count")
  mv out ../whole
  cd .. || exit 1
  kills=0 stopped=0
  for ((at = begin_at; at <= calls; at += every)); do
    rm -rf run && mkdir run && cd run || exit 1
    prepare
    KILL_AT=$at LD_PRELOAD="$work/crash_at.so" run first
    [ $? -eq 137 ] && stopped=$((stopped + 1))
    kills=$((kills + 1))
    check "at call $at"
    cd .. || exit 1
  done
  full=0
  for ((at = 1; at <= calls; at += every)); do
    rm -rf run && mkdir run && cd run || exit 1
    prepare
    FULL_AT=$at LD_PRELOAD="$work/crash_at.so" run first
    code=$?
    if [ "$code" -eq 0 ]; then # what comes after the last write needs no room
      same out ../whole >/dev/null 2>&1 || difference "$scenario: a full disk at call $at went unnoticed"
    else
      full=$((full + 1))
      complained "$code" || difference "$scenario: exit code $code of a full disk at call $at, expected 1 and a word"
      [ -z "$(find . -name '*.partial-*')" ] || difference "$scenario: something is left of a full disk at call $at"
    fi
    check "(a full disk) at call $at"
    cd .. || exit 1
  done
  for ((i = 0; i < random / ${#scenarios[@]}; ++i)); do
    rm -rf run && mkdir run && cd run || exit 1
    prepare
    after=$(awk -v s="$((seed * 100003 + i))" -v t="$seconds" 'BEGIN { srand(s); print 0.01 + rand() * t }')
    launch=(timeout -s KILL "$after")
    run first
    launch=()
    kills=$((kills + 1))
    check "after $after s"
    cd .. || exit 1
  done
  echo "$scenario: $calls calls that change files, $kills kills, $stopped of them at a call; $full times a full disk"
done
echo "$failures differences"
[ "$failures" -eq 0 ]
