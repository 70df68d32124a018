"""Optional dependencies: where one is missing, an error with the command that installs it; and a
backend of matplotlib that is not installed, dropped."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import os
import sys

# the modules that the package needs from each extra of pyproject.toml
MODULES = {
    "albumentations": ("albumentations",),
    "opencv": ("cv2",),
    "eval": ("pandas", "pywt", "skimage", "torchmetrics", "tqdm"),
    "train": ("cma", "hydra", "jinja2", "lightning", "matplotlib", "omegaconf", "yaml"),
    "safetensors": ("safetensors",),
}
# the extras that each extra needs to work at all
INCLUDED = {"train": ("eval", "opencv")}
# how an extra is installed: there is no published package yet
INSTALL_ADVICE = "Install with, in a clone of the repository: pip install '.[{extra}]'"
BACKEND = "MPLBACKEND"  # matplotlib's variable


def drop_missing_backend() -> None:
    """Drop a backend of matplotlib that is unknown from the environment: with it, matplotlib cannot
    be imported, nor what imports it where it is installed, such as torchmetrics.

    A notebook's commands inherit the notebook's backend, which their own Python may not have.
    Figures are drawn into files here, and need none.
    """
    if "matplotlib" in sys.modules or not os.environ.get(BACKEND):
        return
    if importlib.util.find_spec("matplotlib") is None:
        return
    backend = os.environ.pop(BACKEND)
    parameters = importlib.import_module("matplotlib").rcParams
    # only now, as a failed import of matplotlib cannot be repeated
    with contextlib.suppress(ValueError):
        parameters["backend"] = backend
        os.environ[BACKEND] = backend


def require(extra: str, subject: str) -> None:
    """Raise if a module of an extra is not installed; import none of them.

    Args:
        extra: one of `MODULES`.
        subject: of the message, the module or file that needs the extra: "moireaug.evaluation".

    Raises:
        ModuleNotFoundError: names the missing modules and the command that installs them.
    """
    missing = []
    for name in (extra, *INCLUDED.get(extra, ())):
        for module in MODULES[name]:
            if importlib.util.find_spec(module) is None:
                missing.append(module)
    if not missing:
        return
    raise ModuleNotFoundError(
        f"{subject} needs {', '.join(missing)}, not installed here. "
        f"{INSTALL_ADVICE.format(extra=extra)}",
        name=missing[0],
    )
