"""What the tests of the transforms share: values, leaves, and a small scene per frame."""

import dataclasses

import torch
from torchvision import tv_tensors

from moireaug import Develop, Lens, Panel, Scene, Sensor, View

REGISTERED = Scene(
    panel=Panel(scale=(0.8, 1.5)),
    view=View(yaw=(-20.0, 20.0), pitch=(-10.0, 10.0), roll=(-25.0, 25.0)),
    lens=Lens(k1=(-0.05, 0.05), blur=0.4),
    sensor=Sensor(gain=2.5, read_noise=0.01),
)
CAMERA = dataclasses.replace(REGISTERED, develop=Develop(registered=False))
# next to no moiré, no noise
CLEAR = dataclasses.replace(CAMERA, panel=Panel(scale=3.0), sensor=Sensor(scale=4.0))
SQUARE = (30.0, 10.0, 40.0, 18.0)  # x1, y1, x2, y2
FRAMES = {"registered": REGISTERED, "camera": CAMERA}


def values(shape, dtype, seed=0):
    x = torch.rand(shape, generator=torch.Generator().manual_seed(seed))
    return (x * 255).round().to(dtype) if dtype == torch.uint8 else x.to(dtype)


def sample_of_leaves(image):
    return {
        "image": image,
        "mask": tv_tensors.Mask(torch.ones(2, 9, 12, dtype=torch.uint8)),
        "boxes": tv_tensors.BoundingBoxes(
            [[1.0, 2.0, 5.0, 6.0]], format="XYXY", canvas_size=(9, 12)
        ),
        "points": tv_tensors.KeyPoints([[1.0, 2.0]], canvas_size=(9, 12)),
        "label": torch.tensor(3),
        "name": "a",
        "id": 7,
    }
