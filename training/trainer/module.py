"""The Lightning module of all runs: it keeps the history of its training."""

import time
from collections.abc import Mapping
from typing import Any

import lightning as L
import torch
from torch import Tensor


class RecordedModule(L.LightningModule):
    """A module whose history has a row for each epoch: its loss, its validation and its seconds.

    Its checkpoints hold the history, so that a resumed training continues it. A validation step
    appends the figures of its images, (B,), to `figures`.

    Args:
        figures: names of the figures of a validation.
        hidden: those that are not shown as training goes on.
    """

    def __init__(self, *figures: str, hidden: tuple[str, ...] = ()) -> None:
        super().__init__()
        self.history: list[dict[str, float]] = []
        self.figures: dict[str, list[Tensor]] = {name: [] for name in figures}
        self.hidden = hidden
        self._losses: list[Tensor] = []
        self._epoch_start, self._training_seconds = time.perf_counter(), 0.0

    def progress(self) -> dict[str, float]:
        """Return the place of a row in the history, by name."""
        return {"epoch": self.current_epoch}

    def score(self, means: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return further figures of a validation, of the means of the others."""
        return {}

    def recorded(self, loss: Tensor, index: int) -> Tensor:
        """Return the loss of a batch, which joins the history.

        Raises:
            FloatingPointError: it is nan or infinite.
        """
        if not torch.isfinite(loss):
            raise self.diverged(f"loss became {loss.item()}", index)
        self._losses.append(loss.detach())
        self.log("loss", loss, prog_bar=True, logger=False)
        return loss

    def diverged(self, symptom: str, index: int) -> FloatingPointError:
        """Return the error of a training that cannot go on."""
        return FloatingPointError(
            f"the {symptom} in epoch {self.current_epoch + 1}, batch {index}. Train with a smaller "
            "train.lr, or with trainer.precision=32-true; the epochs before this one are kept in "
            "the run's folder."
        )

    def on_train_epoch_start(self) -> None:
        self._losses, self._epoch_start = [], time.perf_counter()

    def on_validation_epoch_start(self) -> None:
        self._training_seconds = time.perf_counter() - self._epoch_start
        self.figures = {name: [] for name in self.figures}

    def on_validation_epoch_end(self) -> None:
        validation_seconds = time.perf_counter() - self._epoch_start - self._training_seconds
        loss = torch.tensor(self._losses, dtype=torch.float32, device=self.device).mean()
        means = {k: self._over_ranks(torch.cat(v).mean()) for k, v in self.figures.items() if v}
        means |= self.score(means)
        for name, mean in means.items():
            self.log(f"val_{name}", mean, prog_bar=name not in self.hidden, logger=False)
        row = {
            **self.progress(),
            "loss": float(self._over_ranks(loss)),
            "seconds": self._training_seconds,
            "validation_seconds": validation_seconds,
        }
        self.history.append(row | {name: float(mean) for name, mean in means.items()})

    def _over_ranks(self, mean: Tensor) -> Tensor:
        return self.trainer.strategy.reduce(mean, reduce_op="mean")

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["history"] = list(self.history)

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        self.history = list(checkpoint["history"])
