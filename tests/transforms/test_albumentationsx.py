"""The calling convention of AlbumentationsX from 2.4.0, which imports as albumentations.

A stand-in for its base class: `sample_parameters` in place of `get_params_dependent_on_data`, which
is refused. 2.4.0 to 2.4.2 pass dicts; later versions wrap them in a frozen record, SampledParams.
"""

import dataclasses
import importlib.util
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from albumentations.core import transforms_interface
from albumentations.core.transforms_interface import DualTransform

from moireaug import Shot
from moireaug.transforms import _albumentations_base as base
from moireaug.transforms import albumentations as moire
from tests.transforms.common import CAMERA, REGISTERED

IMAGE = np.random.default_rng(0).random((9, 12, 3)).astype(np.float32)


@dataclasses.dataclass(frozen=True, slots=True)
class SampledParams:
    params: dict[str, Any]


class SamplingTransform(DualTransform):
    """Calls like AlbumentationsX: sample once, then apply to each target, a volume as images."""

    is_wrapped = False

    def __init_subclass__(cls, **kwargs):
        super().__init_subclass__(**kwargs)
        if "get_params_dependent_on_data" in vars(cls):
            raise TypeError(f"{cls.__name__} defines a removed sampling hook.")

    def sample_parameters(self, params, data, targets, sampling):
        raise NotImplementedError

    def __call__(self, **data):
        sampling = SimpleNamespace(random_generator=np.random.default_rng(3))
        params = self.update_transform_params(params={}, data=data, invocation=None)
        if not self.is_wrapped:
            params |= self.sample_parameters(params=params, data=data, sampling=sampling)
            return self.recorded(params, data)
        sampled = self.sample_parameters(params=params, data=data, targets=(), sampling=sampling)
        return self.recorded(SampledParams(params={**params, **sampled.params}), data)

    @property
    def targets(self):
        return super().targets | {"volume": self.apply_to_images}

    def update_transform_params(self, params, data, invocation):
        return super().update_transform_params(params=params, data=data)

    def recorded(self, params, data):
        self.record = params
        return self.apply_with_params(params, **data)

    def apply_with_params(self, params, **data):
        values = params.params if self.is_wrapped else params
        return {
            key: self.targets[key](value, **values) if key in self.targets else value
            for key, value in data.items()
        }


@pytest.fixture(params=["2.4.0 to 2.4.2", "2.4.3 to 2.5.1"])
def other_module(request, monkeypatch):
    """The module of the transforms, imported beside such a base class."""
    if request.param != "2.4.0 to 2.4.2":
        monkeypatch.setattr(SamplingTransform, "is_wrapped", True)
        monkeypatch.setattr(transforms_interface, "SampledParams", SampledParams, raising=False)
    monkeypatch.setattr(transforms_interface, "DualTransform", SamplingTransform)
    monkeypatch.setitem(sys.modules, base.__name__, imported_again(base))
    return imported_again(moire)


def imported_again(module):
    spec = importlib.util.spec_from_file_location(f"other_{module.__name__}", module.__file__)
    other = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(other)
    return other


def shot_of(transform):
    values = transform.record.params if transform.is_wrapped else transform.record
    return Shot.from_dict(values["shot"])


def test_a_shot_is_sampled_and_applied(other_module):
    transform = other_module.RandomMoire(CAMERA, p=1)
    mask = np.ones((9, 12), np.uint8)
    out = transform(image=IMAGE, mask=mask, keypoints=np.array([[3.0, 4.0]]), label=1)
    shot = shot_of(transform)
    assert np.array_equal(out["image"], moire.apply_to_one(IMAGE, shot))
    assert np.array_equal(out["mask"], moire.move_mask(mask, shot))
    assert np.array_equal(out["keypoints"], moire.move_keypoints(np.array([[3.0, 4.0]]), shot))


def test_an_attack_is_sampled_and_applied(other_module):
    model = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(3 * 9 * 12, 3))
    transform = other_module.AdversarialMoire(model, REGISTERED, steps=1, p=1)
    out = transform(image=IMAGE, volume=np.stack([IMAGE, IMAGE]), label=1)
    assert np.any(out["image"] != moire.apply_to_one(IMAGE, shot_of(transform)))
    assert np.any(out["volume"][0] != out["image"]), "the volume has the noise of the image"


def test_a_replay_at_another_size_moves_boxes_by_that_size(other_module):
    transform = other_module.RandomMoire(CAMERA, p=1)
    transform(image=IMAGE)
    large, box = np.repeat(IMAGE, 2, 0), np.array([[0.25, 0.25, 0.5, 0.75]])
    out = transform.apply_with_params(transform.record, image=large, bboxes=box)
    expected = moire.move_bboxes(box, dataclasses.replace(shot_of(transform), size=(18, 12)))
    assert np.array_equal(out["bboxes"], expected)
