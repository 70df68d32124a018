"""What photos cost published networks: of a network that is right on clean pictures alone."""

import sys

import pandas as pd
import pytest
import torch
from PIL import Image
from torch import nn

from benchmarks import published_weights
from moireaug.evaluation import SuiteConfig
from moireaug.evaluation.suites.scenes import other_scenes


class KnowsCleanPictures(nn.Module):
    """Answers the class of a red or a green picture, and 7 for one whose pixels differ."""

    def forward(self, images):
        logits = torch.zeros(len(images), 1000)
        logits[:, :2] = 10 * images.mean((2, 3))[:, :2]
        logits[:, 7] = 5000 * images.std((2, 3)).amax(1)
        return logits


@pytest.fixture
def pictures(tmp_path):
    """Class folders of a red and a green picture, and their class indices."""
    for name, colour in (("red", (200, 0, 0)), ("green", (0, 200, 0))):
        folder = tmp_path / "pictures" / name
        folder.mkdir(parents=True)
        Image.new("RGB", (64, 64), colour).save(folder / "one.png")
    labels = tmp_path / "labels.csv"
    labels.write_text("folder,class_index\nred,0\ngreen,1\n")
    return [str(tmp_path / "pictures"), str(labels)]


def test_photos_cost_a_network_what_it_knows_of_clean_pictures(pictures, tmp_path, monkeypatch):
    monkeypatch.setattr(
        published_weights, "read_classifiers", lambda _: {"net": KnowsCleanPictures()}
    )
    monkeypatch.setattr(published_weights, "efficientnets_lite", dict)
    options = ["--classifiers", str(tmp_path), "--quick", "--out", str(tmp_path), "--threads", "1"]
    monkeypatch.setattr(sys, "argv", ["published_weights.py", *pictures, *options])
    published_weights.main()
    table = pd.read_csv(tmp_path / "published_weights.csv")
    assert set(table["images"]) == {"whole photos", "crops"} and set(table["counted"]) == {2}
    assert set(table["column"]) == {"moire", "no_moire"}
    assert table["row"].nunique() == 1 + len(other_scenes(SuiteConfig(scene="screen_photo")))
    assert table["success"].mean() > 0.5  # photos have noise, at least
