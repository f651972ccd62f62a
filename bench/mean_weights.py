#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The cascades of two weights files averaged, or their surface networks, in half precision; all else is the first file's.

  bench/mean_weights.py A.safetensors B.safetensors OUT.safetensors [SHARE [cascade|surface]]

SHARE is B's, 0.5 if left out; with 1 it is B's cascade beside A's surface network. A is in half precision, B may be in either.
The metadata are A's, and under "mean_with" (of surface networks "surface_mean_with") the share, and where B comes from.
"""
import json
import struct
import sys
from pathlib import Path

FORMS = {"F16": ("e", 2), "F32": ("f", 4)}
# what the names of a network's tensors begin with, and where the metadata tell of its mean
NETWORKS = {"cascade": ("model.", "mean_with"), "surface": ("surface.", "surface_mean_with")}


def load(path):
    """The header and the data."""
    content = Path(path).read_bytes()
    end = 8 + struct.unpack("<Q", content[:8])[0]
    return json.loads(content[8:end]), bytearray(content[end:])


def save(path, entries, data):
    header = json.dumps(entries, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 8)  # tensors begin at a whole word
    Path(path).write_bytes(struct.pack("<Q", len(header)) + header + data)


def values_of(entry, data):
    letter, size = FORMS[entry["dtype"]]
    begin, end = entry["data_offsets"]
    return struct.unpack(f"<{(end - begin) // size}{letter}", data[begin:end])


def one_configuration(of, one, other):
    """What both files say of a network. Of a setting that came into the program later the older file says nothing; it stands
    at its default there, which is what training leaves it at."""
    if one == other:
        return one
    left, right = json.loads(one or "{}"), json.loads(other or "{}")
    if left | right != right | left:
        sys.exit(f"{of}: {one} and {other}, expected one configuration")
    alone = ", ".join(sorted(left.keys() ^ right.keys()))
    print(f"{of}: one file alone names {alone}; taken to be the other's, too", file=sys.stderr)
    return json.dumps(left | right, separators=(",", ":"), sort_keys=True)


def main(first, second, out, share="0.5", network="cascade"):
    try:
        of_second = float(share)
    except ValueError:
        of_second = -1
    if not 0 <= of_second <= 1:
        sys.exit(f"SHARE is {share}, expected a number from 0 to 1")
    share = of_second
    prefix, origin = NETWORKS[network]
    entries, data = load(first)
    others, other_data = load(second)
    about, of_other = entries.setdefault("__metadata__", {}), others.get("__metadata__", {})
    about[origin] = json.dumps({"share": share} | {key: of_other.get(key, "") for key in ("git", "seed", "step", "version")})
    configured = prefix.removesuffix(".")
    configuration = one_configuration(configured, about.get(configured), of_other.get(configured))
    if configuration:
        about[configured] = configuration
    names = [name for name in entries if name.startswith(prefix)]
    if not names:
        sys.exit(f"{first}: no tensor of a {network}, expected some whose names begin with '{prefix}'")
    for name in names:
        entry = entries[name]
        other = others.get(name)
        if other is None or entry["shape"] != other["shape"] or entry["dtype"] != "F16" or other["dtype"] not in FORMS:
            sys.exit(f"{name}: {entry} and {other}, expected one shape, F16 in the first file and F16 or F32 in the second")
        mean = [(1 - share) * x + share * y for x, y in zip(values_of(entry, data), values_of(other, other_data))]
        data[slice(*entry["data_offsets"])] = struct.pack(f"<{len(mean)}e", *mean)
    save(out, entries, data)


if __name__ == "__main__":
    arguments = sys.argv[1:]
    if len(arguments) not in (3, 4, 5) or len(arguments) == 5 and arguments[4] not in NETWORKS:
        sys.exit(__doc__)
    main(*arguments)
