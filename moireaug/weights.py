"""Files of weights, read as data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch


def read_weights(path: str | Path, what: str, wanted: str) -> Any:
    """Return what a file of weights holds, on the CPU; no code in it is run.

    Args:
        what: the weights are for; errors begin with it. wanted: which file to pass, in a sentence.

    Raises:
        ValueError: a file that is missing, damaged or holds more than tensors.
    """
    if not Path(path).is_file():
        raise ValueError(f"{what}: there is no weights file {str(path)!r}. {wanted}")
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # whichever byte was hit: UnpicklingError, EOFError, KeyError, ...
        raise ValueError(
            f"{what}: the weights file {str(path)!r} could not be read ({type(error).__name__}): "
            f"it is damaged, or holds more than tensors. {wanted}"
        ) from error
