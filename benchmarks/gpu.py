"""What the camera costs on a GPU.

    python benchmarks/gpu.py
    python benchmarks/gpu.py --compile

Times drawing and capturing photos on the device, beside kornia's RandomJPEG, the engine on the CPU
(with the way there and back), and, unless --eager is given, `torch.compile(capture)`, which takes a
minute or two to compile; then the stages of a capture, a step of an attack beside one of PGD, and
steps of training. Prints four tables and writes results/gpu.json.

With --compile, no GPU is needed: compiles the engine's kernels for two, prints what they take and
the times that follow, as estimates, and writes results/gpu-compiled.json and .txt.
"""

from __future__ import annotations

import functools
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import torch
from kornia.augmentation import RandomJPEG
from torch import Tensor
from torchvision.models import resnet18, resnet50

from benchmarks import gpu_compiled, gpu_training, measure
from benchmarks.steps import step
from moireaug import Scene, capture, develop, expose
from moireaug.attacks import PGD, MoireAttack

Calls = dict[str, Callable[[], Any]]

FULL_SETTINGS: dict[str, Any] = {
    "scenes": ("screen_photo", "phone_at_phone"),
    "networks": (resnet18, resnet50),
    "models": ("resnet18", "resnet50"),
    "warmup": 2,
}
QUICK_SETTINGS: dict[str, Any] = {
    "scenes": ("screen_photo",),
    "networks": (resnet18,),
    "models": ("small_resnet",),
    "warmup": 0,
    "batch": 2,
    "side": 24,
    "repeats": 1,
    "eager": True,
}


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.set_defaults(threads=os.cpu_count())
    there = "cuda" if torch.cuda.is_available() else "cpu"
    parser.add_argument("--device", default=there, help="default here: %(default)s")
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--side", type=int, default=224, help="of the images, in pixels")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--eager", action="store_true", help="do not compile")
    parser.add_argument(
        "--compile",
        action="store_true",
        help="without a GPU: compile its kernels, and estimate their times",
    )
    args, settings, facts = measure.begin(parser, FULL_SETTINGS, QUICK_SETTINGS)
    if args.compile:
        gpu_compiled.main(args, facts)
        return
    settings = vars(args) | settings
    batch, side = settings["batch"], settings["side"]
    images = torch.rand(batch, 3, side, side).to(args.device)
    found = {}
    for group in (photos, stages, attacks, training):
        found[group.__name__] = timed(group(images, settings), settings, images.device)
    gpu_training.add_camera_shares(found["training"])
    for title, rows in found.items():
        print(f"{title.capitalize()}, {batch} of {side} px; memory is the peak in MiB")
        print(measure.text_of_rows(rows), end="\n\n")
    measure.write_json(args, "gpu", metadata=facts, batch=batch, side=side, **found)


def photos(images: Tensor, settings: dict[str, Any]) -> Calls:
    """Return the ways to photos of new shots."""
    jpeg, scene = RandomJPEG(p=1.0), Scene.preset("screen_photo")
    calls: Calls = {"kornia RandomJPEG": lambda: jpeg(images)}
    for name in settings["scenes"]:
        calls[f"{name}, eager"] = functools.partial(Scene.preset(name).capture, images)
    if not settings["eager"]:
        size, photograph = (images.shape[-2], images.shape[-1]), torch.compile(capture)
        shot = scene.sample(len(images), size)
        began = time.perf_counter()
        photograph(images, shot)
        print(f"torch.compile(capture) took {time.perf_counter() - began:.0f} s")
        calls["screen_photo, compiled"] = lambda: photograph(
            images, scene.sample(len(images), size)
        )
    name = f"screen_photo, by the engine on {torch.get_num_threads()} threads, there and back"
    calls[name] = lambda: scene.capture(images.cpu()).to(images.device)
    return calls


def stages(images: Tensor, settings: dict[str, Any]) -> Calls:
    """Return each stage of an eager capture in each scene."""
    calls: Calls = {}
    for name in settings["scenes"]:
        shot = Scene.preset(name).sample(len(images), (images.shape[-2], images.shape[-1]))
        raw = expose(images, shot)

        def by_raw(raw: Tensor = raw, shot: Any = shot) -> None:
            leaf = raw.clone().requires_grad_()
            develop(leaf, shot).sum().backward()

        def by_image(shot: Any = shot) -> None:
            leaf = images.clone().requires_grad_()
            capture(leaf, shot).sum().backward()

        calls[f"{name}, expose"] = lambda shot=shot: expose(images, shot)
        calls[f"{name}, develop"] = lambda raw=raw, shot=shot: develop(raw, shot)
        calls[f"{name}, develop, forward and backward"] = by_raw
        calls[f"{name}, capture, forward and backward in the image"] = by_image
    return calls


def attacks(images: Tensor, settings: dict[str, Any]) -> Calls:
    """Return a step of each attack on each network."""
    labels = torch.zeros(len(images), dtype=torch.long, device=images.device)
    calls = {}
    for make in settings["networks"]:
        model = make(weights=None).eval().to(images.device)
        for attack in (PGD(model), MoireAttack(model, scene="screen_photo")):
            name = f"{make.__name__}, a step of {type(attack).__name__}"
            calls[name] = step(attack, images, labels)
    return calls


def training(images: Tensor, settings: dict[str, Any]) -> Calls:
    """Return a step of each recipe on each network."""
    return gpu_training.steps(settings["models"], len(images), images.shape[-1], images.device)


def timed(calls: Calls, settings: dict[str, Any], device: torch.device) -> list[dict[str, Any]]:
    """Return a row for each call: its time, and on a GPU its peak of memory."""
    rows = []
    times = measure.timed_together(calls, settings["repeats"], settings["warmup"])
    for what, time_of_call in times.items():
        memory = peak(calls[what], device)
        rows.append({"what": what, "seconds": time_of_call._asdict(), "memory": memory})
    return rows


def peak(call: Callable[[], Any], device: torch.device) -> float | None:
    """Return the most memory that a call takes on a GPU, in MiB."""
    if device.type != "cuda":
        return None
    before = torch.cuda.memory_allocated(device)
    torch.cuda.reset_peak_memory_stats(device)
    call()
    torch.cuda.synchronize(device)
    return (torch.cuda.max_memory_allocated(device) - before) / 2**20


if __name__ == "__main__":
    main()
