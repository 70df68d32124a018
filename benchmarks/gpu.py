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
from moireaug import Scene, attacks, capture, develop, expose

SCENES = ("screen_photo", "phone_at_phone", "paper_code")
QUICK = (2, 24)  # batch and side


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
    args = parser.parse_args()
    if args.compile:
        gpu_compiled.main(args)
        return
    torch.set_num_threads(args.threads)
    batch, side = QUICK if args.quick else (args.batch, args.side)
    repeats = 1 if args.quick else args.repeats
    facts = measure.metadata(args.device)
    print(measure.machine_lines(facts), end="\n\n")
    images = torch.rand(batch, 3, side, side).to(args.device)
    found = {
        "photos": photos(images, repeats, compiled=not (args.eager or args.quick)),
        "stages": stages(images, repeats),
        "attacks": attack_steps(images, repeats),
        "training": training(images, repeats, quick=args.quick),
    }
    for title, rows in found.items():
        print(f"{title.capitalize()}, {batch} of {side} px")
        columns = ["what", "ms", "quartiles", "peak, MiB"]
        lines = [[r["what"], *measure.in_ms(r["seconds"]), r["memory"]] for r in rows]
        if title == "training":
            columns.append("camera's share")
            lines = [[*line, row["camera_share"]] for line, row in zip(lines, rows, strict=True)]
        print(measure.table(columns, lines), end="\n\n")
    content = {"metadata": facts, "batch": batch, "side": side} | found
    measure.write_json(measure.results(args) / "gpu.json", content)


@torch.no_grad()
def photos(images: Tensor, repeats: int, compiled: bool) -> list[dict[str, Any]]:
    """Return a row for each way to photos of new shots."""
    jpeg, scene = RandomJPEG(p=1.0), Scene.preset("screen_photo")
    calls: dict[str, Callable[[], Any]] = {"kornia RandomJPEG": lambda: jpeg(images)}
    for name in SCENES:
        calls[f"{name}, eager"] = functools.partial(Scene.preset(name).capture, images)
    if compiled:
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
    return timed(calls, repeats, images.device)


def stages(images: Tensor, repeats: int) -> list[dict[str, Any]]:
    """Return a row for each stage of an eager capture, and scene."""
    calls: dict[str, Callable[[], Any]] = {}
    for name in SCENES:
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
    return timed(calls, repeats, images.device)


def attack_steps(images: Tensor, repeats: int) -> list[dict[str, Any]]:
    """Return a row for a step of each attack on each network."""
    labels = torch.zeros(len(images), dtype=torch.long, device=images.device)
    calls = {}
    for make in (resnet18, resnet50):
        model = make(weights=None).eval().to(images.device)
        for attack in (attacks.PGD(model), attacks.MoireAttack(model, scene="screen_photo")):
            name = f"{make.__name__}, a step of {type(attack).__name__}"
            calls[name] = step(attack, images, labels)
    return timed(calls, repeats, images.device)


def training(images: Tensor, repeats: int, *, quick: bool) -> list[dict[str, Any]]:
    """Return a row for a step of each recipe on each network, with the camera's share of it."""
    models = gpu_training.QUICK_MODELS if quick else gpu_training.MODELS
    calls = gpu_training.steps(models, len(images), images.shape[-1], images.device)
    rows = timed(calls, repeats, images.device)
    gpu_training.add_camera_shares(rows)
    return rows


def timed(
    calls: dict[str, Callable[[], Any]], repeats: int, device: torch.device
) -> list[dict[str, Any]]:
    """Return a row for each call: its time, and on a GPU its peak of memory."""
    rows = []
    for what, times in measure.timed_together(calls, repeats, warmup=2).items():
        rows.append({"what": what, "seconds": times._asdict(), "memory": peak(calls[what], device)})
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
