#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Whether a surface that was made in tiles shows where they meet.

  bench/seams.py SURFACE TRUTH

SURFACE  what `satsurf reconstruct --out` made, in tiles
TRUTH    a DSM of the same place, in the surface's system, as `simulate` writes it: a GeoTIFF with a .txt beside it that says
         least easting, least northing, cells and their side

For each distance from the nearest border between two tiles, in cells of the surface, the cells of the truth: their number,
how far heights lie from the truth (mean and median of the absolute differences), and the mean absolute jump of that
difference from one cell of the truth to the next across that border, along the row or column of cells that runs most across
it, which a seam would raise at 0. Needs python3-gdal and python3-numpy of Debian.
"""
import json
import sys
from pathlib import Path

import numpy as np
from osgeo import gdal

gdal.UseExceptions()
BANDS = [0, 2, 4, 8, 16, 32, 64, 128, 10**9]  # cells


def read(path):
    raster = gdal.Open(str(path))
    band = raster.GetRasterBand(1)
    out = band.ReadAsArray().astype(np.float32)
    if band.GetNoDataValue() is not None:
        out[out == band.GetNoDataValue()] = np.nan
    return raster, out


def borders(table):
    """Directions of the tiles' axes and, along both, where two of them meet, m."""
    tiles = [t for t in table if t["status"] == "done"]

    def corners(t):
        x0, y0, x1, y1 = t["ground"]
        return np.array(t.get("corners", [[x0, y1], [x1, y1], [x1, y0], [x0, y0]]))

    first = corners(tiles[0])
    axes = [(first[1] - first[0]) / np.linalg.norm(first[1] - first[0]),
            (first[3] - first[0]) / np.linalg.norm(first[3] - first[0])]
    meet = []
    for axis, key in zip(axes, ("column", "row")):
        ends = {}
        for t in tiles:
            at = corners(t) @ axis
            ends[t[key]] = at.min()
        meet.append(np.array([at for k, at in sorted(ends.items())][1:]))
    return axes, meet


def main(surface, truth):
    table = json.loads((Path(surface) / "run.json").read_text())["results"]["tile_table"]
    axes, meet = borders(table)
    raster, z = read(Path(surface) / "dsm.tif")
    east, step, _, north, _, _ = raster.GetGeoTransform()
    _, true = read(truth)
    x0, y0, _, side = [float(v) for v in Path(truth).with_suffix(".txt").read_text().split()]
    rows = np.arange(true.shape[0])[:, None]
    columns = np.arange(true.shape[1])[None, :]
    e = x0 + (columns + 0.5) * side + 0 * rows
    n = y0 + (true.shape[0] - rows - 0.5) * side + 0 * columns
    u = np.floor((e - east) / step).astype(int)
    v = np.floor((north - n) / step).astype(int)
    inside = (u >= 0) & (v >= 0) & (u < z.shape[1]) & (v < z.shape[0])
    made = np.full(true.shape, np.nan, np.float32)
    made[inside] = z[v[inside], u[inside]]
    off = made - true
    jumps = np.full((2, *true.shape), np.nan, np.float32)  # along a row of cells, along a column
    jumps[0, :, 1:] = np.abs(off[:, 1:] - off[:, :-1])
    jumps[1, 1:] = np.abs(off[1:] - off[:-1])
    jump = np.full(true.shape, np.nan, np.float32)
    distance = np.full(true.shape, np.inf, np.float32)
    for axis, at in zip(axes, meet):
        along = e * axis[0] + n * axis[1]
        across = jumps[0] if abs(axis[0]) >= abs(axis[1]) else jumps[1]
        for border in at:
            here = np.abs(along - border) / step
            jump = np.where(here < distance, across, jump)
            distance = np.minimum(distance, here)
    print("cells from a border       cells      mean    median      jump")
    for low, high in zip(BANDS, BANDS[1:]):
        some = (distance >= low) & (distance < high) & np.isfinite(off)
        if not some.any():
            continue
        error = np.abs(off[some])
        name = f"{low} to {high}" if high < BANDS[-1] else f"{low} and more"
        print(f"{name:18}{some.sum():13}{error.mean():9.3f} m{np.median(error):7.3f} m"
              f"{np.nanmean(jump[some]):8.3f} m")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
