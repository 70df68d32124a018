"""The first photos on a GPU: kernels are held against the reference on the user's own batch, once a
process and kind of reading, and left alone where they fail or differ. They were proved equal on a
CPU; drivers and cards are many."""

from __future__ import annotations

import logging

import torch
from torch import Tensor

from moireaug.engine.autograd import Stage
from moireaug.numeric import as_float

MAX_RMS = 1e-3  # of photos and readings, in [0, 1]; kernels and reference differ by 1e-4 at most
_agreements: dict[tuple[str, torch.device], bool] = {}


def agrees(stage: Stage, kind: str, values: Tensor) -> bool:
    """Return whether a stage's kernels give the reference's results on the device of `values`.

    Args:
        kind: name of the kernels, such as "developing, demosaic, encode".
        values: pictures or readings, (B, C, H, W).
    """
    if values.device.type == "cpu":
        return True
    key = kind, values.device
    if key not in _agreements:
        failure = why_not(stage, values.detach())
        _agreements[key] = not failure
        if failure:
            logging.getLogger("moireaug").warning(
                f"moireaug's GPU kernels ({kind}) {failure}: on {values.device}, PyTorch computes "
                "photos instead, which takes longer. Please report it."
            )
    return _agreements[key]


@torch.no_grad()
def why_not(stage: Stage, values: Tensor) -> str:
    """Return how a stage's kernels fail, or an empty string."""
    try:
        result, _ = stage.forward(values, False)
    except torch.OutOfMemoryError:
        raise  # the batch's fault, not the kernels'
    except Exception as error:  # of a compiler, a driver or a launch
        return f"do not run ({type(error).__name__}: {str(error).partition(chr(10))[0]})"
    difference = (result - stage.reference(as_float(values))).square().mean().sqrt().item()
    return "" if difference <= MAX_RMS else f"differ from the reference by {difference:.1g} RMS"
