"""The base of transforms for albumentations, and for AlbumentationsX, which is imported under the
same name."""

from __future__ import annotations

import dataclasses
import itertools
from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from albumentations.core import transforms_interface
from albumentations.core.transforms_interface import DualTransform

from moireaug.transforms._arrays import IMAGE_TARGETS, MASK_TARGETS, check_arrays, pictures_of

Params = dict[str, Any]  # of a call, by name
# the parameters of a call in albumentationsx from 2.4.3, some perhaps of one target alone
SampledParams = getattr(transforms_interface, "SampledParams", None)


def torch_generator(random: np.random.Generator) -> torch.Generator:
    """Return a generator of torch, seeded by one of NumPy with 32 bits: torch's keeps no more."""
    return torch.Generator().manual_seed(int(random.integers(2**63)) % 2**32)


class SampledTransform(DualTransform):
    """A transform of numpy arrays that draws parameters once a call, for all targets. A subclass
    defines `draw`, the `apply` methods and `_moves`, whether masks move with the picture."""

    _moves = False

    @abstractmethod
    def draw(self, params: Params, data: Params, random: np.random.Generator) -> Params:
        """Return the parameters of a call's `apply` methods, as plain numbers."""

    # albumentationsx from 2.4.0, which refuses the other name
    if hasattr(DualTransform, "sample_parameters"):

        def sample_parameters(
            self, params: Params, data: Params, *, sampling: Any, **_: Any
        ) -> Any:
            drawn = self.draw(params, data, sampling.random_generator)
            return SampledParams(params=drawn) if SampledParams else drawn

    else:

        def get_params_dependent_on_data(self, params: Params, data: Params) -> Params:
            return self.draw(params, data, self.random_generator)

    @property
    def targets(self) -> dict[str, Callable[..., Any]]:
        # albumentationsx passes a volume to apply_to_images
        return {**super().targets, "volume": self.apply_to_volume}

    def _check_targets(self, data: Params) -> None:
        depths = IMAGE_TARGETS | MASK_TARGETS if self._moves else IMAGE_TARGETS
        for key, value in data.items():
            target = self._additional_targets.get(key, key)
            if target in depths and value is not None:
                check_arrays(key, value, depths[target])

    def update_transform_params(self, params: Params, data: Params, **kwargs: Any) -> Params:
        self._check_targets(data)  # before albumentations reads their shapes
        params = super().update_transform_params(params=params, data=data, **kwargs)
        return _with_shape(params, data)

    def apply_with_params(self, params: Any, *args: Any, **kwargs: Any) -> Params:
        self._check_targets(kwargs)
        # a replay holds the shape that it was recorded at
        return super().apply_with_params(_with_shape(params, kwargs), *args, **kwargs)


def _with_shape(params: Any, data: Params) -> Any:
    """Return a call's parameters, a dict or SampledParams, with the shape of its pictures."""
    pictures = list(itertools.chain(*pictures_of(data).values()))
    if not pictures:
        return params
    shape = {"shape": pictures[0].shape}
    if isinstance(params, dict):
        return params | shape
    return dataclasses.replace(params, params={**params.params, **shape})
