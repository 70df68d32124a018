"""The classifier that is trained: Lightning's loop around a model and an adversary."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import lightning as L
import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset
from torch.utils.data.distributed import DistributedSampler

from moireaug.attacks import PGD, Attack, MoireAttack, Normalized
from moireaug.capture import capture
from moireaug.evaluation import mix
from moireaug.fields import one_of
from moireaug.scene import Scene
from training.data import Splits, augment
from training.models import build
from training.schema import Adversary, Config, scene_of

Perturb = Callable[[Tensor, Tensor, float], Tensor]  # images, labels, share of eps in force -> images


def as_model(name: str, num_classes: int, weights: str | None, *, whole: bool = False) -> nn.Module:
    """A classifier of [0, 1] images: torchvision's models get their ImageNet normalisation put inside.

    Args: as in `models.build`.
    """
    # in this layout convolutions are up to twice as fast on CPU
    model = build(name, num_classes, weights, whole=whole).to(memory_format=torch.channels_last)
    return model if name == "small_resnet" else Normalized(model)


def _clean(model: nn.Module, scene: Scene, cfg: Adversary) -> Perturb:
    return lambda images, labels, strength: images


def _moire(model: nn.Module, scene: Scene, cfg: Adversary) -> Perturb:
    return lambda images, labels, strength: capture(images, scene.sample(len(images), tuple(images.shape[-2:])))


def _attack(attack: Attack) -> Perturb:
    return lambda images, labels, strength: replace(attack, eps=strength * attack.eps).last(images, labels)


def _steps(cfg: Adversary) -> dict[str, Any]:
    return {"eps": cfg.eps, "steps": cfg.steps, "step_size": cfg.step_size, "random_start": cfg.random_start}


ADVERSARIES: dict[str, Callable[[nn.Module, Scene, Adversary], Perturb]] = {
    "none": _clean,
    "moire": _moire,
    "moire_attack": lambda model, scene, cfg: _attack(MoireAttack(model=model, scene=scene, **_steps(cfg))),
    "pgd": lambda model, scene, cfg: _attack(PGD(model=model, **_steps(cfg))),
}


class Classifier(L.LightningModule):
    """Trains a model on images that an adversary has turned against it.

    Validation scores the mean of clean accuracy and accuracy under the recipe's own adversary, on draws that are the
    same in every epoch; an adversary of fewer than three steps is validated with three, so that a model that only
    defeats single steps (catastrophic overfitting) is seen.
    """

    def __init__(self, cfg: Config, num_classes: int) -> None:
        super().__init__()
        self.cfg = cfg
        self.model = as_model(cfg.model, num_classes, cfg.weights)
        a = cfg.adversary
        one_of("adversary.kind", a.kind, ADVERSARIES)
        if not 0 <= a.share <= 1:
            raise ValueError(f"adversary.share must lie in [0, 1]; got {a.share}.")
        scene = scene_of(cfg)
        self.perturb = ADVERSARIES[a.kind](self.model, scene, a)
        strong = Adversary(kind=a.kind, eps=a.eps, steps=max(a.steps, 3), random_start=min(1.0, a.random_start))
        self.perturb_strongly = ADVERSARIES[a.kind](self.model, scene, strong)
        self.history: list[dict[str, float]] = []
        self.collapsed_at: int | None = None
        self._loss: list[Tensor] = []
        self._hits: dict[str, list[Tensor]] = {}
        self._began, self._trained = time.perf_counter(), 0.0

    def forward(self, images: Tensor) -> Tensor:
        """[0, 1] images (B, 3, H, W) to logits."""
        return self.model(images)

    def on_train_epoch_start(self) -> None:
        self._loss, self._began = [], time.perf_counter()

    def training_step(self, batch: tuple[Tensor, Tensor], index: int) -> Tensor:
        # every draw of a step follows from seed, epoch, batch and rank: a resumed run repeats what it would have been
        torch.manual_seed(mix(self.cfg.seed, self.current_epoch, index, self.global_rank))
        images, labels = batch
        images = augment(images.float() / 255, self.cfg.data.augment)
        n = round(self.cfg.adversary.share * len(images))  # batches are shuffled: the first n are a random share
        if n and self.cfg.adversary.kind != "none":
            images = torch.cat([self.perturb(images[:n], labels[:n], self._strength()), images[n:]])
        loss = F.cross_entropy(self(images), labels, label_smoothing=self.cfg.train.label_smoothing)
        if not torch.isfinite(loss):
            raise FloatingPointError(
                f"the loss became {loss.item()} in epoch {self.current_epoch}, batch {index}. The last whole epoch is "
                "in last.ckpt: go on from it with resume=true, a smaller train.lr or trainer.precision=32-true."
            )
        self._loss.append(loss.detach())
        self.log("loss", loss, prog_bar=True, logger=False)
        return loss

    def _strength(self) -> float:
        """Share of eps in force: it rises linearly over the warm-up."""
        ramp = self.cfg.adversary.warmup * self.trainer.estimated_stepping_batches
        return min(1.0, (self.global_step + 1) / ramp) if ramp else 1.0

    def on_validation_epoch_start(self) -> None:
        self._hits, self._trained = {"clean": [], "perturbed": []}, time.perf_counter() - self._began
        self._rng = torch.random.get_rng_state()
        torch.manual_seed(self.cfg.seed)

    def validation_step(self, batch: tuple[Tensor, Tensor], index: int) -> None:
        images, labels = batch
        images = images.float() / 255
        self._hits["clean"].append((self(images).argmax(1) == labels).float())
        if self.cfg.adversary.kind != "none":
            images = self.perturb_strongly(images, labels, 1.0)
            self._hits["perturbed"].append((self(images).argmax(1) == labels).float())

    def on_validation_epoch_end(self) -> None:
        torch.random.set_rng_state(self._rng)
        if self.trainer.sanity_checking:
            return
        means = {k: torch.cat(v).mean() for k, v in self._hits.items() if v}
        means = {k: self.trainer.strategy.reduce(v, reduce_op="mean") for k, v in means.items()}
        means["score"] = torch.stack(list(means.values())).mean()
        for name, value in means.items():
            self.log(f"val_{name}", value, prog_bar=True, logger=False)
        loss = float(torch.stack(self._loss).mean()) if self._loss else float("nan")
        validation = time.perf_counter() - self._began - self._trained
        row = {"epoch": self.current_epoch, "loss": loss, "seconds": self._trained, "validation_seconds": validation}
        self.history.append(row | {k: float(v) for k, v in means.items()})
        self._watch_collapse()

    def _watch_collapse(self) -> None:
        a = self.cfg.adversary
        if a.kind not in ("moire_attack", "pgd") or a.steps > 2 or self.collapsed_at is not None:
            return
        best, now = max(h["perturbed"] for h in self.history), self.history[-1]["perturbed"]
        if best > 0.2 and now < best / 2:
            self.collapsed_at = self.current_epoch
            warnings.warn(
                f"Catastrophic overfitting in epoch {self.current_epoch}: accuracy under a three-step attack fell to "
                f"{now:.0%} from {best:.0%}. The best checkpoint is kept; train with adversary.steps=3, or with a "
                "larger adversary.random_start.",
                stacklevel=2,
            )

    def configure_optimizers(self) -> dict[str, Any]:
        t = self.cfg.train
        optimizer = torch.optim.SGD(
            self.parameters(), t.lr, momentum=t.momentum, weight_decay=t.weight_decay, nesterov=t.momentum > 0
        )
        # five steps would leave the rise of the rate no length, which OneCycleLR divides by
        total = max(6, int(self.trainer.estimated_stepping_batches) + 1)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, t.lr, total_steps=total, pct_start=0.2)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["history"], checkpoint["collapsed_at"] = list(self.history), self.collapsed_at

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        self.history, self.collapsed_at = list(checkpoint["history"]), checkpoint["collapsed_at"]


class Batches(L.LightningDataModule):
    """The splits as loaders; an epoch's order follows from the seed and the epoch alone, on any number of ranks."""

    def __init__(self, cfg: Config, splits: Splits) -> None:
        super().__init__()
        self.cfg, self.splits = cfg, splits

    def _loader(self, data: Dataset, shuffle: bool, batch_size: int) -> DataLoader:
        ranks, rank = (self.trainer.world_size, self.trainer.global_rank) if self.trainer else (1, 0)
        sampler = DistributedSampler(data, ranks, rank, shuffle=shuffle, seed=self.cfg.seed, drop_last=False)
        workers = self.cfg.data.workers
        return DataLoader(
            data, max(1, batch_size // ranks), sampler=sampler, num_workers=workers, persistent_workers=workers > 0,
            drop_last=shuffle and len(sampler) > batch_size // ranks,
        )  # fmt: skip

    def train_dataloader(self) -> DataLoader:
        return self._loader(self.splits.train, True, self.cfg.train.batch_size)

    def val_dataloader(self) -> DataLoader:
        return self._loader(self.splits.val, False, 320)
