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
BACKEND = "MPLBACKEND"  # matplotlib's variable


def drop_missing_backend() -> None:
    """Drop a backend of matplotlib that is unknown from the environment: with it, matplotlib cannot
    be imported, nor what imports it where it is installed, such as torchmetrics. A notebook's
    commands inherit the notebook's, which their own Python may not have."""
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
    """Raise a ModuleNotFoundError with the command that installs them if modules of an extra are
    missing; import none of them.

    extra: one of `MODULES`. subject: of the message, the module or file that needs the extra.
    """
    needed = [module for name in (extra, *INCLUDED.get(extra, ())) for module in MODULES[name]]
    missing = [module for module in needed if importlib.util.find_spec(module) is None]
    if missing:
        raise ModuleNotFoundError(
            f"{subject} needs {', '.join(missing)}, not installed here. Install with, in a clone "
            f"of the repository: pip install '.[{extra}]'",
            name=missing[0],
        )
