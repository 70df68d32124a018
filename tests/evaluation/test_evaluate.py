"""The public function: a stranger's model, in a few lines."""

import dataclasses
import sys
import warnings

import numpy as np
import pytest
import torch
from torch import nn
from torch.utils.data import DataLoader, TensorDataset

from moireaug import evaluation
from moireaug.attacks import MoireAttack
from moireaug.defenses import JPEG, Defended, Median, Quilting, TotalVariation
from moireaug.evaluation import SuiteConfig, Table, evaluate, rates, tables_of
from moireaug.evaluation.attackers import MoireAttacker
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier
from moireaug.evaluation.conditions import Clean
from moireaug.evaluation.tables import cross, paper_defences
from moireaug.scene.draws import mix_seeds
from moireaug.scenes import Scene
from tests.attacks.common import counting
from tests.evaluation.haze import frame_of
from tests.evaluation.suite_checks import check_bounds_of_rows

SCENE = Scene.preset("screen_photo")
QUICK = {"eps": 4 / 255, "steps": 1, "progress": False}


@pytest.fixture(scope="module")
def loader(known):
    images, labels = (torch.cat(parts) for parts in zip(*known[1], strict=True))
    return DataLoader(TensorDataset(images, labels), batch_size=8)


@pytest.fixture(scope="module")
def frame(known, loader):
    return evaluate(known[0], loader, **QUICK)


def test_a_frame_has_a_line_a_cell_and_image(frame):
    lines = rates(frame)
    assert len(frame) == 16 * len(lines) and set(frame["table"]) == {"ladder"}
    assert list(frame.columns[:3]) == ["table", "row", "column"] and "ma_4" in set(frame["row"])
    for row, cell in frame.groupby("row"):
        line = lines.set_index("row").loc[row]
        assert sorted(cell["image"]) == list(range(16))
        assert line["accuracy"] == cell["correct"].mean()
        # a row that is each image's worst has no answer of its own
        answered = cell[cell["predicted"].notna()]
        assert len(answered) == (0 if row.startswith("worst") else 16)
        assert (answered["correct"] == (answered["predicted"] == answered["label"])).all()
    attacks = frame[~frame["control"] & frame["predicted"].notna()]
    assert attacks["psnr"].notna().all() and frame[frame["control"]]["psnr"].isna().all()


def test_any_callable_any_loader_and_inference_mode_will_do(known, loader, frame):
    model, batches = known
    empty = (torch.rand(0, 3, 16, 16), torch.zeros(0, dtype=torch.long))
    with torch.inference_mode():
        inferred = evaluate(lambda x: model(x), loader, **QUICK)
    again = evaluate(model, [empty, *batches, empty], **QUICK)
    assert frame["predicted"].equals(inferred["predicted"])
    assert frame["predicted"].equals(again["predicted"])


def test_generators_arrays_and_bytes_are_taken(known):
    model, batches = known
    codes = [((255 * x).round().byte(), y) for x, y in batches]
    settings = QUICK | {"n": np.uint8(11), "steps": np.int64(0), "seed": np.int64(2**40)}
    found = evaluate(model, ((x.numpy(), y.numpy()) for x, y in codes), **settings)
    same = evaluate(model, [(x.float() / 255, y) for x, y in codes], **settings)
    assert found["image"].nunique() == 11 and found["predicted"].equals(same["predicted"])


def test_a_suite_attacks_at_the_bounds_asked_for():
    config = SuiteConfig(scene=SCENE, steps=1)
    (usual,) = tables_of("standard", config)
    (asked,) = tables_of("standard", dataclasses.replace(config, eps=(8 / 255, 1 / 255)))
    assert usual.rows == ["eps_4", "eps_8"] and asked.rows == ["eps_1", "eps_8"]
    for table in (usual, asked):
        check_bounds_of_rows(table)


def test_a_defence_stands_beside_the_papers():
    defences = paper_defences() | {"jpeg_75": JPEG(75)}
    (table,) = tables_of("adaptive", SuiteConfig(scene=SCENE, defences=defences))
    assert "jpeg_75" in table.rows and "jpeg_80" not in table.rows


def test_a_suite_of_ones_own(known):
    """With the options that the library's suites are asked for by name."""

    def transfer_to_itself(config):
        itself = Classifier("itself", model=config.targets["itself"])
        attacker = MoireAttacker(eps=config.middle, steps=config.steps)
        rows = {"attacked": UNDEFENDED, "itself": itself}
        return Table("transfer_to_itself", tuple(cross(rows, {"ma": attacker})))

    settings = {"suite": transfer_to_itself, "eps": 8 / 255, "steps": 1, "progress": False}
    lines = rates(evaluate(*known, **settings, targets={"itself": known[0]})).set_index("row")
    assert lines["eps"].tolist() == [8 / 255] * 2
    assert lines["outcomes"]["attacked"] == lines["outcomes"]["itself"]


def test_labels_and_classes_are_checked_before_the_first_attack(known):
    model, (batch, (images, labels)) = known
    counted, asked = counting(model)
    for label, allowed in ((-1, ">= 0"), (4, r"in \[0, 3\]")):
        later = (images, torch.full_like(labels, label))
        with pytest.raises(ValueError, match=f"{allowed}.*; got {label}"):
            evaluate(counted, [batch, later], progress=False)
    assert asked == [1]


class Rounded(torch.nn.Module):
    """A defence that hides its gradient, in steps that the noise crosses."""

    def forward(self, images):
        return (8 * images).round() / 8


def test_a_defence_that_hides_its_gradient_is_searched_without(known):
    defences = paper_defences() | {"mine": Rounded()}
    config = SuiteConfig(scene=SCENE, eps=(24 / 255,), steps=1, defences=defences)
    (table,) = tables_of("adaptive", config)
    assert table.columns[-2:] == ["square", "worst"]
    assert [cell.row for cell in table.cells if cell.column == "square"] == ["mine"]
    own = Table("mine", tuple(cell for cell in table.cells if cell.row == "mine"))
    frame = frame_of((known[0], known[1][:1]), own)
    fooled = frame.groupby("column")["fooled"].sum()
    assert fooled["adaptive"] == fooled["moire"] < fooled["square"] <= fooled["worst"]


def test_a_defence_under_a_name_of_the_papers_is_searched_without_gradients_too():
    own = {"jpeg_60": Rounded(), "quilting": Rounded(), "median_3": Median(3)}
    config = SuiteConfig(scene=SCENE, steps=1, defences=paper_defences() | own)
    (table,) = tables_of("adaptive", config)
    searched = [cell.row for cell in table.cells if cell.column == "square"]
    assert searched == ["jpeg_60", "quilting"]
    for row in searched:
        worst, square = table.cell(row, "worst"), table.cell(row, "square")
        assert square.conditions[0] in worst.conditions
    papers = {"quilting": Quilting(torch.rand(4, 3, 5, 5))}
    config = SuiteConfig(scene=SCENE, steps=1, defences=paper_defences() | papers)
    (table,) = tables_of("adaptive", config)
    assert "quilting" in table.rows and "square" not in table.columns


def test_the_attack_is_the_attack(known, frame):
    """The frame's figure is what MoireAttack finds by itself on the same shots."""
    model, batches = known
    attack, found = MoireAttack(model, scene=SCENE, eps=4 / 255, steps=1), []
    for index, (images, labels) in enumerate(batches):
        shot = SCENE.sample(8, (16, 16), torch.Generator().manual_seed(mix_seeds(0, index, 0)))
        found += attack(images, labels, shot=shot).success.tolist()
    assert frame[frame["row"] == "ma_4"]["fooled"].tolist() == found and 0 < sum(found) < 16


def test_records_are_taken_up(known, loader, tmp_path, monkeypatch):
    first = evaluate(known[0], loader, **QUICK, folder=tmp_path)
    (file,) = tmp_path.glob("records-*.jsonl")
    lines = file.read_text()

    def never(*_, **__):
        raise AssertionError("attacked again")

    monkeypatch.setattr(MoireAttack, "__call__", never)
    again = evaluate(known[0], loader, **QUICK, folder=tmp_path)
    assert again.equals(first) and file.read_text() == lines
    with pytest.raises(AssertionError, match="attacked again"):
        evaluate(known[0], loader, **QUICK | {"steps": 2}, folder=tmp_path)


def test_a_stated_identity_takes_up_the_records_of_a_function(known, tmp_path):
    model, batches = known
    settings = QUICK | {"folder": tmp_path, "n": 4}
    frames = []
    for name in ("v1", "v1", b"v1"):
        frames.append(evaluate(lambda x: model(x), batches, identity=name, **settings))
    assert frames[0].equals(frames[1])
    assert not frames[0].equals(frames[2])  # attacked again: other seconds
    assert frames[0]["predicted"].equals(frames[2]["predicted"])


def test_a_suite_of_several_tables(known):
    settings = {"suite": "recipes", "scene": "phone_at_laptop", "steps": 1, "n": 2}
    lines = rates(evaluate(*known, **settings, progress=False))
    assert set(lines["table"]) == set(evaluation.GROUPS["recipes"])
    assert np.isfinite(lines["success"]).all()


def test_without_a_terminal_no_bar_is_shown(known, loader, monkeypatch):
    """As in daemons, and in programs without a console."""
    for stream in ("stdout", "stderr"):
        monkeypatch.setattr(sys, stream, None)
    assert len(evaluate(*known, **QUICK | {"n": 2, "progress": True}))


def test_the_global_generator_is_left_alone(known):
    model = Defended(known[0], TotalVariation(iterations=1))
    state = torch.get_rng_state()
    evaluate(model, known[1], suite="unseen", progress=False)
    assert torch.equal(torch.get_rng_state(), state)


def test_a_model_at_chance_is_warned_about():
    """As one of normalised images; its answers have nothing to do with the labels."""
    images = torch.rand(24, 3, 16, 16)
    model = nn.Sequential(nn.Flatten(), nn.Linear(768, 4)).eval()
    right = model(images).argmax(1)
    wrong = (right + 1) % 4
    settings = {"suite": "unseen", "progress": False}
    with pytest.warns(UserWarning, match=r"gets 0 of 24 clean .* among 4 .*attacks\.Normalized"):
        evaluate(model, [(images, wrong)], **settings)
    with pytest.warns(UserWarning, match="gets 0 of 20 clean"):
        evaluate(model, [(images[:10], wrong[:10]), (images[10:20], wrong[10:20])], **settings)
    evaluate(model, [(images, right)], **settings)
    evaluate(model, [(images, wrong)], **settings, n=19)  # too few to tell


def test_a_few_mistakes_are_not_called_guessing():
    """14 of 20 by a model of two classes say little, 140 of 200 that it does not guess, and 55 of
    100 that it may; a warning comes once."""

    def first_class(images):
        return torch.tensor([1.0, 0.0]).expand(len(images), 2)

    def clean(config):
        return Table("clean", tuple(cross({"model": UNDEFENDED}, {"clean": Clean()})))

    for n_right, n, n_warnings in ((14, 20, 0), (140, 200, 0), (55, 100, 1), (0, 200, 1)):
        labels = (torch.arange(n) >= n_right).long()
        images = torch.zeros(n, 3, 8, 8)
        batches = [(images[::2], labels[::2]), (images[1::2], labels[1::2])]
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            evaluate(first_class, batches, suite=clean, progress=False)
        told = [one for one in caught if "as guessing" in str(one.message)]
        assert len(told) == n_warnings, (n_right, n)


def test_rates_print_as_a_table(known, frame):
    lines = rates(frame)
    head, columns, *rows = str(lines).splitlines()
    assert head.startswith("ladder, accuracy and success in % [95 %], eps in 1/255")
    assert columns.split() == ["column", "eps", "codes", "dB", "moiré", "accuracy", "success", "n"]
    assert len(rows) == len(lines) and max(map(len, rows)) < 100
    attack = lines.set_index("row").loc["ma_4"]
    low, high = 100 * attack["accuracy_low"], 100 * attack["accuracy_high"]
    shown = f"{100 * attack['accuracy']:.1f} [{low:.1f}, {high:.1f}]"
    (row,) = [row for row in rows if row.split()[0] == "ma_4"]
    assert shown in row and f"{255 * attack['largest']:.3g}" in row.split()
    (row,) = [row for row in rows if row.split()[0] == "moire"]
    assert f"{lines.set_index('row').loc['moire', 'moire']:.2g}" in row.split()
    lines["moire"] = np.nan
    assert "moiré" not in str(lines)
    assert "outcomes" in str(lines[["row", "outcomes"]])  # a part of it is pandas'
    del lines["psnr"]
    assert "outcomes" in lines.to_string() and "psnr" not in str(lines)
