"""Optional dependencies: where one is missing, an error that says what to install."""

from __future__ import annotations

import importlib.util

# the modules that the package needs from each extra of pyproject.toml
MODULES = {
    "eval": (
        "jinja2",
        "matplotlib",
        "pandas",
        "pywt",
        "rich",
        "skimage",
        "torchmetrics",
        "tqdm",
    ),
    "train": ("cma", "hydra", "lightning", "omegaconf", "yaml"),
    "explore": ("gradio",),
}
# the extras that each extra includes
INCLUDED = {"eval": (), "train": ("eval",), "explore": ("eval", "train")}


def require(extra: str, what: str) -> None:
    """Raise if a module of an extra is not installed; import none of them.

    Args:
        extra: "eval", "train" or "explore".
        what: what needs the extra, as the subject of the message: "moireaug.evaluation".

    Raises:
        ModuleNotFoundError: names the missing modules and the command that installs them.
    """
    missing = []
    for name in (extra, *INCLUDED[extra]):
        for module in MODULES[name]:
            if importlib.util.find_spec(module) is None:
                missing.append(module)
    if not missing:
        return
    raise ModuleNotFoundError(
        f"{what} needs {', '.join(missing)}, not installed here. "
        f"Install with: pip install 'moireaug[{extra}]'",
        name=missing[0],
    )
