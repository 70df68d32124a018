"""Speed and memory of the capture, each beside something well known, in one run.

    python benchmarks/speed.py [--only GROUP]

Prints a table and writes results/speed.json; with `--only`, results/speed-GROUP.json. A ratio is
ours over the other's, of medians taken in turns; `met` says whether it keeps its bar. Rows without
a bar are for information. Images are float32 of 224 px in batches of 16 and gradients are off,
unless a row says otherwise; the scene is the default, "screen_photo".
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import torch
from kornia.augmentation import RandomJPEG
from torch import Tensor

from benchmarks import measure, memory_and_starts, panels, released, steps
from benchmarks.measure import timed_together
from benchmarks.rows import Row, Size, report, time_row
from moireaug import Lens, Scene, Sensor, View, capture, develop, engine, expose
from moireaug.nn import ScreenCamera
from moireaug.transforms import RandomMoire
from moireaug.transforms import albumentations as albumentations_transforms
from moireaug.transforms import kornia as kornia_transforms

QUICK_SETTINGS = Size(
    side=32,
    batch=2,
    paper=27,
    large=(48, 64),
    training=(4, 16),
    lit=(0.9,),
    repeats=1,
    layer=(16,),
    slow=1,
    first=0,
    calls=2,
)


def transforms(size: Size) -> Iterator[Row]:
    """Yield the random transform beside kornia's JPEG, and with few images chosen."""
    images = size.images()
    by_library = {"torchvision": RandomMoire, "kornia": kornia_transforms.RandomMoire}
    calls: dict[str, Callable] = {"jpeg": partial(RandomJPEG(p=1), images)}
    for name, transform in by_library.items():
        calls[name] = partial(transform(p=1), images)
    calls["torchvision, uint8"] = partial(RandomMoire(p=1), (255 * images).to(torch.uint8))
    times = timed_together(calls, size.repeats, warmup=2)
    rival = times.pop("jpeg")
    for name, own in times.items():
        bars = {"bar": 0.25, "stretch": 0.15} if name in by_library else {}
        yield time_row(f"RandomMoire(p=1), {name}", own, "kornia RandomJPEG(p=1)", rival, **bars)
    for name, transform in by_library.items():
        calls = {"few": partial(transform(p=0.1), images), "all": partial(transform(p=1), images)}
        times = timed_together(calls, size.calls, budget=20.0)
        # means, because how many images are chosen varies by call
        few, whole = times["few"], times["all"]
        ms = [1e3 * s for s in (few.mean, few.low, few.high)]
        what = f"RandomMoire(p=0.1), {name}, mean of {few.runs} calls"
        yield Row(what, *ms, "ms", "at p=1", 1e3 * whole.mean, bar=0.12, stretch=0.105)


def released_chain(size: Size) -> Iterator[Row]:
    """Yield `paper_code` against the same chain on every sensor pixel. They must agree before they
    are timed."""
    image = torch.rand(1, 3, size.paper, size.paper, generator=torch.Generator().manual_seed(0))
    shot = Scene.preset("paper_code").sample(
        1, tuple(image.shape[-2:]), torch.Generator().manual_seed(0)
    )
    matrix, shape = shot.matrix(), tuple(image.shape[-2:])
    exact = released.photograph(image.double(), matrix)
    apart_by = float((capture(image.double(), shot) - exact).abs().max()) * 255
    if not apart_by < 0.1:
        raise SystemExit(
            f"paper_code is {apart_by:.3g}/255 off the released chain: there is nothing to compare."
        )
    reading, sensor = expose(image, shot), released.expose(image, matrix)
    calls = {
        "ours": with_gradient(
            lambda noise: develop(reading + noise, shot), torch.zeros_like(reading)
        ),
        "plain": with_gradient(
            lambda noise: released.photograph(image, matrix, noise), torch.zeros_like(sensor)
        ),
        "developed": with_gradient(
            lambda noise: released.develop(sensor + noise, shape), torch.zeros_like(sensor)
        ),
    }
    times = timed_together(calls, size.slow)
    what = f"paper_code, {size.paper} px, an attack step's camera, forward and backward"
    chain = f"the plain chain on all {released.SCALE * size.paper} px"
    yield time_row(what, times["ours"], chain, times["plain"], bar=1 / 100, stretch=1 / 200)
    yield time_row(what, times["ours"], f"{chain}, exposed before", times["developed"])
    calls = {
        "ours": lambda: capture(image, shot),
        "plain": lambda: released.photograph(image, matrix),
    }
    times = timed_together(calls, size.slow)
    yield time_row(
        f"paper_code, capture, same to {apart_by:.1g}/255", times["ours"], chain, times["plain"]
    )


def with_gradient(photo: Callable[[Tensor], Tensor], values: Tensor) -> Callable[[], Tensor]:
    """Return a function that runs a photo forward and backward for the gradient of its images or
    noise."""

    @torch.enable_grad()
    def run() -> Tensor:
        leaf = values.clone().requires_grad_()
        return torch.autograd.grad(photo(leaf).sum(), leaf)[0]

    return run


def precisions(size: Size) -> Iterator[Row]:
    """Yield other precisions against a capture of float32."""
    images = size.images()
    shot = Scene.preset("screen_photo").sample(size.batch, (size.side, size.side))
    halves, doubles = images.to(torch.bfloat16), images.double()
    calls = {
        "capture of float32": lambda: capture(images, shot),
        "capture of bfloat16": lambda: capture(halves, shot),
        "capture of float64": lambda: capture(doubles, shot),
    }
    times = timed_together(calls, size.slow)
    for name in list(times)[1:]:
        yield time_row(name, times[name], "capture of float32", times["capture of float32"])


def image_gradient(size: Size) -> Iterator[Row]:
    """Yield a capture with a gradient in the image, forward and backward, against one without: of
    bins, and of a full reading."""
    scenes = {
        "the default scene": Scene.preset("screen_photo"),
        "a full reading": Scene(
            view=View(yaw=10.0, roll=5.0), lens=Lens(blur=0.3), sensor=Sensor(scale=2.0)
        ),
    }
    images = size.images()
    for name, scene in scenes.items():
        shot = scene.sample(size.batch, (size.side, size.side), torch.Generator().manual_seed(0))
        calls = {
            "with": with_gradient(partial(capture, shot=shot), images),
            "without": partial(capture, images, shot),
        }
        times = timed_together(calls, size.repeats)
        what = f"capture of {name}, forward and backward in the image"
        yield time_row(what, times["with"], "the capture", times["without"], bar=4, stretch=3)


def layer(size: Size) -> Iterator[Row]:
    """Yield the camera as a layer, forward and backward: an image of a batch of eight on one
    thread, whole photos and crops, in the time of the thread."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    for side in size.layer:
        images = torch.rand(8, 3, side, side, generator=torch.Generator().manual_seed(0))
        calls = {}
        for name, shrink in (("whole photos", None), ("crops, shrink 1 to 3", (1.0, 3.0))):
            calls[name] = with_gradient(ScreenCamera("screen_photo", shrink=shrink), images)
        times = timed_together(calls, size.repeats, clock=time.process_time)
        for name, own in times.items():
            yield time_row(f"ScreenCamera, {name} of {side} px, forward and backward", own / 8)
    torch.set_num_threads(threads)


def single(size: Size) -> Iterator[Row]:
    """Yield an image as a DataLoader's worker transforms it: alone, or one of a batch in its
    `collate_fn`; whole photos and crops, uint8, on one thread, in the time of the thread."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    for side in (size.side // 2, size.side):
        images = (255 * torch.rand(size.batch, 3, side, side)).to(torch.uint8)
        array = images[0].permute(1, 2, 0).numpy().copy()
        for name, shrink in (("whole photo", None), ("crop, shrink 1 to 3", (1.0, 3.0))):
            moire = RandomMoire(p=1, shrink=shrink)
            numpy_moire = albumentations_transforms.RandomMoire(p=1, shrink=shrink)
            calls: dict[str, Callable] = {
                "torchvision, alone": partial(moire, images[0]),
                "albumentations, alone": partial(numpy_moire, image=array),
                f"torchvision, of {size.batch}": partial(moire, images),
            }
            times = timed_together(calls, size.calls, warmup=2, clock=time.process_time)
            for how, own in times.items():
                share = own if how.endswith("alone") else own / size.batch
                yield time_row(f"RandomMoire(p=1), {name} of {side} px, {how}", share)
    torch.set_num_threads(threads)


def executions(size: Size) -> Iterator[Row]:
    """Yield the stages of a capture by the engine against the reference."""
    images = size.images()
    shot = Scene.preset("screen_photo").sample(
        size.batch, (size.side, size.side), torch.Generator().manual_seed(0)
    )
    raw = expose(images, shot)
    stages: dict[str, Callable[[], Tensor]] = {
        "expose": partial(expose, images, shot),
        "develop": partial(develop, raw, shot),
        "develop, forward and backward": with_gradient(partial(develop, shot=shot), raw),
        "capture": partial(capture, images, shot),
    }
    for name, stage in stages.items():
        calls = {"engine": stage, "reference": partial(by_reference, stage)}
        times = timed_together(calls, size.repeats)
        yield time_row(f"{name}, the engine", times["engine"], "the reference", times["reference"])


def by_reference(stage: Callable[[], Tensor]) -> Tensor:
    with engine.reference():
        return stage()


GROUPS = (
    transforms,
    released_chain,
    panels.panels,
    steps.attack_step,
    steps.training,
    precisions,
    image_gradient,
    executions,
    layer,
    single,
    memory_and_starts.memory,
    memory_and_starts.large_photo,
    memory_and_starts.starts,
    memory_and_starts.workers,
)


def main() -> None:
    parser = measure.arguments(__doc__)
    names = [group.__name__ for group in GROUPS]
    parser.add_argument("--only", choices=names, help="one group of rows, into a file of its own")
    args, size, facts = measure.begin(parser, Size(), QUICK_SETTINGS)
    torch.manual_seed(0)
    size = replace(size, threads=args.threads)
    rows = []
    with torch.no_grad():
        for name, group in zip(names, GROUPS, strict=True):
            if args.only in (None, name):
                rows += list(group(size))
                print(f"{name} measured", file=sys.stderr)
    print(report(rows))
    measure.write_json(
        args,
        f"speed-{args.only}" if args.only else "speed",
        metadata=facts,
        size=dataclasses.asdict(size),
        rows=[row.to_dict() for row in rows],
    )


if __name__ == "__main__":
    main()
