"""Named scenes."""

from moireaug.scene import Develop, Lens, Panel, Scene, Sensor, View

PRESETS: dict[str, Scene] = {
    "paper": Scene(
        panel=Panel(scale=3.0),
        view=View(roll=(-45.0, 45.0), fit=False),
        lens=Lens(k1=(-0.05, 0.05)),
        sensor=Sensor(scale=9.0, exposure="point"),
        develop=Develop(registered=False),
    ),
    "paper_code": Scene(
        panel=Panel(scale=3.0),
        view=View(yaw=(-20.0, 20.0), pitch=(-20.0, 20.0), roll=(-20.0, 20.0), pose="released", fit=False),
        sensor=Sensor(scale=9.0, exposure="point"),
        develop=Develop(registered=False, resize="point"),
    ),
    "screen_photo": Scene(
        panel=Panel(scale=(0.8, 2.0)),
        view=View(yaw=(-20.0, 20.0), pitch=(-15.0, 15.0), roll=(-10.0, 10.0)),
        lens=Lens(blur=(0.2, 0.4), k1=(-0.03, 0.03)),
        sensor=Sensor(scale=2.0, gain=(2.2, 3.2), read_noise=(0.0, 0.01)),
        develop=Develop(linear_light=True),
    ),
}
