"""Rungs: what a model is shown, from the clean image to the strongest attack. Each is a name and one function.

A rung depends on its batch, its shot and its generator alone, so the same name always means the same pictures,
whichever table asks for them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from moireaug.attacks import ATTACKS, MoireAttack, NoAnswerError
from moireaug.capture import capture, develop, expose
from moireaug.evaluation.statistics import ratio_of_means
from moireaug.evaluation.visibility import visibility
from moireaug.numeric import clip
from moireaug.scene.scene import Scene, Shot

Model = nn.Module | Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Bout:
    """What a rung is given: one batch, its shot, its targets, and a generator of its own."""

    model: Model
    images: Tensor
    labels: Tensor
    targets: Tensor
    shot: Shot
    generator: torch.Generator

    def __getitem__(self, rows: slice) -> Bout:
        parts = {k: getattr(self, k)[rows] for k in ("images", "labels", "targets", "shot")}
        return dataclasses.replace(self, **parts)


@dataclass(frozen=True)
class Rung:
    """What is shown.

    Args:
        name: stands for the pictures in files; two rungs of the same name are the same.
        title: for people.
        show: a Bout to images (B, 3, H, W) in [0, 1].
        eps: bound of the noise, 0 without an attacker.
        targeted: whether being fooled means giving the target's class.
        scene: the evaluation's scene to the one that this rung is photographed in; None keeps it. The draws are seeded
            alike, so that two rungs of one scene share their shots.
        measure: figures to take beside, from the Bout and what was shown.
    """

    name: str
    title: str
    show: Callable[[Bout], Tensor]
    eps: float = 0.0
    targeted: bool = False
    scene: Callable[[Scene], Scene] | None = None
    measure: Callable[[Bout, Tensor], dict[str, float]] | None = None


def label(eps: float) -> str:
    """An eps in units of 1/255, as names and titles have it."""
    return f"{eps * 255:g}"


def photo(b: Bout) -> Tensor:
    """The photo without an attacker."""
    return capture(b.images, b.shot)


def with_sensor(shot: Shot, **changes: Any) -> Shot:
    """The same shot by a sensor with other settings; its drawn numbers stay."""
    sensor = dataclasses.replace(shot.scene.sensor, **changes)
    return dataclasses.replace(shot, scene=dataclasses.replace(shot.scene, sensor=sensor))


def no_moire(shot: Shot) -> Shot:
    """The same shot of a panel without subpixels: camera, light and noise stay, the stripes leave their mean light."""
    return with_sensor(shot, exposure="mean")


def _dimmed(b: Bout) -> Tensor:
    return clip(b.images * ratio_of_means(photo(b), b.images))


def _rotated(b: Bout) -> Tensor:
    """The photo without moiré, as bright as its screen: a gain brings white back to white."""
    white = capture(torch.ones_like(b.images), no_moire(b.shot)).amax((1, 2, 3), keepdim=True)
    return clip(capture(b.images, no_moire(b.shot)) / white.clamp(min=1e-6))


def _random_noise(eps: float) -> Callable[[Bout], Tensor]:
    def show(b: Bout) -> Tensor:
        signs = torch.randint(0, 2, b.shot.raw_shape(), generator=b.generator).to(b.images) * 2 - 1
        return develop(expose(b.images, b.shot) + eps * signs, b.shot).to(b.images.dtype)

    return show


def unless_broken(attack: Callable[[], Tensor], start: Callable[[], Tensor]) -> Tensor:
    """What an attack shows, or, where the model has no answer to any of the images, what it starts from: these images
    are wrong without it, and an evaluation goes on."""
    try:
        return attack()
    except NoAnswerError:
        return start()


def attacking(kind: str, targeted: bool = False, **settings: Any) -> Callable[[Bout], Tensor]:
    """How the attack of that name in `attacks.ATTACKS` shows a batch; a Moiré Attack meets the bout's own shot."""
    attack, on_screen = ATTACKS[kind], issubclass(ATTACKS[kind], MoireAttack)

    def show(b: Bout) -> Tensor:
        scene = {"scene": b.shot.scene} if on_screen else {}
        shot = {"shot": b.shot} if on_screen else {}
        made = attack(model=b.model, **scene, **settings)
        goals = b.labels, b.targets if targeted else None
        return unless_broken(
            lambda: made(b.images, *goals, generator=b.generator, **shot).images,
            lambda: photo(b) if on_screen else b.images,
        )

    return show


def _against_photo(b: Bout, shown: Tensor) -> dict[str, float]:
    return visibility(shown, photo(b))


def _against_image(b: Bout, shown: Tensor) -> dict[str, float]:
    return visibility(shown, b.images)


CLEAN = Rung("clean", "clean image", lambda b: b.images)
DIMMED = Rung("dimmed", "dimmed to the photo's mean", _dimmed)
ROTATED = Rung("rotated", "rotated", _rotated)
NO_MOIRE = Rung("no_moire", "photo, no moiré", lambda b: capture(b.images, no_moire(b.shot)))
MOIRE = Rung("moire", "photo with moiré, no noise", photo)


def random_noise(eps: float) -> Rung:
    """Noise of random sign on the raw reading, at the bound."""
    return Rung(f"random_{label(eps)}", f"moiré, random noise {label(eps)}/255", _random_noise(eps), eps)


def moire_attack(eps: float, steps: int, *, targeted: bool = False, name: str = "", **settings: Any) -> Rung:
    """The Moiré Attack; `name` tells one with other settings from the plain one."""
    title = f"{'targeted ' if targeted else ''}Moiré Attack {label(eps)}/255" + (f", {name}" if name else "")
    tail = ("_targeted" if targeted else "") + (f"_{name.replace(' ', '_')}" if name else "")
    show = attacking("ma", targeted, eps=eps, steps=steps, **settings)
    # where the camera turns there is no photo of the same pose to compare with
    measure = None if "optimise" in settings else _against_photo
    return Rung(f"ma_{label(eps)}{tail}", title, show, eps, targeted, measure=measure)


def rival(kind: str, eps: float, steps: int, title: str) -> Rung:
    """An attack on pixels that no camera saw; C&W has no bound."""
    settings = {"steps": steps} if kind == "cw" else {"steps": steps, "eps": eps}
    show = attacking(kind, **settings)
    if kind == "cw":
        return Rung("cw", f"{title} on pixels", show, measure=_against_image)
    return Rung(f"{kind}_{label(eps)}", f"{title} on pixels {label(eps)}/255", show, eps, measure=_against_image)


def in_scene(rung: Rung, name: str, scene: Callable[[Scene], Scene]) -> Rung:
    """The same rung in another scene, under a name that says so."""
    return dataclasses.replace(
        rung, name=f"{rung.name}@{name.replace(' ', '_')}", title=f"{rung.title}, {name}", scene=scene
    )
