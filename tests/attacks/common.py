"""What the tests of attacks share: a scene, a bound, and a model's decisions."""

import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, attacks

SCENE = Scene(
    panel=Panel(scale=1.1),
    view=View(roll=(-5, 5)),
    lens=Lens(blur=0.25),
    sensor=Sensor(scale=2.0, gain=2.0),
    develop=Develop(brighten=0.1),
)
EPS = 4 / 255


def predicted(model, images):
    with attacks.evaluating(model), torch.no_grad():
        return model(images).argmax(1)
