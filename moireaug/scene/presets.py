"""Named scenes, with where their figures come from.

The pitch of a panel in sensor pixels is f * p / d: focal length f in sensor pixels, panel pixel p
and distance d in mm. A scene's pitch is `Sensor.scale * zoom / Panel.scale`. Stepping back until a
turned picture fits the photo magnifies it by 0.77 to 1 in its centre with the angles below, so
`Panel.scale = 0.8 * Sensor.scale / pitch`, and pitches are good to that.

Figures used below:
- Phone: iPhone 12 main camera, 4032 x 3024 pixels, 26 mm equivalent (Apple's specifications; the
  phone of the paper's appendix C): f = 26 / 43.3 of the 5040 px diagonal = 3030 px. Spread at f/1.6
  with 1.4 um pixels and 0.55 um light: the Airy disc's Gaussian, 0.42 * wavelength * N
  = 0.37 um = 0.26 px; defocus and shake add to it.
- Monitors: 27 inch 3840 x 2160 (AOC U27P1U, the paper's appendix C) 0.155 mm; 27 inch 2560 x 1440
  0.233 mm; 24 inch 1920 x 1080 0.277 mm. The first at 400 mm, the others at up to 600 mm: pitch 1.2
  to 2.1.
- Laptops: 13.3 inch 2560 x 1600 (MacBook Air 2020, the paper's appendix C) 0.112 mm, 15.6 inch 1920
  x 1080 0.179 mm. The first at 250 to 300 mm, the second at 300 to 450 mm: pitch 1.1 to 1.8.
- LED signs: 10 to 20 mm between pixels, as full-colour road and street displays are sold; three
  dies on one package. Dashcam: 2560 px across a 120 degree lens, 740 px focal length in the middle,
  barrel distorted. 10 mm at 4 to 7 m, 20 mm at 8 to 14 m: pitch 1.05 to 1.9. From farther away
  nothing is left to alias, from nearer single LEDs are seen.
- Gain, a choice: the phones' exposure brings a white screen to 75 to 105 % of full scale, 3 times
  the inverse of the lit area; a dashcam does not expose for the sign, which then lies between 45 %
  and an overexposed 150 %.
- Read noise, a choice: 0.2 to 1 % of full scale for the phones, a signal-to-noise ratio of 54 to 40
  dB at white; 0.5 to 2 % for the dashcam.
"""

from __future__ import annotations

from moireaug.scene.parts import Develop, Lens, Panel, Sensor, View
from moireaug.scene.record import SceneRecord

PRESETS: dict[str, SceneRecord] = {
    # Paper, section 3.3, steps 1 to 6: alpha 3, 3 x 3 subpixels, rotation by up to 45 degrees,
    # radial distortion (of an extent that is not given there), one sensor pixel per subpixel. In
    # the camera's frame, on sRGB codes.
    "paper": SceneRecord(
        panel=Panel(scale=3.0),
        view=View(roll=(-45.0, 45.0), fit=False),
        lens=Lens(k1=(-0.05, 0.05)),
        sensor=Sensor(scale=9.0, exposure="point"),
        develop=Develop(registered=False, resize="point"),
    ),
    # What the paper's released code does: whole degrees from -20 to 19 about three axes, focal
    # length tied to the roll.
    "paper_code": SceneRecord(
        panel=Panel(scale=3.0),
        view=View(
            yaw=(-20.0, 20.0), pitch=(-20.0, 20.0), roll=(-20.0, 20.0), pose="released", fit=False
        ),
        sensor=Sensor(scale=9.0, exposure="point"),
        develop=Develop(registered=False, resize="point"),
    ),
    # A phone in the hand, half a metre from a desk monitor.
    "phone_at_monitor": SceneRecord(
        panel=Panel(scale=(0.75, 1.35)),
        view=View(yaw=(-20.0, 20.0), pitch=(-12.0, 12.0), roll=(-6.0, 6.0), fov=(30.0, 60.0)),
        lens=Lens(k1=(-0.02, 0.03), blur=(0.26, 0.4)),
        sensor=Sensor(scale=2.0, gain=(2.25, 3.15), read_noise=(0.002, 0.01)),
        develop=Develop(linear_light=True),
    ),
    # The same phone looking down at a laptop.
    "phone_at_laptop": SceneRecord(
        panel=Panel(scale=(0.9, 1.45)),
        view=View(yaw=(-15.0, 15.0), pitch=(0.0, 30.0), roll=(-8.0, 8.0), fov=(20.0, 45.0)),
        lens=Lens(k1=(-0.02, 0.03), blur=(0.26, 0.4)),
        sensor=Sensor(scale=2.0, gain=(2.25, 3.15), read_noise=(0.002, 0.01)),
        develop=Develop(linear_light=True),
    ),
    # A car drives up to a full-colour LED sign.
    "dashcam_at_led_sign": SceneRecord(
        panel=Panel(layout="led", scale=(0.85, 1.5), lit=(0.6, 1.0)),
        view=View(yaw=(-30.0, 30.0), pitch=(-12.0, 0.0), roll=(-3.0, 3.0), fov=(5.0, 20.0)),
        lens=Lens(k1=(0.0, 0.06), blur=(0.2, 0.45)),
        sensor=Sensor(scale=2.0, gain=(9.0, 18.0), read_noise=(0.005, 0.02)),
        develop=Develop(linear_light=True),
    ),
    # The broad default of RandomMoire: any of the screens above, pitch 1.1 to 2.5.
    "screen_photo": SceneRecord(
        panel=Panel(scale=(0.65, 1.45)),
        view=View(yaw=(-25.0, 25.0), pitch=(-15.0, 15.0), roll=(-12.0, 12.0), fov=(20.0, 50.0)),
        lens=Lens(k1=(-0.03, 0.05), blur=(0.2, 0.4)),
        sensor=Sensor(scale=2.0, gain=(2.0, 3.2), read_noise=(0.0, 0.01)),
        develop=Develop(linear_light=True),
    ),
}
