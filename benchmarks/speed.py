"""Speed and memory of the capture, each beside something well known, in one run.

    python benchmarks/speed.py [--before DIR] [--only WORD]

Prints a table and writes results/speed.json, with `--only WORD` results/speed-WORD.json. A ratio is
ours over the other's, of medians taken in turns; `met` says whether it keeps its bar. Rows without
a bar are for information. Images are float32 of 224 px in batches of 16 and gradients are off,
unless a row says otherwise; the scene is the default, "screen_photo". `--before` names an older
checkout of the project (`git worktree add DIR COMMIT`), whose DataLoaders take turns with this
one's.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import torch
import torch.nn.functional as F
from hydra import initialize
from kornia.augmentation import RandomJPEG
from torch import Tensor, nn
from torchvision.models import resnet18

from benchmarks import apart, checkouts, measure, released, training_steps
from benchmarks.measure import timed_together
from benchmarks.rows import Row, Size, in_ms, report
from moireaug import Scene, attacks, capture, develop, expose
from moireaug.transforms import RandomMoire
from moireaug.transforms import kornia as kornia_door
from training.schema import register

QUICK = Size(
    side=32,
    batch=2,
    paper=27,
    large=(48, 64),
    training=(4, 16),
    lit=(0.9,),
    repeats=1,
    slow=1,
    first=0,
    calls=2,
    loaded=4,
)


def transforms(size: Size) -> Iterator[Row]:
    """Yield the random transform of both doors beside kornia's JPEG, and with few images chosen."""
    images = size.images()
    doors = {"torchvision": RandomMoire, "kornia": kornia_door.RandomMoire}
    calls: dict[str, Callable] = {"jpeg": partial(RandomJPEG(p=1), images)}
    for name, door in doors.items():
        calls[name] = partial(door(p=1), images)
    calls["torchvision, uint8"] = partial(RandomMoire(p=1), (255 * images).to(torch.uint8))
    times = timed_together(calls, size.repeats, warmup=2)
    rival = times.pop("jpeg")
    for name, own in times.items():
        bars = {"bar": 0.25, "stretch": 0.15} if name in doors else {}
        yield in_ms(f"RandomMoire(p=1), {name} door", own, "kornia RandomJPEG(p=1)", rival, **bars)
    for name, door in doors.items():
        calls = {"few": partial(door(p=0.1), images), "all": partial(door(p=1), images)}
        times = timed_together(calls, size.calls, budget=20.0)
        # means, because how many images are chosen varies by call
        few, whole = times["few"], times["all"]
        ms = [1e3 * s for s in (few.mean, few.low, few.high)]
        what = f"RandomMoire(p=0.1), {name} door, mean of {few.runs} calls"
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
        "ours": in_the_noise(lambda noise: develop(reading + noise, shot), reading.shape),
        "plain": in_the_noise(
            lambda noise: released.photograph(image, matrix, noise), sensor.shape
        ),
        "developed": in_the_noise(
            lambda noise: released.develop(sensor + noise, shape), sensor.shape
        ),
    }
    times = timed_together(calls, size.slow)
    what = f"paper_code, {size.paper} px, an attack step's camera, forward and backward"
    chain = f"the plain chain on all {released.SCALE * size.paper} px"
    yield in_ms(what, times["ours"], chain, times["plain"], bar=1 / 100, stretch=1 / 200)
    yield in_ms(what, times["ours"], f"{chain}, exposed before", times["developed"])
    calls = {
        "ours": lambda: capture(image, shot),
        "plain": lambda: released.photograph(image, matrix),
    }
    times = timed_together(calls, size.slow)
    yield in_ms(
        f"paper_code, capture, same to {apart_by:.1g}/255", times["ours"], chain, times["plain"]
    )


def in_the_noise(photo: Callable[[Tensor], Tensor], shape: tuple[int, ...]) -> Callable[[], Tensor]:
    """Return a function that runs a photo forward and backward for the gradient of its noise."""

    @torch.enable_grad()
    def run() -> Tensor:
        noise = torch.zeros(shape, requires_grad=True)
        return torch.autograd.grad(photo(noise).sum(), noise)[0]

    return run


def panels(size: Size) -> Iterator[Row]:
    """Yield what a panel's black matrix costs the exposure, beside stripes without one; and a scene
    without a lattice."""
    images, default = size.images(), Scene.preset("screen_photo")
    plain, scenes = black_matrices(size.lit)
    calls = {"plain": running(expose, plain, images)}
    for name, scene in scenes.items():
        calls[name] = running(expose, scene, images)
    times = timed_together(calls, size.repeats)
    for name, scene in scenes.items():
        what = f"{name}: {scene.plan().exposure}, {len(scene.plan().harmonics)} harmonics"
        yield in_ms(what, times[name], "rgb_stripe, lit 1", times["plain"], bar=1.3)
    calls = {
        "default": running(capture, default, images),
        "even": running(capture, without_lattice(), images),
    }
    times = timed_together(calls, size.repeats)
    yield in_ms("capture without any lattice", times["even"], "the default scene", times["default"])


def black_matrices(lit: Iterable[float]) -> tuple[Scene, dict[str, Scene]]:
    """Return the default scene with stripes that are lit all over, and, by the names of their rows,
    scenes whose subpixels are lit in part, the same along both axes."""
    default = Scene.preset("screen_photo")
    whole = replace(default.panel, layout="rgb_stripe", lit=1.0, lit_x=1.0, lit_y=1.0)
    scenes = {}
    for layout in ("rgb_stripe", "pentile"):
        for share in lit:
            panel = replace(whole, layout=layout, lit=share)
            scenes[f"expose, {layout}, lit {share:g}"] = replace(default, panel=panel)
    return replace(default, panel=whole), scenes


def without_lattice() -> Scene:
    """Return the default scene with pixels that shine evenly, right up to the next."""
    default = Scene.preset("screen_photo")
    panel = replace(default.panel, layout="even", lit=1.0, lit_x=1.0, lit_y=1.0)
    # no colour filters, and so no need of more pixels
    sensor = replace(default.sensor, cfa="none", scale=1)
    return replace(default, panel=panel, sensor=sensor)


def running(stage: Callable, scene: Scene, images: Tensor) -> Callable[[], Tensor]:
    """Return `expose` or `capture` of the images, in a shot that is drawn and planned once."""
    shot = scene.sample(len(images), tuple(images.shape[-2:]), torch.Generator().manual_seed(0))
    return lambda: stage(images, shot)


def attack_step(size: Size) -> Iterator[Row]:
    """Yield a step of the Moiré Attack against one of PGD on pixels: forward, backward, update."""
    images, labels = size.images(), torch.zeros(size.batch, dtype=torch.long)
    model = resnet18(weights=None).eval()
    ours = attacks.MoireAttack(model, scene="screen_photo")
    steps = {"moire": step(ours, images, labels), "pgd": step(attacks.PGD(model), images, labels)}
    times = timed_together(steps, 2 * size.slow)
    yield in_ms(
        "a Moiré Attack step, ResNet-18",
        times["moire"],
        "a PGD step",
        times["pgd"],
        bar=1.03,
        stretch=1.01,
    )


def step(attack: attacks.Attack, images: Tensor, labels: Tensor) -> Callable[[], Tensor]:
    """Return a step as in the attacks' loop, on a problem that is set up once for all steps."""
    problem, eps = attack.problem(images, None, None), attack.eps
    start = torch.zeros(problem.shape)

    @torch.enable_grad()
    def run() -> Tensor:
        noise = start.clone().requires_grad_(True)
        loss = F.cross_entropy(attack.model(problem.rehearse(noise)), labels, reduction="sum")
        (gradient,) = torch.autograd.grad(loss, noise)
        return (noise.detach() + eps / 4 * gradient.sign()).clamp(-eps, eps)

    return run


def training(size: Size) -> Iterator[Row]:
    """Yield a step of adversarial training through the camera beside one on pixels."""
    register()
    batch, side = size.training
    with initialize(version_base="1.3", config_path=None), torch.enable_grad():
        calls = {}
        for name in ("moire_at", "pgd_at"):
            cfg = training_steps.configure(f"recipe={name}", "model=small_resnet")
            calls[name] = training_steps.step(cfg, batch, side)
        times = timed_together(calls, 2 * size.slow)
    what = f"a moire_at step, small_resnet, {batch} of {side} px"
    yield in_ms(what, times["moire_at"], "a pgd_at step", times["pgd_at"], bar=1.25, stretch=1.1)


def precisions(size: Size) -> Iterator[Row]:
    """Yield other precisions, and gradients in the image, against a capture of float32."""
    images = size.images()
    shot = Scene.preset("screen_photo").sample(size.batch, (size.side, size.side))
    halves, doubles = images.to(torch.bfloat16), images.double()

    @torch.enable_grad()
    def backward() -> None:
        x = images.clone().requires_grad_(True)
        capture(x, shot).sum().backward()

    calls = {
        "capture of float32": lambda: capture(images, shot),
        "capture of bfloat16": lambda: capture(halves, shot),
        "capture of float64": lambda: capture(doubles, shot),
        "capture, forward and backward in the image": backward,
    }
    times = timed_together(calls, size.slow)
    for name in list(times)[1:]:
        yield in_ms(name, times[name], "capture of float32", times["capture of float32"])


def gpu(size: Size, device: str = "cuda") -> Iterator[Row]:
    """Yield draw and capture on a GPU against a training step there; the batch is 4 times that on
    the CPU."""
    images = size.images().to(device).repeat(4, 1, 1, 1)
    scene, model = Scene.preset("screen_photo"), resnet18(weights=None).to(device)
    labels = torch.zeros(len(images), dtype=torch.long, device=device)
    calls = {"photo": lambda: scene.capture(images), "train": training_step(model, images, labels)}
    times = timed_together(calls, 4 * size.repeats, warmup=5)
    what = f"draw and capture {len(images)} on the GPU, {measure.name_of(device)}"
    yield in_ms(what, times["photo"], "a ResNet-18 training step, bf16", times["train"], bar=0.02)


def training_step(model: nn.Module, images: Tensor, labels: Tensor) -> Callable[[], None]:
    optimiser = torch.optim.SGD(model.parameters(), lr=1e-3, momentum=0.9)

    @torch.enable_grad()
    def run() -> None:
        optimiser.zero_grad()
        with torch.autocast(images.device.type, dtype=torch.bfloat16):
            loss = F.cross_entropy(model(images), labels)
        loss.backward()
        optimiser.step()

    return run


GROUPS = (
    transforms,
    released_chain,
    panels,
    attack_step,
    training,
    precisions,
    apart.executions,
    apart.doors,
    apart.memory,
    apart.large_photo,
    apart.starts,
    gpu,
)


def groups_of(word: str, before: Path | None) -> Sequence[Callable[[Size], Iterator[Row]]]:
    """Return the groups with a word in their names, without those that cannot be measured here."""
    found = [group for group in GROUPS if word in group.__name__]
    if not before and apart.doors in found:
        found.remove(apart.doors)
    if not torch.cuda.is_available() and gpu in found:
        found.remove(gpu)
    return found


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument(
        "--only",
        default="",
        metavar="WORD",
        help="only the groups with this in their name; writes speed-WORD.json",
    )
    checkouts.add_before(parser)
    args = parser.parse_args()
    chosen = groups_of(args.only, args.before)
    if not chosen:
        names = ", ".join(group.__name__ for group in GROUPS)
        parser.error(
            f"--only {args.only} leaves nothing to measure. Name a part of one of these: {names}; "
            "doors needs --before DIR, and gpu a GPU."
        )
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    facts = measure.metadata() | {"before": checkouts.commit(args.before)}
    size = replace(QUICK if args.quick else Size(), threads=args.threads, before=args.before)
    print(measure.told(facts), end="\n\n")
    rows = []
    with torch.no_grad():
        for group in chosen:
            rows += list(group(size))
            print(f"{group.__name__} measured", file=sys.stderr)
    print(report(rows))
    if not args.before:
        print("Without --before DIR, the rows of DataLoaders are missing.")
    # no path of this machine among the results
    sizes = dataclasses.asdict(replace(size, before=None))
    name = f"speed-{args.only}.json" if args.only else "speed.json"
    measure.write_json(
        measure.results(args) / name,
        {"metadata": facts, "size": sizes, "rows": [r.to_dict() for r in rows]},
    )


if __name__ == "__main__":
    main()
