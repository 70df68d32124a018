"""Runs beside one another on a folder of images that has changed between them."""

import json
import shutil

import pytest
import torch
from PIL import Image

from tests.training.small import BRIEF, TINY, configured
from training import fit
from training.classifier.train import train_model
from training.data.load import load
from training.models import classifiers as models
from training.recipe import phases
from training.runs import resume
from training.runs.run import Run

pytestmark = pytest.mark.usefixtures("as_the_command_is")


@pytest.fixture
def settings(tmp_path):
    """Settings of runs on a folder of images that are red or blue."""
    for half, n in (("train", 12), ("test", 5)):
        for k, colour in enumerate(("red", "blue")):
            (tmp_path / "images" / half / colour).mkdir(parents=True)
            for i in range(n):
                shade = [40, 40, 40]
                shade[2 * k] += 5 * i + 20
                path = tmp_path / "images" / half / colour / f"{i}.png"
                Image.new("RGB", (24, 24), tuple(shade)).save(path)
    given = ["data=folder", f"data.root={tmp_path / 'images'}", "data.val=4", "train.epochs=1"]
    return [*TINY, *BRIEF, *given, "reattack.n=24", "train.batch_size=10", "model=small_resnet"]


@pytest.fixture
def trained_again(monkeypatch, capsys):
    """Return what is said of a start that cannot be reused, when it would be trained again."""

    def said(run):
        cfg = run.config
        splits = load(cfg.data)
        with monkeypatch.context() as patch:
            patch.setattr(phases, "train_run", lambda run, *_: run.prepare() or 1 / 0)
            with pytest.raises(ZeroDivisionError):
                phases.plain_run(run, splits, None, role="start")
        assert len(list(run.folder.parent.glob("seed0-*"))) == 1, "nothing is lost"
        return capsys.readouterr().out

    return said


def test_a_gain_is_over_the_folders_present_images(tmp_path, settings):
    """An image that is added later is seen by the baseline, too."""
    settings = [*settings, "train.init=random", f"runs={tmp_path / 'runs'}"]
    fit.fit(configured("recipe=baseline", *settings))
    shutil.copy(tmp_path / "images/test/red/0.png", tmp_path / "images/test/red/9.png")
    fit.fit(configured("recipe=moire_aug", *settings))
    found = json.loads(next(tmp_path.glob("runs/*/moire_aug/seed0/metrics.json")).read_text())
    assert {row["n"] for row in found["baseline"]["reattack"]} == {11}
    assert set(found["gain"]) == {row["name"] for row in found["reattack"]}


def test_no_run_resumes_from_an_overwritten_weights_file(tmp_path, settings, trained_again):
    """Two models with one file's name would share a start, a baseline and a report."""
    weights = tmp_path / "weights.pt"
    torch.save(models.as_model("small_resnet", 2).state_dict(), weights)
    given = [*settings, f"weights={weights}"]
    cfg = configured("recipe=clean", *given, f"runs={tmp_path / 'runs'}")
    train_model(Run(cfg), load(cfg.data))
    run = Run(cfg)
    assert resume.weights_difference(run) is None
    torch.save(models.as_model("small_resnet", 2).state_dict(), weights)
    with pytest.raises(ValueError, match=r"weights\.pt no longer holds the weights that it began"):
        fit.fit(cfg)
    weights.unlink()  # a trained run needs it no more
    assert resume.weights_difference(run) is None
    torch.save(models.as_model("small_resnet", 2).state_dict(), weights)
    assert "The start cannot be reused" in trained_again(run)


def test_no_run_goes_on_with_other_classes_or_files(tmp_path, settings, trained_again):
    """Its logits would mean others, or it would be validated on what it was trained on."""
    images = tmp_path / "images"
    cfg = configured("recipe=clean", *settings, f"runs={tmp_path / 'runs'}")
    train_model(Run(cfg), load(cfg.data))
    run = Run(cfg)

    def difference():
        splits = load(cfg.data)
        return resume.data_difference(run, splits.files, splits.classes)

    assert difference() is None
    (images / "train/red/0.png").rename(images / "train/red/24.png")
    with pytest.raises(ValueError, match="cannot go on: the files that it was trained on are not"):
        fit.fit(cfg)
    (images / "train/red/24.png").rename(images / "train/red/0.png")
    assert difference() is None
    for half in ("train", "test"):
        (images / half / "blue").rename(images / half / "green")
    with pytest.raises(ValueError, match="cannot go on: it was trained on other classes"):
        fit.fit(cfg)
    said = "The start cannot be reused and is trained again: it was trained on other classes."
    assert said in trained_again(run)
