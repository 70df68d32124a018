"""Every setting of synthesise.py."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from omegaconf import MISSING

from training.config.schema import SHRINK_HELP
from training.config.settings import setting
from training.pairs.files import FORMATS, SUFFIXES


@dataclass
class Config:
    """All settings of the command."""

    images: str = setting(MISSING, "a folder of pictures")
    out: str = setting(MISSING, "the folder that the pairs go to")
    n: int = setting(MISSING, "pairs, of all commands together")
    scene: str = setting(
        "screen_photo", "a preset's name, or a YAML file of a scene or a list of them"
    )
    shrink: Any = setting(None, SHRINK_HELP, example="[1,3]")
    size: int = setting(512, "side of the crops, in pixels")
    twin: bool = setting(False, "whether to add the same shot without moiré")
    format: str = setting("webdataset", "of the files", choices=tuple(FORMATS))
    encoding: str = setting("png", "of the pictures", choices=tuple(SUFFIXES))
    quality: int | None = setting(
        None, "of webp and jpeg; null is lossless, and 95 for jpeg", bounds=(1, 100)
    )
    seed: int = setting(0, "of the crops and the shots")
    per_shard: int = setting(1000, "pairs a tar, or a folder", bounds=(1, None))
    shard: str = setting("0/1", "which of how many commands this is, counted from 0")
    workers: int | None = setting(
        None, "processes; 0 is none but this one, null is one for each core", bounds=(0, 1024)
    )
