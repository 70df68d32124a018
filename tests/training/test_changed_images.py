"""Runs beside one another on a folder of images that has changed between them."""

import json
import shutil

import pytest
import torch
from PIL import Image

from tests.training.small import BRIEF, TINY, configured, inside, train
from training import fit
from training.data.load import load
from training.models import classifiers as models
from training.recipe import phases
from training.runs import resume
from training.runs.identity import Origin
from training.runs.run import Run

pytestmark = pytest.mark.usefixtures("as_the_command_is")


@pytest.fixture
def settings(tmp_path):
    """Settings of runs on a folder of images that are red or blue."""
    for half, n in (("train", 12), ("test", 3)):
        for k, colour in enumerate(("red", "blue")):
            (tmp_path / "images" / half / colour).mkdir(parents=True)
            for i in range(n):
                shade = [40, 40, 40]
                shade[2 * k] += 5 * i + 20
                path = tmp_path / "images" / half / colour / f"{i}.png"
                Image.new("RGB", (24, 24), tuple(shade)).save(path)
    given = ["data=folder", f"data.root={tmp_path / 'images'}", "data.val=8", "train.epochs=1"]
    return [*TINY, *BRIEF, *given, "model=small_resnet", "reattack.n=24"]


def test_a_gain_is_over_the_folders_present_images(tmp_path, settings):
    """An image that is added later is seen by the baseline, too."""
    inside("fit.py", "recipe=baseline", *settings, cwd=tmp_path)
    shutil.copy(tmp_path / "images/test/red/0.png", tmp_path / "images/test/red/9.png")
    done = inside("fit.py", "recipe=moire_aug", *settings, cwd=tmp_path)
    assert done.returncode == 0 and not done.stderr, (done.stdout, done.stderr)
    found = json.loads(next(tmp_path.glob("runs/*/moire_aug/seed0/metrics.json")).read_text())
    assert {row["n"] for row in found["baseline"]["reattack"]} == {7}
    assert set(found["gain"]) == {row["name"] for row in found["reattack"]}


def test_no_run_goes_on_with_other_weights_classes_or_files(tmp_path, settings, capsys):
    """Two models with one file's name would share a start, its logits would mean others, or it
    would be validated on what it was trained on."""
    images, weights = tmp_path / "images", tmp_path / "weights.pt"

    def overwrite():
        torch.save(models.as_model("small_resnet", 2).state_dict(), weights)

    overwrite()
    given = [*settings, f"weights={weights}", f"runs={tmp_path / 'runs'}"]
    cfg, baseline = (configured(f"recipe={name}", *given) for name in ("clean", "baseline"))
    run, _ = train(cfg)

    def difference():
        splits = load(cfg.data)
        origin = Origin.of(cfg.weights, splits)
        return resume.origin_difference(run, origin)

    def refused(message):
        with pytest.raises(ValueError, match=message):
            fit.fit(cfg)

    def start_is_trained_again(because):
        phases.plain_runs(Run(baseline), load(cfg.data))
        said = f"The start cannot be reused and is trained again: {because}"
        assert said in capsys.readouterr().out

    assert difference() is None
    (images / "train/red/0.png").rename(images / "train/red/24.png")
    refused("cannot go on: the files that it was trained on are not")
    (images / "train/red/24.png").rename(images / "train/red/0.png")
    assert difference() is None
    overwrite()
    refused(r"weights\.pt no longer holds the weights that it began")
    start_is_trained_again(f"{weights} no longer holds the weights")
    weights.rename(tmp_path / "elsewhere")  # a finished run needs it no more
    assert difference() is None
    for half in ("train", "test"):
        (images / half / "blue").rename(images / half / "green")
    refused("cannot go on: it was trained on other classes")
    (tmp_path / "elsewhere").rename(weights)
    start_is_trained_again("it was trained on other classes.")
    assert len(list(run.folder.parent.glob("seed0-*"))) == 2, "nothing is lost"
