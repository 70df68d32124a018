"""The Lightning module that trains a classifier against its adversary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from moireaug.attacks import NoAnswerError, predicted
from moireaug.mixtures import Mixture
from moireaug.scene.draws import mix_seeds
from moireaug.scenes import Scene
from training.classifier.adversaries import (
    MIN_STRONG_STEPS,
    TrainingAdversary,
    part_counts,
    strengthen,
)
from training.classifier.original import Original, divergence
from training.classifier.tuning import freeze_but_first, make_optimizer, tuning_of
from training.config.schema import PHOTO_ATTACKS, Adversary, Train
from training.data.augmentation import augment
from training.trainer.module import RecordedModule

MIN_COLLAPSE_ACCURACY = 0.2  # of the best epoch: below it a model has nothing to lose yet
COLLAPSE_FRACTION = 0.5  # share of the best accuracy that counts as a collapse
MASKED_MARGIN = 0.05  # by which an attack that finds no way up leaves images easier than others


def has_fallen(perturbed: list[float]) -> bool:
    """Return whether accuracy in the last epoch has fallen below half of the best before it.

    Args:
        perturbed: accuracy of each epoch under an attack of at least three steps, in [0, 1].
    """
    *before, last = perturbed
    if not before or max(before) <= MIN_COLLAPSE_ACCURACY:
        return False
    return last < COLLAPSE_FRACTION * max(before)


def accuracy_unattacked(means: Mapping[str, Any]) -> float:
    """Return the accuracy of an epoch without an attack, on clean images or on photos: a model that
    trains on photos alone may find these easier."""
    return max(float(means["clean"]), float(means.get("photo", 0)))


class Classifier(RecordedModule):
    """Trains a model on images that an adversary has photographed or attacked.

    Validation scores the mean of clean accuracy and accuracy under the recipe's own adversary, on
    draws that are the same in every epoch; an adversary of fewer than three steps is validated with
    three, so that a model that only defeats single steps (catastrophic overfitting) is noticed.
    `guard.CollapseGuard` acts on it. Where attacked images are photos, accuracy on photos without
    an attack is recorded, too.

    With `train.target=answers` the answers of the model as it is given take the place of labels:
    its logits of the images before they are photographed, in validation its answers.

    Args:
        model: classifier of [0, 1] images (B, 3, H, W), which returns logits (B, classes).
        scene: scene in which training images are photographed.
        augment: augmentation of the clean images, one of `AUGMENTATIONS`.
        fine: whether given weights are fine-tuned.
    """

    def __init__(
        self,
        model: nn.Module,
        train: Train,
        adversary: Adversary,
        scene: Scene | Mixture,
        *,
        seed: int,
        augment: str = "none",
        fine: bool = False,
    ) -> None:
        photo = ("photo",) if adversary.kind in PHOTO_ATTACKS else ()
        super().__init__("clean", "perturbed", *photo, hidden=photo)
        self.model, self.scene, self.seed = model, scene, seed
        self.train_cfg, self.adversary_cfg = train, adversary
        self.augment = augment
        self.original = Original(model) if train.target == "answers" else None
        freeze_but_first(model, train.layers)
        if train.compile:
            self.model.compile()
        self.adversary = TrainingAdversary(model, scene, adversary)
        self.validation_adversary = TrainingAdversary(model, scene, strengthen(adversary))
        self.tuning = tuning_of(train, fine=fine)
        self.collapsed_at: int | None = None
        own_statistics = not fine if train.batch_statistics is None else train.batch_statistics
        self._fixed_normalisations: list[nn.Module] = []
        if not own_statistics:
            for module in model.modules():
                if isinstance(module, nn.modules.batchnorm._BatchNorm):
                    self._fixed_normalisations.append(module)
        self.train()

    def train(self, mode: bool = True) -> Classifier:
        """Switch the mode of all but batch normalisation with fixed statistics.

        Fine-tuning keeps the statistics of the given weights: few images give no better ones, and
        published weights may have theirs folded into the convolutions."""
        super().train(mode)
        for module in self._fixed_normalisations:
            module.eval()
        return self

    def forward(self, images: Tensor) -> Tensor:
        """Return the logits of [0, 1] images (B, 3, H, W)."""
        return self.model(images)

    @property
    def has_few_steps(self) -> bool:
        """Return whether the model may learn to defeat only the few steps of its adversary."""
        return self.adversary_cfg.kind != "none" and self.adversary_cfg.steps < MIN_STRONG_STEPS

    @property
    def is_hardened(self) -> bool:
        return self.collapsed_at is not None

    def harden(self, epoch: int) -> None:
        """Attack in three steps from now on, or in twice as many as before: the model has collapsed
        in `epoch`."""
        self.collapsed_at = epoch
        cfg = self.adversary_cfg
        stronger = strengthen(cfg) if self.has_few_steps else replace(cfg, steps=2 * cfg.steps)
        self.adversary = TrainingAdversary(self.model, self.scene, stronger)

    def on_train_epoch_start(self) -> None:
        super().on_train_epoch_start()
        if torch.distributed.is_initialized():
            # Each process has its own statistics of batch normalisation, which DDP does not share
            # after a validation; attacks see them. A resumed run begins with the first's.
            for buffer in self.buffers():
                torch.distributed.broadcast(buffer, 0)

    def training_step(self, batch: tuple[Tensor, Tensor], index: int) -> Tensor:
        # all draws follow from seed, epoch, batch and rank, so that a resumed run repeats them
        torch.manual_seed(mix_seeds(self.seed, self.current_epoch, index, self.global_rank))
        images, labels = batch
        images = augment(images.float() / 255, self.augment)
        wanted = self.original.logits(images) if self.original else None
        if wanted is not None:
            labels = predicted(wanted)
        try:
            images = self._attack_and_photograph(images, labels)
        except NoAnswerError:
            raise self.diverged("loss became nan", index) from None
        logits = self(images)
        loss = F.cross_entropy(logits, labels) if wanted is None else divergence(logits, wanted)
        return self.recorded(loss, index)

    def _attack_and_photograph(self, images: Tensor, labels: Tensor) -> Tensor:
        """Return the images of a batch with the first ones attacked, the next ones photographed and
        the rest clean; batches are shuffled, so that each part is random."""
        n, photo_count = part_counts(self.adversary_cfg, len(images))
        end = n + photo_count
        attacked, photos, clean = images[:n], images[n:end], images[end:]
        if len(photos):
            photos = self.adversary.photograph(photos)
        if len(attacked):
            attacked = self.adversary(attacked, labels[:n], self._strength())
        return torch.cat([attacked, photos, clean])

    def _strength(self) -> float:
        """Return the share of eps in force, which rises linearly over `adversary.warmup`."""
        total = self.trainer.estimated_stepping_batches
        if not self.adversary_cfg.warmup:
            return 1.0
        return min(1.0, (self.global_step + 1) / (self.adversary_cfg.warmup * total))

    def on_validation_epoch_start(self) -> None:
        super().on_validation_epoch_start()
        self._rng = torch.random.get_rng_state()
        torch.manual_seed(self.seed + self.global_rank)

    def validation_step(self, batch: tuple[Tensor, Tensor], index: int) -> None:
        images, labels = batch
        images = images.float() / 255
        if self.original:
            labels = self.original.answers(images)
        self.figures["clean"].append((predicted(self(images)) == labels).float())
        if "photo" in self.figures:
            with torch.random.fork_rng(devices=[]):  # leaves the attack's draws as they are
                photos = self.validation_adversary.photograph(images)
            self.figures["photo"].append((predicted(self(photos)) == labels).float())
        if self.adversary_cfg.kind != "none" or self.adversary_cfg.natural:
            try:
                perturbed = self.validation_adversary(images, labels)
            except NoAnswerError:  # no answer is wrong, attacked or not
                perturbed = images
            self.figures["perturbed"].append((predicted(self(perturbed)) == labels).float())

    def on_validation_epoch_end(self) -> None:
        torch.random.set_rng_state(self._rng)
        super().on_validation_epoch_end()

    def score(self, means: Mapping[str, Tensor]) -> dict[str, Tensor]:
        mean = torch.stack([means[name] for name in means if name != "photo"]).mean()
        # a collapsed epoch is never the best
        collapsed = self.is_masked(means) or self.collapses([*self.history, means])
        return {"score": 0 * mean if collapsed else mean}

    def is_masked(self, means: Mapping[str, Any]) -> bool:
        """Return whether attacked images are easier than others: the model's gradients mislead its
        adversary, and the noise shows the label (label leaking, Kurakin et al., 2017)."""
        if self.adversary_cfg.kind == "none":
            return False
        return float(means["perturbed"]) > accuracy_unattacked(means) + MASKED_MARGIN

    def collapses(self, history: Sequence[Mapping[str, Any]]) -> bool:
        """Return whether the last of these epochs ends in catastrophic overfitting."""
        if not history or self.is_hardened:
            return False
        fallen = self.has_few_steps and has_fallen([float(row["perturbed"]) for row in history])
        return fallen or self.is_masked(history[-1])

    def configure_optimizers(self) -> Any:
        momentum = self.train_cfg.momentum
        trained = [weight for weight in self.parameters() if weight.requires_grad]
        optimizer = make_optimizer(trained, self.tuning, momentum)
        # with five steps the warm-up would have length 0, which OneCycleLR divides by
        total = max(6, int(self.trainer.estimated_stepping_batches) + 1)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimizer,
            [group["lr"] for group in optimizer.param_groups],
            total_steps=total,
            pct_start=0.2,
            cycle_momentum=momentum > 0,
            max_momentum=momentum,
            base_momentum=max(0.0, momentum - 0.1),
        )
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        super().on_save_checkpoint(checkpoint)
        checkpoint["collapsed_at"] = self.collapsed_at
        if self.original:
            checkpoint["original"] = self.original.model.state_dict()

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        super().on_load_checkpoint(checkpoint)
        if checkpoint["collapsed_at"] is not None:
            self.harden(checkpoint["collapsed_at"])
