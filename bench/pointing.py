#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""How well errors of pointing are found that are known: simulated scenes whose cameras are moved.

  bench/pointing.py SATSURF FOLDER [--scenes N] [--views N] [--surfaces] [--show]

SATSURF   the program
FOLDER    to work in; scenes that are there are used again
--scenes  of one date and as many of several dates (6)
--views   images of each scene (3)
--surfaces  reconstruct, too: mean error after registration, of that with the true cameras
--show    every scene, not only means

Every image's camera is moved by up to 0, 1, 5, 30 px in both axes, another way in each scene. What is left after the
correction that `satsurf info` would make is told without what no image can tell: a shift and a lift of all of the ground
are fitted to the remaining errors of all images and taken out, and the mean length of the rest is shown, before
and after, in pixels. Needs python3-gdal and python3-numpy of Debian.
"""
import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from osgeo import gdal

gdal.UseExceptions()
ERRORS = [0, 1, 5, 30]  # px
BIAS_SEED = 20261126


def run(*command):
    return subprocess.run([str(c) for c in command], capture_output=True, text=True)


def terms(p, l, h):
    return np.array([1, l, p, h, l * p, l * h, p * h, l * l, p * p, h * h, p * l * h, l**3, l * p * p, l * h * h, l * l * p,
                     p**3, p * h * h, l * l * h, p * p * h, h**3])


class Camera:
    def __init__(self, path):
        self.tags = gdal.Open(str(path)).GetMetadata("RPC")
        number = lambda name: float(self.tags[name])
        self.offsets = [number(n) for n in ("LAT_OFF", "LONG_OFF", "HEIGHT_OFF")]
        self.scales = [number(n) for n in ("LAT_SCALE", "LONG_SCALE", "HEIGHT_SCALE")]
        rows = [np.array([float(v) for v in self.tags[n].split()])
                for n in ("SAMP_NUM_COEFF", "SAMP_DEN_COEFF", "LINE_NUM_COEFF", "LINE_DEN_COEFF")]
        self.rows = rows
        self.image = [(number("SAMP_SCALE"), number("SAMP_OFF")), (number("LINE_SCALE"), number("LINE_OFF"))]

    def project(self, lat, lon, h):
        t = terms(*[(v - o) / s for v, o, s in zip((lat, lon, h), self.offsets, self.scales)])
        return np.array([scale * (num @ t) / (den @ t) + off
                         for (scale, off), num, den in zip(self.image, self.rows[::2], self.rows[1::2])])

    def jacobian(self, lat, lon, h):
        """Of the pixel by metres to the east, to the north and up."""
        north = 1 / 110574.0
        east = north / np.cos(np.radians(lat))
        steps = [(0, east, 0), (north, 0, 0), (0, 0, 1)]
        return np.column_stack([self.project(lat + a, lon + b, h + c) - self.project(lat - a, lon - b, h - c)
                                for a, b, c in steps]) / 2


def unseen_left_out(errors, jacobians):
    """Mean length of the errors of images, px, without a shift and a lift of all of the ground."""
    a, y = np.vstack(jacobians), np.concatenate(errors)
    rest = y - a @ np.linalg.lstsq(a, y, rcond=None)[0]
    return np.hypot(*rest.reshape(-1, 2).T).mean()


def moved(images, folder, by):
    folder.mkdir(parents=True, exist_ok=True)
    out = []
    for image, (x, y) in zip(images, by):
        out.append(folder / image.name)
        if out[-1].exists():
            continue
        shutil.copy(image, out[-1])
        copy = gdal.Open(str(out[-1]), gdal.GA_Update)
        tags = copy.GetMetadata("RPC")
        tags["SAMP_OFF"] = repr(float(tags["SAMP_OFF"]) + x)
        tags["LINE_OFF"] = repr(float(tags["LINE_OFF"]) + y)
        copy.SetMetadata(tags, "RPC")
        del copy
    return out


def surface_error(satsurf, images, folder, truth, *flags):
    if not (folder / "dsm.tif").exists():
        done = run(satsurf, "reconstruct", *images, "--out", folder, "--mesh", "none", "--report", "none", *flags)
        if done.returncode:
            print(done.stderr)
            return float("nan")
    out = folder.with_suffix(".json")
    run(satsurf, "evaluate", "--dsm", folder / "dsm.tif", "--truth", truth, "--register", "xyz", "--json", out)
    return json.loads(out.read_text())["results"]["registered"]["mae"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("satsurf")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scenes", type=int, default=6)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--surfaces", action="store_true")
    parser.add_argument("--show", action="store_true")
    args = parser.parse_args()
    for same in (1, 0):
        data = args.folder / ("one_date" if same else "apart")
        if not data.exists():
            done = run(args.satsurf, "simulate", "--scenes", args.scenes, "--pixels", 512, "--views", args.views, "--kinds",
                       "city,suburb,industrial,village", "--same_pass", same, "--seed", 970001 + same, "--out", data)
            if done.returncode:
                sys.exit(done.stderr)
        random = np.random.default_rng(BIAS_SEED)
        unit = random.uniform(-1, 1, (args.scenes, args.views, 2))
        for most in ERRORS:
            rows = []
            for k in range(args.scenes):
                name = f"SIM_{k + 1:03}"
                images = sorted((data / "Track3-RGB").glob(name + "_*.tif"))
                by = most * unit[k]
                given = moved(images, args.folder / f"{data.name}_{most}" / name, by)
                cameras = [Camera(i) for i in images]
                lat, lon, h = cameras[0].offsets
                jacobians = [c.jacobian(lat, lon, h) for c in cameras]
                told = json.loads(run(args.satsurf, "info", *given, "--json").stdout)["pointing"]
                shifts = np.zeros((len(images), 2))
                if told.get("applied"):
                    shifts = np.array([[s["x"], s["y"]] for s in told["shifts"]])
                before, after = unseen_left_out(by, jacobians), unseen_left_out(by + shifts, jacobians)
                row = [before, after]
                if args.surfaces:
                    truth = data / "Track3-Truth" / f"{name}_DSM.tif"
                    true = surface_error(args.satsurf, images, args.folder / "true" / f"{data.name}_{name}", truth, "--pointing", "off")
                    row += [true, surface_error(args.satsurf, given, args.folder / "made" / f"{data.name}_{name}_{most}", truth)]
                rows.append(row)
                if args.show:
                    ties = [p["ties"] for p in told.get("pairs", [])]
                    print(f"  {data.name} {name} {most:2} px: {before:6.2f} -> {after:5.2f} px, ties {ties}"
                          + (f", {row[2]:.3f} -> {row[3]:.3f} m" if args.surfaces else ""))
            mean = np.nanmean(rows, axis=0)
            worst = np.nanmax(rows, axis=0)
            print(f"{data.name:9}{most:3} px: {mean[0]:6.2f} -> {mean[1]:5.2f} px, at most {worst[1]:5.2f}"
                  + (f"; {mean[2]:.3f} -> {mean[3]:.3f} m, {mean[3] / mean[2]:.3f}" if args.surfaces else ""), flush=True)


if __name__ == "__main__":
    main()
