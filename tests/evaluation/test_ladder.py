"""The ladder: its controls show what they say, its rows count what they say, two models meet the same photos."""

import dataclasses

import pytest
import torch
from torch import nn

from moireaug import Scene, capture
from moireaug.evaluation import climb, ladder, no_moire, paired_gain, report, wilson
from moireaug.evaluation.pictures import examples
from moireaug.scene.presets import PRESETS

from .conftest import classifier

SCENE = Scene.preset("screen_photo")


def test_rows_count_what_they_say(known):
    model, data = known
    rungs = ladder((4 / 255, 64 / 255), steps=4)
    assert [r.name for r in rungs] == [
        "clean", "dimmed", "no_moire", "moire", "random_64", "ma_4", "ma_64", "ma_64_targeted", "pgd_64",
    ]  # fmt: skip
    *_, rows = climb(model, data, SCENE, rungs)
    table = {r.name: r.to_dict() for r in rows}
    assert table["clean"]["accuracy"] == 1.0 and table["clean"]["success"] == 0.0
    for row in table.values():
        assert row["n"] == 16 and row["counted"] == 16
        low, high = row["accuracy_interval"]
        assert 0 <= low <= row["accuracy"] <= high <= 1
        if not row["targeted"]:
            assert row["success"] == pytest.approx(1 - row["accuracy"])
    assert table["ma_64"]["accuracy"] <= table["ma_4"]["accuracy"] <= table["moire"]["accuracy"]
    assert table["ma_64"]["success"] > table["random_64"]["success"]
    assert table["ma_64_targeted"]["success"] <= table["ma_64"]["success"]


def test_success_is_counted_on_what_was_right_when_clean(known):
    model, data = known
    wrong = [(x, (y + (torch.arange(8) < 4)) % 4) for x, y in data]  # half of the labels are not what the model says
    *_, rows = climb(model, wrong, SCENE, ladder((8 / 255,), steps=2))
    clean = rows[0].to_dict()
    assert clean["accuracy"] == 0.5 and clean["counted"] == 8 and clean["success"] == 0.0


def test_two_models_meet_the_same_photos(known):
    seen = []

    class Spy(nn.Module):
        def forward(self, x):
            seen[-1].append(x.detach().clone())
            return x.mean((2, 3)) @ torch.ones(3, 4)

    rungs = [r for r in ladder() if r.name in ("dimmed", "no_moire", "moire", "random_8")]
    for _ in range(2):
        seen.append([])
        for _ in climb(Spy(), known[1], SCENE, rungs, seed=5):
            pass
    assert (
        len(seen[0]) == 12
    )  # the classes are counted on one image and all(torch.equal(a, b) for a, b in zip(*seen, strict=True))


@pytest.mark.parametrize("name", PRESETS)
def test_no_moire_is_the_photo_less_its_stripes(name):
    """On a grey screen without noise, nothing is left to see, and the mean light is the same."""
    scene = Scene.preset(name)
    quiet = dataclasses.replace(scene.sensor, read_noise=0.0, gain=1.0)
    still = dataclasses.replace(scene.view, yaw=0.0, pitch=0.0, roll=0.0, pose="camera")
    scene = dataclasses.replace(scene, sensor=quiet, view=still, lens=dataclasses.replace(scene.lens, k1=0.0))
    grey, shot = torch.full((2, 3, 24, 24), 0.5), scene.sample(2, (24, 24))
    with_stripes, without = capture(grey, shot), capture(grey, no_moire(shot))
    assert without[..., 2:-2, 2:-2].std((2, 3)).max() < 1e-5
    if name.startswith("paper"):
        assert with_stripes.std() > 0.05
    assert "layout" not in no_moire(shot).scene.plan()


def test_the_model_is_left_alone(known):
    model = classifier().train()
    state = {k: v.clone() for k, v in model.state_dict().items()}
    for _ in climb(model, known[1], SCENE, ladder((2 / 255,), steps=1)):
        pass
    assert model.training and all(torch.equal(v, model.state_dict()[k]) for k, v in state.items())


def test_labels_beyond_the_model_get_a_sentence(known):
    with pytest.raises(ValueError, match=r"\[0, 3\], the model's classes; got 9"):
        next(climb(known[0], [(torch.rand(1, 3, 8, 8), torch.tensor([9]))], SCENE))


def test_pictures_for_a_report(known):
    model, ((images, labels), _) = known
    shown = examples({"ours": model, "theirs": classifier(1)}, images[:2], labels[:2], SCENE, 8 / 255, 2, {0: "zero"})
    assert len(shown) == 2
    cells = shown[0]["cells"]
    assert [len(c["predictions"]) for c in cells] == [2, 2, 1, 0, 1, 0]
    assert all(c["image"].shape == (16, 16, 3) and c["image"].dtype.name == "uint8" for c in cells)
    assert cells[0]["predictions"][0][2] is True


@pytest.mark.parametrize(
    ("hits", "n", "expected"), [(0, 10, (0.0, 0.278)), (5, 10, (0.237, 0.763)), (10, 10, (0.722, 1.0))]
)
def test_wilson_against_published_values(hits, n, expected):
    assert wilson(hits, n) == pytest.approx(expected, abs=1e-3)


def test_nothing_counted_says_nothing():
    assert wilson(0, 0) == (0.0, 1.0)
    assert paired_gain(torch.zeros(0, dtype=torch.bool), torch.zeros(0, dtype=torch.bool)) == (0.0, -1.0, 1.0)


def test_paired_gain_covers_the_truth():
    """Simulated pairs: the 95 % interval holds the true difference about 95 times of 100; unpaired draws widen it."""
    g, covered, widths = torch.Generator().manual_seed(0), 0, []
    for _ in range(400):
        u = torch.rand(200, generator=g)
        theirs, ours = u < 0.5, u < 0.6
        flip = torch.rand(200, generator=g) < 0.1
        ours = ours ^ flip
        gain, low, high = paired_gain(ours, theirs)
        truth = 0.6 * 0.9 + 0.4 * 0.1 - 0.5
        covered += low <= truth <= high
        widths.append(high - low)
        assert low <= gain <= high
    assert 0.92 <= covered / 400 <= 0.985
    shuffled = paired_gain(ours, theirs[torch.randperm(200, generator=g)])
    assert shuffled[2] - shuffled[1] > 1.3 * sum(widths) / len(widths)


class SilentOn(nn.Module):
    """Answers NaN to dark images, whose argmax is class 0; the others get the model's own answer."""

    def __init__(self, model, level):
        super().__init__()
        self.model, self.level = model, level

    def forward(self, x):
        dark = x.mean((1, 2, 3)) < self.level
        return torch.where(dark[:, None], torch.nan, self.model(x))


def test_images_without_an_answer_are_wrong_and_counted(known):
    model, data = known
    zeros = [(x, torch.zeros_like(y)) for x, y in data]  # as if argmax of NaN were an answer
    *_, rows = climb(SilentOn(model, 0.5), zeros, SCENE, ladder((8 / 255,), steps=2))
    table = {r.name: r.to_dict() for r in rows}
    assert 0 < table["clean"]["undecided"] < 16
    assert all(r["accuracy"] <= 1 - r["undecided"] / 16 for r in table.values())
    said = report.summary({"reattack": list(table.values()), "model": "silent"})
    assert "(silent, clean image)" in said.splitlines()[-1] and "NaN or infinite" in said


def test_a_model_without_any_answer_is_evaluated_to_its_end(known):
    broken = SilentOn(known[0], 2.0)
    zeros = [(x, torch.zeros_like(y)) for x, y in known[1]]
    *_, rows = climb(broken, zeros, SCENE, ladder((8 / 255,), steps=2))
    assert all(r.accuracy == 0 and sum(r.undecided) == 16 for r in rows)
    shown = examples({"broken": broken}, zeros[0][0][:2], zeros[0][1][:2], SCENE, 8 / 255, 2, {0: "zero"})
    assert shown[0]["cells"][0]["predictions"] == [("broken", "no answer", False)]


def test_a_model_that_returns_a_dict_gets_a_sentence(known):
    with pytest.raises(ValueError, match=r"got a dict of 'logits'.*model\(images\)\['logits'\]"):
        next(climb(lambda x: {"logits": known[0](x)}, known[1], SCENE))
