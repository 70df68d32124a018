"""Named scenes, and where their figures come from.

A scene is a screen, whatever the picture's size. `Sensor.pitch` is f * p / d: focal length f in
sensor pixels, panel pixel p and distance d in mm. `Panel.width` is how much of the panel the
picture takes, in a window or full screen: 400 to 1600 panel pixels on monitors, from 150 on other
screens in the hand, 128 to 400 on LED walls. Width * pitch has to fit on the sensor; in up to 8 %
of a preset's draws it does not, once the camera has stepped back from a turned picture.

Screens:
- Monitors: 27 inch 3840 x 2160 (AOC U27P1U, the paper's appendix C) 0.155 mm; 24 inch 1920 x 1080
  0.277 mm. The first at 400 mm, the second at up to 600 mm: pitch 1.2 to 2.1.
- Laptops: 13.3 inch 2560 x 1600 (MacBook Air 2020, the paper's appendix C) 0.112 mm, 15.6 inch 1920
  x 1080 0.179 mm. The first at 200 to 300 mm, the second at 180 to 450 mm: pitch 1.1 to 3.
- OLED phones: 460 pixels per inch (iPhone 12, Apple's specifications) 0.055 mm at 80 to 150 mm:
  pitch 1.1 to 2.1. Phones in front of a webcam: 270 to 460 per inch, 0.094 to 0.055 mm.
- Television: 55 inch 3840 x 2160, 0.317 mm, WRGB, at 450 to 900 mm: pitch 1.1 to 2.1.
- LED walls: 1.5 to 2.5 mm between pixels, as indoor walls are sold, at 2.4 to 7.5 m: pitch 1 to
  1.9.
- LED signs: 10 to 20 mm between pixels, as full-colour road and street displays are sold; 32 to 96
  of them across a sign, from whatever distance makes it as large as its image: at 48 px and
  `shrink` 1, one of 48 LEDs is at pitch 1, of 10 mm at 12 m.
- Tablet: 264 pixels per inch (iPad, Apple's specifications), 0.096 mm. Before a phone at 140 to
  180 mm: pitch 1.6 to 2.05.
- LCDs from close: 0.179 and 0.277 mm at 150 to 300 mm: pitch 1.8 to 5.6. A part of the screen, 80
  to 400 panel pixels, fills a small photo or a crop of a large one, and its pixels are seen.
- Whole screens: 1366 to 1920 panel pixels across half to all of the camera's 4032: pitch 1.6 to
  2.1.
- LCD televisions across a room: 43 inch 1920 x 1080, 0.496 mm, at 1.5 to 2.7 m, by a camera of two
  to three times the main one's focal length: pitch 1.6 to 2.1.
- Black matrix: LCDs of these sizes emit from about half to three quarters of a pixel; rows are the
  wider gaps, because transistors lie there.
- Light that is not the picture's: an LCD's black is 1/1000 of its white in a dark room, and 1/100
  at an angle. Glass reflects 4 %: of a room at 300 lx, 1 % of a screen of 200 cd/m2; of a window of
  1500 cd/m2, 30 %, more of it in a screen's upper part.
- OLED phones turned down: pulses of 240 Hz, as reviewers measure on most, to 480 Hz, on for 20 to
  70 % of the time. A screen of 50 cd/m2 is exposed for 2 to 5 ms at ISO 130 to 320 and f/1.6.

Cameras:
- Phone: iPhone 12 main camera, 4032 x 3024 pixels, 26 mm equivalent (Apple's specifications; the
  phone of the paper's appendix C): f = 26 / 43.3 of the 5040 px diagonal = 3030 px. Spread at f/1.6
  with 1.4 um pixels and 0.55 um light: the Airy disc's Gaussian, 0.42 * wavelength * N
  = 0.37 um = 0.26 px; defocus adds to it.
- Webcam: 1920 x 1080, 78 degrees across the diagonal (Logitech C920's data sheet): f = 1360 px. At
  60 to 120 mm: pitch 1 to 2.1.
- Document camera: 3264 px across 160 to 300 mm of the desk, 1.2 times as high above it as that is
  wide: 11 to 20 px per mm, pitch 1.05 to 2.
- Dashcam: 2560 px across a 120 degree lens, barrel distorted (angles grow as the distance from the
  middle): 2560 / 2.09 = 1220 px focal length in the middle.

What no data sheet says was chosen so that photos, whole and crops of 224 px, agree with photographs
(docs/reality.md): the phone's blur, noise and motion, screen_photo's pitch, crosstalk, exposure,
white balance, tone, colour smoothing and sharpening. It is shrunk by area, which leaves the weave
of one to three pixels that photographs show; its JPEG is of a larger picture and leaves no blocks.
Elsewhere the camera may balance white for a room's lamps: a third of the way to 3000 K, a screen of
6500 K turns red to 0.78 and blue to 1.45 of green. A phone's local contrast is an unsharp mask of a
few photo pixels. A messenger saves the photo again, at a quality of 50 to 95.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from moireaug.scene.parts import Develop, Lens, Panel, Sensor, View
from moireaug.scene.record import SceneRecord

# An LCD in a room: black matrix along both axes, a backlight that leaks, glass that reflects.
LCD = Panel(
    lit_x=(0.7, 0.9),
    lit_y=(0.4, 0.75),
    black=(0.0, 0.003),
    glare=(0.0, 0.015),
    glare_x=(-0.5, 0.5),
    glare_y=(-0.5, 0.5),
)
LIT_LCD = replace(LCD, black=(0.0, 0.01), glare=(0.0, 0.03))  # at an angle, in a brighter room
# OLEDs have no backlight; their subpixels are small.
OLED = replace(LIT_LCD, black=0.0, lit=(0.5, 0.8), lit_x=1.0, lit_y=1.0)
DIAMONDS = replace(OLED, layout="pentile_diamond")

PHONE_LENS = Lens(k1=(-0.02, 0.03), blur=(0.4, 0.6), motion_x=(-0.3, 0.3), motion_y=(-0.3, 0.3))
PHONE_SENSOR = Sensor(
    crosstalk=(0.15, 0.3),
    gain=(1.5, 3.0),
    read_noise=(0.002, 0.008),
    crop_x=(0.35, 0.65),  # what is photographed is in the middle
    crop_y=(0.35, 0.65),
)
DARK_SENSOR = replace(PHONE_SENSOR, gain=(2.0, 5.0), read_noise=(0.008, 0.03))
PHONE_PHOTO = Develop(
    linear_light=True,
    red=(0.92, 1.12),
    blue=(0.92, 1.08),
    saturation=(0.7, 1.2),
    shoulder=(0.2, 1.2),
    contrast=(0.4, 1.0),
    chroma_blur=(2.0, 6.0),
    sharpen=(-0.2, 0.7),
    sharpen_radius=(2.0, 5.0),
    resize="area",
)
# The same in a room whose lamps the camera is balanced for, with local contrast.
ROOM_PHOTO = replace(
    PHONE_PHOTO, red=(0.78, 1.12), blue=(0.92, 1.45), sharpen=(-0.2, 0.8), sharpen_radius=(2.0, 6.0)
)
SAVED_TWICE = replace(ROOM_PHOTO, jpeg=(50.0, 95.0))
BY_HAND = View(yaw=(-20.0, 20.0), pitch=(-12.0, 12.0), roll=(-8.0, 8.0), fov=(20.0, 50.0))
PHONE = SceneRecord(view=BY_HAND, lens=PHONE_LENS, sensor=PHONE_SENSOR, develop=ROOM_PHOTO)
by_phone = partial(replace, PHONE)  # a phone's scene with some parts of its own

PRESETS: dict[str, SceneRecord] = {
    # Paper, section 3.3, steps 1 to 6; the extent of radial distortion is not given there.
    "paper": SceneRecord(
        panel=Panel(scale=3.0),
        view=View(roll=(-45.0, 45.0), fit=False),
        lens=Lens(k1=(-0.05, 0.05)),
        sensor=Sensor(scale=9.0, exposure="point"),
        develop=Develop(registered=False, resize="point"),
    ),
    # What the paper's released code does.
    "paper_code": SceneRecord(
        panel=Panel(scale=3.0),
        view=View(
            yaw=(-20.0, 20.0), pitch=(-20.0, 20.0), roll=(-20.0, 20.0), pose="released", fit=False
        ),
        sensor=Sensor(scale=9.0, exposure="point"),
        develop=Develop(registered=False, resize="point"),
    ),
    # The broad default of RandomMoire: a phone in front of an LCD, compared with photographs.
    "screen_photo": by_phone(
        panel=replace(LCD, width=(400.0, 1600.0)),
        lens=replace(PHONE_LENS, k1=(-0.03, 0.05)),
        sensor=replace(PHONE_SENSOR, pitch=(1.3, 2.2), gain=(1.5, 5.0)),
        develop=PHONE_PHOTO,
    ),
    # A phone in the hand, half a metre from a desk monitor.
    "phone_at_monitor": by_phone(
        panel=replace(LCD, width=(400.0, 1600.0)),
        view=replace(BY_HAND, roll=(-6.0, 6.0), fov=(30.0, 60.0)),
        sensor=replace(PHONE_SENSOR, pitch=(1.2, 2.1)),
        develop=PHONE_PHOTO,
    ),
    # The same phone looking down at a laptop, whose rows lean right and left in turn.
    "phone_at_laptop": by_phone(
        panel=replace(LIT_LCD, layout="chevron", width=(150.0, 1600.0)),
        view=replace(BY_HAND, yaw=(-15.0, 15.0), pitch=(0.0, 30.0), fov=(20.0, 45.0)),
        sensor=replace(PHONE_SENSOR, pitch=(1.1, 3.0), gain=(1.5, 6.0)),
    ),
    # A phone over another phone.
    "phone_at_phone": by_phone(
        panel=replace(DIAMONDS, width=(150.0, 1600.0)),
        view=replace(BY_HAND, roll=(-15.0, 15.0)),
        sensor=replace(PHONE_SENSOR, pitch=(1.1, 2.1), gain=(2.0, 8.0)),
    ),
    # A phone near an OLED television.
    "phone_at_television": by_phone(
        panel=replace(OLED, layout="wrgb", width=(150.0, 1600.0)),
        view=replace(BY_HAND, fov=(30.0, 60.0)),
        sensor=replace(PHONE_SENSOR, pitch=(1.1, 2.1), gain=(1.0, 4.0)),
    ),
    # A phone in front of an LED wall.
    "phone_at_led_wall": by_phone(
        panel=Panel(layout="led", width=(128.0, 400.0), lit=(0.4, 1.0)),
        view=replace(BY_HAND, yaw=(-30.0, 30.0), fov=(20.0, 60.0)),
        sensor=replace(PHONE_SENSOR, pitch=(1.0, 1.9), gain=(4.5, 9.0)),
        develop=PHONE_PHOTO,
    ),
    # A phone held in front of a webcam, as in an identity check.
    "webcam_at_phone": SceneRecord(
        panel=replace(DIAMONDS, width=(150.0, 1000.0)),
        view=replace(BY_HAND, roll=(-15.0, 15.0), fov=(30.0, 70.0)),
        lens=Lens(k1=(0.0, 0.06), blur=(0.35, 0.7), motion_x=(-0.4, 0.4), motion_y=(-0.4, 0.4)),
        sensor=replace(
            PHONE_SENSOR,
            pitch=(1.0, 2.1),
            pixels=1920.0,
            focal=0.71,
            gain=(2.0, 5.0),
            read_noise=(0.006, 0.02),
        ),
        develop=replace(ROOM_PHOTO, jpeg=(40.0, 85.0)),
    ),
    # A tablet under a document camera, which looks straight down.
    "document_camera_at_tablet": SceneRecord(
        panel=replace(LCD, layout="chevron", width=(600.0, 1600.0)),
        view=View(yaw=(-3.0, 3.0), pitch=(-3.0, 3.0), roll=(-10.0, 10.0), fov=(30.0, 60.0)),
        lens=Lens(k1=(-0.02, 0.04), blur=(0.3, 0.65)),
        sensor=replace(
            PHONE_SENSOR, pitch=(1.05, 2.0), pixels=3264.0, focal=1.2, read_noise=(0.003, 0.012)
        ),
        develop=replace(PHONE_PHOTO, jpeg=(75.0, 98.0)),
    ),
    # A car drives up to a full-colour LED sign, which is all of the image.
    "dashcam_at_led_sign": SceneRecord(
        panel=Panel(layout="led", width=(32.0, 96.0), lit=(0.6, 1.0)),
        view=View(yaw=(-20.0, 20.0), pitch=(-12.0, 0.0), roll=(-3.0, 3.0)),
        lens=Lens(k1=(0.0, 0.06), blur=(0.3, 0.6), motion_x=(-0.3, 0.3), motion_y=(-0.2, 0.2)),
        sensor=replace(
            PHONE_SENSOR,
            shrink=1.0,
            pixels=2560.0,
            focal=0.48,
            gain=(3.0, 6.0),
            read_noise=(0.003, 0.012),
        ),
        develop=PHONE_PHOTO,
    ),
    # A phone close to an LCD, whose pixels are seen beside strong moiré.
    "phone_close_to_lcd": by_phone(
        panel=replace(LIT_LCD, width=(80.0, 400.0)),
        lens=replace(PHONE_LENS, blur=(0.3, 0.8)),
        sensor=replace(PHONE_SENSOR, pitch=(1.8, 5.6)),
        develop=PHONE_PHOTO,
    ),
    # A laptop or monitor seen whole, in a room that the camera exposes for.
    "phone_at_whole_screen": by_phone(
        panel=replace(LIT_LCD, width=(1366.0, 1920.0), black=(0.001, 0.01), glare=(0.0, 0.15)),
        view=replace(BY_HAND, yaw=(-30.0, 30.0)),
        sensor=replace(PHONE_SENSOR, pitch=(1.6, 2.1), gain=(1.5, 6.0)),
        develop=SAVED_TWICE,
    ),
    # A tablet held at an angle, in whose glass a window is reflected.
    "phone_at_tablet_by_window": by_phone(
        panel=replace(
            LIT_LCD,
            layout="chevron",
            width=(600.0, 1900.0),
            glare=(0.05, 0.3),
            glare_y=(-0.5, -0.3),
        ),
        view=replace(
            BY_HAND, yaw=(-30.0, 30.0), pitch=(-10.0, 30.0), roll=(-15.0, 15.0), fov=(20.0, 40.0)
        ),
        sensor=replace(PHONE_SENSOR, pitch=(1.6, 2.05), gain=(1.5, 4.0)),
        develop=SAVED_TWICE,
    ),
    # An OLED phone turned down in the dark: bands, noise.
    "phone_at_dimmed_phone": by_phone(
        panel=replace(DIAMONDS, width=(150.0, 1600.0), pwm=(240.0, 480.0), duty=(0.2, 0.7)),
        view=replace(BY_HAND, roll=(-15.0, 15.0)),
        sensor=replace(
            DARK_SENSOR, pitch=(1.1, 2.1), shutter=(0.002, 0.005), readout=(0.008, 0.02)
        ),
    ),
    # An LCD television from across a room.
    "phone_across_room_at_television": by_phone(
        panel=replace(LIT_LCD, layout="chevron", width=(640.0, 1920.0), black=(0.001, 0.01)),
        view=replace(BY_HAND, yaw=(-30.0, 30.0), fov=(8.0, 40.0)),
        sensor=replace(PHONE_SENSOR, pitch=(1.6, 2.1), focal=1.9, gain=(1.5, 4.5)),
        develop=SAVED_TWICE,
    ),
}

# Names of several presets, of which each image is photographed in one: `mixtures.as_scenes`.
MIXTURES: dict[str, tuple[str, ...]] = {
    # A screen that nobody knows: every preset but the paper's.
    "anywhere": tuple(name for name in PRESETS if not name.startswith("paper")),
}
