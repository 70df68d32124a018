"""The detector: a published network's stages, pooled, looked at twice and weighed by two heads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from PIL import Image
from torch import Tensor, nn

from moireaug.attacks import Normalized
from moireaug.common.image_checks import check_images
from moireaug.common.weights import read_weights, write_tensors
from training.data.codes import codes_of
from training.detection.heads import Heads
from training.models.classifiers import as_model

PHOTO_SIDE = 1024  # longest side at which photos are looked at, pixels: as messengers send them
CROP_SIDE, WHOLE_SIDE = 224, 256  # of what the network sees, pixels
# middles of the crops, as shares of a photo's height and width
PLACES = ((0.2, 0.25), (0.2, 0.75), (0.5, 0.5), (0.8, 0.25), (0.8, 0.75))
# of torchvision's ResNets, in the order of their forward pass
STEM, STAGES = ("conv1", "bn1", "relu", "maxpool"), ("layer1", "layer2", "layer3", "layer4")
FILE_ADVICE = "Pass a file that training/detect.py train wrote."


class Detector(nn.Module):
    """Scores of photos: above `threshold`, a photo is taken to be one of a screen.

    A photo is looked at twice: in crops at its own pixels, for the panel's pattern, and whole and
    small, for what is around a screen. Each look has a linear head on the mean and the deviation
    of every stage of the network.

    Args:
        backbone: name of a ResNet of torchvision. weights: of it, see `as_model`; None leaves it
            random.

    Raises:
        ValueError: a network without the stages of a ResNet, or weights that do not fit.
    """

    threshold: Tensor

    def __init__(self, backbone: str, weights: str | None = None) -> None:
        super().__init__()
        network = as_model(backbone, 1000, weights)
        parts = dict(network.named_modules())
        missing = [part for part in (*STEM, *STAGES) if f"model.{part}" not in parts]
        if missing:
            raise ValueError(
                f"backbone must be a ResNet of torchvision, with the stages {', '.join(STAGES)}; "
                f"{backbone!r} has no {missing[0]}. Pass backbone=resnet18."
            )
        self.backbone, self.network = backbone, network.requires_grad_(False).eval()
        self.normalise = Normalized(nn.Identity())
        with torch.no_grad():
            width = self.features(torch.zeros(1, 3, CROP_SIDE, CROP_SIDE)).shape[1]
        self.heads = Heads(width)
        self.register_buffer("threshold", torch.zeros(()))

    def features(self, images: Tensor) -> Tensor:
        """Return features (B, F) of images (B, 3, H, W) in [0, 1]."""
        resnet: Any = self.network.model
        x = self.normalise(images)
        for part in STEM:
            x = getattr(resnet, part)(x)
        pooled = []
        for stage in STAGES:
            x = getattr(resnet, stage)(x)
            pooled += [x.mean((2, 3)).float(), x.std((2, 3)).float()]
        return torch.cat(pooled, 1)

    def train(self, mode: bool = True) -> Detector:
        """Leave the network's batch statistics alone."""
        super().train(mode)
        self.network.eval()
        return self

    def seen(self, photos: Tensor) -> dict[str, Tensor]:
        """Return the features of photos (B, 3, H, W) in [0, 1], of any size: of their crops
        (B, crops, F), and of the whole ones (B, F)."""
        photos = at_photo_size(check_images(photos))
        crops = crops_of(photos)
        of_crops = self.features(crops.flatten(0, 1)).unflatten(0, crops.shape[:2])
        whole = F.interpolate(photos, (WHOLE_SIDE, WHOLE_SIDE), mode="bilinear", antialias=True)
        return {"crop": of_crops, "whole": self.features(whole)}

    def forward(self, photos: Tensor) -> Tensor:
        """Return scores (B,) of photos (B, 3, H, W) in [0, 1], of any size. Differentiable."""
        seen = self.seen(photos)
        return self.heads(seen["crop"], seen["whole"])

    def save(self, path: Path) -> None:
        """Write the detector to a file, its network included; errors as `write_tensors`."""
        write_tensors(path, {"backbone": self.backbone, "state": self.state_dict()})

    @staticmethod
    def load(path: str | Path) -> Detector:
        """Return the detector of a file.

        Raises:
            ValueError: no such file, or one of something else.
        """
        content = read_weights(path, "the detector", FILE_ADVICE)
        if not isinstance(content, dict) or set(content) != {"backbone", "state"}:
            raise ValueError(f"the file {str(path)!r} holds no detector. {FILE_ADVICE}")
        detector = Detector(content["backbone"])
        try:
            detector.load_state_dict(content["state"])
        except (RuntimeError, TypeError) as error:
            reason = str(error).splitlines()[0].rstrip(":")
            raise ValueError(
                f"the file {str(path)!r} holds no detector of this version ({reason}). "
                f"{FILE_ADVICE}"
            ) from error
        return detector.eval()


def at_photo_size(photos: Tensor) -> Tensor:
    """Return photos (B, 3, H, W) shrunk to `PHOTO_SIDE`, or enlarged until a crop fits."""
    height, width = photos.shape[-2:]
    factor = min(1.0, PHOTO_SIDE / max(height, width))
    factor = max(factor, CROP_SIDE / min(height, width))
    if factor == 1:
        return photos
    size = [max(CROP_SIDE, round(side * factor)) for side in (height, width)]
    return F.interpolate(photos, size, mode="bicubic", antialias=True).clamp(0, 1)


def crops_of(photos: Tensor) -> Tensor:
    """Return the crops (B, crops, 3, side, side) of photos (B, 3, H, W)."""
    height, width = photos.shape[-2:]
    crops = []
    for y, x in PLACES:
        top = min(max(int(y * height - CROP_SIDE / 2), 0), height - CROP_SIDE)
        left = min(max(int(x * width - CROP_SIDE / 2), 0), width - CROP_SIDE)
        crops.append(photos[..., top : top + CROP_SIDE, left : left + CROP_SIDE])
    return torch.stack(crops, 1)


def shrunk(picture: Image.Image) -> Image.Image:
    """Return a picture at most `PHOTO_SIDE` long."""
    picture = picture.copy()
    picture.thumbnail((PHOTO_SIDE, PHOTO_SIDE), Image.Resampling.LANCZOS)
    return picture


def as_photo(picture: Image.Image) -> Tensor:
    """Return a picture as a photo (1, 3, H, W) in [0, 1], at most `PHOTO_SIDE` long."""
    return codes_of(shrunk(picture))[None].float() / 255
