#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The mean of the cascades of two weights files in half precision; all else is the first file's.

  bench/mean_weights.py A.safetensors B.safetensors OUT.safetensors
"""
import json
import struct
import sys
from pathlib import Path


def load(path):
    """The header's bytes, the header, the data."""
    content = Path(path).read_bytes()
    end = 8 + struct.unpack("<Q", content[:8])[0]
    return content[:end], json.loads(content[8:end]), bytearray(content[end:])


def main(first, second, out):
    head, entries, data = load(first)
    _, others, other_data = load(second)
    for name, entry in entries.items():
        if not name.startswith("model."):
            continue
        if any(entry[key] != others[name][key] for key in ("dtype", "shape")) or entry["dtype"] != "F16":
            sys.exit(f"{name}: {entry['dtype']} {entry['shape']} and {others[name]['dtype']} {others[name]['shape']}, "
                     "expected F16 of one shape")
        begin, end = entry["data_offsets"]
        form = f"<{(end - begin) // 2}e"
        a = struct.unpack(form, data[begin:end])
        b = struct.unpack(form, other_data[slice(*others[name]["data_offsets"])])
        data[begin:end] = struct.pack(form, *((x + y) / 2 for x, y in zip(a, b)))
    Path(out).write_bytes(head + data)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(*sys.argv[1:])
