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
    versions["cpu"] = _cpu_field("model name") or platform.processor() or platform.machine()
    versions["threads"] = torch.get_num_threads()
    versions["device"] = torch.cuda.get_device_name() if on_gpu(accelerator) else "cpu"
    return versions


def command(argv: list[str] | None = None) -> str:
    """Return the command line of this run as a user would type it."""
    script, *words = sys.argv if argv is None else argv
    here = Path(f"training/{Path(script).name}")
    if here.exists():  # else it is run from elsewhere: as it was named
        script = str(here)
    return shlex.join(["python", script, *words])


def on_gpu(accelerator: str) -> bool:
    """Return whether a trainer with this accelerator uses a GPU."""
    return torch.cuda.is_available() and accelerator != "cpu"


def device(accelerator: str) -> torch.device:
    """Return the GPU where there is one, unless the trainer's accelerator is "cpu"."""
    return torch.device("cuda" if on_gpu(accelerator) else "cpu")


def accelerator(accelerator_setting: str) -> str:
    """Return the accelerator to name to Lightning, whose "auto" may be mps, see `ACCELERATORS`."""
    return accelerator_setting if on_gpu(accelerator_setting) else "cpu"


def precision(precision_setting: Any, accelerator: str) -> Any:
    """Return the precision that a classifier is trained in: the setting, or for null "bf16-mixed"
    on hardware that multiplies bfloat16 (NVIDIA's GPUs from Ampere on, CPUs with AMX or
    AVX512_BF16) and "32-true" on any other."""
    if precision_setting is not None:
        return precision_setting
    if on_gpu(accelerator):
        has_bfloat16 = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        has_bfloat16 = not BFLOAT16_FLAGS.isdisjoint(_cpu_field("flags").split())
    return "bf16-mixed" if has_bfloat16 else DEFAULT_PRECISION


def _cpu_field(name: str) -> str:
    """Return what Linux says of the first core under a name; "" where it says nothing."""
    try:
        lines = CPUINFO.read_text("utf-8").splitlines()
    except OSError:  # not Linux
        return ""
    fields = (line.partition(":") for line in lines)
    return next((value.strip() for key, _, value in fields if key.strip() == name), "")
