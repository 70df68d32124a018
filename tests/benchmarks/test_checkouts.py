"""What ours is compared with: another checkout of the project, and the released chain."""

from pathlib import Path

import pytest
import torch

from benchmarks import apart, checkouts, released
from moireaug import Scene, capture, engine, expose
from moireaug.scene.presets import PRESETS

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name", PRESETS)
def test_a_scene_reaches_another_checkout_whole(name):
    scene = Scene.preset(name)
    told = checkouts.plain(scene)
    assert Scene.from_dict(told) == scene and "olpf" not in told["lens"]


def test_a_checkout_is_a_process_that_captures():
    torch.set_num_threads(1)  # as there
    image = torch.rand(1, 3, 16, 16)
    scene = Scene.preset(apart.SCENE)
    with checkouts.Checkout(ROOT, threads=1, engine=False) as run:
        run.ask("hold", key="it", scene=scene.to_dict(), images=image.numpy())
        run.call("it", "capture")()
        reading = torch.from_numpy(run.ask("result", key="it", what="first reading"))
        assert run.ask("resident_rise", scene=apart.SCENE, shape=(1, 64, 64)) > 0
    shot = scene.sample(1, (16, 16), torch.Generator().manual_seed(0))
    with engine.reference():
        torch.testing.assert_close(reading, expose(image, shot))


def test_the_first_photo_of_a_start_is_one():
    names = {}
    exec(apart.PHOTO, names)
    assert names["scene"] == Scene.preset(apart.SCENE)


def test_a_checkout_measures_its_own_code_alone(tmp_path, monkeypatch):
    """Where another one is found, here an empty one, with a torch that takes no time to import."""
    other = tmp_path / "other"
    files = {
        "moireaug/__init__.py": "Scene = None",
        "torch/__init__.py": "Tensor = set_num_threads = manual_seed = no_grad = nullcontext",
        "torch/utils/data.py": "DataLoader = Dataset = object",
    }
    for name, text in files.items():
        (other / name).parent.mkdir(parents=True, exist_ok=True)
        (other / name).write_text(f"from contextlib import nullcontext\n{text}\n")
    monkeypatch.setenv("PYTHONPATH", str(other))
    with pytest.raises(RuntimeError, match="no moireaug of its own"):
        checkouts.Checkout(tmp_path / "mine", threads=1)


def test_the_plain_chain_is_the_capture():
    scene, image = Scene.preset("paper_code"), torch.rand(1, 3, 21, 21, dtype=torch.float64)
    shot = scene.sample(1, (21, 21))
    assert (released.photograph(image, shot.matrix()) - capture(image, shot)).abs().max() < 1e-6
