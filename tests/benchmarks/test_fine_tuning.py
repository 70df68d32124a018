"""Tuned classifiers are judged on pairs, beside what they were and beside cheaper photos."""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from PIL import Image
from torch import nn
from torchvision.models import squeezenet1_1

from benchmarks import fine_tuning
from benchmarks.tuned_answers import Pictures, rows_of
from training.data.real_pairs import ScreenPhoto
from training.models.classifiers import OWN_MODELS

pytestmark = pytest.mark.filterwarnings("ignore")


class Bright(nn.Module):
    """Answers 1 for pictures brighter than a bound."""

    def __init__(self, bound):
        super().__init__()
        self.bound = bound

    def forward(self, images):
        brightness = images.mean((1, 2, 3)) - self.bound
        return torch.stack([-brightness, brightness], 1)


class Scale(nn.Module):
    def __init__(self, factor):
        super().__init__()
        self.factor = factor

    def forward(self, logits):
        return self.factor * logits


def test_a_row_holds_the_shares_of_equal_answers():
    codes = torch.arange(10, dtype=torch.uint8) * 20 + 10  # 10 to 190
    originals = codes[:, None, None, None].expand(-1, 3, 4, 4)
    pictures = {"pairs": Pictures(originals, originals // 2)}
    students = {
        ("nothing", "its own"): [Bright(100 / 255)] * 2,
        ("photos", "as trained"): [Bright(60 / 255), Bright(60 / 255)],
        ("photos", "averaged"): [Bright(60 / 255), Bright(200 / 255)],
    }
    nothing, tuned, halves = rows_of("bright", students, pictures)
    assert nothing["original as before"] == 1 and nothing["n"] == 10 and nothing["gain"] == 0
    assert nothing["photo as original"] == nothing["photo as original before"] == 0.5
    assert tuned["original as before"] == 0.8  # 70 and 90 are bright now
    assert tuned["photo as original"] == 0.7  # 70 to 110 are still dark in their photos
    assert tuned["photo as original before"] == 0.9
    assert tuned["photo as original, low"] < 0.7 < tuned["photo as original, high"]
    assert tuned["gain"] == pytest.approx(0.4, abs=0.1) and tuned["gain, low"] > 0
    assert halves["original as before"] == 0.3  # the second half, 110 to 190, is dark now


def test_pairs_of_which_a_network_is_sure_are_judged_apart():
    originals = torch.tensor([10, 100, 102, 250], dtype=torch.uint8)
    originals = originals[:, None, None, None].expand(-1, 3, 4, 4)
    steep = nn.Sequential(Bright(101 / 255), Scale(100))
    pictures = {"pairs": Pictures(originals, originals)}
    rows = rows_of("steep", {("nothing", "its own"): [steep] * 2}, pictures)
    assert {row["pairs"]: row["n"] for row in rows} == {"pairs": 4, "pairs, sure": 2}


def test_crops_of_a_pair_are_of_one_place():
    picture = torch.arange(90, dtype=torch.uint8).expand(3, 80, 90)
    crops = fine_tuning.draw_crops([ScreenPhoto("a", 2 * picture, picture)], 6, 32)
    assert (crops.photos.int() - 2 * crops.originals.int()).abs().max() <= 1
    assert len({one.float().mean().item() for one in crops.originals}) > 3
    assert torch.equal(crops.photos / 255, fine_tuning.real_photos(crops)(crops.originals / 255))


def test_the_rivals_change_every_image_and_stay_in_bounds():
    images = torch.rand(3, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    for treatment in fine_tuning.TREATMENTS.values():
        if treatment.photograph:
            changed = fine_tuning.Rival(treatment.photograph)(images, torch.zeros(3))
            assert changed.shape == images.shape and changed.min() >= 0 and changed.max() <= 1
            assert ((changed - images).abs().amax((1, 2, 3)) > 0.01).all()


def test_the_script_tunes_and_judges(tmp_path, monkeypatch):
    draw = np.random.default_rng(0)
    for name in ("photo", "original", "classifiers"):
        (tmp_path / name).mkdir()
    for folder in ("photo", "original"):
        for k in range(4):
            codes = draw.integers(0, 256, (80, 90, 3), dtype=np.uint8)
            Image.fromarray(codes).save(tmp_path / folder / f"{k}.png")
    torch.save(squeezenet1_1().state_dict(), tmp_path / "classifiers/squeezenet1_1.pth")
    paths = [f"photo/{k}.png,original/{k}.png" for k in range(4)]
    (tmp_path / "pairs.csv").write_text("\n".join(["photo,original", *paths]))
    (tmp_path / "loose.csv").write_text(
        "photo,original\nphoto/0.png,original/1.png\nphoto/2.png,original/2.png\n"
    )

    def small(_, num_classes):
        return nn.Sequential(nn.AdaptiveAvgPool2d(4), nn.Flatten(), nn.Linear(48, num_classes))

    monkeypatch.delitem(OWN_MODELS, "efficientnet_lite0", raising=False)  # and again at the end
    monkeypatch.setattr(fine_tuning, "efficientnet_lite", small)
    monkeypatch.setattr(
        fine_tuning, "efficientnets_lite", lambda: {"efficientnet_lite0": small(0, 1000)}
    )
    monkeypatch.chdir(tmp_path)
    given = ["pairs.csv", "--loose", "loose.csv"]
    given += ["--classifiers", "classifiers", "--quick", "--threads", "1", "--out", "."]
    given += ["--epochs", "2", "--only"]
    given += ["screen_photo without moiré", "blur, colour and JPEG", "real photos"]
    monkeypatch.setattr(sys, "argv", [str(Path("fine_tuning.py")), *given])
    fine_tuning.main()
    table = pd.read_csv("fine_tuning.csv")
    counts = table.groupby("pairs", sort=False)["n"].first()
    assert counts["pairs"] == 4 and counts["loose"] == 2
    assert (table.groupby(["classifier", "pairs"])["tuned on"].nunique() == 4).all()
    assert set(table["crops"]) == {4} and set(table["epochs"]) == {2}
    assert set(table["classifier"]) == {"squeezenet1_1", "efficientnet_lite0"}
    untouched = table[table["tuned on"] == "nothing"]
    assert (untouched["original as before"] == 1).all()
