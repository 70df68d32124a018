"""Every benchmark runs in its quick form. No time is asserted."""

import itertools
import json
import math
import re
import runpy
import sys
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
import torch
from PIL import Image

from benchmarks import (
    accuracy_vs_time,
    attack_budget,
    bins,
    codes,
    detecting,
    effects_cost,
    memory_and_starts,
    other_libraries,
    rejecting,
    released,
    suites,
    text,
    text_pairs,
    training_steps,
    watermark_networks,
)
from moireaug import Scene, capture, evaluation
from moireaug.defenses import Rejecting
from tests.training.small import TINY, configured, train
from tests.training.strangers import put

ROOT = Path(__file__).resolve().parents[2]
QUICKLY = ["--quick", "--threads", "1", "--out", "."]


def test_a_script_finds_the_repository_from_anywhere():
    own_import = re.compile(r"^(from|import) (benchmarks|training|moireaug)\b", re.MULTILINE)
    for file in ROOT.glob("benchmarks/*.py"):
        text = file.read_text("utf-8")
        if '__name__ == "__main__"' in text and own_import.search(text):
            before, found, _ = text.partition("\nsys.path")
            assert found and not own_import.search(before), file.name


@pytest.fixture
def ran(tmp_path, monkeypatch, capsys):
    """Run a script in this process: what it printed, and what it wrote."""

    def run(name):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [f"{name}.py", *QUICKLY])
        runpy.run_path(str(ROOT / f"benchmarks/{name}.py"), run_name="__main__")
        file = tmp_path / f"{name}.json"
        written = json.loads(file.read_text()) if file.exists() else pd.read_csv(f"{name}.csv")
        return capsys.readouterr().out, written

    return run


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


def test_codes(ran, tmp_path):
    _, table = ran("codes")
    assert set(table["code"]) == {"Data Matrix"}  # others are too large at this size
    assert table["photo, zxing-cpp"].between(0, 1).all() and (table["moire"] > 0.1).all()
    assert (tmp_path / "codes.png").stat().st_size > 1000


def test_real_photos_of_codes_are_read_at_each_size(tmp_path):
    picture = (255 * codes.drawn("QR", 7, 256)).byte().permute(1, 2, 0).contiguous().numpy()
    for name, pixels in (("code.png", picture), ("blank.png", np.full_like(picture, 255))):
        Image.fromarray(pixels).save(tmp_path / name)
    rows = codes.rows_of_real(tmp_path, codes.Sizes(modules=(1, 4)))
    assert [row["module"] for row in rows] == [0, 1, 4] and {row["n"] for row in rows} == {2}
    assert rows[0]["zxing-cpp"] == rows[2]["zxing-cpp"] == 0.5
    assert rows[0]["median_pixels"] == pytest.approx(7 / 2, abs=0.3)  # of 7 and of none


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


def test_text(ran, tmp_path):
    pytest.importorskip("rapidocr_onnxruntime")
    _, table = ran("text")
    assert set(table["state"]) == {"picture", "photo", "twin", "cleaned"}
    assert (table.loc[table["state"] == "picture", "error"] < 0.05).all()
    assert (tmp_path / "text.png").stat().st_size > 1000


def test_pages_are_drawn_with_their_text():
    for kind in ("page", "interface"):
        page, again, other = (text.drawn(kind, 16, 256, seed) for seed in (0, 0, 1))
        assert torch.equal(page.picture, again.picture) and page.text == again.text != other.text
        assert len(page.text) > 40 and not set(page.text) & set(" \n")
        assert page.picture.shape == (3, 256, 256) and page.picture.std() > 0.1


def test_a_photo_is_brought_to_its_screenshot_s_frame():
    pages = [text.drawn(kind, 26, 400, seed).picture for seed, kind in enumerate(text.KINDS)]
    screenshot = (255 * torch.cat(pages, 2)).byte().permute(1, 2, 0).contiguous().numpy()
    seen = np.array([[120, 40], [560, 70], [540, 370], [100, 350]], np.float32)
    corners = np.array([[0, 0], [599, 0], [599, 399], [0, 399]], np.float32)
    to_photo = cv2.getPerspectiveTransform(seen, corners)
    photo = cv2.warpPerspective(screenshot, to_photo, (600, 400))
    part = text_pairs.part_of(photo, screenshot)
    middle = np.s_[40:-40, 40:-40]
    difference = part.photo[middle].astype(float) - part.picture[middle]
    assert np.abs(difference).mean() < 0.25 * screenshot.std()
    assert part.panel_pixels == pytest.approx(420, abs=5)  # between the inner two of four corners
    assert part.shrink == pytest.approx(4032 / 600)
    assert text_pairs.part_of(np.full_like(photo, 128), screenshot) is None


def test_codes_as_they_are_drawn_are_read():
    for code in codes.TEXTS:
        picture = codes.drawn(code, 2, 256)
        photo = (255 * picture).byte().permute(1, 2, 0).contiguous().numpy()
        readers = [name for name in codes.READERS if (name, code) != ("OpenCV", "Data Matrix")]
        assert all(codes.READERS[name](code, photo) for name in readers), code
        blank = np.full_like(photo, 255)
        assert not any(codes.READERS[name](code, blank) for name in readers)
    assert codes.drawn("QR", 8, 128) is None


def test_a_collection_is_scored_by_heads_of_the_others():
    generator = torch.Generator().manual_seed(0)
    truth = torch.arange(40) % 2 == 0
    group = np.repeat(["one", "other"], 20)
    signs = torch.from_numpy(np.where(group == "one", 1.0, -1.0)).float() * (2.0 * truth - 1)
    crops = signs[:, None, None] + 0.1 * torch.randn(40, 5, 3, generator=generator)
    scores = detecting.of_others(crops, crops.mean(1), truth, group)
    for name in ("one", "other"):  # what tells them apart here says the opposite there
        rows = torch.from_numpy(group == name)
        assert scores[rows & truth].max() < scores[rows & ~truth].min()
