"""Adversaries of training by name: what each does to the images, and what it costs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from torch import Tensor, nn

from moireaug.attacks import PGD, Attack, MoireAttack
from moireaug.capture import capture
from moireaug.scene.fields import one_of
from moireaug.scene.scene import Scene, Shot
from training.schema import Adversary

KINDS = ("none", "moire", "moire_attack", "pgd")
STRONG = 3  # steps of the validation's attack, and of training once fewer have failed


class Adversaries:
    """Photographs or attacks training images, as `adversary.*` says.

    Args:
        model: the model in training.
        scene: the scene of the shots.
        cfg: the settings.

    Raises:
        ValueError: settings that are out of range or do not go together.
    """

    def __init__(self, model: nn.Module, scene: Scene, cfg: Adversary) -> None:
        check(cfg)
        self.scene, self.cfg = scene, cfg
        self.attack = _attack(model, scene, cfg)

    def __call__(self, images: Tensor, labels: Tensor, strength: float = 1.0) -> Tensor:
        """Return images (B, 3, H, W) in [0, 1] as the adversary leaves them, without gradient.

        Args:
            labels: (B,) int64. strength: share of eps that is in force, in [0, 1].
        """
        if self.cfg.kind == "none":
            return images
        if self.attack is None:
            return self.photograph(images)
        attack = replace(self.attack, eps=strength * self.cfg.eps)
        return attack.last(images, labels, shot=self._shot(images))

    def photograph(self, images: Tensor) -> Tensor:
        """Return photos of images (B, 3, H, W) in [0, 1], each by a random shot, unattacked."""
        return capture(images, self.scene.sample(len(images), _size(images)))

    def _shot(self, images: Tensor) -> Shot | None:
        if self.cfg.kind == "pgd":
            return None
        return self.scene.sample(len(images), _size(images))


def _size(images: Tensor) -> tuple[int, int]:
    return images.shape[-2], images.shape[-1]


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
    """Refuse invalid settings.

    Raises:
        ValueError: with what was got, what is allowed and what to do.
    """
    one_of("adversary.kind", cfg.kind, KINDS)
    for name in ("share", "natural", "warmup"):
        if not 0 <= getattr(cfg, name) <= 1:
            raise ValueError(f"adversary.{name} must lie in [0, 1]; got {getattr(cfg, name)}.")
    if cfg.kind != "none" and cfg.share + cfg.natural > 1:
        raise ValueError(
            "adversary.share and adversary.natural are parts of one batch and must not add up to "
            f"more than 1; got {cfg.share} and {cfg.natural}."
        )


def strengthened(a: Adversary) -> Adversary:
    """Return the same adversary with at least three steps and a start within eps."""
    few = a.steps < STRONG
    return replace(
        a,
        steps=max(a.steps, STRONG),
        step_size=None if few else a.step_size,
        random_start=min(1.0, a.random_start),
    )


def passes(cfg: Adversary) -> float:
    """Return the forward and backward passes per image in a training step."""
    if cfg.kind not in ("moire_attack", "pgd"):
        return 1.0
    return 1 + cfg.share * cfg.steps
