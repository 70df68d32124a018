"""Files of weights, written whole and read as data."""

from __future__ import annotations

import argparse
import contextlib
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor, nn

from moireaug.common.extras import require
from moireaug.common.files import write_bytes

SAFETENSORS = ".safetensors"
# keys of the state_dict in checkpoints; averaged weights last, where there are no others
STATE_DICT_KEYS = ["state_dict", "model_state_dict", "model"]
STATE_DICT_KEYS += ["state_dict_ema", "ema_state_dict", "model_ema"]
# prefixes of names by DataParallel, AveragedModel, a LightningModule and torch.compile
WRAPPER_PREFIXES = ("module.", "model.", "_orig_mod.")
Value = TypeVar("Value")


def write_tensors(path: str | Path, content: Any) -> None:
    """Write what `torch.save` takes, as `write_bytes` does.

    Raises:
        OSError: the disk is full or not writable; says how many MB are needed and free.
    """
    file = io.BytesIO()  # torch hides the cause when it writes to a full disk itself
    torch.save(content, file)
    write_bytes(Path(path), file.getbuffer())


def read_state_dict(path: str | Path, subject: str, advice: str) -> dict[str, Tensor]:
    """Return the state_dict that a file holds, alone or in a checkpoint, with the names of the bare
    model: a wrapper's prefix is taken off, and the wrapper's own tensors, such as a counter, are
    left out. So a model with layers called "module" or "model" next to others cannot be read.

    Args, Raises: as `read_weights`; ValueError also for a file without a state_dict.
    """
    content = read_weights(path, subject, advice)
    candidates = [content]
    if isinstance(content, Mapping):
        candidates += [content.get(name) for name in STATE_DICT_KEYS]
    for candidate in candidates:
        items = candidate.items() if isinstance(candidate, Mapping) else ()
        if items and all(isinstance(k, str) and isinstance(v, Tensor) for k, v in items):
            return without_wrappers(dict(items))
    names = ", ".join(map(repr, STATE_DICT_KEYS))
    raise ValueError(
        f"{subject}: the weights file {str(path)!r} holds something other than a state_dict (a "
        f"mapping of names to tensors), alone or as its {names}. {advice}"
    )


def read_features(
    path: str | Path, subject: str, networks: Sequence[str]
) -> tuple[str, nn.Sequential]:
    """Return torchvision's name of the network that a file holds, one of some, and its features,
    the layers before the classifier, in float32 with the weights of the file.

    Args, Raises: as `read_state_dict`; ValueError also for the weights of another network.
    """
    import torchvision  # takes seconds to import

    choice = "one of " if len(networks) > 1 else ""
    advice = f"Pass a state_dict of {choice}torchvision's {', '.join(networks)}."
    weights = {}
    for name, value in read_state_dict(path, subject, advice).items():
        if name.startswith("features."):
            weights[name.removeprefix("features.")] = value.float()
    shapes = {name: value.shape for name, value in weights.items()}
    for network in networks:
        with torch.device("meta"):  # the file's weights replace the random ones
            features = torchvision.models.get_model(network).features
        if shapes == {name: value.shape for name, value in features.state_dict().items()}:
            features.load_state_dict(weights, assign=True)
            return network, features
    raise ValueError(
        f"{subject}: the file {str(path)!r} does not hold the weights of {choice}"
        f"{', '.join(networks)}. {advice}"
    )


def read_weights(path: str | Path, subject: str, advice: str) -> Any:
    """Return the content of a file of weights, on the CPU; no code in it is run.

    Args:
        path: a file of `torch.save`, or of safetensors with that suffix.
        subject: purpose of the weights, with which errors begin.
        advice: sentence on the file to pass, with which errors end.

    Raises:
        ValueError: the file is missing, damaged or holds more than tensors, or the package
            safetensors is needed and not installed.
    """
    if not Path(path).is_file():
        raise ValueError(f"{subject}: there is no weights file {str(path)!r}. {advice}")
    try:
        return _content(path)
    except ModuleNotFoundError as error:
        raise ValueError(f"{subject}: {error}. {advice}") from error
    except Exception as error:  # which one depends on the damaged byte
        raise ValueError(
            f"{subject}: the weights file {str(path)!r} could not be read "
            f"({type(error).__name__}): it is damaged, or holds more than tensors. Fetch it again, "
            f"or save it again. {advice}"
        ) from error


def _content(path: str | Path) -> Any:
    if Path(path).suffix.lower() == SAFETENSORS:
        require("safetensors", f"the weights file {str(path)!r}")
        from safetensors.torch import load_file

        return load_file(path)
    # the settings that torchvision's training scripts keep beside the weights, without code
    with torch.serialization.safe_globals([argparse.Namespace]):
        return torch.load(path, map_location="cpu", weights_only=True)


def without_wrappers(state: Mapping[str, Value]) -> dict[str, Value]:
    """Return the part of a state_dict that is the wrapped model's, with the model's names."""
    state = dict(state)
    while prefix := next(
        (p for p in WRAPPER_PREFIXES if any(name.startswith(p) for name in state)), None
    ):
        wrapped = [name for name in state if name.startswith(prefix)]
        state = {name.removeprefix(prefix): state[name] for name in wrapped}
    return state


@contextlib.contextmanager
def float32_on_cpu() -> Iterator[None]:
    """Make modules in float32 on the CPU, to be filled from a file: half precision, torch's default
    dtype within a step of Lightning's "bf16-true", would round what the file holds."""
    default = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    try:
        with torch.device("cpu"):
            yield
    finally:
        torch.set_default_dtype(default)
