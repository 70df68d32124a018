"""A scene's file: read in one place, checked, and kept in a run as the scene itself."""

import pytest

from moireaug import Scene
from tests.training.small import TINY, configured
from training import fit, reattack, saved, scenes
from training.schema import scene_of

TEXT = "preset: phone_at_monitor\npanel: {lit: [0.6, 0.9]}\nview: {roll: [-3, 3]}\n"
WANTED = {
    "preset": "phone_at_monitor",
    "panel": {"lit": [0.6, 0.9]},
    "view": {"roll": [-3, 3]},
}


class StopError(Exception):
    pass


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(TEXT)
    return path


def test_a_file_is_the_scene_that_it_describes(file):
    scene = scenes.load(str(file))
    assert scene == Scene.from_dict(WANTED)
    assert scene.panel.lit == (0.6, 0.9) and scene.lens == Scene.preset("phone_at_monitor").lens
    assert scenes.load("screen_photo") == Scene.preset("screen_photo")
    assert scenes.inlined(WANTED) is WANTED


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("panel: [", "could not be read as YAML"),
        ("- panel", "it must be a YAML mapping"),
        ("pannel: {}", "Did you mean 'panel'"),
        ("panel: {lid: 1}", "Did you mean 'lit'"),
        ("panel: 3", "Scene.panel must be a mapping of its fields; got 3"),
        ("panel: {lit: 7}", r"Panel.lit must lie in"),
        ("preset: phone", "a preset must be one of"),
        ("tolerance: 1e-3", "must be a number"),  # which YAML takes for a word
        (
            "lens: {blur: 1}\npanel: {}\nlens: {}",
            "duplicate key 'lens' in line 3, first set in line 1",
        ),
        ("lens:\n  blur: 1\n  blur: 2", "duplicate key 'blur' in line 3, first set in line 2"),
        ("lens: {blur: 2026-13-45}", "could not be read as YAML"),
        ("[" * 5000, "could not be read as YAML"),
        (b"\xff\xfe\xff", "could not be read as YAML"),
    ],
)
def test_what_is_no_scene_is_refused_by_the_files_name(tmp_path, text, said):
    path = tmp_path / "wrong.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=rf"^scene={path} .*{said}"):
        scenes.load(str(path))


def test_training_and_re_attack_take_a_file_and_keep_what_is_in_it(file, monkeypatch):
    seen = []

    def stop(cfg):
        seen.append(cfg)
        raise StopError

    monkeypatch.setattr(fit, "check", stop)
    monkeypatch.setattr(reattack, "attack_weights", stop)
    with pytest.raises(StopError):
        fit.fit(configured("recipe=moire_at", *TINY, f"scene={file}"))
    given = ["model=small_resnet", "weights=FILE", f"scene={file}"]
    with pytest.raises(StopError):
        reattack.reattack(configured(*given, name="reattack"), given)
    file.unlink()
    for cfg in seen:
        assert cfg.scene == WANTED and scene_of(cfg) == Scene.from_dict(WANTED)


def test_the_settings_of_a_run_name_no_file_that_is_read(file, tmp_path):
    config = tmp_path / "config.yaml"
    config.write_text(f"recipe: clean\nscene: {file}\ndata: {{name: signs}}\n")
    with pytest.raises(ValueError, match="file is for the commands"):
        saved.read_config(config)
    config.write_text("recipe: clean\nscene: screen_photo\ndata: {name: signs}\n")
    assert saved.read_config(config).scene == "screen_photo"
