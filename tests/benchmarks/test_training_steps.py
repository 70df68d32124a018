"""What the steps and the loading are timed on."""

import pytest
from hydra import initialize

from benchmarks import training_steps
from moireaug import image_files
from training.data import image_sets


@pytest.fixture(autouse=True)
def _hydra():
    with initialize(version_base="1.3", config_path=None):
        yield


@pytest.mark.parametrize(("source", "again"), [("files", 4), ("memory", 0)])
def test_a_pass_reads_what_its_row_says(monkeypatch, tmp_path, source, again):
    training_steps.write_folder(tmp_path, 4, 16)
    opened = []
    monkeypatch.setattr(
        image_sets,
        "read_picture",
        lambda path: opened.append(path) or image_files.read_picture(path),
    )
    given = ["data=folder", "data.size=16", "data.val=2", "train.batch_size=2"]
    cfg = training_steps.configure("recipe=clean", *given, f"data.root={tmp_path}")
    loader = training_steps.loader_of(cfg, source, 0)
    list(loader)
    assert len(opened) == 4
    list(loader)
    assert len(opened) == 4 + again
