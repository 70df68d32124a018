"""The keys of an evaluation's records: whatever a record depends on changes its key."""

from __future__ import annotations

import hashlib
from typing import Any

from torch import Tensor, nn

from moireaug.evaluation.conditions import Condition
from moireaug.evaluation.identity import identity_of
from moireaug.evaluation.judges import Judge
from moireaug.evaluation.loader import Batches
from moireaug.evaluation.records import key_of
from moireaug.mixtures import Mixture
from moireaug.scenes import Scene


class RecordKeys:
    """The keys of the records of one model.

    Args:
        model_identity: identity of the model.
        batches: test images.
        scene: scene, or mixture of scenes, of conditions without one of their own.
        seed: seed of the evaluation.
        bound: what the eps of noise on a reading counts.
        lpips: network that attacks are measured with, or None. Records with and without it have
            different keys.
    """

    def __init__(
        self,
        model_identity: str,
        batches: Batches,
        scene: Scene | Mixture,
        seed: int,
        bound: str,
        lpips: nn.Module | None,
    ) -> None:
        self.model_identity = model_identity
        self.batches = batches
        self.scene = scene
        self.seed = seed
        self.bound = bound
        self._lpips_identity = None if lpips is None else identity_of(lpips)
        self._batch_digests: dict[int, str] = {}

    def key(self, condition: Condition, judge: Judge, index: int) -> str:
        """Return the key of the record of one condition before one judge on one batch."""
        if index not in self._batch_digests:  # a batch that another process has done
            self.hash_batch(index, *self.batches[index])
        batch = {"content": self._batch_digests[index], "index": index}
        return key_of(self._condition_fields(condition) | {"judge": judge.identity, "batch": batch})

    def hash_batch(self, index: int, images: Tensor, labels: Tensor) -> None:
        """Take the content of a batch into its keys."""
        sha256 = hashlib.sha256(images.detach().cpu().contiguous().numpy().tobytes())
        sha256.update(f"{tuple(images.shape)} {labels.tolist()}".encode())
        self._batch_digests[index] = sha256.hexdigest()[:16]

    def _condition_fields(self, condition: Condition) -> dict[str, Any]:
        scene = self.scene if condition.scene is None else condition.scene
        fields = {
            "model": self.model_identity,
            "scene": scene.to_dict(),
            "condition": condition.settings() | {"name": condition.name},
            "seed": self.seed,
            "bound": condition.eps_unit(self.bound),
        }
        if self._lpips_identity is not None and not condition.control:
            fields["lpips"] = self._lpips_identity
        return fields
