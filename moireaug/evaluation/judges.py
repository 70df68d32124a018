"""Judges: the models that classify what a condition shows."""

from __future__ import annotations

import dataclasses
import hashlib
import numbers
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor, nn

from moireaug.attacks import evaluating
from moireaug.defenses import restore_mean
from moireaug.evaluation.conditions import Defence, EvalBatch, Model


@dataclass(frozen=True)
class Judge:
    """The attacked model, the same behind a defence, or another model.

    Args:
        name: of the judge within an evaluation.
        defence: what the images pass before the model.
        model: another model than the attacked one: transfer.
        restores_mean: whether the mean of the clean image, which only an experimenter knows, is
            restored first.
    """

    name: str
    defence: Defence | None = None
    model: Model | None = None
    restores_mean: bool = False

    @property
    def base(self) -> str:
        """The judge without its defence; success counts the images that it gets right clean."""
        return UNDEFENDED.name if self.model is None else self.name

    def logits(self, batch: EvalBatch, shown: Tensor) -> Tensor:
        """Return the logits (B, K) for what is shown; every model's state is restored."""
        if self.restores_mean:
            shown = restore_mean(shown, batch.images)
        model = batch.model if self.model is None else self.model
        with evaluating(model), torch.no_grad():
            if self.defence is not None:
                shown = self.defence(shown)
            return model(shown)

    @cached_property
    def identity(self) -> str:
        """What identifies this judge in records: its defence's settings, its weights."""
        parts = [self.name]
        for part in (self.defence, self.model):
            if part is not None:
                parts.append(identity(part))
        return "#".join(parts)


UNDEFENDED = Judge("model")


def identity(part: object) -> str:
    """Return what identifies a model or a defence: the weights of a network, the settings of a
    dataclass, the import path of a function; for any other callable, its id in memory."""
    if isinstance(part, nn.Module):
        return digest(part)
    if isinstance(part, Tensor):
        return hashlib.sha256(part.detach().cpu().numpy().tobytes()).hexdigest()[:16]
    if dataclasses.is_dataclass(part) and not isinstance(part, type):
        fields = [type(part).__name__]
        for field in dataclasses.fields(part):
            fields.append(identity(getattr(part, field.name)))
        return f"({' '.join(fields)})"
    if isinstance(part, tuple | list):
        return f"({' '.join(identity(inner) for inner in part)})"
    if callable(part):
        return _place(part) or f"callable {id(part)}"
    return repr(part)


def require_identity(name: str, part: object) -> None:
    """Refuse a callable that a later process could not identify.

    Raises:
        ValueError: a lambda, a closure or an object; names it.
    """
    if "callable " in identity(part):
        raise ValueError(
            f"records are kept by what was asked, and nothing tells {name}, a "
            f"{type(part).__name__}, from another: pass a torch.nn.Module, a record of `defenses` "
            "or a function of a module, or leave folder out."
        )


def _place(part: object) -> str:
    """Return where a function can be imported from; empty where it cannot."""
    module, name = getattr(part, "__module__", ""), getattr(part, "__qualname__", "")
    if not module or not name or "<" in name or module == "__main__":
        return ""
    return f"{module}.{name}"


def _tells(value: object) -> bool:
    """Return whether `identity` is the same for an equal value in another process."""
    if isinstance(value, tuple | list):
        return all(_tells(inner) for inner in value)
    if callable(value):
        return bool(_place(value))
    return value is None or isinstance(value, Tensor | str | numbers.Number)


def digest(model: nn.Module) -> str:
    """Return sixteen hex digits that change with a weight, a buffer or a layer's settings: numbers,
    text, tensors and functions that it holds; code in a custom `forward` is not seen."""
    sums = hashlib.sha256(repr(model).encode())
    for name, layer in model.named_modules():
        sums.update(f"{name} {type(layer).__qualname__}".encode())
        for setting, value in sorted(vars(layer).items()):
            if not setting.startswith("_") and setting != "training" and _tells(value):
                sums.update(f"{setting} {identity(value)}".encode())
    values = {**model.state_dict(), **dict(model.named_buffers())}  # some buffers are not saved
    for name, value in sorted(values.items()):
        sums.update(name.encode())
        sums.update(value.detach().cpu().contiguous().view(-1).view(torch.uint8).numpy())
    return sums.hexdigest()[:16]
