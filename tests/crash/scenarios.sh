# SPDX-License-Identifier: Apache-2.0
# What run.sh has killed. A scenario defines `first`, which runs as if nothing had happened, `again`, which a user would
# have run after it was stopped, `same A B`, which compares results, and where there is something before, `prepare`, which
# puts it there, and `intact WHAT`, which says what has become of it. All of them run in an empty folder and leave `out`.
# shellcheck shell=bash disable=SC2034,SC2154  # variables are shared with run.sh

prepare() { :; }
intact() { :; }

# knows COMMAND FLAG: whether this program has it; an older one may not.
knows() {
  "$satsurf" "$1" --help 2>/dev/null | grep -E -- "^ +$2( |,|=|\$)" >/dev/null
}

# known COMMAND [FLAG VALUE]...: fills `flags` with those of these flags that the program has.
known() {
  local command=$1
  shift
  flags=()
  while [ $# -ge 2 ]; do
    knows "$command" "$1" && flags+=("$1" "$2")
    shift 2
  done
}

# needs COMMAND FLAG: says that a scenario is not there and returns failure, where the program has no such flag.
needs() {
  knows "$1" "$2" && return
  echo "$scenario: not there, this program's $1 has no $2"
  return 1
}

# --- trainings, which go on where they stopped ---------------------------------------------------------------------
train_with() { # FLAGS...
  how=("$@")
  first() { "${launch[@]}" "$satsurf" train --out out --seed 9 "${how[@]}"; }
  again() {
    if [ -e out/checkpoint.safetensors ]; then
      "$satsurf" train --out out --seed 9 "${how[@]}" --resume
    elif [ -e out ]; then
      "$satsurf" train --out out --seed 9 "${how[@]}" --overwrite
    else
      first
    fi
  }
  same() {
    cmp "$1/weights.safetensors" "$2/weights.safetensors" && cmp "$1/checkpoint.safetensors" "$2/checkpoint.safetensors" &&
      cmp <(sed 's/"seconds.*//' "$1/train.jsonl") <(sed 's/"seconds.*//' "$2/train.jsonl") &&
      diff <(ls -A "$1") <(ls -A "$2")
  }
}
scenario_train() {
  known train --average 0.9 --half true
  train_with --data ../data --preset tiny --crop 32 --steps 6 --checkpoint_every 2 "${flags[@]}"
}
scenario_mono() { train_with --task mono --data ../data --mono.base 2 --crop 32 --steps 6 --checkpoint_every 2; }
scenario_surface() {
  needs train --cascades || return
  train_with --task surface --data ../data --cascades ../tiny/weights.safetensors --crop 32 --steps 4 --checkpoint_every 2 --batch 1
}

# --- folders that appear when they are whole ------------------------------------------------------------------------
same_surface() { diff -r -x run.json -x report.html "$1" "$2"; }

scenario_tiles() {
  needs reconstruct --max-memory || return
  known reconstruct --pointing off
  how=("$satsurf" reconstruct "$work"/large/Track3-RGB/*.tif --weights ../tiny/weights.safetensors --max-memory 300MB
    --height-range 345 423 "${flags[@]}" --out out) # looking for heights and shifts takes time and changes no file
  first() { "${launch[@]}" "${how[@]}"; }
  again() { # a finished one is made once more
    if [ -e out ]; then "${how[@]}" --overwrite; else "${how[@]}" --resume; fi
  }
  same() { same_surface "$@"; }
}
scenario_reconstruct() {
  how=("$satsurf" reconstruct "$work"/data/Track3-RGB/*.tif --weights ../tiny/weights.safetensors --out out)
  first() { "${launch[@]}" "${how[@]}"; }
  again() { "${how[@]}" --overwrite; }
  same() { same_surface "$@"; }
}
scenario_overwrite() {
  prepare() { cp -r ../old out; }
  first() { "${launch[@]}" "$satsurf" simulate --out out --scenes 1 --views 2 --pixels 64 --seed 2 --overwrite; }
  again() { first; }
  same() { diff -r -x run.json "$1" "$2"; }
  intact() { # the name is never without a whole run
    if [ -e out ]; then
      diff -r out ../old >/dev/null || same out ../whole >/dev/null || difference "$scenario: neither old nor new after $1"
    else
      difference "$scenario: nothing there after $1"
    fi
  }
}

# --- files that replace older ones ----------------------------------------------------------------------------------
# What is in a file but times and memory, which no two runs have in common.
lasting() {
  case $1 in
    *.json) sed -E '/"(started|wall_seconds|peak_memory_bytes|peak_tensor_bytes|seconds)"/d' "$1" ;;
    *.csv) sed 's/,[^,]*$//' "$1" ;; # the last column is seconds
    *) cat "$1" ;;
  esac
}
same_file() { cmp <(lasting "$1") <(lasting "$2"); }

# files_with COMMAND...: it writes into the folder `out`, where files of these names lie with other content.
files_with() {
  how=("$@" --overwrite)
  prepare() {
    mkdir out
    [ ! -e ../whole ] || for file in ../whole/*; do echo old >"out/${file##*/}"; done
  }
  first() { "${launch[@]}" "${how[@]}"; }
  again() { first; }
  same() {
    local file
    diff <(ls -A "$1") <(ls -A "$2") && for file in "$2"/*; do same_file "$1/${file##*/}" "$file" || return; done
  }
  intact() { # each of them is old or new
    local file
    for file in ../whole/*; do
      file=out/${file##*/}
      cmp -s "$file" <(echo old) || same_file "$file" "../whole/${file##*/}" >/dev/null 2>&1 ||
        difference "$scenario: $file is neither old nor new after $1"
    done
  }
}

# A surface of the scene, once.
make_surface() {
  [ -e ../made ] || [ -e made ] ||
    run "$satsurf" reconstruct data/Track3-RGB/*.tif --weights tiny/weights.safetensors --out made --quiet || exit 1
}
scenario_evaluate() {
  files_with "$satsurf" evaluate --data ../data --weights ../tiny/weights.safetensors --csv out/scores.csv --json out/scores.json \
    --confidence-csv out/confidence.csv --confidence-figure out/confidence.svg
}
scenario_score() {
  make_surface
  files_with "$satsurf" evaluate --dsm ../made/dsm.tif --truth "$work"/data/Track3-Truth/*_DSM.tif --json out/scores.json --error-map out/map.png
}
scenario_render() {
  make_surface
  files_with "$satsurf" render --surfels ../made/surfels.ply --nadir --out out/view.tif
}
scenario_picture() {
  make_surface
  files_with "$satsurf" render --surfels ../made/surfels.ply --nadir --out out/view.png
}
scenario_export() {
  needs export --mesh || return
  make_surface
  files_with "$satsurf" export --mesh ../made/mesh.ply --to out/mesh.glb
}
