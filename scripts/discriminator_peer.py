#!/usr/bin/env python3
"""The discriminator beside PyTorch's on the CPU: same patches, same weights, same run.

usage: discriminator_peer.py EXAMPLE [--side PX] [--steps N] [--threads N] [--pad]

EXAMPLE is target/release/examples/discriminator. Compares losses, every layer's gradients, the
weights after a step and the texture's gradient with PyTorch's in double precision; then times both,
ours before and after PyTorch, in single precision, and prints a table. Ends with 1 where a loss or a
gradient is further than 1e-5 of the largest from the truth.
"""

import argparse
import json
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np
import torch
from torch.nn import functional

LAYERS = [(6, 64, 2), (64, 128, 2), (128, 128, 2), (128, 128, 1), (128, 1, 1)]
SLOPE = 0.2
MASK_THRESHOLD = 0.1
TOLERANCE = 1e-5
# A value this near 0 may have either sign in single precision, and then either slope.
KINK = 2e-8


def read_saved(path):
    """Per layer: weight, bias and both of Adam's moments, as PyTorch lays them out."""
    data = path.read_bytes()
    assert data[:8] == b"veneerD1"
    numbers = np.frombuffer(data[16:], "<f4")
    layers, at = [], 0

    def take(shape):
        nonlocal at
        size = int(np.prod(shape))
        at += size
        return torch.from_numpy(numbers[at - size : at].reshape(shape).copy())

    for inputs, outputs, _ in LAYERS:
        kernel, flat = (4, 4, inputs, outputs), (outputs,)
        shapes = [kernel, flat, kernel, kernel, flat, flat]
        weight, bias, weight_1, weight_2, bias_1, bias_2 = map(take, shapes)
        to_torch = lambda k: k.permute(3, 2, 0, 1).contiguous()
        layers.append(
            {
                "weight": to_torch(weight),
                "bias": bias,
                "weight_first": to_torch(weight_1),
                "bias_first": bias_1,
            }
        )
    return layers


class Peer:
    def __init__(self, layers, mask, padding, dtype=torch.float32):
        self.padding = padding
        # Per layer and output: the nearest that a value came to the kink of the leaky ReLU.
        self.least = [None] * len(LAYERS)
        self.parameters = []
        for layer in layers:
            for name in ("weight", "bias"):
                self.parameters.append(layer[name].to(dtype, copy=True).requires_grad_())
        self.adam = torch.optim.Adam(self.parameters, lr=1e-4, betas=(0.5, 0.999), eps=1e-8)
        counts = mask[None, None]
        box = torch.full((1, 1, 4, 4), 1 / 16)
        for _, _, stride in LAYERS:
            counts = functional.conv2d(counts, box, stride=stride, padding=padding)
            counts = (counts > MASK_THRESHOLD).float()
        self.counts = counts.to(dtype)

    def logits(self, patches):
        out = patches
        for index, (_, _, stride) in enumerate(LAYERS):
            weight, bias = self.parameters[2 * index : 2 * index + 2]
            out = functional.conv2d(out, weight, bias, stride=stride, padding=self.padding)
            self.least[index] = out.detach().abs().amin((0, 2, 3))
            if index + 1 < len(LAYERS):
                out = functional.leaky_relu(out, SLOPE)
        return out

    def mean(self, losses):
        return (losses * self.counts).sum() / self.counts.sum()

    def step(self, both, measure=False):
        self.adam.zero_grad(set_to_none=True)
        logits = self.logits(both)
        real = self.mean(functional.softplus(-logits[:1]))
        fake = self.mean(functional.softplus(logits[1:]))
        texture = self.mean(functional.softplus(-logits[1:].detach()))
        if measure:
            parts = torch.autograd.grad(real, self.parameters, retain_graph=True)
            self.largest = [part.abs().max() for part in parts]
        (real + fake).backward()
        self.adam.step()
        return real.item(), fake.item(), texture.item()

    def texture_gradient(self, photo, difference):
        for parameter in self.parameters:
            parameter.requires_grad_(False)
        difference = difference.clone().requires_grad_()
        loss = self.mean(functional.softplus(-self.logits(torch.cat([photo, difference], 1))))
        loss.backward()
        for parameter in self.parameters:
            parameter.requires_grad_(True)
        return loss.item(), difference.grad


def timed(num, call):
    call()
    wall = []
    before = time.process_time()
    for _ in range(num):
        start = time.perf_counter()
        call()
        wall.append(1e3 * (time.perf_counter() - start))
    processor = 1e3 * (time.process_time() - before) / num
    wall.sort()
    return {"least": wall[0], "median": wall[num // 2], "processor": processor}


def gflop(side, padding):
    """Multiplications and additions of one patch, forward; and those of the first layer."""
    total, first = 0, 0
    for index, (inputs, outputs, stride) in enumerate(LAYERS):
        side = (side + 2 * padding - 4) // stride + 1
        one = 2 * 16 * inputs * outputs * side * side / 1e9
        total += one
        first = one if index == 0 else first
    return total, first


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("example")
    parser.add_argument("--side", type=int, default=256)
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--pad", action="store_true")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    padding, side = int(options.pad), options.side

    with tempfile.TemporaryDirectory() as folder:
        command = [options.example, folder, "--side", str(side), "--steps", str(options.steps)]
        command += ["--threads", str(options.threads)] + ["--pad"] * options.pad
        run = lambda: json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
        ours = [run()]
        folder = pathlib.Path(folder)
        before, after = (read_saved(folder / name) for name in ("before.bin", "after.bin"))
        read = lambda name: torch.from_numpy(np.fromfile(folder / f"{name}.f32", "<f4"))
        real, fake = (read(name).reshape(1, 6, side, side) for name in ("real", "fake"))
        mask, gradient = read("mask").reshape(side, side), read("gradient").reshape(1, 3, side, side)

        both = torch.cat([real, fake])
        is_wrong = False

        def compare(what, found, peer, truth, largest=None):
            nonlocal is_wrong
            largest = truth.abs().max() if largest is None else largest
            far = lambda x: ((x - truth).abs().max() / largest).item()
            ours_far, peer_far = far(found.double()), far(peer.double())
            is_wrong |= not ours_far <= TOLERANCE
            print(f"{what}: {ours_far:.1e} of the largest from the truth (PyTorch {peer_far:.1e})")

        peer, truth = Peer(before, mask, padding), Peer(before, mask, padding, torch.float64)
        losses, true_losses = peer.step(both), truth.step(both.double(), True)
        truth_least = truth.least
        truth_least[-1] = torch.full((1,), torch.inf)
        for name, loss, true_loss in zip(("real", "fake", "texture"), losses, true_losses):
            found = torch.tensor(ours[0]["losses"][name])
            compare(f"loss {name}", found, torch.tensor(loss), torch.tensor(true_loss).double())
        for index, layer in enumerate(after):
            for offset, name in enumerate(("weight", "bias")):
                at = 2 * index + offset
                # After one step the first moment is half the gradient, exactly.
                found = 2 * layer[f"{name}_first"]
                what = f"layer {index + 1} {name} gradient"
                # Those of the real and the fake patch nearly cancel at first; one is the measure.
                judged = truth_least[index] > KINK
                if not judged.all():
                    what += f" (less {(~judged).sum()} outputs at a kink)"
                rows = [x[judged] for x in (found, peer.parameters[at].grad, truth.parameters[at].grad)]
                compare(what, *rows, truth.largest[at])
                # Where a gradient is near 0, Adam's first step is its sign, full size.
                apart = (layer[name] - truth.parameters[at].detach()).abs().mean()
                print(f"layer {index + 1} {name} after the step: {apart:.1e} apart on average")
        # Ours is after its own step; so let the peer judge by the same weights.
        peer, truth = Peer(after, mask, padding), Peer(after, mask, padding, torch.float64)
        _, theirs = peer.texture_gradient(fake[:, :3], fake[:, 3:])
        _, expected = truth.texture_gradient(fake[:, :3].double(), fake[:, 3:].double())
        compare("texture's gradient", gradient, theirs, expected)

        theirs = {
            "step_open_ms": timed(options.steps, lambda: peer.step(both)),
            "texture_ms": timed(
                options.steps, lambda: peer.texture_gradient(fake[:, :3], fake[:, 3:])
            ),
        }
        ours.append(run())

    total, first = gflop(side, padding)
    work = {
        "step_open_ms": 2 * (3 * total - first),
        "step_shut_ms": 2 * total,
        "texture_ms": 2 * total - first / 2,
    }
    peak = max(o["peak_gflops"] for o in ours)
    print(f"\n{side}x{side}, padding {padding}, {options.threads} threads, PyTorch {torch.__version__}")
    print(f"large matrix product: {peak:.0f} GFLOP/s")
    print("| | least ms | median ms | processor ms | GFLOP/s | share |")
    print("|---|---|---|---|---|---|")
    rows = [(f"veneer, run {i + 1}", o) for i, o in enumerate(ours)] + [("PyTorch", theirs)]
    for name, times in rows:
        for what, flop in work.items():
            t = times.get(what)
            if t is None:
                continue
            rate = flop / t["least"] * 1e3
            print(
                f"| {name}: {what[:-3]} | {t['least']:.1f} | {t['median']:.1f} "
                f"| {t['processor']:.1f} | {rate:.0f} | {rate / peak:.0%} |"
            )
    return int(is_wrong)


if __name__ == "__main__":
    sys.exit(main())
