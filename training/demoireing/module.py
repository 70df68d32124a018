"""The Lightning module that trains a demoiréing network."""

import math
import time
from typing import Any

import lightning as L
import torch
from torch import Tensor, nn

from moireaug.defenses.demoire import DemoireNet
from moireaug.defenses.demoire.losses import LOSSES, VGGFeatures
from moireaug.evaluation.visibility import psnr, ssim
from training.classifier.muon import Muon
from training.demoireing.schema import Demoire, Train

MAX_GRADIENT_NORM = 1.0  # of a step: the networks have no normalisation
MOMENTUM = 0.95
BIAS_LR = 0.05  # of SGD, in learning rates of the matrices


class Demoireing(L.LightningModule):
    """Trains a network by its published loss; validation scores PSNR and SSIM of the cleaned
    photos, and for comparison the photos' own PSNR."""

    def __init__(self, network: DemoireNet, demoire: Demoire, train: Train) -> None:
        super().__init__()
        self.network, self.settings = network, train
        # in this layout convolutions are faster on CPU
        self.network.to(memory_format=torch.channels_last)
        self.loss = LOSSES[network.name]
        # in a list, so that its weights are not kept in every checkpoint
        self._features = [VGGFeatures(demoire.vgg, network.name)] if demoire.vgg else []
        self.history: list[dict[str, float]] = []
        self._losses: list[Tensor] = []
        self._scores: dict[str, list[Tensor]] = {}
        self._epoch_start = self._training_seconds = 0.0

    def forward(self, photos: Tensor) -> Tensor:
        """Return photos (B, 3, H, W) in [0, 1], cleaned."""
        return self.network(photos.contiguous(memory_format=torch.channels_last))

    def features(self) -> nn.Module | None:
        """Return the network whose features the loss compares, on this device."""
        return self._features[0].to(self.device) if self._features else None

    def on_train_epoch_start(self) -> None:
        self._losses, self._epoch_start = [], time.perf_counter()

    def training_step(self, batch: tuple[Tensor, Tensor], index: int) -> Tensor:
        photos, targets = (codes.float() / 255 for codes in batch)
        photos = photos.contiguous(memory_format=torch.channels_last)
        loss = self.loss(self.network.outputs(photos), targets, self.features())
        if not torch.isfinite(loss):
            raise FloatingPointError(
                f"the loss became {loss.item()} in step {self.global_step}. Train with a smaller "
                "train.lr, or with trainer.precision=32-true; what was validated before is kept in "
                "the run's folder."
            )
        self._losses.append(loss.detach())
        self.log("loss", loss, prog_bar=True, logger=False)
        return loss

    def on_validation_epoch_start(self) -> None:
        self._training_seconds = time.perf_counter() - self._epoch_start
        self._scores = {"psnr": [], "ssim": [], "photo_psnr": []}

    def validation_step(self, batch: tuple[Tensor, Tensor], index: int) -> None:
        photos, targets = (codes.float() / 255 for codes in batch)
        cleaned = self(photos).float()
        self._scores["psnr"].append(psnr(cleaned, targets))
        self._scores["ssim"].append(ssim(cleaned, targets))
        self._scores["photo_psnr"].append(psnr(photos, targets))

    def on_validation_epoch_end(self) -> None:
        validation = time.perf_counter() - self._epoch_start - self._training_seconds
        loss = torch.tensor(self._losses, dtype=torch.float32, device=self.device).mean()
        row = {
            "steps": float(self.global_step),
            "loss": float(self.trainer.strategy.reduce(loss, reduce_op="mean")),
            "seconds": self._training_seconds,
            "validation_seconds": validation,
        }
        for name, values in self._scores.items():
            mean = self.trainer.strategy.reduce(torch.cat(values).mean(), reduce_op="mean")
            self.log(f"val_{name}", mean, prog_bar=name != "photo_psnr", logger=False)
            row[name] = float(mean)
        self.history.append(row)

    def configure_optimizers(self) -> Any:
        train = self.settings
        optimizer = Muon(self.network.parameters(), train.lr, MOMENTUM, 0.0, BIAS_LR)
        schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, self._rate)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def _rate(self, step: int) -> float:
        """Return the learning rate as a share of the greatest: it rises, then falls by a cosine."""
        train = self.settings
        warmup = min(train.warmup, train.steps // 2)
        if step < warmup:
            return (step + 1) / warmup
        progress = (step - warmup) / max(1, train.steps - warmup)
        return 0.5 * (1 + math.cos(math.pi * min(1.0, progress)))

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["history"] = list(self.history)

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        self.history = list(checkpoint["history"])
