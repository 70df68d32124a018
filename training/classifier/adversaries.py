"""Adversaries of training by name, and their cost."""

from dataclasses import replace

from torch import Tensor, nn

from moireaug.attacks import PGD, Attack, MoireAttack
from moireaug.capture import capture
from moireaug.mixtures import Mixture, map_scenes
from moireaug.scenes import Scene
from moireaug.synthesis.twins import without_subpixels
from training.config.schema import Adversary
from training.system.messages import count_text

MIN_STRONG_STEPS = 3  # of the validation's attack, and of training once fewer have failed


class TrainingAdversary:
    """Photographs or attacks training images, by the settings `adversary.*`."""

    def __init__(self, model: nn.Module, scene: Scene | Mixture, cfg: Adversary) -> None:
        if not cfg.moire:
            scene = map_scenes(scene, without_subpixels)
        self.scene, self.cfg = scene, cfg
        self.attack: Attack | None = None
        if cfg.kind != "none":
            self.attack = ATTACK_OF_KIND[cfg.kind](model, scene, cfg)

    def __call__(self, images: Tensor, labels: Tensor, strength: float = 1.0) -> Tensor:
        """Return images (B, 3, H, W) in [0, 1] under attack, without gradient; where the kind is
        "photographed_pgd", photographed then; where it is "pgd_on_photo", photographed before; and
        where it is "none", only photographed.

        Args:
            strength: share of eps that is in force, in [0, 1].
        """
        if self.attack is None:
            return self.photograph(images)
        if self.cfg.kind == "pgd_on_photo":
            images = self.photograph(images)
        attacked = replace(self.attack, eps=strength * self.cfg.eps).last(images, labels)
        return self.photograph(attacked) if self.cfg.kind == "photographed_pgd" else attacked

    def photograph(self, images: Tensor) -> Tensor:
        """Return photos of images (B, 3, H, W) in [0, 1], each by a random shot, unattacked."""
        size = images.shape[-2], images.shape[-1]
        return capture(images, self.scene.sample(len(images), size))


def _moire_attack(model: nn.Module, scene: Scene | Mixture, cfg: Adversary) -> Attack:
    return MoireAttack(
        model,
        scene=scene,
        eps=cfg.eps,
        bound=cfg.bound,
        steps=cfg.steps,
        random_start=1.0,
        optimise=tuple(cfg.optimise),
        draws=cfg.draws,
    )


def _pgd(model: nn.Module, scene: Scene | Mixture, cfg: Adversary) -> Attack:
    return PGD(model, eps=cfg.eps, steps=cfg.steps, random_start=1.0)


ATTACK_OF_KIND = {
    "moire_attack": _moire_attack,
    "pgd": _pgd,
    "photographed_pgd": _pgd,
    "pgd_on_photo": _pgd,
}


def part_counts(cfg: Adversary, images: int) -> tuple[int, int]:
    """Return how many of a batch's images are attacked, and how many are only photographed."""
    attacked = round(cfg.share * images)
    return attacked, round((cfg.share + cfg.natural) * images) - attacked


def require_parts(cfg: Adversary, images: int) -> None:
    """Refuse a batch of a process that is too small for a share of it to be an image."""
    shares = {"share": cfg.share, "natural": cfg.natural}
    for (name, share), count in zip(shares.items(), part_counts(cfg, images), strict=True):
        if share and not count:
            raise ValueError(
                f"adversary.{name}={share:g} of the {count_text(images, 'image')} that a process "
                "trains on at a time is none: pass a larger train.batch_size."
            )


def strengthen(cfg: Adversary) -> Adversary:
    """Return the same adversary with at least three steps."""
    return replace(cfg, steps=max(cfg.steps, MIN_STRONG_STEPS))


def passes(cfg: Adversary, target: str) -> float:
    """Return the forward and backward passes per image in a training step; a forward pass alone, of
    each of several draws or of the network whose answers are learnt, is a third of one.

    Args:
        target: what is learnt, one of `TARGETS`.
    """
    original = 1 / 3 if target == "answers" else 0
    draws = cfg.draws / 3 if cfg.draws > 1 else 0
    return 1 + original + cfg.share * (cfg.steps + draws)
