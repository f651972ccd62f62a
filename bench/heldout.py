#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Scores weights on scenes that no training sees, as docs/training.md and the README tell of them.

  bench/heldout.py SATSURF FOLDER [--weights FILE --name NAME] [--sets NAME...] [--lidar DIR] [--lpips FILE]
                   [--seed S] [--against NAME]

SATSURF    the program
FOLDER     to work in: sets/ gets the scenes, NAME/ a table of scores for each set; what is there already is not made
           again
--weights  what is scored, the shipped weights unless said; --name is `shipped` then
--sets     city, suburb, industrial and village are the 48 scenes, which is what is scored unless said; others (12 of
           all kinds, seed 9000) and crags (6)
--seed     of the first of the four sets of the 48, 910001 unless said; with others no weights and no settings were chosen by
           these scenes
--lidar    a folder of surfaces somebody measured, *_DSM.tif and *_CLS.tif: four scenes under simulated light on each
--lpips    a network for LPIPS of the held-out views
--against  another NAME scored before: how many scenes are better

All scenes are seen in three views and scored without meshes. Means are over scenes; heights are those of the surface
with its holes filled unless said, without any shift.
"""
import argparse
import csv
import shutil
import statistics
import subprocess
from pathlib import Path

FORTY_EIGHT = {
    "city": ["--scenes", 17, "--kinds", "city", "--seed", 910001],
    "suburb": ["--scenes", 12, "--kinds", "suburb", "--seed", 910002],
    "industrial": ["--scenes", 10, "--kinds", "industrial", "--seed", 910003],
    "village": ["--scenes", 9, "--kinds", "village,rural,rough", "--seed", 910004],
}
SETS = {name: ["--pixels", 512, "--views", 4, *what] for name, what in FORTY_EIGHT.items()} | {
    "others": ["--pixels", 512, "--views", 5, "--scenes", 12, "--seed", 9000],
    "crags": ["--pixels", 512, "--views", 4, "--scenes", 6, "--kinds", "rough,rural", "--crags", 1, "--relief_max", 110,
              "--seed", 910005],
}
FILLED = "dsm_filled_none_"

# title, columns, what each is multiplied with, its digits
ROWS = [
    ("mean error, RMSE, m", [FILLED + "mae", FILLED + "rmse"], 1, 3),
    ("< 1 m, < 2.5 m, < 7.5 m, %", [FILLED + "pag1", FILLED + "pag2.5", FILLED + "pag7.5"], 100, 1),
    ("holes as they are: mean error, m", ["dsm_none_mae"], 1, 3),
    ("holes as they are: < 1 m, < 2.5 m, with a height, %",
     ["dsm_none_pag1", "dsm_none_pag2.5", "dsm_none_completeness"], 100, 1),
    ("mean error hidden from a view, in shadow, m", ["cause_hidden_mae", "cause_shadow_mae"], 1, 2),
    ("on roofs above 2000 m2, at rims, on trees, on open ground, m",
     [f"cause_{cause}_mae" for cause in ("roof_large", "rim", "tree", "open_ground")], 1, 2),
    ("heights in the source views, m", ["mvs_source_mae"], 1, 3),
    ("held-out view: PSNR, SSIM, LPIPS", ["render_target_psnr", "render_target_ssim", "render_target_lpips"], 1, 3),
    ("errors within the expected one, within twice that, %", ["sigma_within_1", "sigma_within_2"], 100, 1),
]


def run(*command):
    command = [str(c) for c in command]
    if subprocess.run(command, stdout=subprocess.DEVNULL).returncode != 0:
        raise SystemExit(f"failed: {' '.join(command)}")


def scenes_of(options, name, recipe):
    """The folder of a set, which appears when it is complete."""
    place = options.folder / "sets" / name
    if not place.exists():
        part = place.with_name(name + ".part")
        shutil.rmtree(part, ignore_errors=True)
        run(options.program, "simulate", "--quiet", "--out", part, *recipe)
        part.rename(place)
    return place


def scores(table):
    """Of each scene its numbers by their columns."""
    with table.open(newline="") as lines:
        return {row["scene"]: {column: float(value) for column, value in row.items() if column != "scene" and value}
                for row in csv.DictReader(lines) if row["scene"] != "mean"}


def scored(options, name, recipe):
    table = options.folder / options.name / f"{name}.csv"
    if not table.exists():
        table.parent.mkdir(parents=True, exist_ok=True)
        part = table.with_suffix(".part")
        given = [word for flag, file in (("--weights", options.weights), ("--lpips-weights", options.lpips)) if file
                 for word in (flag, file)]
        run(options.program, "evaluate", "--quiet", "--data", scenes_of(options, name, recipe), "--views", 3,
            "--no-meshes", "--csv", part, *given)
        part.rename(table)
    return scores(table)


def report(title, scenes):
    """The rows of some scenes."""
    print(f"\n{title}: {len(scenes)} scenes")
    for name, columns, factor, digits in ROWS:
        means = []
        for column in columns:
            values = [row[column] for row in scenes if column in row]
            means.append(f"{factor * statistics.fmean(values):.{digits}f}" if values else "-")
        print(f"  {name:62} {', '.join(means)}")
    errors = [row[FILLED + "mae"] for row in scenes]
    print(f"  {'median of the scenes, worst scene, m':62} {statistics.median(errors):.2f}, {max(errors):.2f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--name")
    parser.add_argument("--sets", nargs="*", choices=SETS, default=list(FORTY_EIGHT))
    parser.add_argument("--seed", type=int, default=910001)
    parser.add_argument("--lidar", type=Path)
    parser.add_argument("--lpips", type=Path)
    parser.add_argument("--against")
    options = parser.parse_args()
    if options.weights and not options.name:
        parser.error("--weights came without --name, expected the folder of their scores")
    options.name = options.name or "shipped"
    wanted = {name: SETS[name] for name in options.sets}
    of_the_four = {name: name for name in FORTY_EIGHT}
    if options.seed != 910001:
        of_the_four = {name: f"{name}_{options.seed}" for name in FORTY_EIGHT}
        wanted = {of_the_four.get(name, name): recipe for name, recipe in wanted.items()}
        for k, name in enumerate(FORTY_EIGHT):
            if of_the_four[name] in wanted:
                wanted[of_the_four[name]] = [*SETS[name][:-1], options.seed + k]
    if options.lidar:
        for surface in sorted(options.lidar.glob("*_DSM.tif")):
            place = surface.name.removesuffix("_DSM.tif")
            wanted[place] = ["--surface", surface, "--classes", surface.with_name(f"{place}_CLS.tif"),
                             "--scenes", 4, "--views", 4, "--pixels", 640, "--seed", 77]
    lacking = [name for name in wanted if options.against and not (options.folder / options.against / f"{name}.csv").exists()]
    if lacking:
        parser.error(f"--against {options.against}: {options.folder / options.against} has no scores of {', '.join(lacking)}, "
                     f"expected those of an earlier run with --name {options.against}")
    of_the_48 = []  # of each of their sets the scenes
    better = compared = 0
    for name, recipe in wanted.items():
        of_set = scored(options, name, recipe)
        report(name, list(of_set.values()))
        if options.against:
            other = scores(options.folder / options.against / f"{name}.csv")
            both = [(of_set[s][FILLED + "mae"], other[s][FILLED + "mae"]) for s in of_set if s in other]
            less = sum(a < b for a, b in both)
            print(f"  {options.against}: {statistics.fmean(b for _, b in both):.3f} m, of {len(both)} scenes better: {less}")
            if name in of_the_four.values():
                better, compared = better + less, compared + len(both)
        if name in of_the_four.values():
            of_the_48.append(list(of_set.values()))
    if len(of_the_48) > 1:
        report("of the 48", sum(of_the_48, []))
        if options.against:
            print(f"  {options.against}: of {compared} scenes better: {better}")


if __name__ == "__main__":
    main()
