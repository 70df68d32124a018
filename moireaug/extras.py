"""Optional dependencies: one sentence that says what to install, wherever one is missing."""

from __future__ import annotations

import importlib.util

# extra of pyproject.toml to the modules that its part of the package imports
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
# extras that an extra brings with it
INCLUDED = {"eval": (), "train": ("eval",), "explore": ("eval", "train")}


def require(extra: str, what: str) -> None:
    """Refuse to go on where a module of an extra is not installed; imports none of them.

    Args:
        extra: "eval", "train" or "explore".
        what: what needs it, as the sentence's subject: "moireaug.evaluation".

    Raises:
        ModuleNotFoundError: with the modules that are missing and the command that installs them.
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
