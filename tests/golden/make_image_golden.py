#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes image_golden.safetensors: what scikit-image and PyTorch make of two images, for the tests of SSIM and LPIPS.

    python3 tests/golden/make_image_golden.py   (Debian 12: apt-get install python3-skimage python3-torch)

ssim.skimage is structural_similarity's mean; ssim.conv and its gradient come from plain 2D convolutions. Each
lpips.KIND.* is a whole small network with random weights under the keys of the `lpips` package, an image, a
reference and a mask, their distance, its gradient, and the distance under the mask. Single numbers are float64.
"""
import json
import pathlib
import struct

import numpy
import skimage
import torch
import torch.nn.functional as F
from skimage.metrics import structural_similarity

torch.manual_seed(3)
tensors = {}


def pictures(*shape):
    """An image and a reference that is somewhat like it, in [0, 1]."""
    rows = torch.arange(shape[-2]).double()[:, None]
    columns = torch.arange(shape[-1]).double()
    base = 0.5 + 0.3 * torch.sin(rows * 0.4) * torch.cos(columns * 0.3)
    x = (base + 0.15 * torch.randn(shape).double()).clamp(0, 1)
    y = (0.9 * x + 0.1 * torch.randn(shape).double()).clamp(0, 1)
    return x.float().double(), y.float().double()  # stored in F32


def ssim_map(x, y):
    """Weighted moments with zeros beyond the borders."""
    C = x.shape[1]
    line = torch.exp(-torch.arange(-5, 6).double() ** 2 / (2 * 1.5 ** 2))
    line = line / line.sum()
    window = (line[:, None] * line)[None, None].repeat(C, 1, 1, 1)

    def mean(t):
        return F.conv2d(t, window, padding=5, groups=C)

    mx, my = mean(x), mean(y)
    vx, vy, c = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    return (2 * mx * my + 1e-4) * (2 * c + 9e-4) / ((mx * mx + my * my + 1e-4) * (vx + vy + 9e-4))


x, y = pictures(3, 24, 37)
x.requires_grad_()
value = ssim_map(x[None], y[None]).mean()
value.backward()
tensors["ssim.x"], tensors["ssim.y"], tensors["ssim.conv.dx"] = x.float(), y.float(), x.grad.float()
tensors["ssim.conv"] = value
tensors["ssim.skimage"] = torch.tensor(structural_similarity(
    x.detach().numpy(), y.numpy(), gaussian_weights=True, sigma=1.5, data_range=1.0, use_sample_covariance=True,
    channel_axis=0), dtype=torch.float64)


def lpips(kind, slices, *size):
    """slices: per slice a list of ("conv", number, out, kernel, stride, padding), ("fire", number, few, many) and
    ("pool", kernel, ceil)."""
    weights = {}

    def parameters(name, *shape):
        fan_in = shape[1] * shape[2] * shape[3]
        weights[name + ".weight"] = torch.randn(shape) * (2 / fan_in) ** 0.5
        weights[name + ".bias"] = torch.randn(shape[0]) * 0.1
        return weights[name + ".weight"].double(), weights[name + ".bias"].double()

    weights["scaling_layer.shift"] = torch.tensor([-.030, -.088, -.188])[None, :, None, None]
    weights["scaling_layer.scale"] = torch.tensor([.458, .448, .450])[None, :, None, None]
    channels, layers, lins = 3, [], []
    for s, steps in enumerate(slices):
        made = []
        for step in steps:
            if step[0] == "pool":
                made.append(lambda t, k=step[1], up=step[2]: F.max_pool2d(t, k, 2, ceil_mode=up))
            elif step[0] == "conv":
                _, number, out, kernel, stride, padding = step
                w, b = parameters(f"net.slice{s + 1}.{number}", out, channels, kernel, kernel)
                made.append(lambda t, w=w, b=b, st=stride, p=padding: F.relu(F.conv2d(t, w, b, st, p)))
                channels = out
            else:
                _, number, few, many = step
                name = f"net.slice{s + 1}.{number}"
                w, b = parameters(name + ".squeeze", few, channels, 1, 1)
                w1, b1 = parameters(name + ".expand1x1", many, few, 1, 1)
                w3, b3 = parameters(name + ".expand3x3", many, few, 3, 3)

                def fire(t, w=w, b=b, w1=w1, b1=b1, w3=w3, b3=b3):
                    t = F.relu(F.conv2d(t, w, b))
                    return F.relu(torch.cat([F.conv2d(t, w1, b1), F.conv2d(t, w3, b3, padding=1)], 1))

                made.append(fire)
                channels = 2 * many
        layers.append(made)
        weights[f"lin{s}.model.1.weight"] = torch.rand(1, channels, 1, 1)
        lins.append(weights[f"lin{s}.model.1.weight"].double())
    shift, scale = weights["scaling_layer.shift"].double(), weights["scaling_layer.scale"].double()

    def features(t):
        t = (2 * t - 1 - shift) / scale
        found = []
        for made in layers:
            for f in made:
                t = f(t)
            found.append(t / (t.square().sum(1, keepdim=True).sqrt() + 1e-10))
        return found

    def distance(a, b):
        return sum(F.conv2d((u - v).square(), w).mean() for u, v, w in zip(features(a), features(b), lins))

    x, y = pictures(*size)
    mask = (torch.rand(size[-2:]) > 0.3).double()
    x.requires_grad_()
    value = distance(x, y)
    value.backward()
    tensors[f"lpips.{kind}.value"] = value
    tensors[f"lpips.{kind}.masked"] = distance(x * mask, y * mask)
    for name, tensor in (("x", x), ("y", y), ("mask", mask), ("dx", x.grad)):
        tensors[f"lpips.{kind}.{name}"] = tensor.float()
    tensors.update({f"lpips.{kind}.{k}": v for k, v in weights.items()})


lpips("alex", [[("conv", 0, 4, 11, 4, 2)],
               [("pool", 3, False), ("conv", 3, 5, 5, 1, 2)],
               [("pool", 3, False), ("conv", 6, 6, 3, 1, 1)],
               [("conv", 8, 3, 3, 1, 1)],
               [("conv", 10, 4, 3, 1, 1)]], 1, 3, 33, 40)
lpips("squeeze", [[("conv", 0, 4, 3, 2, 0)],
                  [("pool", 3, True), ("fire", 3, 2, 3), ("fire", 4, 2, 3)],
                  [("pool", 3, True), ("fire", 6, 3, 2), ("fire", 7, 2, 4)],
                  [("pool", 3, True), ("fire", 9, 3, 3)],
                  [("fire", 10, 2, 3)], [("fire", 11, 3, 2)], [("fire", 12, 2, 5)]], 1, 3, 22, 29)
lpips("vgg", [[("conv", 0, 3, 3, 1, 1), ("conv", 2, 4, 3, 1, 1)],
              [("pool", 2, False), ("conv", 5, 3, 3, 1, 1), ("conv", 7, 5, 3, 1, 1)],
              [("pool", 2, False), ("conv", 10, 4, 3, 1, 1), ("conv", 12, 3, 3, 1, 1), ("conv", 14, 4, 3, 1, 1)],
              [("pool", 2, False), ("conv", 17, 3, 3, 1, 1), ("conv", 19, 4, 3, 1, 1), ("conv", 21, 5, 3, 1, 1)],
              [("pool", 2, False), ("conv", 24, 4, 3, 1, 1), ("conv", 26, 3, 3, 1, 1), ("conv", 28, 4, 3, 1, 1)]],
      2, 3, 18, 21)

header = {"__metadata__": {"torch": torch.__version__, "skimage": skimage.__version__, "numpy": numpy.__version__}}
data = b""
for name, tensor in sorted(tensors.items()):
    double = tensor.dtype == torch.float64
    values = tensor.detach().flatten().tolist()
    begin = len(data)
    data += struct.pack(f"<{len(values)}{'d' if double else 'f'}", *values)
    header[name] = {"dtype": "F64" if double else "F32", "shape": list(tensor.shape), "data_offsets": [begin, len(data)]}
text = json.dumps(header, separators=(",", ":")).encode()
text += b" " * (-len(text) % 8)
pathlib.Path(__file__).with_name("image_golden.safetensors").write_bytes(struct.pack("<Q", len(text)) + text + data)
