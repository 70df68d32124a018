"""The fit of a scene's ranges: it finds hidden ones, and is judged in shots that it did not see."""

import math
from dataclasses import replace

import pytest
import torch

from moireaug import Lens, Panel, Scene, Sensor
from tests.training.screens import PLAIN, picture
from training import calibrate
from training.calibration import fit as fitting
from training.calibration.compare import (
    Crops,
    compare_statistics,
    mean_distance,
    measure_crops,
    photograph_crops,
)
from training.calibration.fit import SearchedField, fit
from training.config import scenes


def measured(scene):
    """Return crops photographed by a scene and their statistics; drawn from the seed of a search
    whose shots are judged by 0, so that the distance at the scene's ranges is 0."""
    originals = torch.stack([torch.from_numpy(picture(s, 32, 32)) for s in range(4)])
    originals = originals.permute(0, 3, 1, 2)
    photos = photograph_crops(scene, originals, 1)
    crops = Crops(photos, originals, torch.arange(4), tuple("abcd"))
    return crops, measure_crops(photos, originals)


@pytest.fixture(scope="module")
def hidden():
    """Photos of a scene of which gain and blur are to be found."""
    sensor = Sensor(scale=2.0, gain=(2.9, 3.3))
    return measured(replace(PLAIN, lens=Lens(blur=(0.7, 0.8)), sensor=sensor))


DECODE, FIELDS_TO_SEARCH = fitting.decode, fitting.fields_to_search  # as they are
SEARCHED = (SearchedField("lens.blur", 0.2, 1.2), SearchedField("sensor.gain", 1.0, 5.0))
START = replace(PLAIN, sensor=Sensor(scale=2.0, gain=(1.6, 2.0)))


@pytest.fixture(autouse=True)
def few_fields(monkeypatch):
    monkeypatch.setattr(fitting, "fields_to_search", lambda scene: SEARCHED)


def test_a_fit_finds_what_was_hidden(hidden, tmp_path, capsys):
    crops, real = hidden
    found = fit(START, crops, real, 64, math.inf, 0)
    assert found.searched_after < 0.25 * found.searched_before
    assert found.after < 0.75 * found.before  # in other shots
    assert sum(found.scene.sensor.gain) / 2 == pytest.approx(3.1, abs=0.35)
    assert sum(found.scene.lens.blur) / 2 == pytest.approx(0.75, abs=0.12)
    assert found.scene.view == START.view and found.evaluations == 64
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("fit: distance") and len(lines) > 3
    path = tmp_path / "scene.yaml"
    for scene in (START, PLAIN, found.scene):
        calibrate.write_scene(path, scene)
    assert scenes.load(str(path)) == found.scene
    # earlier fits are kept
    assert scenes.load(str(tmp_path / "scene-2.yaml")) == START
    assert scenes.load(str(tmp_path / "scene-3.yaml")) == PLAIN


def test_an_interrupted_fit_keeps_the_best(hidden, monkeypatch):
    crops, real = hidden
    points = []

    def interrupt(start, limits, point):
        points.append(point)
        if len(points) > 9:
            raise KeyboardInterrupt
        return DECODE(start, limits, point)

    monkeypatch.setattr(fitting, "decode", interrupt)
    found = fit(START, crops, real, 1000, math.inf, 0)
    assert found.evaluations == 1 + 9
    assert found.after <= found.before
    assert "evaluations in" in found.sentence()


def test_a_scene_that_overfits_the_search_is_not_taken(monkeypatch, hidden, capsys):
    crops, real = hidden

    def distance_to(scene, originals, wanted, seed):
        """Better in the search's shots, worse in others."""
        return float(scene.sensor.gain[0]) * (1 if seed == 8 else -1)

    monkeypatch.setattr(fitting, "distance_to", distance_to)
    found = fit(START, crops, real, 40, math.inf, 7)
    assert found.scene is START and found.before == found.after == -1.6
    last = capsys.readouterr().out.splitlines()[-1]
    assert float(last.split()[2]) < 1.3  # it had found something


def test_every_searched_field_is_a_range_of_a_scene():
    presets = [Scene.preset(name) for name in ("screen_photo", "dashcam_at_led_sign", "paper")]
    for scene in (*presets, presets[0].with_shrink((1, 3))):
        limits = tuple(fitting.widen(scene, one) for one in FIELDS_TO_SEARCH(scene))
        again = fitting.decode(scene, limits, fitting.encode(scene, limits))
        names = {one.field for one in limits}
        assert ("sensor.shrink" in names) == scene.is_crop
        assert ("panel.scale" in names) == (not scene.is_binned), "elsewhere it has no effect"
        for field, low, high in limits:
            wanted = pytest.approx(fitting.range_of(scene, field), abs=0.021 * (high - low))
            assert fitting.range_of(again, field) == wanted, field


def test_a_screen_is_searched_by_its_width_and_pitch():
    """As far as the scene states them: 0 is no width, and a scale says the same in another way."""
    screen, pitch = Panel(width=(300.0, 500.0)), Sensor(pitch=(1.8, 2.4))
    given = [
        (Scene.preset("phone_at_monitor"), ["panel.width", "sensor.pitch"]),
        (Scene(panel=screen, sensor=Sensor(reading="binned", scale=2.0)), ["panel.width"]),
        (Scene(panel=Panel(scale=1.2), sensor=pitch), ["sensor.pitch", "panel.scale"]),
        (Scene(panel=Panel(width=99.0), sensor=Sensor(reading="full")), []),
        (Scene.preset("paper"), ["panel.scale"]),
    ]
    for scene, fields in given:
        searched = FIELDS_TO_SEARCH(scene)
        assert [one.field for one in searched[: len(fields)]] == fields
        assert searched[len(fields) :] == fitting.CAMERA_FIELDS
        limits = tuple(fitting.widen(scene, one) for one in searched)
        for share in (0.02, 0.5, 0.98):  # no point of the search is refused for its size
            point = fitting.encode(scene, limits)
            point[: 2 * len(fields)] = share
            assert fitting.decode(scene, limits, point) is not None


def test_a_fit_finds_how_large_a_picture_was_shown(monkeypatch):
    width = SearchedField("panel.width", 10.0, 100.0)
    monkeypatch.setattr(fitting, "fields_to_search", lambda scene: (width,))
    screen = replace(PLAIN, sensor=Sensor(pitch=(2.0, 2.1), gain=2.8))
    crops, real = measured(replace(screen, panel=Panel(width=(45.0, 50.0))))
    start = replace(screen, panel=Panel(width=(14.0, 15.0)))
    found = fit(start, crops, real, 32, math.inf, 0)
    assert found.searched_after < 0.5 * found.searched_before and found.after < found.before
    assert sum(found.scene.panel.width) / 2 == pytest.approx(47.5, rel=0.2)


def test_a_fits_distance_is_that_of_the_written_scene(hidden, monkeypatch):
    """Narrow ranges, too: as numbers they would draw nothing, and shift all other draws."""
    crops, real = hidden
    narrow = (SearchedField("lens.blur", 0.7, 0.8), SearchedField("sensor.gain", 1.0, 5.0))
    monkeypatch.setattr(fitting, "fields_to_search", lambda scene: narrow)
    found = fit(replace(START, lens=Lens(blur=(0.75, 0.7501))), crops, real, 8, math.inf, 3)
    for seed, said in ((3, found.after), (4, found.searched_after)):
        photos = photograph_crops(found.scene, crops.originals, seed)
        again = mean_distance(compare_statistics(real, measure_crops(photos, crops.originals)))
        assert said == pytest.approx(again, abs=1e-12)
    assert found.after < found.before


def test_rounding_leaves_every_range_its_width():
    """Without width a range draws nothing, and shifts all other draws."""
    scene = replace(START, lens=Lens(blur=(0.75, 0.7500008)), sensor=Sensor(gain=(1.23456, 2.0)))
    found = fitting.round_ranges(scene, SEARCHED)
    assert found.lens.blur == (0.75, 0.7500008) and found.sensor.gain == (1.235, 2.0)


def test_photos_alone_cannot_be_fitted(hidden):
    crops, real = hidden
    with pytest.raises(ValueError, match="needs the pictures that were on the screen"):
        fit(START, replace(crops, originals=None), real, 8, math.inf, 0)
