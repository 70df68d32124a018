"""What training images are turned into: kinds of adversaries by name, and what each costs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from moireaug.attacks import PGD, Attack, MoireAttack
from moireaug.attacks.model import evaluating
from moireaug.attacks.pose import moved_fields
from moireaug.attacks.problem import single
from moireaug.capture import capture
from moireaug.scene.fields import bounds, one_of, ranged_fields
from moireaug.scene.parts import PARTS
from moireaug.scene.scene import Scene, Shot
from training.schema import Adversary

KINDS = ("none", "moire", "moire_attack", "pgd")
TURNED = (
    "panel",
    "view",
)  # what a turned camera changes: where it stands, and how large the picture is shown
STEP = 0.5  # of the turned camera, in units of half a range
FORWARD = 1 / 3  # of a forward and backward pass
STRONG = 3  # steps of the validation's attack, and of training once fewer have failed


class Moment(NamedTuple):
    """How far training has come: the shares of eps and of the ranges in force, in [0, 1]."""

    strength: float = 1.0
    width: float = 1.0


WHOLE = Moment()


@dataclass
class Shown:
    """Images under attack, whose noise moves on with the training step's own gradient.

    Args:
        render: noise to images (B, 3, H, W) in [0, 1], differentiable.
        noise: what is rendered; after a backward pass its gradient is in `noise.grad`.
    """

    render: Callable[[Tensor], Tensor]
    noise: Tensor

    def images(self) -> Tensor:
        return self.render(self.noise.requires_grad_(True))

    def stepped(self, step: float, eps: float) -> Shown:
        """Return the same images after a sign step along the last gradient, within eps.

        Raises:
            RuntimeError: `images` was not followed by a backward pass.
        """
        if self.noise.grad is None:
            raise RuntimeError(
                "the noise has no gradient: call backward on a loss of images() before stepped()."
            )
        moved = self.noise.detach() + step * eps * self.noise.grad.sign()
        return replace(self, noise=moved.clamp(-eps, eps))


class Adversaries:
    """Turns images against a model, as `adversary.*` says.

    Args:
        model: the one that is trained.
        scene: of the shots.
        cfg: the settings.

    Raises:
        ValueError: settings out of their range or that do not go together, with what is allowed.
    """

    def __init__(self, model: nn.Module, scene: Scene, cfg: Adversary) -> None:
        self.model, self.scene, self.cfg = model, scene, cfg
        check(cfg)
        self.turned = _turned(scene) if cfg.turn else ()
        self.attack = _attack(model, scene, cfg)

    def __call__(self, images: Tensor, labels: Tensor, moment: Moment = WHOLE) -> Tensor:
        """Turn images (B, 3, H, W) in [0, 1] into attacked ones of that shape, without gradient."""
        if self.cfg.kind == "none":
            return images
        shot = self.shot(images, labels, moment)
        if self.cfg.kind == "moire":
            return capture(images, shot)  # type: ignore[arg-type]
        return self._now(moment).last(images, labels, shot=shot)

    def show(self, images: Tensor, labels: Tensor, moment: Moment) -> Shown:
        """Return the attacked images as `Shown`, for recipes that replay them."""
        problem, point = self._now(moment).walk(
            images, labels, shot=self.shot(images, labels, moment)
        )
        return Shown(problem.render, point["noise"])

    def shot(self, images: Tensor, labels: Tensor, moment: Moment) -> Shot | None:
        """Return each image's shot; None without a camera.

        It is a draw, or the worst of several, turned one step for the worse where `turn` is set.
        """
        if self.cfg.kind == "pgd":
            return None
        b, size = len(images), (images.shape[-2], images.shape[-1])
        shot = narrowed(self.scene.sample(b * self.cfg.worst_of, size), moment.width)
        if self.cfg.worst_of > 1:
            shot = self._worst(images, labels, shot)
        if self.turned:
            # of the shot and the turned one it keeps the worse
            camera = MoireAttack(
                model=self.model,
                scene=self.scene,
                eps=0.0,
                steps=1,
                step_size=STEP,
                optimise=self.turned,
            )
            return single(camera(images, labels, shot=shot)).shot
        return shot

    def _worst(self, images: Tensor, labels: Tensor, shots: Shot) -> Shot:
        """Return the shot of each image with the greatest loss, of several."""
        k, b = self.cfg.worst_of, len(images)
        with torch.no_grad(), evaluating(self.model):
            logits = self.model(capture(images.repeat(k, 1, 1, 1), shots))
            loss = F.cross_entropy(logits.float(), labels.repeat(k), reduction="none").view(k, b)
        return shots[(loss.argmax(0) * b + torch.arange(b, device=loss.device)).to(shots.device)]

    def _now(self, moment: Moment) -> Attack:
        if self.attack is None:
            raise ValueError(f"the adversary {self.cfg.kind!r} has no attack.")
        return replace(self.attack, eps=moment.strength * self.cfg.eps)


def _attack(model: nn.Module, scene: Scene, cfg: Adversary) -> Attack | None:
    steps: dict[str, Any] = {
        "eps": cfg.eps,
        "steps": cfg.steps,
        "step_size": cfg.step_size,
        "random_start": cfg.random_start,
    }
    if cfg.kind == "moire_attack":
        return MoireAttack(model=model, scene=scene, **steps)
    return PGD(model=model, **steps) if cfg.kind == "pgd" else None


def check(cfg: Adversary) -> None:
    """Refuse settings that cannot be followed.

    Raises:
        ValueError: with what was got, what is allowed and what to do.
    """
    one_of("adversary.kind", cfg.kind, KINDS)
    for name in ("share", "warmup", "curriculum"):
        if not 0 <= getattr(cfg, name) <= 1:
            raise ValueError(f"adversary.{name} must lie in [0, 1]; got {getattr(cfg, name)}.")
    for name in ("replays", "window", "worst_of"):
        if getattr(cfg, name) < 1:
            raise ValueError(f"adversary.{name} must be at least 1; got {getattr(cfg, name)}.")
    if not cfg.consistency >= 0:
        raise ValueError(f"adversary.consistency must be a weight >= 0; got {cfg.consistency}.")
    if cfg.replays > 1 and cfg.kind not in ("moire_attack", "pgd"):
        raise ValueError(
            f"adversary.replays={cfg.replays} replays an attack's noise; the kind {cfg.kind!r} has "
            "none. Use moire_attack or pgd, or replays=1."
        )
    if (cfg.worst_of > 1 or cfg.turn) and cfg.kind not in ("moire", "moire_attack"):
        raise ValueError(
            "adversary.worst_of and adversary.turn choose among a camera's shots; "
            f"the kind {cfg.kind!r} has none. Use moire or moire_attack."
        )


def validated(threat: Adversary) -> Adversary:
    """Return what a recipe is validated against: its adversary, strong, on one shot an image."""
    return replace(strengthened(threat), replays=1, worst_of=1, turn=False)


def strengthened(a: Adversary) -> Adversary:
    """Return the same adversary with at least three steps, from a start within its ball."""
    few = a.steps < STRONG
    return replace(
        a,
        steps=max(a.steps, STRONG),
        step_size=None if few else a.step_size,
        random_start=min(1.0, a.random_start),
    )


def passes(cfg: Adversary) -> float:
    """Return the forward and backward passes an image of a training step.

    A forward pass alone counts as a third.
    """
    if cfg.kind == "none":
        return 1.0
    steps = cfg.steps if cfg.kind in ("moire_attack", "pgd") else 0
    choosing = (cfg.worst_of if cfg.worst_of > 1 else 0) * FORWARD + (
        1 + 2 * FORWARD if cfg.turn else 0
    )
    beside = 1 if cfg.consistency else 0
    return 1 + cfg.share * ((steps + choosing) / cfg.replays + beside)


def narrowed(shot: Shot, width: float) -> Shot:
    """Return the shot with each drawn number moved towards the middle of its range.

    Args:
        width: share of each range that is used, in [0, 1]; 1 returns the shot itself.
    """
    if width >= 1:
        return shot
    parts: dict[str, Any] = {}
    for name in PARTS:
        part, drawn = getattr(shot.scene, name), {}
        for field in ranged_fields(part):
            middle = sum(bounds(getattr(part, field))) / 2
            value = middle + width * (getattr(getattr(shot, name), field) - middle)
            # the released poses are whole degrees
            drawn[field] = value.floor() if name == "view" and part.pose == "released" else value
        parts[name] = dataclasses.replace(getattr(shot, name), **drawn)
    return dataclasses.replace(shot, **parts)


def _turned(scene: Scene) -> tuple[str, ...]:
    """Return those of `TURNED` that have a range in this scene.

    Raises:
        ValueError: none has one, or no gradient turns this camera.
    """
    parts = {name: getattr(scene, name) for name in TURNED}
    open_ = [
        n
        for n, part in parts.items()
        if any(isinstance(getattr(part, f), tuple) for f in ranged_fields(part))
    ]
    if not open_:
        raise ValueError(
            f"adversary.turn searches the ranges of {' and '.join(TURNED)}, and the scene has "
            "none: give one of their fields a (low, high) pair, or leave adversary.turn out."
        )
    moved_fields(scene, tuple(open_))
    return tuple(open_)
