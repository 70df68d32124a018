"""What the tests of calibration show on a screen, and the camera before it."""

import numpy as np

from moireaug import Develop, Lens, Scene, Sensor, View

PLAIN = Scene(
    view=View(roll=(-6.0, 6.0)),
    lens=Lens(blur=(0.3, 0.4)),
    sensor=Sensor(scale=2.0, gain=(2.4, 3.0)),
    develop=Develop(linear_light=True),
)


def picture(seed, height=120, width=160):
    """Return discs before a gradient, (H, W, 3) uint8."""
    draw = np.random.default_rng(seed)
    y, x = np.mgrid[0.5:height, 0.5:width]
    found = np.stack([40 + 150 * x / width, 90 + 100 * y / height, 0 * x + 120], -1)
    for _ in range(height * width // 800):
        inside = np.hypot(x - draw.uniform(0, width), y - draw.uniform(0, height))
        found[inside < draw.uniform(3, 22)] = draw.uniform(20, 235, 3)
    return found.astype(np.uint8)
