"""Displays, cameras and angles of the paper's section 3.1, as scenes: how often natural moiré alone
fools a model.

The paper names kinds of screens and three cameras, but neither pixel pitches nor distances. Those
below are of common devices of these kinds; distances are where one would stand. Its "outdoor LCD"
is a wall of LEDs here. The pitch of a panel in sensor pixels is f * p / d: focal length f in sensor
pixels, panel pixel p and distance d in mm. The picture is shown as wide as in the presets, in a
window or full screen, and fits on each sensor.

- LED wall, 10 mm between pixels, from 20 m. Television, 55 inch 3840 x 2160, 0.317 mm, from 1 m.
  Large display, 98 inch 3840 x 2160, 0.565 mm, from 2 m. Monitor, 24 inch 1920 x 1080, 0.277 mm,
  from 0.5 m.
- Pixel 4: 4032 x 3024 pixels, 27 mm equivalent. P20 Pro: 3648 x 2736, 27 mm equivalent. A Sony
  camera with 6000 pixels over 23.5 mm behind a 24 mm lens; such a sensor has an optical low-pass
  filter, here of half a pixel.
"""

import math
from typing import NamedTuple

from moireaug.evaluation.conditions import Photo, PhotoWithoutMoire
from moireaug.evaluation.tables import Cell, SuiteConfig, Table
from moireaug.mixtures import as_scenes
from moireaug.scene.parts import Develop, Lens, Panel, Sensor, View
from moireaug.scenes import Scene


class Display(NamedTuple):
    """A display of the paper's section 3.1, and where one stands before it."""

    layout: str
    pixel_mm: float
    distance_mm: float
    width: tuple[float, float]  # of the picture, in panel pixels
    gain: float  # white comes to about 90 % of full scale


class Camera(NamedTuple):
    """A camera of the paper's section 3.1."""

    focal_px: float  # sensor pixels
    olpf_px: float  # sensor pixels


DISPLAYS = {
    "LED wall": Display("led", 10.0, 20_000.0, (128.0, 400.0), 12.0),
    "television": Display("rgb_stripe", 0.317, 1_000.0, (600.0, 1600.0), 2.7),
    "large display": Display("rgb_stripe", 0.565, 2_000.0, (600.0, 1600.0), 2.7),
    "monitor": Display("rgb_stripe", 0.277, 500.0, (400.0, 1600.0), 2.7),
}
CAMERAS = {
    "Pixel 4": Camera(3143.0, 0.0),
    "P20 Pro": Camera(2845.0, 0.0),
    "Sony": Camera(6128.0, 0.5),
}
DISPLAY_CAMERA_PAIRS = [(d, c) for d in DISPLAYS for c in CAMERAS]
ANGLES = (30, 45, 60, 75, 90, 105, 130, 145)  # degrees; 90 is frontal


def pitch(display: str, camera: str) -> float:
    """Return the width of a panel pixel on the sensor, in sensor pixels, seen frontally."""
    screen = DISPLAYS[display]
    return CAMERAS[camera].focal_px * screen.pixel_mm / screen.distance_mm


def view_angle(screen: Display, width: float) -> float:
    """Return the angle that the diagonal of a square picture of that width, in panel pixels, spans
    seen from the display's distance, in degrees."""
    diagonal = math.hypot(width, width) * screen.pixel_mm  # mm
    return math.degrees(2 * math.atan(diagonal / 2 / screen.distance_mm))


def threat_scene(display: str, camera: str, angle: float) -> Scene:
    """Return the scene of that display and camera at that angle, in degrees; the camera is held
    within two degrees of level."""
    screen, body = DISPLAYS[display], CAMERAS[camera]
    return Scene(
        panel=Panel(layout=screen.layout, width=screen.width),
        view=View(
            yaw=angle - 90.0,
            pitch=(-2.0, 2.0),
            roll=(-2.0, 2.0),
            fov=(view_angle(screen, screen.width[0]), view_angle(screen, screen.width[1])),
        ),
        lens=Lens(blur=0.3, olpf=body.olpf_px),
        sensor=Sensor(pitch=pitch(display, camera), gain=screen.gain, read_noise=0.005),
        develop=Develop(linear_light=True),
    )


def threat(config: SuiteConfig) -> Table:
    """Paper, section 3.1 and figure 3: displays x cameras x angles."""
    cells: list[Cell] = []
    for display, camera in DISPLAY_CAMERA_PAIRS:
        row = f"{display}, {camera}"
        photos, plain = [], []
        for angle in ANGLES:
            place = f"{row}, {angle}"
            scene = as_scenes(threat_scene(display, camera, angle), config.shrink)
            photos.append(Photo().at(place, scene))
            plain.append(PhotoWithoutMoire().at(place, scene))
            cells.append(Cell(row, f"angle_{angle}", (photos[-1],)))
        cells.append(Cell(row, "all", tuple(photos)))
        cells.append(Cell(row, "all_no_moire", tuple(plain)))
    return Table("threat", tuple(cells))
