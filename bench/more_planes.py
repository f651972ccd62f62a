#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Weights of a surface network that was given fewer planes, for a program that gives it more. The new ones count 0.

  bench/more_planes.py WEIGHTS.safetensors OUT.safetensors ADDED

ADDED planes go behind those there were, before the one that says where there are surfels, as `SurfaceNet::channels` has
them. What the network says stays the same; training it further (`train --init OUT`) teaches it to use them.
"""
import sys

from mean_weights import load, save

STEM = "surface.stem.weight"


def main(source, out, added):
    entries, data = load(source)
    if STEM not in entries:
        sys.exit(f"{source}: no tensor {STEM}, expected weights with a surface network")
    stem = entries[STEM]
    outputs, inputs, *kernel = stem["shape"]
    first, last = stem["data_offsets"]
    plane = (last - first) // (outputs * inputs)  # bytes of one kernel
    wider = b""
    for o in range(outputs):
        kernels = data[first + o * inputs * plane:first + (o + 1) * inputs * plane]
        wider += kernels[:-plane] + bytes(added * plane) + kernels[-plane:]
    for name, entry in entries.items():
        if name != "__metadata__" and entry["data_offsets"][0] >= last:
            entry["data_offsets"] = [offset + len(wider) - (last - first) for offset in entry["data_offsets"]]
    stem["shape"], stem["data_offsets"] = [outputs, inputs + added, *kernel], [first, first + len(wider)]
    save(out, entries, data[:first] + wider + data[last:])


if __name__ == "__main__":
    if len(sys.argv) != 4 or not sys.argv[3].isdigit():
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
