"""The Lightning module that trains a demoiréing network."""

import math
from typing import Any

import torch
from torch import Tensor, nn

from moireaug.defenses.demoire import DemoireNet
from moireaug.defenses.demoire.losses import LOSSES, VGGFeatures
from moireaug.evaluation.visibility import psnr, ssim
from training.classifier.muon import Muon
from training.demoireing.schema import Demoire, Train
from training.trainer.module import RecordedModule

MAX_GRADIENT_NORM = 1.0  # of a step: the networks have no normalisation
MOMENTUM = 0.95
BIAS_LR = 0.05  # of SGD, in learning rates of the matrices


class Demoireing(RecordedModule):
    """Trains a network by its published loss; validation scores PSNR and SSIM of the cleaned
    photos, and for comparison the photos' own PSNR."""

    def __init__(self, network: DemoireNet, demoire: Demoire, train: Train) -> None:
        super().__init__("psnr", "ssim", "photo_psnr", hidden=("photo_psnr",))
        self.network, self.settings = network, train
        # in this layout convolutions are faster on CPU
        self.network.to(memory_format=torch.channels_last)
        self.loss = LOSSES[network.name]
        # in a list, so that its weights are not kept in every checkpoint
        self._features = [VGGFeatures(demoire.vgg, network.name)] if demoire.vgg else []

    def forward(self, photos: Tensor) -> Tensor:
        """Return photos (B, 3, H, W) in [0, 1], cleaned."""
        return self.network(photos.contiguous(memory_format=torch.channels_last))

    def features(self) -> nn.Module | None:
        """Return the network whose features the loss compares, on this device."""
        return self._features[0].to(self.device) if self._features else None

    def training_step(self, batch: tuple[Tensor, Tensor], index: int) -> Tensor:
        photos, targets = (codes.float() / 255 for codes in batch)
        photos = photos.contiguous(memory_format=torch.channels_last)
        loss = self.loss(self.network.outputs(photos), targets, self.features())
        return self.recorded(loss, index)

    def validation_step(self, batch: tuple[Tensor, Tensor], index: int) -> None:
        photos, targets = (codes.float() / 255 for codes in batch)
        cleaned = self(photos).float()
        self.figures["psnr"].append(psnr(cleaned, targets))
        self.figures["ssim"].append(ssim(cleaned, targets))
        self.figures["photo_psnr"].append(psnr(photos, targets))

    def progress(self) -> dict[str, float]:
        return {"steps": float(self.global_step)}

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
