"""Checkpoints that are whole or not there, in a folder that may be moved."""

from __future__ import annotations

import io
import os
import shutil
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.fabric.plugins import TorchCheckpointIO
from lightning.pytorch.callbacks import ModelCheckpoint


class WholeFiles(TorchCheckpointIO):
    """Writes a checkpoint beside the one before it, and then puts it into its place.

    Lightning's own passes through the temporary folder, which is often another disk: a copy that can be cut short.
    """

    def save_checkpoint(self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any = None) -> None:
        """
        Raises:
            OSError: a full disk, or one that cannot be written; the file that was there before is whole.
        """
        path = Path(path)
        buffer = io.BytesIO()  # torch hides the cause when a file that it writes itself cannot take any more
        torch.save(checkpoint, buffer)
        unfinished = path.with_name(f".{path.name}.tmp")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with unfinished.open("wb") as file:
                file.write(buffer.getbuffer())
                file.flush()
                os.fsync(file.fileno())
            os.replace(unfinished, path)
        except OSError as error:
            unfinished.unlink(missing_ok=True)
            need, free = buffer.getbuffer().nbytes / 1e6, shutil.disk_usage(path.parent).free / 1e6
            raise OSError(
                f"{path} could not be written ({error.strerror}): it needs {need:.1f} MB, and {free:.1f} MB are free. "
                "The checkpoints before it are whole: make room, and the same command goes on from them."
            ) from error


class Keep(ModelCheckpoint):
    """Keeps one checkpoint under one name in a run's folder.

    Args:
        folder: where it is kept. name: without the ending. settings: as of ModelCheckpoint.
    """

    def __init__(self, folder: Path, name: str, **settings: Any) -> None:
        super().__init__(folder, name, enable_version_counter=False, save_on_train_epoch_end=True, **settings)

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        # the state names files by whole paths; in a folder that was moved, Lightning would forget the best score
        def here(path: str) -> str:
            return path and str(Path(self.dirpath) / Path(path).name)  # type: ignore[arg-type]

        moved = {k: here(state_dict[k]) for k in ("best_model_path", "kth_best_model_path", "last_model_path")}
        best = {here(path): score for path, score in state_dict["best_k_models"].items()}
        super().load_state_dict(state_dict | moved | {"best_k_models": best, "dirpath": self.dirpath})


class Names(L.Callback):
    """Writes into each checkpoint what its classes are called, so that it is never asked about others.

    Args:
        classes: the name of each logit.
    """

    def __init__(self, classes: dict[int, str]) -> None:
        self.classes = classes

    def on_save_checkpoint(self, trainer: L.Trainer, module: L.LightningModule, checkpoint: dict[str, Any]) -> None:
        checkpoint["classes"] = dict(self.classes)
