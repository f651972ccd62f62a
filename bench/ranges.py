#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Whether the height range that is found of three images holds the true surface.

  bench/ranges.py SATSURF FOLDER [--scenes N] [--seed S] [--data SET...]

SATSURF  the program
FOLDER   to work in; ranges.csv there gets a line for every scene, and those that are in it are not tried again
N        scenes, 300 unless said: three images of 512 px each, made one at a time and thrown away
S        of the first one, 970001 unless said
SET      data sets of `simulate` that are there already, whose first three images are taken instead

A scene's range comes from `reconstruct --dry-run`, its truth from the simulator's surface where it falls into two images or
more. Prints how many ranges hold the lowest and the highest true height, how many of them those of the water, too, which
has no texture and may lie far below, and how wide they are; then how many of those that the network's first look leaves of
them to be searched do, and what share of the cells lies beyond. Needs python3-gdal and python3-numpy of Debian.
"""
import argparse
import csv
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
from osgeo import gdal, osr

gdal.UseExceptions()
MIX = ["--kinds", "city,suburb,industrial,village,rural,rough", "--kind_weights", "0.35,0.25,0.2,0.07,0.07,0.06"]
COLUMNS = ["scene", "low", "high", "true_low", "true_high", "low_with_water", "high_with_water", "searched_low", "searched_high",
           "beyond"]
WATER = 9  # its class


def run(*command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(map(str, command))}: {done.stderr.strip()}")
    return done.stdout


def true_heights(truth, classes, images):
    """Those that fall into two images or more, every second cell a side; without the water, and with it."""
    raster = gdal.Open(str(truth))
    z = raster.ReadAsArray()[::2, ::2].astype(float)
    water = gdal.Open(str(classes)).ReadAsArray()[::2, ::2] == WATER
    nodata = raster.GetRasterBand(1).GetNoDataValue()
    x0, step_x, _, y0, _, step_y = raster.GetGeoTransform()
    x, y = np.meshgrid(x0 + (2 * np.arange(z.shape[1]) + 0.5) * step_x, y0 + (2 * np.arange(z.shape[0]) + 0.5) * step_y)
    known = np.isfinite(z) if nodata is None else np.isfinite(z) & (z != nodata)
    there, geodetic = osr.SpatialReference(raster.GetProjection()), osr.SpatialReference()
    geodetic.ImportFromEPSG(4326)
    for system in (there, geodetic):
        system.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
    places = np.array(osr.CoordinateTransformation(there, geodetic).TransformPoints(np.column_stack([x[known], y[known]])))[:, :2]
    points = np.column_stack([places, z[known]])
    seen = np.zeros(len(points), int)
    for image in images:
        picture = gdal.Open(str(image))
        pixels, good = gdal.Transformer(picture, None, ["METHOD=RPC"]).TransformPoints(True, points.tolist())
        pixels = np.array(pixels)
        seen += (np.array(good) > 0) & (pixels[:, 0] >= 0) & (pixels[:, 0] < picture.RasterXSize) & \
            (pixels[:, 1] >= 0) & (pixels[:, 1] < picture.RasterYSize)
    return points[(seen >= 2) & ~water[known], 2], points[seen >= 2, 2]


def tried(program, name, images, truth):
    said = run(program, "reconstruct", *images, "--dry-run", "--quiet")
    low, high = re.search(r"height range +(-?[\d.]+) to (-?[\d.]+) m", said).groups()
    less = re.search(r"of it +(-?[\d.]+) to (-?[\d.]+) m is searched", said)
    searched = less.groups() if less else (low, high)
    both = true_heights(truth, truth.with_name(truth.name.replace("_DSM", "_CLS")), images)
    beyond = np.mean((both[0] < float(searched[0])) | (both[0] > float(searched[1])))
    return [name, low, high, *(f"{z:.2f}" for heights in both for z in (heights.min(), heights.max())), *searched,
            f"{beyond:.6f}"]


def scenes(options):
    """Name, images and truth, one after the other."""
    for data in options.data:
        for truth in sorted((data / "Track3-Truth").glob("*_DSM.tif")):
            scene = truth.name.removesuffix("_DSM.tif")
            yield f"{data.name}/{scene}", lambda d=data, s=scene, t=truth: (sorted((d / "Track3-RGB").glob(f"{s}_*.tif"))[:3], t)
    if options.data:
        return
    place = options.folder / "scene"

    def made(seed):
        shutil.rmtree(place, ignore_errors=True)
        run(options.program, "simulate", "--out", place, "--scenes", 1, "--views", 3, "--pixels", 512, *MIX, "--parallax_min",
            0.15, "--seed", seed, "--quiet")
        return sorted((place / "Track3-RGB").glob("*.tif")), next((place / "Track3-Truth").glob("*_DSM.tif"))
    for seed in range(options.seed, options.seed + options.scenes):
        yield str(seed), lambda s=seed: made(s)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--seed", type=int, default=970001)
    parser.add_argument("--data", type=Path, nargs="*", default=[])
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    table = options.folder / "ranges.csv"
    rows = list(csv.reader(table.open()))[1:] if table.exists() else []
    with table.open("a", newline="") as out:
        writer = csv.writer(out)
        if out.tell() == 0:  # one that was stopped in its first scene has left its header alone
            writer.writerow(COLUMNS)
        for name, get in scenes(options):
            if any(r[0] == name for r in rows):
                continue
            rows.append(tried(options.program, name, *get()))
            writer.writerow(rows[-1])
            out.flush()
    low, high, true_low, true_high, lowest, highest, least, most, beyond = np.array([r[1:] for r in rows], float).T
    below, above = low - true_low, true_high - high  # m that are missed
    wide = (high - low) / (true_high - true_low)
    print(f"{len(rows)} scenes; {np.sum((below <= 0) & (above <= 0))} ranges hold the surface, "
          f"{np.sum((low <= lowest) & (highest <= high))} with its water")
    for row, b, a in zip(rows, below, above):
        if b > 0 or a > 0:
            print(f"  {row[0]}: found {row[1]} to {row[2]} m, true {row[3]} to {row[4]} m")
    print(f"as wide as the surface is high: median {np.median(wide):.2f} times, most {wide.max():.2f}")
    wide = (most - least) / (true_high - true_low)
    print(f"searched: {np.sum((least <= true_low) & (true_high <= most))} hold the surface, {np.sum(beyond > 0.001)} lack more "
          f"than a thousandth of it; as wide as it is high: median {np.median(wide):.2f} times, most {wide.max():.2f}")
    for row, share in zip(rows, beyond):
        if share > 0.001:
            print(f"  {row[0]}: searched {row[7]} to {row[8]} m, true {row[3]} to {row[4]} m, {100 * share:.2f} % beyond")


if __name__ == "__main__":
    main()
