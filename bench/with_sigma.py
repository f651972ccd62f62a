#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The first file's weights and the second's network for expected errors (`--learn sigma`), whose answers are scaled.

  bench/with_sigma.py WEIGHTS.safetensors SIGMA.safetensors OUT.safetensors [SCALE]

SIGMA was trained from WEIGHTS, whose heights it has been told. What it says is multiplied with SCALE, 1 if left out.
The metadata are those of WEIGHTS, and under "sigma_of" the scale, and where SIGMA comes from.
"""
import json
import math
import struct
import sys

from mean_weights import load, save, values_of

PREFIX, BIAS = "surface.sigma.", "surface.sigma.head.bias"


def main(weights, sigma, out, scale="1"):
    try:
        scale = float(scale)
    except ValueError:
        scale = 0
    if not 0 < scale < math.inf:
        sys.exit("SCALE has to be a number above 0")
    entries, data = load(weights)
    others, other_data = load(sigma)
    if any(name.startswith(PREFIX) for name in entries):
        sys.exit(f"{weights}: has a network for expected errors already, expected weights without")
    names = [name for name in others if name.startswith(PREFIX)]
    if BIAS not in names:
        sys.exit(f"{sigma}: no tensor {BIAS}, expected weights with a network for expected errors")
    for name in names:
        entry = others[name]
        if entry["dtype"] != "F16":
            sys.exit(f"{sigma}: {name} is {entry['dtype']}, expected F16 (train with --half true)")
        values = list(values_of(entry, other_data))
        if name == BIAS:
            values[0] += math.log(scale)
        first = len(data)
        data += struct.pack(f"<{len(values)}e", *values)
        entries[name] = {"dtype": "F16", "shape": entry["shape"], "data_offsets": [first, len(data)]}
    about, of_other = entries["__metadata__"], others["__metadata__"]
    about["surface"] = of_other["surface"]
    origin = {key: of_other.get(key, "") for key in ("git", "seed", "step", "version")}
    about["sigma_of"] = json.dumps({"scale": scale} | origin)
    save(out, entries, data)


if __name__ == "__main__":
    if len(sys.argv) not in (4, 5):
        sys.exit(__doc__)
    main(*sys.argv[1:])
