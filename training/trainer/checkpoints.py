"""Checkpoints that are written whole or not at all, in a folder that may be moved."""

from __future__ import annotations

import io
from dataclasses import asdict
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.fabric.plugins import TorchCheckpointIO
from lightning.pytorch.callbacks import ModelCheckpoint

from moireaug.common.files import write_bytes
from training.runs.identity import Origin


class AtomicCheckpointIO(TorchCheckpointIO):
    """Writes a checkpoint beside the previous one, which it then replaces.

    Lightning's own goes through the temporary folder, often on another disk: a copy that can be
    cut short.
    """

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any = None
    ) -> None:
        """Write a checkpoint, whole or not at all.

        Raises:
            OSError: the disk is full or not writable; the previous checkpoint stays whole.
        """
        # torch hides the cause when it writes the file itself and the disk is full
        buffer = io.BytesIO()
        torch.save(checkpoint, buffer)
        write_bytes(Path(path), buffer.getbuffer())


class RunCheckpoint(ModelCheckpoint):
    """Keeps one checkpoint under one name in a run's folder.

    Args:
        folder: folder of the run.
        name: file name, without its suffix.
        settings: further arguments of ModelCheckpoint.
    """

    def __init__(self, folder: Path, name: str, **settings: Any) -> None:
        super().__init__(
            folder, name, enable_version_counter=False, save_on_train_epoch_end=True, **settings
        )

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        # the state holds absolute paths: in a moved folder, Lightning would forget the best score
        def here(path: str) -> str:
            return path and str(Path(self.dirpath) / Path(path).name)  # type: ignore[arg-type]

        moved_paths = {
            k: here(state_dict[k])
            for k in ("best_model_path", "kth_best_model_path", "last_model_path")
        }
        best = {here(path): score for path, score in state_dict["best_k_models"].items()}
        super().load_state_dict(
            state_dict | moved_paths | {"best_k_models": best, "dirpath": self.dirpath}
        )


class OriginRecord(L.Callback):
    """Writes the origin of a training into each checkpoint, so that it is not evaluated on other
    classes, or resumed on other images or with other weights."""

    def __init__(self, origin: Origin) -> None:
        self.origin = origin

    def on_save_checkpoint(
        self, trainer: L.Trainer, module: L.LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        checkpoint.update(asdict(self.origin))
