"""Files of weights, read as data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch


def read_weights(path: str | Path, what: str, wanted: str) -> Any:
    """Return what a file of weights holds, on the CPU; no code in it is run.

    Args:
        what: what the weights are for; errors begin with it.
        wanted: a sentence that says which file to pass; errors end with it.

    Raises:
        ValueError: the file is missing, damaged or holds more than tensors.
    """
    if not Path(path).is_file():
        raise ValueError(f"{what}: there is no weights file {str(path)!r}. {wanted}")
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # which one depends on the damaged byte
        raise ValueError(
            f"{what}: the weights file {str(path)!r} could not be read ({type(error).__name__}): "
            f"it is damaged, or holds more than tensors. {wanted}"
        ) from error
