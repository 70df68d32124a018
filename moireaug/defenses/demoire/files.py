"""Networks by name, and their weights in files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from moireaug.common.argument_checks import one_of
from moireaug.common.weights import float32_on_cpu, read_weights, write_tensors
from moireaug.defenses.demoire.amnet import AMNet
from moireaug.defenses.demoire.base import DemoireNet
from moireaug.defenses.demoire.esdnet import ESDNet
from moireaug.defenses.demoire.fhde2net import FHDe2Net
from moireaug.defenses.demoire.mddm import MDDM
from moireaug.defenses.demoire.mopnet import MopNet

NETWORKS: dict[str, type[DemoireNet]] = {
    "mopnet": MopNet,
    "mddm": MDDM,
    "fhde2net": FHDe2Net,
    "amnet": AMNet,
    "esdnet": ESDNet,
}
FILE_KEYS = ("network", "width", "state")
RELEASED_WEIGHTS = ("screen",)  # files of this folder


def build(name: str, *, width: float = 1.0, weights: str | Path | None = None) -> DemoireNet:
    """Return a demoiréing network by name: freshly initialised, in torch's default dtype and on its
    default device, or with weights, in float32 on the CPU.

    Args:
        name: of `demoire.NETWORKS`.
        width: factor on the published numbers of channels, in (0, 4].
        weights: a file that `save` wrote, of this name and width; or "screen", released weights of
            an AMNet of width 0.25, trained on simulated photos of drawn pictures.

    Raises:
        TypeError, ValueError: an unknown name, a width out of range, a file that is missing,
            damaged, or of another network.
    """
    one_of("a demoiréing network", name, NETWORKS)
    if weights is None:
        return NETWORKS[name](width)
    network = load(weights).train()
    if (network.name, network.width) != (name, width):
        raise ValueError(
            f"demoire: {str(weights)!r} holds {network.name} of width {network.width:g}; you asked "
            f"for {name} of width {width}. Ask for what it holds, or use demoire.load, which reads "
            "both from the file."
        )
    return network


def load(path: str | Path) -> DemoireNet:
    """Return the network that `save` wrote to a file, in evaluation mode, in float32 on the CPU;
    "screen" is the released one.

    Raises:
        ValueError: a file that is missing, damaged, or holds none of `demoire.NETWORKS`.
    """
    content = _read(path)
    with float32_on_cpu():
        network = NETWORKS[content["network"]](content["width"])
    try:
        network.load_state_dict(content["state"])
    except (RuntimeError, TypeError, AttributeError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(
            f"demoire: the weights in {str(path)!r} are not of {network.name} of width "
            f"{network.width:g} ({reason[:200]}). {_advice()}"
        ) from error
    return network.eval()


def save(network: DemoireNet, path: str | Path) -> None:
    """Write a network's name, width and weights, whole or not at all.

    Args:
        network: of `demoire.NETWORKS`, on any device.
        path: its folder is created if missing.

    Raises:
        TypeError: another module, whose file could not be read again.
        OSError: the disk is full or not writable.
    """
    if NETWORKS.get(getattr(network, "name", "")) is not type(network):
        raise TypeError(
            f"demoire.save takes a network of demoire.build; got {type(network).__name__}. Save "
            "any other module with torch.save(module.state_dict(), path)."
        )
    state = {key: value.detach().cpu() for key, value in network.state_dict().items()}
    write_tensors(path, {"network": network.name, "width": network.width, "state": state})


def _read(path: str | Path) -> dict[str, Any]:
    """Return a file's name, width and state; no code in it is run."""
    file = Path(__file__).with_name(f"{path}.pt") if str(path) in RELEASED_WEIGHTS else path
    content = read_weights(file, "demoire", _advice())
    if not isinstance(content, Mapping) or set(content) != set(FILE_KEYS):
        raise ValueError(
            f"demoire: the file {str(path)!r} holds no network, width and state. {_advice()}"
        )
    name, width = content["network"], content["width"]
    if not isinstance(name, str) or name not in NETWORKS:
        raise ValueError(
            f"demoire: {str(path)!r} holds a network {name!r}, which this version does not know. "
            f"{_advice()}"
        )
    if isinstance(width, bool) or not isinstance(width, (int, float)):
        raise ValueError(
            f"demoire: {str(path)!r} holds the width {width!r}, which is no number. {_advice()}"
        )
    return dict(content)


def _advice() -> str:
    released = ", ".join(map(repr, RELEASED_WEIGHTS))
    return f"Pass {released}, or a file that demoire.save wrote, of {', '.join(NETWORKS)}."
