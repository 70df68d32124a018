"""Adversaries of training by name: what each does to the images, and what it costs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor, nn

from moireaug.attacks import PGD, Attack, MoireAttack
from moireaug.capture import capture
from moireaug.scene.fields import one_of
from moireaug.scene.scene import Scene, Shot
from training.schema import Adversary

KINDS = ("none", "moire", "moire_attack", "pgd")
STRONG = 3  # steps of the validation's attack, and of training once fewer have failed


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
        if self.cfg.kind == "moire":
            return self.photograph(images)
        return self._attack_at(strength).last(images, labels, shot=self._shot(images))

    def photograph(self, images: Tensor) -> Tensor:
        """Return photos of images (B, 3, H, W) in [0, 1], each by a random shot, unattacked."""
        return capture(images, self.scene.sample(len(images), _size(images)))

    def show(self, images: Tensor, labels: Tensor, strength: float = 1.0) -> Shown:
        """Return the attacked images as `Shown`, for recipes that replay them.

        Raises:
            ValueError: an adversary without an attack, "none" or "moire".
        """
        attack = self._attack_at(strength)
        problem, point = attack.walk(images, labels, shot=self._shot(images))
        return Shown(problem.render, point["noise"])

    def _shot(self, images: Tensor) -> Shot | None:
        if self.cfg.kind == "pgd":
            return None
        return self.scene.sample(len(images), _size(images))

    def _attack_at(self, strength: float) -> Attack:
        if self.attack is None:
            raise ValueError(
                f"the adversary {self.cfg.kind!r} has no attack: use moire_attack or pgd."
            )
        return replace(self.attack, eps=strength * self.cfg.eps)


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
    for name in ("replays", "window"):
        if getattr(cfg, name) < 1:
            raise ValueError(f"adversary.{name} must be at least 1; got {getattr(cfg, name)}.")
    if cfg.replays > 1 and cfg.kind not in ("moire_attack", "pgd"):
        raise ValueError(
            f"adversary.replays={cfg.replays} replays an attack's noise; the kind {cfg.kind!r} has "
            "none. Use moire_attack or pgd, or replays=1."
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
    return 1 + cfg.share * cfg.steps / cfg.replays
