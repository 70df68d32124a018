"""The public function: a stranger's model, in a few lines."""

import dataclasses

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, TensorDataset

from moireaug import capture, evaluation
from moireaug.attacks import MoireAttack
from moireaug.defenses import JPEG, Defended, TotalVariation
from moireaug.draws import mix_seeds
from moireaug.evaluation import (
    Cell,
    SuiteConfig,
    Table,
    evaluate,
    images_frame,
    rates,
    tables_of,
)
from moireaug.evaluation.conditions import Photo
from moireaug.evaluation.records import RecordFolder
from moireaug.evaluation.tables import paper_defences
from moireaug.scenes import Scene
from tests.evaluation.haze import ran

SCENE = Scene.preset("screen_photo")


@pytest.fixture
def loader(known):
    images, labels = (torch.cat(parts) for parts in zip(*known[1], strict=True))
    return DataLoader(TensorDataset(images, labels), batch_size=8)


def test_a_frame_has_a_line_a_cell_and_image(known, loader):
    frame = evaluate(known[0], loader, steps=2, progress=False)
    lines = rates(frame)
    assert len(frame) == 16 * len(lines) and set(frame["table"]) == {"ladder"}
    assert list(frame.columns[:3]) == ["table", "row", "column"]
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


def test_any_callable_will_do(known, loader):
    model = known[0]
    frame = evaluate(lambda x: model(x), loader, steps=2, progress=False)
    whole = evaluate(model, loader, steps=2, progress=False)
    assert frame["predicted"].equals(whole["predicted"])


def test_any_loader_will_do(known):
    """Lists, generators, numpy and bytes; n may cut a batch."""
    model, batches = known
    images = [(255 * x).round().byte() for x, _ in batches]
    pairs = [(x.numpy(), y.numpy()) for x, (_, y) in zip(images, batches, strict=True)]
    frame = evaluate(model, (pair for pair in pairs), steps=1, n=11, progress=False)
    exact = [(x.float() / 255, y) for x, (_, y) in zip(images, batches, strict=True)]
    same = evaluate(model, exact, steps=1, n=11, progress=False)
    assert frame["image"].nunique() == 11 and frame["predicted"].equals(same["predicted"])


def test_empty_batches_are_left_out_and_one_bound_is_a_number(known):
    model, batches = known
    empty = (torch.rand(0, 3, 16, 16), torch.zeros(0, dtype=torch.long))
    given = [empty, *batches, empty]
    frame = evaluate(model, given, steps=1, eps=4 / 255, progress=False)
    assert frame["image"].nunique() == 16 and "ma_4" in set(frame["row"])


@pytest.mark.parametrize(
    ("suite", "own"),
    [
        ("success", ["eps_2", "eps_4", "eps_6", "eps_8"]),
        ("budget", ["eps_4", "eps_8", "eps_16", "eps_32"]),
        ("standard", ["eps_4", "eps_8"]),
    ],
)
def test_a_suite_attacks_at_the_bounds_asked_for(suite, own):
    config = SuiteConfig(scene=SCENE, steps=1)
    (usual,), (asked,) = (
        evaluation.tables_of(suite, dataclasses.replace(config, eps=eps))
        for eps in (None, (8 / 255, 1 / 255))
    )
    assert usual.rows == own and asked.rows == ["eps_1", "eps_8"]
    for table in (usual, asked):
        for cell in table.cells:
            attacked = [one for one in cell.conditions if not one.control]
            assert all(f"eps_{one.eps * 255:g}" == cell.row for one in attacked)
        assert {row for row, _ in table.pictures} <= set(table.rows)


@pytest.mark.parametrize("suite", ["defences", "adaptive"])
def test_a_defence_stands_beside_the_papers(suite):
    defences = paper_defences() | {"jpeg_75": JPEG(75)}
    (table,) = tables_of(suite, SuiteConfig(scene=SCENE, defences=defences))
    assert "jpeg_75" in table.rows and "jpeg_80" not in table.rows


def test_labels_and_classes_are_checked_before_the_first_attack(known):
    model, (batch, (images, labels)) = known
    asked = []

    def counting(images):
        asked.append(len(images))
        return model(images)

    for label, allowed in ((-1, ">= 0"), (4, r"in \[0, 3\]")):
        later = (images, torch.full_like(labels, label))
        with pytest.raises(ValueError, match=f"{allowed}.*; got {label}"):
            evaluate(counting, [batch, later], progress=False)
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
    frame = images_frame([own], ran(known, own, (0,)), (0,))
    fooled = frame.groupby("column")["fooled"].sum()
    assert fooled["adaptive"] == fooled["moire"] < fooled["square"] <= fooled["worst"]


class Tinted(torch.nn.Module):
    """A defence that leaves one colour."""

    def __init__(self, channel):
        super().__init__()
        self.register_buffer("kept", torch.eye(3)[channel], persistent=False)

    def forward(self, images):
        return images * self.kept[:, None, None]


def test_another_defence_of_one_name_is_another(known, tmp_path):
    """The records of one are not taken for the other."""
    model, batches = known
    found = []
    for channel in range(3):
        judge = SuiteConfig(scene=SCENE, defences={"mine": Tinted(channel)}).behind("mine")
        table = Table("mine", (Cell("mine", "moire", (Photo(),), judge),))
        with RecordFolder(tmp_path) as records:
            runner = ran(known, table, seed=0, records=records)
            kept = images_frame([table], runner, (0, 1))["predicted"].tolist()
        with torch.no_grad():
            kept_colour = torch.eye(3)[channel][:, None, None]
            shot = SCENE.sample(8, (16, 16), torch.Generator().manual_seed(mix_seeds(0, 0, 0)))
            expected = model(capture(batches[0][0], shot) * kept_colour).argmax(1).tolist()
        assert kept[:8] == expected
        found.append(tuple(kept))
    assert len(set(found)) > 1


def test_without_gradients_and_in_inference_mode(known, loader):
    with torch.inference_mode():
        frame = evaluate(known[0], loader, steps=1, progress=False)
    same = evaluate(known[0], loader, steps=1, progress=False)
    assert frame["predicted"].equals(same["predicted"])


def test_the_attack_is_the_attack(known, loader):
    """The frame's figure is what MoireAttack finds by itself on the same shots."""
    model, batches = known
    frame = evaluate(model, loader, eps=(32 / 255,), steps=3, progress=False)
    found = []
    for index, (images, labels) in enumerate(batches):
        shot = SCENE.sample(8, (16, 16), torch.Generator().manual_seed(mix_seeds(0, index, 0)))
        found += MoireAttack(model, scene=SCENE, eps=32 / 255, steps=3)(
            images, labels, shot=shot
        ).success.tolist()
    cell = frame[frame["row"] == "ma_32"]
    assert cell["fooled"].tolist() == found


def test_numpys_integers_count(known, tmp_path):
    settings = {"steps": np.int64(0), "seed": np.int64(2**40), "n": np.uint8(3)}
    frame = evaluate(*known, **settings, eps=4 / 255, folder=tmp_path, progress=False)
    assert frame["image"].nunique() == 3


def test_records_are_taken_up(known, loader, tmp_path, monkeypatch):
    first = evaluate(known[0], loader, steps=1, folder=tmp_path, progress=False)
    lines = (tmp_path / "records-0.jsonl").read_text()

    def never(*_, **__):
        raise AssertionError("attacked again")

    monkeypatch.setattr(MoireAttack, "__call__", never)
    again = evaluate(known[0], loader, steps=1, folder=tmp_path, progress=False)
    assert again.equals(first) and (tmp_path / "records-0.jsonl").read_text() == lines
    with pytest.raises(AssertionError, match="attacked again"):
        evaluate(known[0], loader, steps=2, folder=tmp_path, progress=False)


def test_a_stated_identity_takes_up_the_records_of_a_function(known, loader, tmp_path):
    model = known[0]
    settings = {"steps": 1, "folder": tmp_path, "progress": False}
    frames = []
    for name in ("v1", "v1", b"v1"):
        frames.append(evaluate(lambda x: model(x), loader, identity=name, **settings))
    assert frames[0].equals(frames[1])
    assert not frames[0].equals(frames[2])  # attacked again: other seconds
    assert frames[0]["predicted"].equals(frames[2]["predicted"])


def test_a_suite_of_several_tables(known, loader):
    lines = rates(
        evaluate(
            known[0], loader, suite="recipes", scene="phone_at_laptop", steps=1, progress=False
        )
    )
    assert set(lines["table"]) == set(evaluation.GROUPS["recipes"])
    assert np.isfinite(lines["success"]).all()


def test_the_global_generator_is_left_alone(known):
    model = Defended(known[0], TotalVariation(iterations=1))
    state = torch.get_rng_state()
    evaluate(model, known[1], suite="unseen", progress=False)
    assert torch.equal(torch.get_rng_state(), state)
