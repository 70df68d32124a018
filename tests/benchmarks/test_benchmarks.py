"""Every benchmark runs in its quick form. No time is asserted."""

import itertools
import math
import re
import sys

import numpy as np
import pandas as pd
import pytest
import torch

from benchmarks import (
    accuracy_vs_time,
    attack_budget,
    bins,
    detecting,
    effects_cost,
    memory_and_starts,
    other_libraries,
    rejecting,
    released,
    suites,
    training_steps,
    watermark_networks,
    worst_photos,
)
from moireaug import Scene, capture, evaluation
from moireaug.defenses import Rejecting
from tests.benchmarks.conftest import QUICKLY, ROOT
from tests.training.small import TINY, configured, train
from tests.training.strangers import put
from training.detection.labelled import LabelledPhotos


def test_a_script_finds_the_repository_from_anywhere():
    own_import = re.compile(r"^(from|import) (benchmarks|training|moireaug)\b", re.MULTILINE)
    for file in ROOT.glob("benchmarks/*.py"):
        text = file.read_text("utf-8")
        if '__name__ == "__main__"' in text and own_import.search(text):
            before, found, _ = text.partition("\nsys.path")
            assert found and not own_import.search(before), file.name


def test_accuracy_vs_time(ran, tmp_path):
    _, table = ran("accuracy_vs_time")
    assert (tmp_path / "accuracy_vs_time.png").is_file()
    assert table["problem"].nunique() == len(accuracy_vs_time.QUICK_SETTINGS["problems"])
    assert (table[["ms_low", "ms", "ms_high", "max_percent", "ciede2000"]] > 0).all(axis=None)
    for title, rows in table.groupby("problem"):
        error = rows.set_index("method")["rmse_percent"]
        assert list(error.index) == list(accuracy_vs_time.METHODS)
        assert error["supersample:8"] < error["supersample:2"]
        assert error["auto"] < error["point"] / 5
        left = rows["brute_force_percent"].iloc[0]
        assert 0 < left < 15 and error["auto"] <= math.hypot(1, left), title


def test_bins(ran):
    _, written = ran("bins")
    rows = written["rows"]
    assert len(rows) == len(list(bins.problems(bins.QUICK_SETTINGS))) * len(bins.TOLERANCES)
    for row in rows:
        assert 0 < row["binned_error"] < row["moire"]
        assert row["full_error"] < 0.01 * row["moire"]  # it differs by its tolerance alone
        assert row["times_as_fast"] == pytest.approx(row["full_ms"] / row["binned_ms"])


def test_effects_cost(ran):
    _, written = ran("effects_cost")
    effects = {row["effect"]: row for row in written["default_photo"]["effects"]}
    assert effects.keys() == {
        *effects_cost.REMOVED_EFFECTS,
        *effects_cost.ADDED_EFFECTS,
        *effects_cost.CONSTANT_STAGES,
    }
    whole = written["default_photo"]["seconds"]["median"]
    assert effects["pose"]["share"] == pytest.approx(effects["pose"]["seconds"] / whole)
    assert effects["jpeg"]["run_by"] == "expose and develop; reference from 'jpeg' on"


def test_speed(ran, monkeypatch, capsys):
    def run_here(code):
        capsys.readouterr()
        exec(code, {})
        return capsys.readouterr().out or 0

    monkeypatch.setattr(memory_and_starts, "run_apart", run_here)  # imports of torch take seconds
    out, written = ran("speed")
    assert sum(row["bar"] is not None for row in written["rows"]) == 15
    for row in written["rows"]:
        assert row["what"] in out
        assert row["value"] >= 0 or "above" in row["what"]  # a difference of two times
        assert row["met"] == (row["ratio"] <= row["bar"] if row["bar"] else None)


def test_code_runs_in_an_interpreter_of_its_own():
    assert memory_and_starts.run_apart("import os; print(os.environ['KEY'])", KEY="1") == "1\n"


def test_the_plain_chain_is_the_capture():
    scene, image = Scene.preset("paper_code"), torch.rand(1, 3, 21, 21, dtype=torch.float64)
    shot = scene.sample(1, (21, 21))
    assert (released.photograph(image, shot.matrix()) - capture(image, shot)).abs().max() < 1e-6


def test_training_steps(ran):
    _, written = ran("training_steps")
    rows = {row["recipe"]: row for row in written["recipes"]}
    assert rows.keys() == {p.stem for p in (ROOT / "recipes").glob("*.yaml")}
    assert rows["clean"]["relative"] == 1 and rows["clean"]["passes"] == 1
    assert rows["moire_at"]["passes"] == 2.875 and rows["moire_at"]["relative"] > 0
    assert all(row["loaded"] > 0 and row["share"] > 0 for row in written["loading"])
    read = [(row["read_from"], row["workers"]) for row in written["loading"]]
    assert read == list(training_steps.READ_SOURCES)


def test_gpu(ran):
    """On the CPU, where there is no GPU."""
    _, written = ran("gpu")
    for group in ("photos", "stages", "attacks", "training"):
        assert written[group] and all(row["seconds"]["median"] > 0 for row in written[group])
    shares = {row["what"]: row["camera_share"] for row in written["training"]}
    assert shares["small_resnet, plain"] is None and shares["small_resnet, moire_at"] < 1


def test_attack_budget(ran):
    out, table = ran("attack_budget")
    names, steps = attack_budget.attackers(1), attack_budget.QUICK_SETTINGS["steps"]
    assert set(zip(table["attacker"], table["steps"], strict=True)) == set(
        itertools.product(names, steps)
    )
    assert table["accuracy"].between(0, 1).all() and (table["seconds_per_image"] > 0).all()
    best = attack_budget.recommended(table.to_dict("records"))
    assert f"lowest accuracy: {best['attacker']}, {best['steps']} steps" in out


def test_suites(tmp_path, monkeypatch):
    run, _ = train(configured("recipe=clean", *TINY, f"runs={tmp_path / 'runs'}"))
    monkeypatch.setattr(sys, "argv", ["suites.py", str(run.folder), *QUICKLY[:-1], str(tmp_path)])
    suites.main()
    table = pd.read_csv(tmp_path / "suites.csv").set_index("suite")
    assert tuple(table.index) == suites.QUICK_SETTINGS["suites"] and set(table["n"]) == {1}
    assert table["cpu_minutes"].tolist() == pytest.approx(
        (8 * table["cpu_seconds"]).tolist(), rel=1e-3
    )
    monkeypatch.setattr(sys, "argv", ["worst_photos.py", *sys.argv[1:]])
    worst_photos.main()
    table = pd.read_csv(tmp_path / "worst_photos.csv")
    assert table["row"].tolist() == ["worst of 1"] * 2 + ["worst of 2"] * 2
    few, many = (table[table["row"] == f"worst of {n}"]["accuracy"].to_numpy() for n in (1, 2))
    assert (many <= few).all()


def test_synthesis(ran):
    rows = ran("synthesis")[1]["rows"]
    encodings = {(row["encoding"], row["quality"]) for row in rows}
    assert encodings == {("png", None), ("webp", None), ("webp", 90), ("jpeg", 95)}
    for row in rows:
        parts = [row[name]["mean"] for name in ("make", "encode", "write")]
        assert row["whole"]["mean"] == pytest.approx(sum(parts))
    # three pictures where there were two
    assert [row["twin"] for row in rows] == [False] * 4 + [True] * 4
    for one, three in zip(rows[:4], rows[4:], strict=True):
        assert three["bytes"] > one["bytes"]


def test_the_strength_of_a_wave_is_its_own():
    """Of a sinusoid in green on grey; its period is inside the band."""
    x = torch.arange(64) / 8
    grey = torch.full((2, 3, 64, 64), 0.5)
    waved = grey.clone()
    waved[:, 1] += 0.1 * (2 * torch.pi * x).sin()
    colour, luma = other_libraries.strength(waved, grey)
    wave = 25.5 / 2**0.5  # in codes; R - G and B - G carry it whole, luma a third
    assert colour == pytest.approx(2**0.5 * 3 * luma, rel=1e-3)
    assert 0.4 * wave < luma * 3 < wave
    assert other_libraries.strength(grey, grey) == (0, 0)


def test_a_ridge_regression_tells_few_from_many():
    x = torch.randn(60, 5, generator=torch.Generator().manual_seed(0))
    y = (torch.arange(60) < 10).float()
    x[:, 2] += 8 * y
    scores = other_libraries.ridge(x, y)(x)
    assert scores[:10].min() > scores[10:].max()


def test_rejected_photos_are_neither_fooled_nor_let_through():
    torch.manual_seed(0)
    images, labels = torch.rand(4, 3, 24, 24), torch.zeros(4, dtype=torch.int64)
    detector = rejecting.train_detector(images, [Scene.preset("screen_photo")], 2)
    model = Rejecting(lambda images: images.mean((2, 3)), detector, -1e6)
    frame = evaluation.evaluate(model, [(images, labels)], "ladder", steps=1, progress=False)
    (row, *_) = rejecting.outcome_rows(frame, "knows the detector")
    assert row["rejected"] == 1 and row["fooled"] == 0 and math.isnan(row["accuracy_of_passed"])


def test_the_detector_is_trained_on_crops_where_the_run_was(tmp_path, monkeypatch):
    def train_detector(images, scenes, batches):
        raise StopIteration(scenes)

    monkeypatch.setattr(rejecting, "train_detector", train_detector)
    with pytest.raises(StopIteration) as trained:
        rejecting.measure_run(put(tmp_path, "shrink=[1,3]"), rejecting.QUICK_SETTINGS)
    (scene,) = trained.value.value
    assert scene.sensor.shrink == (1, 3)


def test_a_folder_without_a_run_is_refused_in_a_sentence(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["attack_budget.py", "nowhere"])
    with pytest.raises(SystemExit):
        attack_budget.main()
    assert "nowhere is not a run's folder" in capsys.readouterr().err


def test_the_recommended_budget_is_the_cheapest_that_is_near():
    rows = [
        {"attacker": "quick", "steps": 1, "accuracy": 0.5, "n": 100, "seconds_per_image": 1.0},
        {"attacker": "near", "steps": 5, "accuracy": 0.31, "n": 100, "seconds_per_image": 2.0},
        {"attacker": "best", "steps": 50, "accuracy": 0.30, "n": 100, "seconds_per_image": 9.0},
    ]
    assert attack_budget.recommended(rows)["attacker"] == "near"
    assert attack_budget.recommended([rows[0], rows[2]])["attacker"] == "best"


def test_watermarks(ran):
    said, table = ran("watermarks")
    assert len(table["trained with"].unique()) == 4 and len(table) == 4 * 5
    assert table["psnr"].between(35.9, 38.0).all() and table["bit errors"].between(0.2, 0.8).all()
    assert "unseen preset" in said


def test_marks_have_their_psnr_and_layers_keep_pictures():
    images, bits = torch.rand(4, 3, 128, 128) * 0.6 + 0.2, torch.randint(0, 2, (4, 64)).float()
    marked = watermark_networks.Encoder()(images, bits, 40.0)
    psnr = -10 * (marked - images).square().mean((1, 2, 3)).log10()
    assert psnr.tolist() == pytest.approx([40.0] * 4, abs=0.01)
    for layer in (watermark_networks.CropBlurJpeg(), watermark_networks.PimogLike()):
        shown = images.clone().requires_grad_()
        photos = layer(shown)
        assert photos.shape == images.shape and photos.min() >= 0 and photos.max() <= 1
        assert not torch.equal(layer(images)[0], photos[0])  # a draw for each call
        (gradient,) = torch.autograd.grad(photos.sum(), shown)
        assert (gradient != 0).float().mean() > 0.9
    assert watermark_networks.Decoder()(marked).shape == (4, 64)


def test_a_collection_is_scored_by_heads_of_the_others():
    generator = torch.Generator().manual_seed(0)
    truth = torch.arange(40) % 2 == 0
    group = np.repeat(["one", "other"], 20)
    signs = torch.from_numpy(np.where(group == "one", 1.0, -1.0)).float() * (2.0 * truth - 1)
    crops = signs[:, None, None] + 0.1 * torch.randn(40, 5, 3, generator=generator)
    photos = LabelledPhotos([""] * 40, crops, crops.mean(1), truth)
    scores = detecting.of_others(photos, group)
    for name in ("one", "other"):  # what tells them apart here says the opposite there
        rows = torch.from_numpy(group == name)
        assert scores[rows & truth].max() < scores[rows & ~truth].min()
    ordinary = {"crop": -crops[:20][~truth[:20]], "whole": -crops[:20].mean(1)[~truth[:20]]}
    found = detecting.with_own(photos, group == "one", 5, detecting.NONE, ordinary)
    assert found["auc"] == 1 and found["eer"] == 0
