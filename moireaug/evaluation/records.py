"""Records: one line per finished piece, appended as it comes. An evaluation that was stopped
repeats nothing.

A record's key is a digest of its settings: the model's weights, the batch's pixels and labels, the
scene, the condition's settings, the classifier and the seed. Whatever a record depends on changes
its key. Every suite reuses the records of others.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from torch import Tensor, nn

from moireaug.attacks.bounds import BOUNDS
from moireaug.common.argument_checks import one_of
from moireaug.common.files import write_bytes
from moireaug.evaluation.conditions import Condition
from moireaug.evaluation.identity import identity_of
from moireaug.mixtures import Mixture
from moireaug.scenes import Scene

KEY_VERSION = 10  # raise it when the same settings would give other figures


@dataclass(frozen=True)
class EvalSetup:
    """The settings that all conditions of an evaluation share.

    Args:
        scene: scene, or mixture of scenes, of which one shot is drawn per image; conditions may
            have their own.
        seed: seed of shots, targets, random starts and randomised classifiers, see `SeededBatch`.
        bound: what the eps of noise on a reading counts: "codes" or "light".
        lpips: `visibility.LPIPS` to measure every attack with, or None. An attack's records with
            and without it have different keys.
    """

    scene: Scene | Mixture
    seed: int = 0
    bound: str = "codes"
    lpips: nn.Module | None = None

    def __post_init__(self) -> None:
        one_of("bound", self.bound, BOUNDS)

    def scene_of(self, condition: Condition) -> Scene | Mixture:
        """Return the scene of a condition's photos."""
        return self.scene if condition.scene is None else condition.scene

    def lpips_of(self, condition: Condition) -> nn.Module | None:
        """Return the LPIPS of a condition: a control has none, and shares its records."""
        return None if condition.control else self.lpips

    @cached_property
    def lpips_identity(self) -> str:
        """The identity of the network that measures LPIPS."""
        return identity_of(self.lpips)

    def key_fields(self, condition: Condition) -> dict[str, Any]:
        """Return the settings of a condition's record."""
        fields = {
            "scene": self.scene_of(condition).to_dict(),
            "condition": condition.settings() | {"name": condition.name},
            "seed": self.seed,
            "bound": condition.eps_unit(self.bound),
        }
        if self.lpips_of(condition) is not None:
            fields["lpips"] = self.lpips_identity
        return fields


def batch_digest(images: Tensor, labels: Tensor) -> str:
    """Return sixteen hex digits that stand for the content of a batch."""
    sha256 = hashlib.sha256(images.detach().cpu().contiguous().numpy().tobytes())
    sha256.update(f"{tuple(images.shape)} {labels.tolist()}".encode())
    return sha256.hexdigest()[:16]


def key_of(fields: Mapping[str, Any]) -> str:
    """Return sixteen hex digits that stand for the settings of a record."""
    text = json.dumps({"version": KEY_VERSION, **fields}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


Record = dict[str, Any]
RECORD_FIELDS = {"key", "labels", "targets", "predicted", "measured", "seconds"}
N_PICTURES = 4  # images of the first batch that are saved as pictures


class Records(dict[str, Record]):
    """Records in memory, by key."""

    def append(self, records: Sequence[Record]) -> None:
        """Keep records."""
        self.update((record["key"], record) for record in records)

    def keep_picture(self, name: str, images: Tensor) -> None:
        """Save the images of a condition in the first batch; records in memory save none."""

    def picture(self, name: str) -> np.ndarray | None:
        """Return the saved images, (n, H, W, 3) uint8; None where there are none."""
        return None

    def read(self) -> None:
        """Read the records that other processes have written meanwhile."""


class RecordFolder(Records):
    """Records in a folder of JSON-lines files, one per process that writes.

    Args:
        folder: created at the first record if missing. Every process appends to its own file and
            reads all.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = Path(folder)
        self.read()

    @cached_property
    def _own_file(self) -> Path:
        """The file of this process alone, which may be killed within a line of it."""
        return self.folder / f"records-{uuid.uuid4().hex[:16]}.jsonl"

    def read(self) -> None:
        """Read the records of all processes. A line that cannot be read, because a process is
        writing it or a disk was full, is left out: its record is computed again."""
        for path in sorted(self.folder.glob("records-*.jsonl")):
            records = []
            for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
                with contextlib.suppress(ValueError):
                    record = json.loads(line)
                    if isinstance(record, dict) and record.keys() >= RECORD_FIELDS:
                        records.append(record)
            super().append(records)

    def append(self, records: Sequence[Record]) -> None:
        """Write records, all of them on the disk before this returns."""
        if not records:
            return
        lines = [json.dumps(record) + "\n" for record in records]
        self.folder.mkdir(parents=True, exist_ok=True)
        with self._own_file.open("a", encoding="utf-8") as file:
            file.write("".join(lines))
            file.flush()
            os.fsync(file.fileno())
        super().append(records)

    def keep_picture(self, name: str, images: Tensor) -> None:
        """Save the first images of a batch (B, 3, H, W) in [0, 1], one below the other in one
        PNG."""
        pictures = (images[:N_PICTURES].detach().float().cpu() * 255).round().byte()
        rows = pictures.permute(0, 2, 3, 1).reshape(-1, pictures.shape[3], 3).numpy()
        text = PngInfo()
        text.add_text("images", str(len(pictures)))
        file = io.BytesIO()
        Image.fromarray(rows).save(file, "PNG", pnginfo=text)
        write_bytes(self._picture_path(name), file.getvalue())

    def picture(self, name: str) -> np.ndarray | None:
        path = self._picture_path(name)
        if not path.is_file():
            return None
        with Image.open(path) as image:
            rows = np.asarray(image.convert("RGB"))
            n = int(image.info["images"])
        return rows.reshape(n, len(rows) // n, -1, 3)

    def _picture_path(self, name: str) -> Path:
        return self.folder / "pictures" / f"{name}.png"
