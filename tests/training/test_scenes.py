"""A scene's file: read in one place, checked, and kept in a run as the scene itself."""

from dataclasses import replace

import pytest
import torch

from moireaug import Scene
from moireaug.mixtures import as_scenes
from tests.training.small import TINY, configured
from training import fit, reattack
from training.attack import results, subject
from training.classifier.adversaries import TrainingAdversary
from training.comparison import comparable
from training.config import scenes
from training.config.checks import check_classifier
from training.config.schema import Adversary
from training.recipe.phases import ClassificationTask
from training.runs import trained

TEXT = "preset: phone_at_monitor\npanel: {lit: [0.6, 0.9]}\nview: {roll: [-3, 3]}\n"
WANTED = {"preset": "phone_at_monitor", "panel": {"lit": [0.6, 0.9]}, "view": {"roll": [-3, 3]}}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(TEXT)
    return path


def test_a_file_is_the_scene_that_it_describes(file):
    scene = scenes.load(str(file))
    assert scene == Scene.from_dict(WANTED)
    assert scene.panel.lit == (0.6, 0.9) and scene.lens == Scene.preset("phone_at_monitor").lens
    assert scenes.load("paper") == scenes.load_one("paper") == Scene.preset("paper")
    assert scenes.inline_files(WANTED) is WANTED
    file.write_text("tolerance: 1e-3")  # which YAML alone takes for a word
    assert scenes.load(str(file)).tolerance == 1e-3


WRONG = [
    ("panel: [", "could not be read as YAML"),
    ("", "it must be a YAML mapping of its parts, or a list of scenes"),
    ("3", "could not be read"),
    ("lens: {blur: '${lens'}", "could not be read as YAML"),
    ("- panel", "a preset must be one of"),
    ("- [paper, screen_photo]", "Put all scenes into one list"),
    ("- paper\n- {lens: {blurr: 1}}", "Did you mean 'blur'"),
    ("pannel: {}", "Did you mean 'panel'"),
    ("panel: {lid: 1}", "Did you mean 'lit'"),
    ("panel: 3", "Scene.panel must be a mapping of its fields; got 3"),
    ("panel: {lit: 7}", r"Panel.lit must lie in"),
    ("preset: phone", "a preset must be one of"),
    ("lens: {blur: 1}\npanel: {}\nlens: {}", "found duplicate key lens .* line 3"),
    ("lens:\n  blur: 1\n  blur: 2", "found duplicate key blur .* line 3"),
    ("lens: {blur: 2026-13-45}", "must be a number"),
    ("[" * 5000, "could not be read as YAML"),
    (b"\xff\xfe\xff", "could not be read as YAML"),
]


def test_what_is_no_scene_is_refused_by_the_files_name(tmp_path):
    path = tmp_path / "wrong.yaml"
    for text, said in WRONG:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        with pytest.raises(ValueError, match=rf"^scene={path} .*{said}"):
            scenes.load(str(path))


def test_training_and_re_attack_keep_what_a_scene_file_holds(file, monkeypatch):
    seen = []

    def stop(cfg):
        seen.append(cfg)
        raise StopIteration

    monkeypatch.setattr(ClassificationTask, "check", lambda task, cfg: stop(cfg))
    monkeypatch.setattr(reattack, "check", stop)
    with pytest.raises(StopIteration):
        fit.fit(configured("recipe=moire_at", *TINY, f"scene={file}"))
    given = ["model=small_resnet", "weights=FILE", f"scene={file}"]
    with pytest.raises(StopIteration):
        reattack.reattack(configured(*given, name="reattack"), given)
    file.unlink()
    for cfg in seen:
        assert cfg.scene == WANTED and as_scenes(cfg.scene) == Scene.from_dict(WANTED)


def test_a_runs_settings_name_no_file_to_read(file, tmp_path):
    config = tmp_path / "config.yaml"
    config.write_text(f"recipe: clean\nscene: {file}\ndata: {{name: signs}}\n")
    with pytest.raises(ValueError, match="file is for the commands"):
        trained.read_config(config)
    config.write_text("recipe: clean\nscene: screen_photo\ndata: {name: signs}\n")
    assert trained.read_config(config).scene == "screen_photo"


LISTED = ["phone_at_monitor", "dashcam_at_led_sign"]


def test_a_file_may_hold_a_list_and_conversely(tmp_path, file):
    several = tmp_path / "several.yaml"
    several.write_text("- phone_at_monitor\n- {preset: screen_photo, lens: {blur: 0.3}}\n")
    blurred = {"preset": "screen_photo", "lens": {"blur": 0.3}}
    assert scenes.inline_files(str(several)) == ["phone_at_monitor", blurred]
    assert scenes.load(str(several)) == as_scenes(["phone_at_monitor", blurred])
    given = ["paper", str(file), str(several)]
    assert scenes.inline_files(given) == ["paper", WANTED, "phone_at_monitor", blurred]
    with pytest.raises(ValueError, match="holds a list of 2 scenes; this command takes one"):
        scenes.load_one(str(several))
    several.write_text("[phone_at_monitor]")
    assert scenes.load_one(str(several)) == Scene.preset("phone_at_monitor")


def test_a_command_takes_a_list():
    given = f"scene=[{','.join(LISTED)}]"
    cfg = configured("recipe=moire_at", *TINY, given)
    assert cfg.scene == LISTED and as_scenes(cfg.scene) == as_scenes(LISTED)
    assert results.scene_title(cfg) == "phone_at_monitor, dashcam_at_led_sign"
    for custom in ([LISTED[0], WANTED], WANTED):
        assert results.scene_title(replace(cfg, scene=custom)) == "custom"
    lists = [replace(cfg, scene=one) for one in (LISTED, LISTED[::-1], [*LISTED, "paper"])]
    names = {subject.scene_name(one) for one in lists}
    assert len(names) == 3 and all(name.startswith("custom-") for name in names)


def test_a_run_may_say_that_its_images_are_crops(tmp_path):
    given = ["recipe=clean", *TINY, "scene=screen_photo"]
    whole, crops, one = (configured(*given, *more) for more in ([], ["shrink=[1,3]"], ["shrink=2"]))
    for cfg, shrink in ((whole, None), (crops, (1, 3)), (one, 2)):
        assert scenes.scene_of(cfg) == as_scenes("screen_photo", shrink)
    titles = [results.scene_title(cfg) for cfg in (whole, crops, one)]
    assert titles == ["screen_photo", "screen_photo, shrink 1 to 3", "screen_photo, shrink 2"]
    assert subject.scene_name(crops) == "screen_photo-shrink-1-to-3"
    metrics = [results.run_metrics(cfg, None, None) for cfg in (whole, crops)]
    assert metrics[0].fingerprint != metrics[1].fingerprint
    assert "1 to 3 sensor pixels" in metrics[1].plan
    found = [comparable.run_settings(one) for one in metrics]
    with pytest.raises(ValueError, match="runs with different scene"):
        comparable.require_shared(dict(zip("ab", found, strict=True)), "runs")
    config = tmp_path / "config.yaml"
    config.write_text("recipe: clean\nscene: paper\nshrink: [1, 3]\ndata: {name: signs}\n")
    with pytest.raises(ValueError, match="Leave it out"):
        trained.read_config(config)
    for wrong in ("0", "[1]", "small", "{a: 1}", "[3, 1]"):
        with pytest.raises((ValueError, TypeError), match="shrink"):
            check_classifier(configured(*given, f"shrink={wrong}"))


def test_runs_of_other_lists_of_scenes_are_not_compared():
    cfg = configured("recipe=clean", *TINY, f"scene=[{','.join(LISTED)}]")
    metrics = results.run_metrics(cfg, None, None)
    assert metrics.scene == as_scenes(LISTED).to_dict()
    assert metrics.plan.count("noise") >= 2
    plan = Scene.preset(LISTED[0]).plan((cfg.data.size, cfg.data.size))
    assert metrics.plan.startswith(str(plan))
    found = comparable.run_settings(metrics)
    assert found["scene 2.panel"] == Scene.preset(LISTED[1]).to_dict()["panel"]
    assert comparable.run_settings(replace(metrics, scene=metrics.scene[0]))["scene.panel"]
    other = comparable.run_settings(replace(metrics, scene=metrics.scene[:1] * 2))
    with pytest.raises(ValueError, match="runs with different scene"):
        comparable.require_shared({"a": found, "b": found, "c": other}, "runs")


@pytest.mark.parametrize("kind", ["none", "moire_attack"])
def test_a_batch_is_trained_on_in_all_listed_scenes(kind):
    bright = [
        {"panel": {"scale": 3.0}, "sensor": {"gain": gain, "scale": 4.0}} for gain in (0.5, 2.5)
    ]
    attack = {"share": 1.0, "eps": 1e-6, "steps": 1} if kind == "moire_attack" else {}
    model = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(3 * 64, 4))
    adversary = TrainingAdversary(model, as_scenes(bright), Adversary(kind=kind, **attack))
    photos = adversary(torch.full((16, 3, 8, 8), 0.6), torch.zeros(16, dtype=torch.long))
    levels = photos.mean((1, 2, 3))
    # each photo is dark or bright, and both are there
    dark = levels < levels.mean()
    assert 0 < dark.sum() < 16
    assert levels[dark].std() + levels[~dark].std() < 0.1 * (levels.max() - levels.min())
