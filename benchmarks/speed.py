"""Speed and memory of the capture, each beside something well known, in one run.

    python benchmarks/speed.py [--compile] [--only WORD]

Prints a table and writes results/speed.json. A ratio is ours over the other's, of medians taken by turns; `met` says
whether it keeps its bar, losses beside wins. Rows without a bar are for information. Images are float32 of 224 px in
batches of 16 and gradients are off, unless a row says otherwise.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import torch
import torch.nn.functional as F
from kornia.augmentation import RandomJPEG
from torch import nn
from torchvision.models import resnet18

from benchmarks import loaders, measure, memory, released
from benchmarks.measure import timed, timed_together
from benchmarks.rows import Row, in_ms, report
from moireaug import Scene, View, attacks, capture
from moireaug.transforms.kornia import RandomMoire


@dataclass(frozen=True)
class Size:
    """What the rows are measured on."""

    side: int = 224
    batch: int = 16
    paper: int = 299
    repeats: int = 15
    slow: int = 5  # repeats of what takes seconds
    calls: int = 200  # of a transform that chooses by chance
    loaded: int = 512  # images an epoch

    def images(self) -> torch.Tensor:
        return torch.rand(self.batch, 3, self.side, self.side, generator=torch.Generator().manual_seed(0))


QUICK = Size(side=32, batch=2, paper=27, repeats=1, slow=1, calls=2, loaded=4)


def transforms(size: Size) -> Iterator[Row]:
    """The random transform beside kornia's JPEG, and with few images chosen."""
    images = size.images()
    ours, jpeg = RandomMoire(p=1), RandomJPEG(p=1)
    times = timed_together({"ours": lambda: ours(images), "jpeg": lambda: jpeg(images)}, size.repeats, warmup=2)
    what = "kornia door, RandomMoire(p=1)"
    yield in_ms(what, times["ours"], "kornia RandomJPEG(p=1)", times["jpeg"], bar=0.7, stretch=0.3)
    seldom = RandomMoire(p=0.1)
    times = timed_together({"few": lambda: seldom(images), "all": lambda: ours(images)}, size.calls, budget=20.0)
    few, every = times["few"], times["all"]  # means, because how many images are chosen varies by call
    ms = [1e3 * s for s in (few.mean, few.low, few.high)]
    yield Row(f"the same at p=0.1, mean of {few.runs} calls", *ms, "ms", "at p=1", 1e3 * every.mean, bar=0.15)


def released_chain(size: Size) -> Iterator[Row]:
    """`paper_code` beside the same chain on every sensor pixel. They must agree before they are timed."""
    image = torch.rand(1, 3, size.paper, size.paper, generator=torch.Generator().manual_seed(0))
    shot = Scene.preset("paper_code").sample(1, tuple(image.shape[-2:]), torch.Generator().manual_seed(0))
    exact = released.photograph(image.double(), shot.matrix())
    apart = float((capture(image.double(), shot) - exact).abs().max()) * 255
    if not apart < 0.1:
        raise SystemExit(f"paper_code differs from the released chain by {apart:.3g}/255: there is nothing to compare.")
    times = timed_together(
        {"ours": lambda: capture(image, shot), "plain": lambda: released.photograph(image, shot.matrix())}, size.slow
    )
    what = f"paper_code, 1 image of {size.paper} px, same to {apart:.1g}/255"
    every = f"all {released.SCALE * size.paper} x {released.SCALE * size.paper} sensor pixels"
    yield in_ms(what, times["ours"], every, times["plain"], bar=1 / 50)


def lattices(size: Size) -> Iterator[Row]:
    """Scenes that call for less, beside the default."""
    images, full = size.images(), Scene.preset("screen_photo")
    scenes = {
        "default": full,
        "no lattice": replace(
            full, panel=replace(full.panel, layout="even"), sensor=replace(full.sensor, cfa="none", scale=1)
        ),  # an even panel, no colour filters, and so no need of more sensor pixels than the photo has
        "panel too fine to alias": replace(full, panel=replace(full.panel, scale=8.0)),
        "frontal view": replace(full, view=View()),
    }
    shots = {name: s.sample(size.batch, (size.side, size.side)) for name, s in scenes.items()}
    times = timed_together({k: lambda shot=shot: capture(images, shot) for k, shot in shots.items()}, size.repeats)
    for name in list(scenes)[1:]:
        bar = 0.35 if name == "no lattice" else None
        yield in_ms(f"default scene but {name}", times[name], "default scene", times["default"], bar=bar)


def attack_step(size: Size) -> Iterator[Row]:
    """One step of the Moiré Attack beside one of PGD on pixels: forward, backward, update."""
    images, labels = size.images(), torch.zeros(size.batch, dtype=torch.long)
    model = resnet18(weights=None).eval()
    ours = attacks.MoireAttack(model, scene="screen_photo")
    steps = {"moire": step(ours, images, labels), "pgd": step(attacks.PGD(model), images, labels)}
    times = timed_together(steps, 2 * size.slow)
    yield in_ms("a Moiré Attack step, ResNet-18", times["moire"], "a PGD step, ResNet-18", times["pgd"], bar=1.10)


def step(attack: attacks.Attack, images: torch.Tensor, labels: torch.Tensor) -> Callable[[], torch.Tensor]:
    """A step as the attacks' loop takes it, on a problem that is set up once for all steps."""
    problem, eps = attack.problem(images, None, None), attack.eps
    start = torch.zeros(problem.shape)

    @torch.enable_grad()
    def run() -> torch.Tensor:
        noise = start.clone().requires_grad_(True)
        loss = F.cross_entropy(attack.model(problem.rehearse(noise)), labels, reduction="sum")
        (gradient,) = torch.autograd.grad(loss, noise)
        return (noise.detach() + eps / 4 * gradient.sign()).clamp(-eps, eps)

    return run


def memory_peak(size: Size) -> Iterator[Row]:
    """What the capture needs at its peak beside what comes in, in fresh processes and as torch's allocator counts."""
    batch = size.images().nbytes / 2**20
    resident = sorted(memory.in_fresh_process(size.batch, size.side) for _ in range(min(3, size.slow)))
    ends = resident[len(resident) // 2], resident[0], resident[-1]
    yield Row("memory of the capture, resident set", *ends, "MiB", "the batch", batch, bar=12.0)
    for name, gradients in (("forward", False), ("forward and backward", True)):
        peak = memory.allocated(size.batch, size.side, gradients)
        yield Row(f"memory of the capture, allocated, {name}", peak, peak, peak, "MiB", "the batch", batch)


def precisions(size: Size) -> Iterator[Row]:
    """Images of each floating type, and the backward pass."""
    images = size.images()
    shot = Scene.preset("screen_photo").sample(size.batch, (size.side, size.side))
    typed = {
        str(t).removeprefix("torch."): images.to(t)
        for t in (torch.float32, torch.float64, torch.float16, torch.bfloat16)
    }
    calls: dict[str, Callable] = {f"capture of {k}": lambda x=x: capture(x, shot) for k, x in typed.items()}

    @torch.enable_grad()
    def backward() -> None:
        x = images.clone().requires_grad_(True)
        capture(x, shot).sum().backward()

    times = timed_together(calls | {"capture forward and backward": backward}, size.repeats)
    base = times["capture of float32"]
    yield in_ms("capture of float32", base)
    for name in list(times)[1:]:
        yield in_ms(name, times[name], "capture of float32", base)


def doors(size: Size) -> Iterator[Row]:
    """DataLoaders of two workers, which have a thread each; uint8 images, all photographed."""
    calls = loaders.epochs(size.loaded, size.side, size.batch)
    times = timed_together(calls, size.slow)
    for door, plain in (("torchvision", "tensors"), ("albumentations", "arrays")):
        t, other = times[door], size.loaded / times[plain].median
        rates = [size.loaded / s for s in (t.median, t.high, t.low)]
        yield Row(f"DataLoader, 2 workers, {door}", *rates, "images/s", f"no transform, {plain}", other)


def compiled(size: Size) -> Iterator[Row]:
    """torch.compile of the capture: its first call, and later ones."""
    images = size.images()
    shot = Scene.preset("screen_photo").sample(size.batch, (size.side, size.side))
    warnings.filterwarnings("ignore", module="torch._dynamo")  # of caches that it does not need
    fast = torch.compile(capture)
    cold = timed(lambda: fast(images, shot), repeats=1, warmup=0)
    times = timed_together({"eager": lambda: capture(images, shot), "fast": lambda: fast(images, shot)}, size.repeats)
    yield in_ms("torch.compile(capture), first call", cold, "capture", times["eager"])
    yield in_ms("torch.compile(capture), later calls", times["fast"], "capture", times["eager"])


def gpu(size: Size, device: str = "cuda") -> Iterator[Row]:
    """Draw and capture on a GPU beside a training step there; a 4 times larger batch than on the CPU."""
    images = size.images().to(device).repeat(4, 1, 1, 1)
    scene, model = Scene.preset("screen_photo"), resnet18(weights=None).to(device)
    labels = torch.zeros(len(images), dtype=torch.long, device=device)
    calls = {"photo": lambda: scene.capture(images), "train": training_step(model, images, labels)}
    times = timed_together(calls, 4 * size.repeats, warmup=5)
    yield in_ms(
        f"draw and capture {len(images)} on the GPU",
        times["photo"],
        "a ResNet-18 training step, bf16",
        times["train"],
        bar=0.02,
    )


def training_step(model: nn.Module, images: torch.Tensor, labels: torch.Tensor) -> Callable[[], None]:
    optimiser = torch.optim.SGD(model.parameters(), lr=1e-3, momentum=0.9)

    @torch.enable_grad()
    def run() -> None:
        optimiser.zero_grad()
        with torch.autocast(images.device.type, dtype=torch.bfloat16):
            loss = F.cross_entropy(model(images), labels)
        loss.backward()
        optimiser.step()

    return run


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("--compile", action="store_true", help="torch.compile(capture), too: a minute or more")
    parser.add_argument("--only", default="", help="only the groups with this in their name")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    facts, size = measure.metadata(), QUICK if args.quick else Size()
    print(measure.told(facts), end="\n\n")
    groups = [transforms, released_chain, lattices, attack_step, memory_peak, precisions, doors]
    groups += [compiled] * args.compile + [gpu] * torch.cuda.is_available()
    rows = []
    with torch.no_grad():
        for group in groups:
            if args.only in group.__name__:
                rows += list(group(size))
                print(f"{group.__name__} measured", file=sys.stderr)
    print(report(rows))
    content = {"metadata": facts, "size": asdict(size), "rows": [row.to_dict() for row in rows]}
    measure.write_json(args.out / "speed.json", content)


if __name__ == "__main__":
    main()
