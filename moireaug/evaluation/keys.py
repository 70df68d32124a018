"""The keys of an evaluation's records: whatever a record depends on changes its key."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from torch import Tensor, nn

from moireaug.attacks.bounds import BOUNDS
from moireaug.common.argument_checks import one_of
from moireaug.evaluation.conditions import Condition
from moireaug.evaluation.identity import identity_of
from moireaug.mixtures import Mixture
from moireaug.scenes import Scene

KEY_VERSION = 9  # raise it when the same settings would give other figures


@dataclass(frozen=True)
class EvalSetup:
    """The settings that all conditions of an evaluation share.

    Args:
        scene: scene, or mixture of scenes, of which one shot is drawn per image; conditions may
            have their own.
        seed: seed of shots, targets, random starts and randomised classifiers, see `SeededBatch`.
        bound: what the eps of noise on a reading counts: "codes" or "light".
        lpips: `visibility.LPIPS` to measure every attack with, or None. Records with and without
            it have different keys.
    """

    scene: Scene | Mixture
    seed: int = 0
    bound: str = "codes"
    lpips: nn.Module | None = None

    def __post_init__(self) -> None:
        one_of("bound", self.bound, BOUNDS)

    def scene_of(self, condition: Condition) -> Scene | Mixture:
        """Return the scene of a condition's photos."""
        return self.scene if condition.scene is None else condition.scene

    @cached_property
    def lpips_identity(self) -> str:
        """The identity of the network that measures LPIPS."""
        return identity_of(self.lpips)

    def key_fields(self, condition: Condition) -> dict[str, Any]:
        """Return the settings of a condition's record."""
        fields = {
            "scene": self.scene_of(condition).to_dict(),
            "condition": condition.settings() | {"name": condition.name},
            "seed": self.seed,
            "bound": condition.eps_unit(self.bound),
        }
        if self.lpips is not None and not condition.control:
            fields["lpips"] = self.lpips_identity
        return fields


def batch_digest(images: Tensor, labels: Tensor) -> str:
    """Return sixteen hex digits that stand for the content of a batch."""
    sha256 = hashlib.sha256(images.detach().cpu().contiguous().numpy().tobytes())
    sha256.update(f"{tuple(images.shape)} {labels.tolist()}".encode())
    return sha256.hexdigest()[:16]


def key_of(fields: Mapping[str, Any]) -> str:
    """Return sixteen hex digits that stand for the settings of a record."""
    text = json.dumps({"version": KEY_VERSION, **fields}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
