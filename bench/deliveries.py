#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""What vendors deliver, made from three images of one simulated scene, and what becomes of it.

  bench/deliveries.py SATSURF FOLDER [--made-by PROGRAM] [CASE...]

SATSURF  the program
PROGRAM  another one that makes the surfaces, which SATSURF scores: an earlier commit's, to compare with
FOLDER   to work in; `simulate` puts a scene there if it holds none
CASE     names of the cases to try; without one all of them

Every case is the same scene, delivered another way: the images turned or cropped with their cameras exactly with them, in
other formats and depths, with borders, clouds or cameras that are off, or reconstructed with other height ranges. A line
for each: mean error of the cells found after a shift (what images tell of a place is relative), how many times that of the
plain case, the same in the cells that both have found and that as many images see, cells found, what was warned of. Where
the cameras or the range were changed the two surfaces lie apart, and the cells in common are others in each. Needs GDAL's
programs and Python's GDAL (Debian: gdal-bin, python3-gdal, python3-numpy).
"""
import json
import re
import subprocess
import sys
from pathlib import Path

from osgeo import gdal

gdal.UseExceptions()
NUMBERS = ["LINE_OFF", "SAMP_OFF", "LAT_OFF", "LONG_OFF", "HEIGHT_OFF",
           "LINE_SCALE", "SAMP_SCALE", "LAT_SCALE", "LONG_SCALE", "HEIGHT_SCALE"]
COEFFICIENTS = ["LINE_NUM_COEFF", "LINE_DEN_COEFF", "SAMP_NUM_COEFF", "SAMP_DEN_COEFF"]


def run(*command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(done.stderr.strip().splitlines()[-1] if done.stderr.strip() else f"exit code {done.returncode}")
    return done


class Image:
    """Bands of 8 or 16 bits in memory, with a camera."""

    def __init__(self, width, height, bands, depth, rpc):
        self.width, self.height, self.bands, self.depth, self.rpc = width, height, bands, depth, rpc

    @staticmethod
    def read(path, scratch):
        info = json.loads(run("gdalinfo", "-json", path).stdout)
        width, height = info["size"]
        raw = scratch / "raw.bin"
        run("gdal_translate", "-q", "-of", "ENVI", "-co", "INTERLEAVE=BSQ", path, raw)
        content, plane = raw.read_bytes(), width * height
        return Image(width, height, [bytearray(content[b * plane:(b + 1) * plane]) for b in range(len(info["bands"]))], 1,
                     dict(info["metadata"]["RPC"]))

    def write(self, path, scratch, *options):
        """A GeoTIFF with its camera in a file beside it, or what GDAL makes of that with these options."""
        raw = scratch / "out.bin"
        raw.write_bytes(b"".join(self.bands))
        raw.with_suffix(".hdr").write_text(
            f"ENVI\nsamples = {self.width}\nlines = {self.height}\nbands = {len(self.bands)}\nheader offset = 0\n"
            f"data type = {1 if self.depth == 1 else 12}\ninterleave = bsq\nbyte order = 0\n")
        tif = scratch / "out.tif" if options else path
        run("gdal_translate", "-q", raw, tif)
        Path(str(tif) + ".aux.xml").unlink(missing_ok=True)
        if "JP2OpenJPEG" in options:  # which knows no camera yet, and GDAL would put it into the file
            run("gdal_translate", "-q", *options, tif, path)
            tags = "".join(f'    <MDI key="{key}">{value}</MDI>\n' for key, value in self.rpc.items())
            Path(str(path) + ".aux.xml").write_text(f'<PAMDataset>\n  <Metadata domain="RPC">\n{tags}  </Metadata>\n</PAMDataset>\n')
            return
        lines = [f"{name}: {self.rpc[name]}" for name in NUMBERS]
        for name in COEFFICIENTS:
            lines += [f"{name}_{i + 1}: {v}" for i, v in enumerate(self.rpc[name].split())]
        tif.with_name(tif.stem + "_RPC.TXT").write_text("\n".join(lines) + "\n")
        if options:
            run("gdal_translate", "-q", *options, tif, path)
            if "NITF" in options:  # what a NITF has room for, no more
                Path(str(path) + ".aux.xml").unlink(missing_ok=True)

    def shift_camera(self, x, y):
        self.rpc["SAMP_OFF"] = repr(float(self.rpc["SAMP_OFF"]) + x)
        self.rpc["LINE_OFF"] = repr(float(self.rpc["LINE_OFF"]) + y)

    def turn(self, quarters):
        """Clockwise."""
        for _ in range(quarters):
            w, h, d = self.width, self.height, self.depth
            turned = []
            for band in self.bands:
                rows = [band[r * w * d:(r + 1) * w * d] for r in range(h)]
                out = bytearray(w * h * d)
                for r in range(h):
                    for byte in range(d):
                        out[(h - 1 - r) * d + byte::h * d] = rows[r][byte::d]
                turned.append(out)
            r = self.rpc
            negative = " ".join(repr(-float(v)) for v in r["LINE_NUM_COEFF"].split())
            self.rpc = dict(r, SAMP_NUM_COEFF=negative, SAMP_DEN_COEFF=r["LINE_DEN_COEFF"], SAMP_SCALE=r["LINE_SCALE"],
                            SAMP_OFF=repr(h - 1 - float(r["LINE_OFF"])), LINE_NUM_COEFF=r["SAMP_NUM_COEFF"],
                            LINE_DEN_COEFF=r["SAMP_DEN_COEFF"], LINE_SCALE=r["SAMP_SCALE"], LINE_OFF=r["SAMP_OFF"])
            self.bands, self.width, self.height = turned, h, w

    def crop(self, x, y, width, height):
        """Outside the image it is black."""
        for b, band in enumerate(self.bands):
            out = bytearray(width * height * self.depth)
            for row in range(height):
                source, first, last = row + y, max(x, 0), min(x + width, self.width)
                if 0 <= source < self.height and first < last:
                    out[(row * width + first - x) * self.depth:(row * width + last - x) * self.depth] = \
                        band[(source * self.width + first) * self.depth:(source * self.width + last) * self.depth]
            self.bands[b] = out
        self.width, self.height = width, height
        self.shift_camera(-x, -y)

    def map(self, function, depth=1):
        """Every value by a table; of 16 bits, function gives them."""
        if depth == 2:
            low = bytes(function(v) & 255 for v in range(256))
            high = bytes(function(v) >> 8 for v in range(256))
            for b, band in enumerate(self.bands):
                out = bytearray(2 * len(band))
                out[0::2], out[1::2] = band.translate(low), band.translate(high)
                self.bands[b] = out
            self.depth = 2
        else:
            table = bytes(function(v) for v in range(256))
            self.bands = [bytearray(band.translate(table)) for band in self.bands]

    def cloud(self, x, y, radius):
        """A white disc."""
        for band in self.bands:
            for row in range(max(0, y - radius), min(self.height, y + radius)):
                half = int((radius * radius - (row - y) ** 2) ** 0.5)
                first, last = max(0, x - half), min(self.width, x + half)
                band[row * self.width + first:row * self.width + last] = b"\xf5" * max(0, last - first)


def cases(images):
    """Name, images, flags of reconstruct, options of gdal_translate, ending."""
    def changed(*changes):
        out = []
        for i, image in enumerate(images):
            copy = Image(image.width, image.height, [bytearray(b) for b in image.bands], image.depth, dict(image.rpc))
            for who, what in changes:
                if who in (i, None):
                    what(copy)
            out.append(copy)
        return out

    def luminance(image):
        image.bands = image.bands[1:2]

    def bands(n):
        def more(image):
            image.bands = [bytearray(image.bands[k % 3]) for k in range(n)]
        return more

    w, h = images[0].width, images[0].height
    tif = ([], ".tif")
    yield "plain", changed(), [], *tif
    yield "cameras off by 3 px", changed((0, lambda i: i.shift_camera(3, 0)), (1, lambda i: i.shift_camera(-1.5, 2.6)),
                                         (2, lambda i: i.shift_camera(-1.5, -2.6))), [], *tif
    yield "cameras off by 30 px", changed((0, lambda i: i.shift_camera(30, 0)), (1, lambda i: i.shift_camera(-15, 26)),
                                          (2, lambda i: i.shift_camera(-15, -26))), [], *tif
    yield "NITF with RPC00B", changed(), [], ["-of", "NITF"], ".ntf"
    yield "JPEG 2000 with the camera in .aux.xml", changed(), [], ["-of", "JP2OpenJPEG", "-co", "QUALITY=25"], ".jp2"
    for quarters in (1, 2, 3):
        yield f"one image turned by {90 * quarters}", changed((1, lambda i, q=quarters: i.turn(q))), [], *tif
    yield "all turned differently", changed((0, lambda i: i.turn(1)), (1, lambda i: i.turn(2)), (2, lambda i: i.turn(3))), [], *tif
    yield "black borders", changed((None, lambda i: i.crop(-90, -60, w + 170, h + 140))), [], *tif
    yield "different sizes", changed((1, lambda i: i.crop(40, 20, w - 60, h - 50)), (2, lambda i: i.crop(10, 50, w - 30, h - 90))), [], *tif
    yield "11 bit", changed((None, lambda i: i.map(lambda v: 90 + 7 * v, 2))), [], *tif
    yield "one band", changed((None, luminance)), [], *tif
    yield "four bands", changed((None, bands(4))), [], *tif
    yield "eight bands", changed((None, bands(8))), [], *tif
    yield "one image with a cloud", changed((1, lambda i: i.cloud(w // 3, h // 2, w // 5))), [], *tif
    yield "a range that misses", changed(), ["--height-range", "MISSES"], *tif
    yield "all heights of the cameras", changed(), ["--height-range", "WIDE"], *tif


def compared(plain, case, folder):
    """Both surfaces in the cells that both have found and that as many images see in the case, as `plain.tif` and `case.tif`."""
    grid = gdal.Open(str(plain / "dsm.tif"))
    x, width, _, y, _, height = grid.GetGeoTransform()
    bounds = [x, y + height * grid.RasterYSize, x + width * grid.RasterXSize, y]

    def values(made, name):
        there = gdal.Warp("", str(made / name), format="MEM", outputBounds=bounds, xRes=width, yRes=-height)
        return there.ReadAsArray(), there.GetRasterBand(1).GetNoDataValue()
    heights = {"plain": values(plain, "dsm.tif"), "case": values(case, "dsm.tif")}
    views = [values(made, "views.tif") for made in (plain, case)]
    kept = (views[0][0] != views[0][1]) & (views[1][0] != views[1][1]) & (views[1][0] >= views[0][0])
    for z, nodata in heights.values():
        kept &= z != nodata
    for name, (z, nodata) in heights.items():
        z[~kept] = nodata
        copy = gdal.GetDriverByName("GTiff").CreateCopy(str(folder / f"{name}.tif"), grid)
        copy.GetRasterBand(1).WriteArray(z)


def main(program, folder, *wanted):
    folder, maker = Path(folder), program
    if wanted[:1] == ("--made-by",):
        maker, wanted = wanted[1], wanted[2:]
    scratch = folder / "scratch"
    if not (folder / "scene").exists():
        run(program, "simulate", "--out", folder / "scene", "--scenes", 1, "--views", 3, "--pixels", 512, "--kinds", "suburb",
            "--seed", 960001, "--quiet")
    scratch.mkdir(exist_ok=True)
    files = sorted((folder / "scene/Track3-RGB").glob("*.tif"))[:3]
    truth = next((folder / "scene/Track3-Truth").glob("*_DSM.tif"))
    images = [Image.read(f, scratch) for f in files]
    statistics = run("gdalinfo", "-stats", "--config", "GDAL_PAM_ENABLED", "NO", truth).stdout
    middle = float(re.search(r"STATISTICS_MEAN=(\S+)", statistics)[1])
    lowest = max(float(i.rpc["HEIGHT_OFF"]) - float(i.rpc["HEIGHT_SCALE"]) for i in images)
    highest = min(float(i.rpc["HEIGHT_OFF"]) + float(i.rpc["HEIGHT_SCALE"]) for i in images)
    ranges = {"MISSES": f"{middle + 150:.0f} {middle + 250:.0f}", "WIDE": f"{lowest + 1:.0f} {highest - 1:.0f}"}

    def registered(surface, place):
        run(program, "evaluate", "--dsm", surface, "--truth", truth, "--register", "xyz", "--seen-by", *files, "--json",
            place / "scores.json", "--overwrite")
        return json.loads((place / "scores.json").read_text())["results"]["registered"]
    first = None  # error of the plain case
    print("| case | mean error | of the plain one | where as many see | cells found | warnings |\n"
          "| --- | --- | --- | --- | --- | --- |")
    for name, made, flags, options, ending in cases(images):
        if wanted and name not in wanted and name != "plain":
            continue
        place = folder / re.sub(r"\W+", "_", name)
        place.mkdir(exist_ok=True)
        delivered = [place / f"image_{i + 1}{ending}" for i in range(3)]
        try:
            for image, path in zip(made, delivered):
                image.write(path, scratch, *options)
            flags = [part for flag in flags for part in ranges.get(flag, flag).split()]
            run(maker, "reconstruct", *delivered, "--out", place / "out", "--mesh", "none", "--overwrite", "--quiet", *flags)
            record = json.loads((place / "out/run.json").read_text())
            compared(folder / "plain/out", place / "out", scratch)
            times = registered(scratch / "case.tif", scratch)["mae"] / registered(scratch / "plain.tif", scratch)["mae"]
            scores = registered(place / "out/dsm.tif", place)
            error, found = scores["mae"], scores["completeness"]
            first = first or error
            warnings = "; ".join(w if isinstance(w, str) else w.get("text", str(w)) for w in record.get("warnings", []))
            print(f"| {name} | {error:.3f} m | {error / first:.2f} | {times:.2f} | {100 * found:.1f} % | {warnings} |", flush=True)
        except RuntimeError as e:
            print(f"| {name} | | | | | {e} |", flush=True)


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
