"""What made a result: the command, the versions of its libraries, and the machine."""

import platform
import shlex
import sys
from pathlib import Path
from typing import Any

import torch

import moireaug

CPUINFO = Path("/proc/cpuinfo")
BFLOAT16_FLAGS = {"amx_bf16", "avx512_bf16"}  # flags of CPUs that multiply it faster than float32
DEFAULT_PRECISION = "32-true"  # of training


def environment(accelerator: str) -> dict[str, Any]:
    """Return versions and machine, for the record."""
    import kornia
    import lightning
    import numpy
    import torchvision

    versions: dict[str, Any] = {"python": platform.python_version()}
    for module in (moireaug, torch, torchvision, kornia, lightning, numpy):
        versions[module.__name__] = module.__version__
    versions["cpu"] = _cpu()
    versions["threads"] = torch.get_num_threads()
    versions["device"] = torch.cuda.get_device_name() if on_gpu(accelerator) else "cpu"
    return versions


def _cpu() -> str:
    try:
        lines = CPUINFO.read_text("utf-8").splitlines()
        return next(
            line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")
        )
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def precision(precision_setting: Any, accelerator: str) -> Any:
    """Return the precision that a classifier is trained in: the setting, or for null "bf16-mixed"
    on hardware that multiplies bfloat16 (NVIDIA's GPUs from Ampere on, CPUs with AMX or
    AVX512_BF16) and "32-true" on any other."""
    if precision_setting is not None:
        return precision_setting
    return "bf16-mixed" if _multiplies_bfloat16(accelerator) else DEFAULT_PRECISION


def device(accelerator: str) -> torch.device:
    """Return the GPU where there is one, unless the trainer's accelerator is "cpu"."""
    return torch.device("cuda" if on_gpu(accelerator) else "cpu")


def accelerator(accelerator_setting: str) -> str:
    """Return the accelerator to name to Lightning, whose "auto" may be mps, see `ACCELERATORS`."""
    return accelerator_setting if on_gpu(accelerator_setting) else "cpu"


def on_gpu(accelerator: str) -> bool:
    """Return whether a trainer with this accelerator uses a GPU."""
    return torch.cuda.is_available() and accelerator != "cpu"


def _multiplies_bfloat16(accelerator: str) -> bool:
    if on_gpu(accelerator):
        return torch.cuda.is_bf16_supported(including_emulation=False)
    try:
        flags = set(CPUINFO.read_text("utf-8").split())
    except OSError:  # not Linux
        return False
    return not flags.isdisjoint(BFLOAT16_FLAGS)


def command(argv: list[str] | None = None) -> str:
    """Return the command line of this run as a user would type it."""
    argv = sys.argv if argv is None else argv
    here = Path(f"training/{Path(argv[0]).name}")
    script = here if here.exists() else Path(argv[0])  # run from anywhere else, as it was named
    return shlex.join(["python", str(script), *argv[1:]])
