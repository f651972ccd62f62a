#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes golden.safetensors: what PyTorch makes of our operators and optimiser, for tests/test_golden.cpp.

    python3 tests/golden/make_golden.py       (Debian 12: apt-get install python3-torch)

Every case holds its inputs, the cotangent `g` of its output `y`, and the inputs' gradients `d...`. All numbers
are float64, but for AdamW's, which are float32 as ours are.
"""
import json
import pathlib
import struct

import torch
import torch.nn.functional as F

torch.manual_seed(1)
tensors = {}


def case(name, f, **inputs):
    """Stores inputs, output, cotangent and gradients of f(**inputs)."""
    leaves = {k: v.double().requires_grad_() for k, v in inputs.items()}
    y = f(**leaves)
    g = torch.randn_like(y)
    y.backward(g)
    for k, v in leaves.items():
        tensors[f"{name}.{k}"] = v
        tensors[f"{name}.d{k}"] = v.grad
    tensors[f"{name}.y"] = y
    tensors[f"{name}.g"] = g


normal = torch.randn
case("conv2d", lambda x, w, b: F.conv2d(x, w, b, stride=(2, 1), padding=(1, 2)),
     x=normal(2, 3, 7, 6), w=normal(4, 3, 3, 3), b=normal(4))
case("conv2d_half", lambda x, w, b: F.conv2d(x, w, b, stride=2, padding=1),
     x=normal(1, 2, 8, 10), w=normal(9, 2, 4, 4), b=normal(9))
case("conv3d", lambda x, w, b: F.conv3d(x, w, b, stride=(1, 2, 2), padding=(1, 1, 0)),
     x=normal(1, 2, 4, 6, 7), w=normal(3, 2, 3, 3, 3), b=normal(3))
case("conv_transpose3d", lambda x, w, b: F.conv_transpose3d(x, w, b, stride=2, padding=1, output_padding=1),
     x=normal(1, 3, 2, 3, 4), w=normal(3, 2, 3, 3, 3), b=normal(2))
case("group_norm", lambda x, gamma, beta: F.group_norm(x, 3, gamma, beta),
     x=normal(2, 6, 5, 4) * 2 + 3, gamma=normal(6), beta=normal(6))
case("bilinear_up", lambda x: F.interpolate(x, (8, 11), mode="bilinear", align_corners=False), x=normal(1, 2, 5, 7))
case("bilinear_down", lambda x: F.interpolate(x, (3, 4), mode="bilinear", align_corners=False), x=normal(1, 2, 7, 9))
case("nearest_up", lambda x: F.interpolate(x, (7, 12), mode="nearest-exact"), x=normal(1, 2, 3, 5))
case("nearest_down", lambda x: F.interpolate(x, (3, 4), mode="nearest-exact"), x=normal(1, 2, 8, 9))
case("softmax", lambda x: F.softmax(x, dim=1), x=normal(2, 7, 3, 5) * 4)
case("gelu", F.gelu, x=torch.linspace(-6, 6, 61))
target = normal(5, 6).double()
tensors["smooth_l1.target"] = target
case("smooth_l1", lambda x: F.smooth_l1_loss(x, target, beta=0.7), x=normal(5, 6))

weight, bias = torch.nn.Parameter(normal(4, 3)), torch.nn.Parameter(normal(4))
tensors["adamw.weight"], tensors["adamw.bias"] = weight.clone(), bias.clone()
optimiser = torch.optim.AdamW([{"params": [weight], "weight_decay": 0.05}, {"params": [bias], "weight_decay": 0.0}],
                              betas=(0.9, 0.99), eps=1e-6)
for step, lr in enumerate([1e-2, 2e-2, 5e-3]):
    weight.grad, bias.grad = normal(4, 3), normal(4) * 1e-3
    tensors[f"adamw.{step}.dweight"], tensors[f"adamw.{step}.dbias"] = weight.grad, bias.grad
    for group in optimiser.param_groups:
        group["lr"] = lr
    optimiser.step()
    tensors[f"adamw.{step}.weight"], tensors[f"adamw.{step}.bias"] = weight.clone(), bias.clone()

header, data = {"__metadata__": {"torch": torch.__version__}}, b""
for name, tensor in sorted(tensors.items()):
    double = tensor.dtype == torch.float64
    values = tensor.detach().flatten().tolist()
    begin = len(data)
    data += struct.pack(f"<{len(values)}{'d' if double else 'f'}", *values)
    header[name] = {"dtype": "F64" if double else "F32", "shape": list(tensor.shape), "data_offsets": [begin, len(data)]}
text = json.dumps(header, separators=(",", ":")).encode()
text += b" " * (-len(text) % 8)
pathlib.Path(__file__).with_name("golden.safetensors").write_bytes(struct.pack("<Q", len(text)) + text + data)
