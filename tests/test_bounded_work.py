"""The work of a photo is bounded at the ends of every range: a scene that may be made can be
photographed."""

from dataclasses import replace

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from moireaug import Develop, Lens, Panel, Scene, Sensor, capture, engine
from moireaug.scene.parts import PARTS

# of a photo of 8 x 8 px in the reference, with its gradient; by far the most take a hundredth
MAX_OPERATIONS, MAX_ELEMENTS, MAX_TENSOR_ELEMENTS = 100_000, 2e9, 2**24
BASES = (
    Scene(panel=Panel(glare=0.1, pwm=100.0), sensor=Sensor(shutter=0.01, readout=0.01)),
    Scene(
        panel=Panel(width=700.0), lens=Lens(blur=0.3, motion_x=0.5), sensor=Sensor(pitch=1.7),
        develop=Develop(linear_light=True, sharpen=0.5, registered=False),
    ),
)  # fmt: skip
CHOICES = {
    "denoise": [("develop", "denoise", name) for name in ("nlm", "bilateral")],
    "scale": [("sensor", "scale", value) for value in (0.25, 64.0)],
    "supersample": [("sensor", "exposure", "supersample:256")],
}


class Work(TorchDispatchMode):
    """Counts the operations of PyTorch, and the elements that they return."""

    def __init__(self):
        super().__init__()
        self.operations, self.elements, self.largest = 0, 0, 0

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        found = function(*args, **(kwargs or {}))
        self.operations += 1
        for one in found if isinstance(found, (tuple, list)) else (found,):
            if isinstance(one, torch.Tensor):
                self.elements += one.numel()
                self.largest = max(self.largest, one.numel())
        return found


def work_of(scene):
    image = torch.rand(1, 3, 8, 8, requires_grad=True)
    with Work() as work, engine.reference():
        photo = capture(image, scene.sample(1, (8, 8), torch.Generator().manual_seed(0)))
        photo.sum().backward()
    assert photo.isfinite().all() and image.grad.isfinite().all()
    return work


def ends(name):
    """The fields of a part, each with an end of its range."""
    if name in CHOICES:
        return CHOICES[name]
    limits = {
        field: PARTS[name].__dataclass_fields__[field].metadata for field in PARTS[name].ranged
    }
    return [(name, field, limits[field][end]) for field in limits for end in ("low", "high")]


def legal(scene, part, field, value):
    """The scene with another value of a field, or None if that is refused."""
    try:
        return replace(scene, **{part: replace(getattr(scene, part), **{field: value})})
    except ValueError:
        return None


@pytest.mark.parametrize("name", [*PARTS, *CHOICES])
def test_a_photo_at_the_ends_of_a_range_takes_bounded_work(name):
    count = 0
    for change in ends(name):
        for scene in BASES:
            if (changed := legal(scene, *change)) is None:
                continue
            count, work = count + 1, work_of(changed)
            assert work.operations < MAX_OPERATIONS, change
            assert work.elements < MAX_ELEMENTS, change
            assert work.largest < MAX_TENSOR_ELEMENTS, change
    assert count


def test_points_of_a_moving_camera_are_as_many_as_of_a_still_one():
    def elements(motion):
        sensor = Sensor(exposure="supersample:24")
        return work_of(Scene(lens=Lens(motion_x=motion), sensor=sensor)).elements

    assert elements(2.0) < 1.5 * elements(0.0)
