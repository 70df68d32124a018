"""The state of borrowed modules: what forward passes in evaluation mode write into it, put back."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.parameter import is_lazy

BUILT_IN = "torch.nn.modules."  # whose modules write nothing in evaluation mode
MODULE_TABLES = frozenset(vars(nn.Module()))  # of every nn.Module: its mode, hooks and parts
SETTING_TYPES = (bool, int, float, str, type(None))


@dataclass(frozen=True)
class ModuleState:
    """The state of one module, without that of the modules in it.

    buffers: name to buffer and a copy of its values, of modules that may write into them.
    settings: name to attribute, of the same modules: numbers, texts and None.
    versions: weight, or buffer without a copy, and torch's count of what was written into it.
    """

    buffers: dict[str, tuple[Tensor | None, Tensor | None]]
    settings: dict[str, Any]
    versions: list[tuple[str, Tensor, int]]

    @classmethod
    def of(cls, module: nn.Module) -> ModuleState:
        """Save a module's state. Buffers are copied, such as the ranges of a quantisation's
        observers, queues and counters, but for those of torch's own layers without hooks."""
        has_hooks = module._forward_pre_hooks or module._forward_hooks
        is_built_in = type(module).__module__.startswith(BUILT_IN) and not has_hooks
        buffers: dict[str, tuple[Tensor | None, Tensor | None]] = {}
        versions = []
        for name, tensor in [*module._parameters.items(), *module._buffers.items()]:
            if tensor is not None and is_lazy(tensor):
                continue
            if name in module._buffers and not is_built_in and _is_dense(tensor):
                buffers[name] = tensor, None if tensor is None else tensor.detach().clone()
            elif tensor is not None and not tensor.is_inference():
                versions.append((name, tensor, tensor._version))
        settings = {}
        if buffers:
            for name, value in vars(module).items():
                if name not in MODULE_TABLES and isinstance(value, SETTING_TYPES):
                    settings[name] = value
        return cls(buffers, settings, versions)

    def restore(self, module: nn.Module) -> list[str]:
        """Put back what has changed; return the names of the weights that have, which were not
        copied. Numbers and texts are put back where a buffer has changed, as they go together, such
        as a range and whether it is set; alone they may be a caller's own count."""
        has_changed = False
        for name, (tensor, values) in self.buffers.items():
            has_changed |= _restore_buffer(module, name, tensor, values)
        if has_changed:
            for name, value in self.settings.items():
                if getattr(module, name, value) is not value:
                    setattr(module, name, value)
        return [name for name, tensor, version in self.versions if tensor._version != version]


def restore_states(states: Iterable[tuple[nn.Module, ModuleState]]) -> None:
    """Put back what forward passes have written into the buffers of modules; warn of weights."""
    changed: list[str] = []
    for module, state in states:
        changed += [f"{type(module).__name__}.{name}" for name in state.restore(module)]
    if changed:
        names = ", ".join(changed if len(changed) < 4 else [*changed[:3], "…"])
        warnings.warn(
            f"the model's weights changed while it was evaluated ({names}), and are not put back: "
            "its forward pass writes them, or another thread trains it.",
            stacklevel=2,
        )


def _is_dense(tensor: Tensor | None) -> bool:
    return tensor is None or (tensor.layout == torch.strided and not tensor.is_meta)


def _restore_buffer(
    module: nn.Module, name: str, tensor: Tensor | None, values: Tensor | None
) -> bool:
    """Put a buffer back, as the same tensor with the same values; return whether it had changed."""
    has_changed = getattr(module, name, None) is not tensor
    if has_changed:
        setattr(module, name, tensor)
    if tensor is None or values is None or torch.equal(tensor, values):
        return has_changed
    with torch.inference_mode(tensor.is_inference()), torch.no_grad():
        if tensor.shape != values.shape:
            tensor.resize_(values.shape)
        tensor.copy_(values)
    return True
