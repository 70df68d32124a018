"""The explorer's functions, without its page: controls, words, pictures and refusals."""

import dataclasses
import importlib.util
import sys
import types

import numpy as np
import pytest
import torch
from PIL import Image

from moireaug import Layout, Panel, Scene, capture
from moireaug.scene.fields import bounds
from moireaug.scene.parts import PARTS, Lens
from moireaug.scene.presets import PRESETS
from training import explore
from training.config import scenes
from training.explorer import photo, scene_code
from training.explorer.controls import CONTROLS, argument_sentences, scene_of, values_of


def test_every_field_of_a_scene_has_one_described_control():
    fields = [f"{part}.{f.name}" for part, cls in PARTS.items() for f in dataclasses.fields(cls)]
    assert [control.name for control in CONTROLS] == fields
    for control in CONTROLS:
        assert len(control.description) > 10 and control.description.endswith("."), control.name


def test_controls_show_every_preset_and_give_it_back():
    for preset in PRESETS:
        scene = Scene.preset(preset)
        values = values_of(scene)
        assert scene_of(values, scene) == scene
        for control in CONTROLS:
            own, values = values[: control.value_count], values[control.value_count :]
            if control.kind in ("range", "number"):
                for value in own:
                    assert control.low <= value <= control.high, control.name
                    steps = (value - control.low) / control.step
                    assert steps == pytest.approx(round(steps), abs=1e-6), control.name
            if control.kind == "choice":
                assert own[0] in control.choices


def test_a_shrink_makes_crops_of_a_preset():
    preset = Scene.preset("screen_photo")
    values, at = values_of(preset), 0
    for control in CONTROLS:
        if control.name == "sensor.shrink":
            values[at : at + 2] = [3.0, 1.0]
        at += control.value_count
    crops = scene_of(values, preset)
    assert crops == preset.with_shrink((1, 3))
    written = scene_code.differences(crops, "screen_photo")
    assert Scene.from_dict(written) == crops and set(written) == {"preset", "panel", "sensor"}
    shrink = next(control for control in CONTROLS if control.name == "sensor.shrink")
    assert shrink.applies_to(preset) and not shrink.applies_to(Scene.preset("paper"))


def test_limits_of_sliders_lie_within_what_is_allowed():
    allowed = {}
    for part, cls in PARTS.items():
        allowed |= {f"{part}.{f.name}": f.metadata for f in dataclasses.fields(cls)}
    ranges = [control for control in CONTROLS if control.kind == "range"]
    assert len(ranges) > 30
    for control in ranges:
        assert allowed[control.name]["low"] <= control.low < control.high
        assert control.high <= allowed[control.name]["high"], control.name


def test_the_ends_of_a_range_come_in_any_order():
    values = values_of(Scene())
    at = values_of(Scene()).index(40.0)  # view.fov
    values[at : at + 2] = [60.0, 20.0]
    assert bounds(scene_of(values, Scene()).view.fov) == (20.0, 60.0)


def test_a_field_is_described_by_its_documentations_first_sentence():
    said = argument_sentences(Lens)
    assert said["blur"].startswith("standard deviation of the Gaussian point spread")
    assert said["k1"] == said["k2"] == "radial distortion."


def test_code_and_yaml_build_the_scene(tmp_path):
    preset, names, file = Scene.preset("phone_at_phone"), {}, tmp_path / "scene.yaml"
    panel = Panel(layout=Layout(((0, 0, 0, 0.5, 1), (1, 0.5, 0, 1, 1))))
    for scene in (preset, dataclasses.replace(preset, lens=Lens(blur=(0.2, 0.4)), panel=panel)):
        exec(scene_code.as_python(scene, "phone_at_phone"), names)
        assert names["scene"] == names["transform"].scene == scene
        file.write_text(scene_code.as_yaml(scene, "phone_at_phone"))
        assert scenes.load(str(file)) == scene


def test_only_differences_are_written():
    scene = dataclasses.replace(Scene.preset("paper"), lens=Lens(k1=(-0.05, 0.05), blur=0.5))
    assert scene_code.differences(scene, "paper") == {"preset": "paper", "lens": {"blur": 0.5}}


def test_the_photo_is_the_captures_own():
    scene, picture = Scene.preset("screen_photo"), photo.draw_sign()[:48, :40]
    taken = photo.photograph(photo.as_batch(picture), scene, seed=3)
    assert torch.equal(taken.photo, capture(photo.as_batch(picture), taken.shot))
    assert photo.as_picture(taken.photo).shape == (48, 40, 3)
    assert taken.seconds > 0


def test_samples_are_pictures_that_are_not_too_large():
    for name, draw in photo.SAMPLES.items():
        picture = draw()
        assert picture.dtype == np.uint8 and picture.ndim == 3 and picture.shape[2] == 3, name
        assert picture.shape[0] * picture.shape[1] <= photo.MAX_PIXELS, name


def test_a_crop_is_magnified_in_place_and_stays_inside():
    ramp = np.broadcast_to(np.arange(200, dtype=np.uint8)[None, :, None], (150, 200, 3))
    for x, left in ((0.0, 0), (0.5, 68), (1.0, 136)):
        crop = photo.magnify(ramp, x, 0.5)
        assert crop.shape == (384, 384, 3)
        assert crop[0, ::6, 0].tolist() == list(range(left, left + 64))
    assert photo.magnify(ramp[:20, :10]).shape == (120, 60, 3)


def test_a_number_that_was_deleted_is_named():
    scene = Scene.preset("screen_photo")
    with pytest.raises(ValueError, match=rf"^{CONTROLS[0].name} is empty: enter a number"):
        scene_of([None, *values_of(scene)[1:]], scene)


def test_the_spectrum_of_stripes_is_two_points_at_their_frequency():
    stripes = 128 + 100 * np.sin(2 * np.pi * np.arange(96) / 8)  # 1/8 cycle a pixel
    picture = np.broadcast_to(stripes[None, :, None], (96, 96, 3)).astype(np.uint8)
    light = photo.spectrum(picture, side=96).sum(2)
    row, columns = 48, {48 - 12, 48 + 12}
    assert set(np.argsort(light[row])[-2:].tolist()) == columns
    assert light[row].max() > 3 * light[10].max()


def test_large_and_damaged_pictures_are_refused(tmp_path, monkeypatch):
    large, damaged = tmp_path / "large.png", tmp_path / "damaged.png"
    Image.new("L", (2001, 1000)).save(large)
    damaged.write_bytes(b"no picture")
    with pytest.raises(ValueError, match=r"large\.png has 2001 x 1000 pixels, .* 2 megapixels"):
        photo.read(str(large))
    with pytest.raises(ValueError, match=r"damaged\.png could not be read"):
        photo.read(str(damaged))
    with monkeypatch.context() as patch, pytest.raises(ValueError, match="decompression bombs"):
        patch.setattr(Image, "MAX_IMAGE_PIXELS", 1000)
        photo.read(str(large))
    Image.new("L", (2000, 1000)).save(large)
    assert photo.read(str(large)).shape == (1000, 2000, 3)


def test_without_gradio_the_command_names_the_extra(monkeypatch):
    def find_spec(name):
        return None if name == "gradio" else object()

    monkeypatch.setattr(importlib.util, "find_spec", find_spec)
    with pytest.raises(SystemExit, match=r"error: .*gradio.*pip install '\.\[explore\]'"):
        explore.main([])


def test_the_command_serves_on_the_port_that_it_is_given(monkeypatch):
    served = []
    page = types.ModuleType("page")
    page.serve = lambda port, in_browser: served.append((port, in_browser))
    monkeypatch.setattr(explore, "require", lambda *_: None)
    monkeypatch.setitem(sys.modules, "training.explorer.page", page)
    monkeypatch.setattr("training.explorer.page", page, raising=False)
    explore.main(["port=7999", "browser=false"])
    assert served == [(7999, False)]


def test_a_port_that_no_machine_has_is_refused():
    for port in ("0", "70000", "-1", "http"):
        with pytest.raises(SystemExit, match=r"^error: port"):
            explore.main([f"port={port}"])
