"""A track is a shot that a hand moves: smooth, of stated amplitude and frequency, on one screen."""

import dataclasses
import math

import pytest
import torch

from moireaug import Develop, Hand, Panel, Scene, Sensor, Shot, View, capture
from moireaug.scene.by_name import with_values
from moireaug.scene.track import MOVED_FIELDS, PEAK, TRIPOD
from tests.closed_forms.common import COLOUR

SIZE = (24, 32)
PHONE = Scene.preset("phone_at_dimmed_phone")
CROP = Scene.preset("screen_photo").with_shrink(1.0)
HAND = Hand()


def track(scene, n=2, frames=5, hand=HAND, seed=0, size=SIZE):
    return scene.sample_track(n, frames, size, torch.Generator().manual_seed(seed), hand)


def of_frames(shot, name, n):
    return shot.numbers()[name].reshape(n, -1)


@pytest.mark.parametrize("scene", [PHONE, CROP, Scene()], ids=["whole", "crop", "frontal"])
def test_frame_0_is_the_sampled_photo_and_others_differ(scene):
    shot, one = track(scene), scene.sample(2, SIZE, torch.Generator().manual_seed(0))
    assert len(shot) == 10 and torch.equal(shot.seed, (one.seed[:, None] + torch.arange(5)).ravel())
    for name, values in one.numbers().items():
        assert torch.allclose(of_frames(shot, name, 2)[:, 0], values, rtol=0, atol=1e-12), name
    images = torch.rand(2, 3, *SIZE, generator=torch.Generator().manual_seed(1))
    photos = capture(images.repeat_interleave(5, 0), shot).unflatten(0, (2, 5))
    assert (photos[:, 0] - capture(images, one)).abs().max() < 2 / 255
    if scene is not PHONE:  # whose sensor noise makes all frames differ
        assert (photos[:, 1:] - photos[:, :1]).abs().amax((2, 3, 4)).min() > 1e-4


def test_a_track_is_a_function_of_its_generator():
    first, again = track(PHONE), track(PHONE)
    assert first.to_dict() == again.to_dict() == Shot.from_dict(first.to_dict()).to_dict()
    longer = track(PHONE, n=3, frames=9)  # frames do not depend on how many there are
    for name, values in first.numbers().items():
        assert torch.equal(of_frames(longer, name, 3)[:2, :5], values.reshape(2, 5)), name
    assert track(PHONE, seed=1).to_dict() != first.to_dict()


def test_only_the_pose_and_what_follows_from_it_change():
    free = {*MOVED_FIELDS, "panel.phase", "sensor.pitch", "sensor.crop_x", "sensor.crop_y"}
    for scene in (PHONE, CROP):
        shot = track(scene)
        for name in shot.numbers().keys() - free:
            values = of_frames(shot, name, 2)
            assert torch.equal(values, values[:, :1].expand_as(values)), name
        still = track(scene, hand=TRIPOD)
        for name in MOVED_FIELDS:
            values = of_frames(still, name, 2)
            assert torch.equal(values, values[:, :1].expand_as(values)), name


def test_motion_has_the_stated_amplitude_and_no_frequency_above_the_highest():
    hand, n, frames = Hand(turn=0.5, shift=0.01, zoom=0.004, frequency=3.0), 40, 600
    view = View(yaw=5.0, pitch=-3.0, roll=2.0, zoom=0.9, fit=False)
    shot = track(Scene(view=view), n, frames, hand)
    for name, amplitude in zip(MOVED_FIELDS, hand.amplitudes(), strict=True):
        values = of_frames(shot, name, n)
        if name == "view.zoom":
            values = values / 0.9
        moved = values - values[:, :1]
        assert moved.abs().max() <= 2 * PEAK * amplitude
        most = 1.8 * 2 * math.pi * hand.frequency / hand.rate * amplitude
        assert 0.5 * most < values.diff(dim=1).abs().max() <= most
        assert values.std(1).square().mean().sqrt().item() == pytest.approx(amplitude, rel=0.1)
        window = torch.hann_window(frames, dtype=torch.float64)
        power = torch.fft.rfft((values - values.mean(1, keepdim=True)) * window).abs().square()
        hertz = torch.fft.rfftfreq(frames, 1 / hand.rate)
        assert power[:, hertz > hand.frequency + 0.2].sum() < 1e-4 * power.sum()


def test_a_beat_moves_by_half_of_its_order_of_a_cycle_for_each_sensor_pixel():
    """A harmonic of f cycles a sensor pixel, which red pixels fold to f - m / 2, keeps its phase on
    the screen, and loses m / 2 cycles a sensor pixel as the screen moves over the sensor."""
    panel = Panel(layout="even", lit_x=0.6)
    for pitch, order in ((2.1, 1), (1.05, 2)):
        sensor = Sensor(pitch=pitch, shrink=1.0)
        scene = Scene(panel=panel, sensor=sensor, develop=Develop(demosaic="bilinear"))
        hand = Hand(turn=0.0, shift=0.001, zoom=0.0)
        shot = track(scene, 1, 20, hand, size=(8, 420))
        photos = capture(torch.full((20, 3, 8, 420), 0.5), shot)[:, 0, 4, :].double()
        wave = 2 * math.pi * (1 / pitch - order / 2) * torch.arange(420, dtype=torch.float64)
        beats = torch.complex(photos @ wave.cos(), -(photos @ wave.sin()))
        assert beats.abs().min() > 0.005 * 420
        pixels = (shot.view.shift_x - shot.view.shift_x[0]) * sensor.pixels
        assert pixels.abs().max() > 1
        turned = (beats / beats[0]).angle() / (2 * math.pi)
        error = turned + order / 2 * pixels
        assert (error - error.round()).abs().max() < 0.02
        assert (turned - turned.round()).abs().max() > 0.1


def test_a_crop_follows_its_part_of_the_screen():
    shot = track(CROP, n=4, frames=30, hand=Hand(turn=1.0))
    inner = (shot.sensor.crop_x % 1 > 0) & (shot.sensor.crop_y % 1 > 0)
    corner = shot.panel_corner.reshape(4, 30, 2)
    assert inner.all() and (corner - corner[:, :1]).abs().max() < 1e-6
    assert (shot.frame.photo_left.reshape(4, 30).diff(dim=1)).abs().max() > 0.1
    scale = shot.panel_scale.reshape(4, 30)
    assert (scale - scale[:, :1]).abs().max() < 1e-9


def test_bands_roll_by_the_pulses_between_frames():
    pulsed = Panel(layout="even", pwm=240.5, duty=0.5, phase=0.25)
    scene = Scene(panel=pulsed, sensor=dataclasses.replace(COLOUR, shutter=1e-3, readout=0.01))
    shot = track(scene, 1, 4, Hand(rate=120.0))
    expected = (0.25 + 240.5 / 120 * torch.arange(4)) % 1
    assert torch.allclose(shot.panel.phase, expected.double())


def test_what_no_hand_can_film_is_refused():
    with pytest.raises(ValueError, match="pose"):
        track(Scene.preset("paper_code"))
    assert len(track(Scene.preset("paper_code"), hand=TRIPOD)) == 10
    for wrong in ({"turn": -1.0}, {"rate": 0.0}, {"frequency": math.inf}):
        with pytest.raises(ValueError, match=f"Hand.{next(iter(wrong))}"):
            Hand(**wrong)
    with pytest.raises(ValueError, match="frames"):
        track(CROP, frames=0)


def test_a_hand_that_moves_further_than_fields_go_is_refused():
    for scene, far, named in (
        (PHONE, Hand(turn=11.0), r"sensor.pitch to numbers in \[-"),
        (Scene(), Hand(zoom=0.5), r"view.zoom to numbers in \[-1.83, 3.83\], where \[0.001, 100\]"),
        (Scene(), Hand(turn=60.0), r"view.yaw to numbers in \[-339, 339\], where \[-89, 89\]"),
        (with_values(CROP, {"view.yaw": (88.9, 89.0)}), HAND, r"or narrow .* \(88.9, 89.0\)"),
    ):
        with pytest.raises(ValueError, match=named):
            track(scene, hand=far)
    track(Scene(), hand=Hand(turn=11.0, zoom=0.0))  # which moves no zoom


def test_every_camera_that_is_held_is_filmed_by_hand():
    for name in Scene.presets():
        scene = Scene.preset(name)
        if scene.view.pose == "camera":
            assert track(scene).view.yaw.isfinite().all(), name


def test_a_roll_goes_on_past_half_a_turn():
    shot = track(Scene(view=View(roll=180.0)), frames=60, hand=Hand(turn=3.0))
    assert shot.view.roll.abs().max() <= 180 and shot.view.roll.abs().min() > 150
    assert (shot.view.roll < 0).any() and (shot.view.roll > 0).any()


def test_a_crop_stops_at_the_edge_of_its_photo():
    edge = with_values(CROP, {"sensor.crop_x": (0.0, 0.01)})
    shot = track(edge, frames=30, hand=Hand(turn=5.0))
    assert shot.sensor.crop_x.min() == 0.0
