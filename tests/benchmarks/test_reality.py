"""The benchmark against real photos, on pairs that the scene itself made."""

import json
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import torchvision
from PIL import Image

from benchmarks import told_apart
from moireaug import Scene
from training.calibration.compare import Crops, photograph_crops

ROOT = Path(__file__).resolve().parents[2]
EFFORT = told_apart.Effort(steps=80, batch=10, side=32, judged=64)


def pictures(n, side=64):
    draw = np.random.default_rng(3)
    small = draw.uniform(0, 255, (n, 3, side // 16, side // 16))
    return torch.from_numpy(np.kron(small, np.ones((16, 16))).astype(np.uint8))


def crops_of(photos, n):
    return Crops(photos, photos, torch.arange(len(photos)) % n, tuple(map(str, range(n))))


def write_pairs(folder, n):
    originals = pictures(n, 96)
    photos = photograph_crops(Scene.preset("paper_code"), originals)
    lines = ["photo,original"]
    for i, (photo, original) in enumerate(zip(photos, originals, strict=True)):
        for kind, picture in (("p", photo), ("o", original)):
            Image.fromarray(picture.permute(1, 2, 0).numpy()).save(folder / f"{kind}{i}.png")
        lines.append(f"p{i}.png,o{i}.png")
    (folder / "pairs.csv").write_text("\n".join(lines))


def run(folder, monkeypatch, *given):
    """Run the script on the pairs of a folder."""
    own = ["--quick", "--threads", "1", "--out", str(folder)]
    monkeypatch.setattr(sys, "argv", ["reality.py", str(folder / "pairs.csv"), *given, *own])
    runpy.run_path(str(ROOT / "benchmarks/reality.py"), run_name="__main__")


def test_the_benchmark_writes_figures(tmp_path, monkeypatch, capsys):
    write_pairs(tmp_path, 2)
    run(tmp_path, monkeypatch, "screen_photo", "--controls")
    assert "Told apart, 2 pictures" in capsys.readouterr().out
    found = json.loads((tmp_path / "reality.json").read_text())
    assert found["statistics"]["screen_photo"]["distance"] > 0
    scenes = ["the real photos", "the originals", "screen_photo"]
    assert [row["scene"] for row in found["told_apart"]] == [s for s in scenes for _ in range(2)]
    assert all(0 <= row["accuracy"] <= 1 for row in found["told_apart"])


def test_what_cannot_be_measured_is_refused(tmp_path, monkeypatch, capsys):
    for pairs, given, said in (
        (1, "screen_photo", "holds one pair, and telling photos apart needs at least two"),
        (2, "screen_photo --only agreement", "pass their folder, --classifiers DIR"),
        (2, "screen_photo --classifiers none", "there are no classifiers in none"),
        (2, "none.yaml", "none.yaml could not be read"),
    ):
        write_pairs(tmp_path, pairs)
        with pytest.raises(SystemExit):
            run(tmp_path, monkeypatch, *given.split())
        assert said in " ".join(capsys.readouterr().err.split())
        assert not (tmp_path / "reality.json").exists()


def test_the_benchmark_asks_classifiers(tmp_path, monkeypatch, capsys):
    write_pairs(tmp_path, 1)
    network = torchvision.models.squeezenet1_1(weights=None)
    torch.save(network.state_dict(), tmp_path / "squeezenet1_1.pth")
    given = ["screen_photo", "--only", "agreement", "--classifiers", str(tmp_path)]
    run(tmp_path, monkeypatch, *given)
    assert "Answers kept, of 1 pictures" in capsys.readouterr().out
    rows = json.loads((tmp_path / "reality-agreement.json").read_text())["agreement"]
    shrunk = ["shrunk to 48 px", "shrunk to 32 px"]
    own = ["its own size", "its own size, no moiré"]
    changed = ["moved by 2 px", "blurred by 0.7 px"]
    assert [row["shown"] for row in rows] == ["a screen", *shrunk, *changed, *own, *shrunk]
    assert {row["classifier"] for row in rows} == {"squeezenet1_1"}


def test_a_discriminator_tells_stripes_but_not_a_photo_from_itself():
    torch.set_num_threads(1)  # so small a network is no faster with more
    photos = pictures(8)
    stripes = 10 * torch.cos(torch.arange(64) * 2 * torch.pi / 8)
    striped = (photos.float() + stripes).round().clamp(0, 255).to(torch.uint8)
    crops = crops_of(photos, 2)
    told = told_apart.accuracy_of_telling(photos, striped[None], crops, EFFORT)
    same = told_apart.accuracy_of_telling(photos, photos[None], crops, EFFORT)
    assert min(told) > 0.9
    assert max(abs(accuracy - 0.5) for accuracy in same) < 0.2
