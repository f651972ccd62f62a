#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Files that lie, one for every way a reader once believed one, given to the program as a user would.

    lies.py PROGRAM [NAME...]

Each is to be refused with exit code 1 and one line that names the file, within two seconds of a processor and ten of
waiting, with at most 200 MB of memory and twenty times the file, and without a word to the network. Commit a844689 fails
every one of them. Only the standard library is used; the files that are changed here PROGRAM made itself.
"""
import json
import math
import os
import re
import shutil
import signal
import socket
import sqlite3
import struct
import subprocess
import sys
import tempfile
import threading
import time
import zlib
from pathlib import Path

SECONDS, BYTES, PER_BYTE = 2.0, 200e6, 20  # seconds of a processor: other work may have the machine
WAITED = 5 * SECONDS


def tensors_of(path):
    """Header and data of a safetensors file."""
    content = Path(path).read_bytes()
    size = struct.unpack("<Q", content[:8])[0]
    return json.loads(content[8:8 + size]), content[8 + size:]


def save_tensors(path, header, data=b""):
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    Path(path).write_bytes(struct.pack("<Q", len(text)) + text + data)


def tiff(path, side, *, x0=500000.0, data=None, kind=3, bits=32):
    """A single-strip GeoTIFF of one band; without data a sparse one."""
    scale, tie = struct.pack("<3d", 1, 1, 0), struct.pack("<6d", 0, 0, 0, x0, 5e6, 0)
    keys = struct.pack("<16H", 1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32631)
    entries, blob = [], b""
    count = 13
    start = 8 + 2 + 12 * count + 4

    def tag(number, type_, values, n=None):
        nonlocal blob
        size = {3: 2, 4: 4, 12: 8}[type_]
        n = len(values) // size
        if len(values) <= 4:
            entries.append(struct.pack("<HHI", number, type_, n) + values.ljust(4, b"\0"))
        else:
            entries.append(struct.pack("<HHII", number, type_, n, start + len(blob)))
            blob += values

    i, h = (lambda v: struct.pack("<I", v)), (lambda v: struct.pack("<H", v))
    tag(256, 4, i(side)), tag(257, 4, i(side)), tag(258, 3, h(bits)), tag(259, 3, h(1)), tag(262, 3, h(1))
    offset = start + len(scale + tie + keys)
    tag(273, 4, i(0 if data is None else offset)), tag(277, 3, h(1)), tag(278, 4, i(side))
    tag(279, 4, i(0 if data is None else len(data))), tag(339, 3, h(kind))
    tag(33550, 12, scale), tag(33922, 12, tie), tag(34735, 3, keys)
    assert len(entries) == count
    Path(path).write_bytes(b"II*\0" + i(8) + h(count) + b"".join(entries) + i(0) + blob + (data or b""))


RPC_KEYS = ["LINE_OFF", "SAMP_OFF", "LAT_OFF", "LONG_OFF", "HEIGHT_OFF", "LINE_SCALE", "SAMP_SCALE", "LAT_SCALE",
            "LONG_SCALE", "HEIGHT_SCALE"]


def camera(path, **changes):
    """A plain camera of 64 x 64 px as _RPC.TXT, with numbers of its own."""
    values = dict(zip(RPC_KEYS, [32, 32, 45, 5, 100, 32, 32, 0.001, 0.001, 100]))
    for name, at in [("LINE_NUM", 2), ("LINE_DEN", 0), ("SAMP_NUM", 1), ("SAMP_DEN", 0)]:
        for k in range(20):
            values[f"{name}_COEFF_{k + 1}"] = (-1 if name == "LINE_NUM" else 1) * (k == at)
    values.update(changes)
    Path(path).write_text("".join(f"{k}: {v}\n" for k, v in values.items()))


def image_with_camera(stem, **changes):
    pixels = bytes((7 * r + 13 * c + r * c) % 251 for r in range(64) for c in range(64))
    tiff(f"{stem}.tif", 64, data=pixels, kind=1, bits=8)
    camera(f"{stem}_RPC.TXT", **changes)
    return f"{stem}.tif"


def sat_nerf(path, **changes):
    """A view as Sat-NeRF's JSON has them."""
    coefficients = {"row_num": [0, 0, -1] + [0] * 17, "col_num": [0, 1] + [0] * 18}
    rpc = {"row_offset": 32, "col_offset": 32, "lat_offset": 45, "lon_offset": 5, "alt_offset": 100, "row_scale": 32,
           "col_scale": 32, "lat_scale": 0.001, "lon_scale": 0.001, "alt_scale": 100,
           "row_den": [1] + [0] * 19, "col_den": [1] + [0] * 19, **coefficients}
    view = {"img": "plain.tif", "height": 64, "width": 64, "min_alt": 50, "max_alt": 150, "rpc": rpc, **changes}
    Path(path).write_text(json.dumps(view))


def ply(path, rows, properties, faces=None):
    header = ["ply", "format binary_little_endian 1.0", "comment crs EPSG:32631", "comment origin 500000 5000000 100",
              f"element vertex {len(rows)}"] + [f"property float {p}" for p in properties]
    if faces is not None:
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    body = b"".join(struct.pack(f"<{len(r)}f", *r) for r in rows)
    body += b"".join(struct.pack("<B3i", 3, *f) for f in faces or [])
    Path(path).write_bytes(("\n".join(header) + "\nend_header\n").encode() + body)


SURFEL = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "rot_0", "rot_1", "rot_2", "rot_3"]


def surfels(path, **changes):
    row = dict(zip(SURFEL, [0, 0, 0, 0, 0, 0, 2, -0.5, -0.5, 1, 0, 0, 0]))
    ply(path, [[row[p] for p in SURFEL], [{**row, "x": 3, **changes}[p] for p in SURFEL]], SURFEL)


class Listener:
    """A web server that only notes that somebody came."""

    def __init__(self):
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.port, self.visits = self.socket.getsockname()[1], 0
        threading.Thread(target=self.serve, daemon=True).start()

    def serve(self):
        while True:
            caller, _ = self.socket.accept()
            self.visits += 1
            caller.close()


class Lies:
    """Makes each lie in the working folder: returns the command's arguments and what of its words must be there."""

    def __init__(self, program):
        self.program, self.listener = program, Listener()
        run = lambda *a: subprocess.run([program, *a, "--quiet"], check=True, stdout=subprocess.DEVNULL)
        run("simulate", "--out", "data", "--scenes", "1", "--views", "4", "--pixels", "96", "--seed", "5")
        run("train", "--data", "data", "--out", "tiny", "--preset", "tiny", "--crop", "32", "--steps", "2")
        image_with_camera("plain")

    def json_nested(self):
        sat_nerf("deep.json")
        nested = "[" * 70000 + "]" * 70000
        Path("deep.json").write_text(Path("deep.json").read_text().replace('"width": 64', f'"width": {nested}'))
        return ["info", "deep.json"], "deep.json: "

    def json_nested_in_a_data_set(self):
        self.json_nested()
        Path("set/scene").mkdir(parents=True)
        Path("set/scene/train.txt").write_text("deep.json\n")
        Path("deep.json").rename("set/scene/deep.json")
        return ["evaluate", "--data", "set", "--weights", "tiny/weights.safetensors"], "deep.json: "

    def json_number(self):
        sat_nerf("number.json")
        Path("number.json").write_text(Path("number.json").read_text().replace('"min_alt": 50', '"min_alt": 1e999'))
        return ["info", "number.json"], "number.json: "

    def json_long_name(self):
        sat_nerf("name.json", img="n" * 300 + ".tif")
        return ["info", "name.json"], "name.json: "

    def json_pipe(self):
        os.mkfifo("pipe.tif")
        sat_nerf("pipe.json", img="pipe.tif")
        return ["info", "pipe.json"], "pipe.tif: is a pipe"

    def json_absolute_path(self):
        Path("own").mkdir()
        sat_nerf("own/elsewhere.json", img=str(Path("plain.tif").resolve()))
        return ["info", "own/elsewhere.json"], "own/elsewhere.json: "

    def vrt_network(self):
        url = f"/vsicurl/http://127.0.0.1:{self.listener.port}/a.tif"
        Path("net.vrt").write_text(
            '<VRTDataset rasterXSize="64" rasterYSize="64"><VRTRasterBand dataType="Byte" band="1"><SimpleSource>'
            f'<SourceFilename relativeToVRT="0">{url}</SourceFilename><SourceBand>1</SourceBand></SimpleSource>'
            "</VRTRasterBand></VRTDataset>")
        camera("net_RPC.TXT")
        shutil.copy("net.vrt", "net2.vrt"), camera("net2_RPC.TXT")
        return ["reconstruct", "net.vrt", "net2.vrt", "--out", "no", "--weights", "tiny/weights.safetensors"], "net.vrt: "

    def raster_sparse(self):
        tiff("sparse.tif", 60000)
        return ["evaluate", "--dsm", "sparse.tif", "--truth", "sparse.tif"], "sparse.tif: "

    def raster_sparse_in_memory(self):
        """262 MB of nothing in 274 bytes, which any memory holds."""
        tiff("thin.tif", 8100)
        return ["evaluate", "--dsm", "thin.tif", "--truth", "thin.tif"], "thin.tif: 8100 x 8100 px"

    def raster_sparse_for_a_mesh(self):
        self.raster_sparse_in_memory()
        return ["export", "--dsm", "thin.tif", "--to", "no.glb"], "thin.tif: 8100 x 8100 px"

    def raster_heights(self):
        tiff("high.tif", 16, data=struct.pack("<f", 1e38) * 256)
        return ["evaluate", "--dsm", "high.tif", "--truth", "high.tif"], "high.tif: a height of 1e+38 m"

    def terrain_origin(self):
        tiff("astray.tif", 16, x0=math.nan, data=struct.pack("<f", 3) * 256)
        return self._reconstruct("--dem", "astray.tif"), "astray.tif: a grid at"

    def mask_origin(self):
        tiff("adrift.tif", 16, x0=1e300, data=struct.pack("<f", 3) * 256)
        return self._reconstruct("--mask", "adrift.tif"), "adrift.tif: a grid at"

    def _reconstruct(self, *more):
        images = sorted(str(p) for p in Path("data").rglob("*_RGB.tif"))[:2]
        return ["reconstruct", *images, "--out", "no", "--weights", "tiny/weights.safetensors", *more]

    def image_beside_a_pipe(self):
        image_with_camera("beside")
        os.mkfifo("beside.tif.ovr")
        return ["info", "beside.tif"], "beside.tif.ovr: is a pipe"

    def weights_pipe(self):
        os.mkfifo("pipe.safetensors")
        images = sorted(str(p) for p in Path("data").rglob("*_RGB.tif"))[:2]
        return ["reconstruct", *images, "--out", "no", "--weights", "pipe.safetensors"], "pipe.safetensors: is a pipe"

    def checkpoint_pipe(self):
        shutil.copytree("tiny", "run")
        Path("run/checkpoint.safetensors").unlink()
        os.mkfifo("run/checkpoint.safetensors")
        return (["train", "--data", "data", "--out", "run", "--preset", "tiny", "--crop", "32", "--steps", "2", "--resume"],
                "checkpoint.safetensors: is a pipe")

    def picture_cut_off(self):
        Path("cut.tif").write_bytes(Path("plain.tif").read_bytes()[:300])
        return ["evaluate", "--image", "cut.tif", "--reference", "plain.tif"], "cut.tif: "

    def json_many_values(self):
        """300,000 objects, for each of which the parser once looked through all before it."""
        sat_nerf("many.json")
        Path("many.json").write_text(Path("many.json").read_text().replace('"width": 64', '"width": [' + "{}," * 300000 + "1]"))
        return ["info", "many.json"], "many.json: "

    def json_memory(self):
        """60 MB of empty lists, which took 28 times as much."""
        sat_nerf("lists.json")
        Path("lists.json").write_text(Path("lists.json").read_text().replace('"width": 64', '"width": [' + "[]," * 20000000 + "1]"))
        return ["info", "lists.json"], "lists.json: more than 2000000 values"

    def dimap_network(self):
        Path("net.xml").write_text(
            '<Dimap_Document><Metadata_Id><METADATA_FORMAT version="1.1">DIMAP</METADATA_FORMAT></Metadata_Id>'
            "<Raster_Dimensions><NCOLS>64</NCOLS><NROWS>64</NROWS><NBANDS>1</NBANDS></Raster_Dimensions><Data_Access><Data_File>"
            f'<DATA_FILE_PATH href="http://127.0.0.1:{self.listener.port}/a.tif"/></Data_File></Data_Access></Dimap_Document>')
        return ["info", "net.xml"], "net.xml: "

    def dimap_pipe(self):
        os.mkfifo("tile.tif")
        self.dimap_network()
        Path("waits.xml").write_text(re.sub("http://[^\"]*", "tile.tif", Path("net.xml").read_text()))
        return ["info", "waits.xml"], "waits.xml: "

    def vrt_overviews(self):
        url = f"http://127.0.0.1:{self.listener.port}/a.tif"
        Path("over.vrt").write_text(
            f'<VRTDataset rasterXSize="64" rasterYSize="64"><Metadata domain="OVERVIEWS"><MDI key="OVERVIEW_FILE">{url}</MDI>'
            '</Metadata><VRTRasterBand dataType="Byte" band="1"><SimpleSource><SourceFilename relativeToVRT="1">plain.tif'
            "</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>")
        return ["info", "over.vrt"], "over.vrt: names"

    def vrt_fan_out(self):
        """Eight VRTs, each of which names the next eight times."""
        for i in range(8):
            source = "plain.tif" if i == 7 else f"fan{i + 1}.vrt"
            Path(f"fan{i}.vrt").write_text(
                '<VRTDataset rasterXSize="64" rasterYSize="64"><VRTRasterBand dataType="Byte" band="1">' +
                f'<SimpleSource><SourceFilename relativeToVRT="1">{source}</SourceFilename></SimpleSource>' * 8 +
                "</VRTRasterBand></VRTDataset>")
        return ["info", "fan0.vrt"], "fan0.vrt: a VRT that reads"

    def area_network(self):
        ring = [[5, 45], [5.01, 45], [5.01, 45.01], [5, 45]]
        crs = {"type": "link", "properties": {"href": f"http://127.0.0.1:{self.listener.port}/a"}}
        Path("link.geojson").write_text(json.dumps({"type": "Polygon", "crs": crs, "coordinates": [ring]}))
        return self._reconstruct("--aoi", "link.geojson"), "link.geojson: names http"

    def area_schema(self):
        Path("schema.gml").write_text(
            '<wfs:FeatureCollection xmlns:wfs="http://www.opengis.net/wfs" xmlns:gml="http://www.opengis.net/gml" xmlns:a="http://a"'
            ' xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:schemaLocation="http://a '
            f'http://127.0.0.1:{self.listener.port}/?SERVICE=WFS&amp;REQUEST=DescribeFeatureType"><gml:featureMember><a:b><a:g>'
            '<gml:Polygon srsName="EPSG:4326"><gml:outerBoundaryIs><gml:LinearRing><gml:coordinates>5,45 5.01,45 5.01,45.01 5,45'
            "</gml:coordinates></gml:LinearRing></gml:outerBoundaryIs></gml:Polygon></a:g></a:b></gml:featureMember>"
            "</wfs:FeatureCollection>")
        return self._reconstruct("--aoi", "schema.gml"), "schema.gml: "

    def area_without_end(self):
        """A GeoPackage whose layer is a view that has rows for ever."""
        base = sqlite3.connect("view.gpkg")
        base.executescript("""PRAGMA application_id=1196444487; PRAGMA user_version=10200;
            CREATE TABLE gpkg_spatial_ref_sys(srs_name, srs_id INTEGER PRIMARY KEY, organization, organization_coordsys_id,
                definition, description);
            CREATE TABLE gpkg_contents(table_name PRIMARY KEY, data_type, identifier, description, last_change, min_x, min_y,
                max_x, max_y, srs_id);
            CREATE TABLE gpkg_geometry_columns(table_name, column_name, geometry_type_name, srs_id, z, m);
            CREATE VIEW v AS WITH RECURSIVE r(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM r) SELECT i AS fid, NULL AS geom FROM r;
            INSERT INTO gpkg_spatial_ref_sys VALUES('x', 4326, 'EPSG', 4326, 'undefined', '');
            INSERT INTO gpkg_contents VALUES('v', 'features', 'v', '', '2020-01-01T00:00:00Z', 0, 0, 1, 1, 4326);
            INSERT INTO gpkg_geometry_columns VALUES('v', 'geom', 'POLYGON', 4326, 0, 0);""")
        base.close()
        return self._reconstruct("--aoi", "view.gpkg"), "view.gpkg: holds views"

    def camera_pole(self):
        """One image of two looks beyond the pole: which?"""
        images = sorted(str(p) for p in Path("data").rglob("*_RGB.tif"))[:1]
        image_with_camera("pole", LAT_OFF=90)
        return ["reconstruct", *images, "pole.tif", "--out", "no", "--weights", "tiny/weights.safetensors"], "pole.tif: "

    def raster_origin(self):
        tiff("nowhere.tif", 16, x0=math.nan, data=struct.pack("<f", 3) * 256)
        return ["evaluate", "--dsm", "nowhere.tif", "--truth", "nowhere.tif"], "nowhere.tif: a grid at"

    def weights_widths(self):
        header, _ = tensors_of("tiny/weights.safetensors")
        meta = header["__metadata__"]
        model = json.loads(meta["model"])
        model.update(base=64, volume_base=64, volume_levels=4, hypotheses=[64, 32, 16], head_width=[256, 256, 256],
                     mono="own")
        model["mono_net"] = {**model.get("mono_net", {}), "base": 64}
        save_tensors("wide.safetensors", {"__metadata__": {**meta, "model": json.dumps(model)}})
        return ["info", "wide.safetensors"], "wide.safetensors: "

    def weights_widths_in_use(self):
        self.weights_widths()
        Path("wide.safetensors").rename("used.safetensors")
        images = sorted(str(p) for p in Path("data").rglob("*_RGB.tif"))[:2]
        return ["reconstruct", *images, "--out", "no", "--weights", "used.safetensors"], "used.safetensors: "

    def _checkpoint(self, change):
        """A training of two steps that goes on from a changed checkpoint."""
        shutil.copytree("tiny", "run")
        header, data = tensors_of("run/checkpoint.safetensors")
        data = bytearray(data)
        change(header, data)
        save_tensors("run/checkpoint.safetensors", header, bytes(data))
        return (["train", "--data", "data", "--out", "run", "--preset", "tiny", "--crop", "32", "--steps", "2", "--resume"],
                "checkpoint.safetensors: ")

    def _put_moment(self, prefix, value):
        def change(header, data):
            name = next(n for n in header if n.startswith(prefix))
            struct.pack_into("<f", data, header[name]["data_offsets"][0], value)
        return self._checkpoint(change)

    def optimiser_nan(self):
        return self._put_moment("adam.m.", math.nan)

    def optimiser_negative(self):
        return self._put_moment("adam.v.", -1.0)

    def optimiser_step(self):
        def change(header, data):
            header["__metadata__"]["step"] = "1"
        return self._checkpoint(change)

    def _render(self, name, **changes):
        surfels(name, **changes)
        return ["render", "--surfels", name, "--nadir", "--out", "no.png"], f"{name}: "

    def surfels_scale(self):
        return self._render("scale.ply", scale_0=1e4)

    def surfels_rotation(self):
        return self._render("rotation.ply", rot_0=0)

    def surfels_far(self):
        return self._render("far.ply", x=1e38)

    def mesh_without_faces(self):
        ply("bare.ply", [[0, 0, 0], [1, 0, 0], [0, 1, 0]], ["x", "y", "z"], [])
        return ["evaluate", "--mesh", "bare.ply", "--reference-mesh", "bare.ply"], "bare.ply: no faces"

    def _info(self, stem, **changes):
        return ["info", image_with_camera(stem, **changes)], stem

    def picture_size(self):
        """30,000 pixels a side in 1 kB."""
        chunk = lambda name, d: struct.pack(">I", len(d)) + name + d + struct.pack(">I", zlib.crc32(name + d))
        Path("huge.png").write_bytes(
            b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", 30000, 30000, 8, 2, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b""))
        return ["evaluate", "--image", "huge.png", "--reference", "huge.png"], "huge.png: 30000 x 30000 px"

    def camera_latitude(self):
        return self._info("latitude", LAT_OFF=95)

    def camera_scale(self):
        return self._info("scale", LAT_SCALE=1e300)

    def camera_negative_scale(self):
        return self._info("negative", HEIGHT_SCALE=-100)

    def camera_height(self):
        return self._info("height", HEIGHT_OFF=1e300)


def measure(command):
    """Exit code (negative for a signal), words, seconds, those of a processor and peak memory in bytes."""
    with open("words", "w+b") as words:
        start = time.monotonic()
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=words)
        killer = threading.Timer(10 * SECONDS, child.kill)
        killer.start()
        _, status, usage = os.wait4(child.pid, 0)
        seconds = time.monotonic() - start
        killer.cancel()
        words.seek(0)
        text = words.read().decode(errors="replace")
    worked = usage.ru_utime + usage.ru_stime
    return os.waitstatus_to_exitcode(status), text, seconds, worked, usage.ru_maxrss * 1024.0


def complaint(lies, name):
    """What is wrong with the answer to one lie; empty if nothing is."""
    before = lies.listener.visits
    command, words = getattr(lies, name)()
    bytes_ = sum(os.path.getsize(a) for a in command if os.path.isfile(a))
    rc, text, seconds, worked, memory = measure([lies.program, *command])
    lines = [line for line in text.splitlines() if line.startswith("satsurf: ")]
    if rc < 0:
        return f"ended by {signal.Signals(-rc).name} after {seconds:.1f} s"
    if rc != 1 or len(lines) != 1:
        return f"exit code {rc} with {len(lines)} lines"
    if words not in lines[0]:
        return f"its words are '{lines[0][:150]}', expected '{words}'"
    if re.search(r"std::|basic_|json\.exception|filesystem error", lines[0]):
        return f"an exception of another library: '{lines[0][:150]}'"
    if worked > SECONDS or seconds > WAITED or memory > BYTES + PER_BYTE * bytes_:
        return f"took {seconds:.1f} s, {worked:.1f} s of a processor and {memory / 1e6:.0f} MB for {bytes_} bytes"
    if lies.listener.visits != before:
        return "asked the network"
    if Path("no").exists() or Path("no.png").exists():
        return "left a result"
    return ""


def main():
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    program = str(Path(sys.argv[1]).resolve())
    names = [name for name in vars(Lies) if not name.startswith("_")]
    for name in sys.argv[2:]:
        if name not in names:
            sys.exit(f"lies.py: '{name}', expected one of {', '.join(names)}")
    names = sys.argv[2:] or names
    failures = 0
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        lies = Lies(program)
        for name in names:
            what = complaint(lies, name)
            failures += bool(what)
            if what:
                print(f"FAIL: {name}: {what}", flush=True)
            for left in ("no", "run", "set"):
                shutil.rmtree(left, ignore_errors=True)
            Path("no.png").unlink(missing_ok=True)
    print(f"{len(names)} lies, {failures} believed")
    sys.exit(failures > 0)


if __name__ == "__main__":
    main()
