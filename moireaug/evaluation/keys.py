"""The keys of an evaluation's records: whatever a record depends on changes its key."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor, nn

from moireaug.attacks.bounds import BOUNDS
from moireaug.common.argument_checks import one_of
from moireaug.evaluation.classifiers import Classifier
from moireaug.evaluation.conditions import Condition
from moireaug.evaluation.identity import identity_of
from moireaug.evaluation.loader import Batches
from moireaug.mixtures import Mixture
from moireaug.scenes import Scene

KEY_VERSION = 9  # raise it when the same settings would give other figures


@dataclass(frozen=True)
class EvalSetup:
    """The settings that all conditions of an evaluation share.

    Args:
        scene: scene, or mixture of scenes, of which one shot is drawn per image; conditions may
            have their own.
        seed: seed of shots, targets, random starts and randomised classifiers, see `BatchDraws`.
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


class RecordKeys:
    """The keys of the records of one model.

    Args:
        model_identity: identity of the model.
        batches: test images.
        setup: settings of the evaluation.
    """

    def __init__(self, model_identity: str, batches: Batches, setup: EvalSetup) -> None:
        self.model_identity = model_identity
        self.batches = batches
        self.setup = setup
        self._lpips_identity = None if setup.lpips is None else identity_of(setup.lpips)
        self._batch_digests: dict[int, str] = {}

    def key(self, condition: Condition, classifier: Classifier, index: int) -> str:
        """Return the key of the record of one condition before one classifier on one batch."""
        if index not in self._batch_digests:  # a batch that another process has done
            self.hash_batch(index, *self.batches[index])
        batch = {"content": self._batch_digests[index], "index": index}
        return key_of(
            self._condition_fields(condition) | {"judge": classifier.identity, "batch": batch}
        )

    def hash_batch(self, index: int, images: Tensor, labels: Tensor) -> None:
        """Take the content of a batch into its keys."""
        sha256 = hashlib.sha256(images.detach().cpu().contiguous().numpy().tobytes())
        sha256.update(f"{tuple(images.shape)} {labels.tolist()}".encode())
        self._batch_digests[index] = sha256.hexdigest()[:16]

    def _condition_fields(self, condition: Condition) -> dict[str, Any]:
        fields = {
            "model": self.model_identity,
            "scene": self.setup.scene_of(condition).to_dict(),
            "condition": condition.settings() | {"name": condition.name},
            "seed": self.setup.seed,
            "bound": condition.eps_unit(self.setup.bound),
        }
        if self._lpips_identity is not None and not condition.control:
            fields["lpips"] = self._lpips_identity
        return fields


def key_of(fields: Mapping[str, Any]) -> str:
    """Return sixteen hex digits that stand for the settings of a record."""
    text = json.dumps({"version": KEY_VERSION, **fields}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
