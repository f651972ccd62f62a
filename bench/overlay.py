#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Whether the rasters of a surface lie where they say, by GDAL's own tools.

  bench/overlay.py SURFACE [TRUTH [IMAGE...]]

SURFACE  what `satsurf reconstruct --out` made
TRUTH    a DSM of the same place in any system, of known position, its heights above the ellipsoid
IMAGE    with an RPC that GDAL reads, one of those the surface is made of

Every raster has to pass GDAL's validator of cloud-optimised GeoTIFFs and to lie on the grid of dsm.tif. Then, by the shift
in cells at which two of them agree best: heights against the truth, which GDAL brings onto the grid, and the orthophoto
against the images, which GDAL rectifies over the truth by their RPC; a pointing correction (pointing.json) shows there. Ends
with 1 if a raster fails. Needs python3-gdal and python3-numpy of Debian.
"""
import sys
from pathlib import Path

import numpy as np
from osgeo import gdal
from osgeo_utils.samples import validate_cloud_optimized_geotiff as cog

gdal.UseExceptions()
REACH = 3  # cells


def grid_of(raster):
    return raster.GetGeoTransform(), raster.RasterXSize, raster.RasterYSize


def values(raster, band=1):
    read = raster.GetRasterBand(band)
    out = read.ReadAsArray().astype(float)
    if read.GetNoDataValue() is not None:
        out[out == read.GetNoDataValue()] = np.nan
    return out


def best_shift(a, b, cost):
    """Columns and rows that b has to be moved by to look like a: between the whole ones, which alone are tried because
    interpolation smooths, by a parabola."""
    steps = range(-REACH, REACH + 1)
    inner = (slice(REACH, -REACH),) * 2
    costs = np.array([[cost(a[inner], np.roll(b, (y, x), (0, 1))[inner]) for x in steps] for y in steps])
    i, j = np.unravel_index(np.argmin(costs), costs.shape)

    def between(line, k):
        if k in (0, len(line) - 1):
            return steps[k]
        low, mid, high = line[k - 1:k + 2]
        return steps[k] + 0.5 * (low - high) / (low - 2 * mid + high)
    return between(costs[i], j), between(costs[:, j], i)


def distance(a, b):
    """Mean distance from the median difference, of 2 m at most: what is built wrongly does not count for more."""
    d = a - b
    d = d[np.isfinite(d)]
    return np.minimum(np.abs(d - np.median(d)), 2).mean()


def unlike(a, b):
    good = np.isfinite(a) & np.isfinite(b)
    return -np.corrcoef(a[good], b[good])[0, 1]


def brightness(raster):
    return sum(values(raster, b + 1) for b in range(min(3, raster.RasterCount)))


def main(surface, truth=None, *images):
    surface, failed = Path(surface), False
    dsm = gdal.Open(str(surface / "dsm.tif"))
    for file in sorted(surface.glob("*.tif")):
        _, errors, _ = cog.validate(str(file))
        same = grid_of(gdal.Open(str(file))) == grid_of(dsm)
        print(f"{file.name}: {'; '.join(errors) if errors else 'cloud-optimised'}, {'on' if same else 'NOT on'} the grid of dsm.tif")
        failed |= bool(errors) or not same
    transform, width, height = grid_of(dsm)
    grid = dict(format="MEM", dstSRS=dsm.GetProjection(), width=width, height=height, resampleAlg="bilinear", outputBounds=(
        transform[0], transform[3] + height * transform[5], transform[0] + width * transform[1], transform[3]))
    away = "at its best %.2f columns and %.2f rows away"
    if truth:
        there = gdal.Warp("", str(truth), dstNodata=-9999, **grid)
        print("truth:", away % best_shift(values(dsm), values(there), distance))
    ortho = brightness(gdal.Open(str(surface / "ortho.tif")))
    for image in images:
        there = gdal.Warp("", str(image), rpc=True, transformerOptions=[f"RPC_DEM={truth}"], dstNodata=0, **grid)
        print(f"{Path(image).name}:", away % best_shift(ortho, brightness(there), unlike))
    return 1 if failed else 0


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
