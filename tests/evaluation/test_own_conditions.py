"""Conditions of one's own: what they hold tells their records apart, and their class, too."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch

from moireaug.evaluation import evaluate
from moireaug.evaluation.attackers import MoireAttacker
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier
from moireaug.evaluation.conditions import FRAME_COLUMNS, Condition, Photo
from moireaug.evaluation.records import RecordFolder
from moireaug.evaluation.runner import jobs_of
from tests.evaluation.haze import CONDITIONS, EPS, frame_of, ran, table_of


@dataclass(frozen=True, kw_only=True)
class Stamped(Condition):
    """The image with a stamp on it, of any type."""

    kind = "stamped"
    stamp: object
    suffix: str = ""

    @property
    def base_name(self):
        return f"{self.kind}{self.suffix}"

    def show(self, batch):
        return (batch.images + torch.as_tensor(self.stamp)).clamp(0, 1)


STAMPS = {
    "tensor": lambda value: torch.full((3, 16, 16), value),
    "array": lambda value: np.full((3, 16, 16), value, np.float32),
    "number of NumPy's": np.float32,
}


@pytest.mark.parametrize("make", STAMPS.values(), ids=STAMPS.keys())
def test_a_condition_of_ones_own_may_hold_anything(make, known, tmp_path):
    """Its records are found again, and those of another are not taken for them."""
    settings = {"records": RecordFolder(tmp_path)}
    first = ran(known, table_of(Stamped(stamp=make(0.1))), **settings)
    again = Stamped(stamp=make(0.1))
    assert first.missing(jobs_of([table_of(again)]), (0, 1)) == 0
    assert first.missing(jobs_of([table_of(Stamped(stamp=make(0.2)))]), (0, 1)) == 2
    with pytest.raises(ValueError, match="two conditions are called 'stamped'"):
        jobs_of([table_of(again), table_of(Stamped(stamp=make(0.2)))])


@dataclass(frozen=True, kw_only=True)
class Noted(MoireAttacker):
    """The Moiré Attack, with a field that is none of the attack's."""

    kind = "noted"
    note: str = ""


def test_a_field_of_ones_own_attacker_is_no_argument_of_the_attack(known):
    noted = Noted(eps=EPS, steps=2, note="mine")
    answers = []
    for attacker in (noted, CONDITIONS["ma"]):
        answers.append(ran(known, table_of(attacker)).record(attacker, UNDEFENDED, 0)["measured"])
    assert answers[0] == answers[1]


UNIDENTIFIED = {
    "stamp of stamped": table_of(Stamped(stamp=lambda images: images)),
    "hazy": table_of(Photo(), classifier=Classifier("hazy", defence=lambda images: images)),
}


@pytest.mark.parametrize(("name", "table"), UNIDENTIFIED.items(), ids=UNIDENTIFIED.keys())
def test_a_folder_takes_no_part_without_an_identity(name, table, known, tmp_path):
    """Python gives the address of one function to the next: its records would be the other's."""
    with pytest.raises(ValueError, match=f"nothing tells {name}, a function"):
        evaluate(*known, lambda config: table, folder=tmp_path)


def test_a_condition_is_no_other_with_the_same_settings():
    with pytest.raises(TypeError, match=r"Brighter needs a kind of its own.*'moire'.*of Photo"):
        type("Brighter", (Photo,), {"show": lambda self, batch: batch.images})
    other_class = type("Other", (Condition,), {"kind": "moire", "show": Photo.show})
    with pytest.raises(ValueError, match="two conditions are called 'moire'"):
        jobs_of([table_of(Photo()), table_of(other_class())])


NO_IMAGES = {
    "0 to 255": (lambda images: 255 * images, ValueError, r"'odd' shows: .*look like 0 to 255"),
    "NaN": (lambda images: images * float("nan"), ValueError, "'odd' shows: .*NaN in image 0"),
    "array": (lambda images: images.numpy(), TypeError, "'odd' shows: .*got ndarray"),
    "fewer": (lambda images: images[:1], ValueError, r"'odd' must show one image for each .*got 1"),
}


@pytest.mark.parametrize(("change", "error", "message"), NO_IMAGES.values(), ids=NO_IMAGES.keys())
def test_what_is_no_image_is_shown_to_no_model(change, error, message, known):
    show = {"kind": "odd", "show": lambda self, batch: change(batch.images)}
    with pytest.raises(error, match=message):
        ran(known, table_of(type("Odd", (Condition,), show)()))


def test_an_image_a_little_outside_is_clipped(known):
    brighter = {"kind": "brighter", "show": lambda self, batch: batch.images + 0.05}
    pictures = ran(known, table_of(type("Brighter", (Condition,), brighter)())).records.pictures
    assert max(float(shown.max()) for shown in pictures.values()) == 1.0


def own_condition(kind, **methods):
    """A condition of that kind, which shows the image unless it is told otherwise."""
    return type(
        kind, (Condition,), {"show": lambda self, batch: batch.images, "kind": kind} | methods
    )()


IN_PLACE = {
    "shown images": {"show": lambda self, batch: batch.images.mul_(0)},
    "shown labels": {"show": lambda self, batch: batch.images + 0 * batch.labels.zero_().sum()},
    "measured": {"measure": lambda self, batch, images: {"level": _mean_of(batch.images.mul_(0))}},
    "answered": {"measure": lambda self, batch, images: {"level": _mean_of(images.mul_(0))}},
}


def _mean_of(images):
    return images.mean((1, 2, 3))


@pytest.mark.parametrize("methods", IN_PLACE.values(), ids=IN_PLACE.keys())
def test_a_condition_may_work_in_place(methods, known):
    """The images that it is judged by and the next one is shown, and the caller's own, stay."""
    model, batches = known
    copies = [(images.clone(), labels.clone()) for images, labels in batches]
    covered, plain = own_condition("covered", **methods), own_condition("plain")
    beside = ran((model, copies), table_of(covered, Photo()))
    alone = ran(known, table_of(plain, Photo()))
    for index, (images, labels) in enumerate(batches):
        assert torch.equal(copies[index][0], images)
        assert torch.equal(copies[index][1], labels)
        records = [one.record(Photo(), UNDEFENDED, index) for one in (beside, alone)]
        for name in ("predicted", "labels"):
            assert records[0][name] == records[1][name]
        if "measure" in methods:
            answers = [
                beside.record(covered, UNDEFENDED, index)["predicted"],
                alone.record(plain, UNDEFENDED, index)["predicted"],
            ]
            assert answers[0] == answers[1]


def test_a_condition_may_ask_the_model(known):
    """It answers in evaluation mode, and keeps its own statistics and mode."""
    model = torch.nn.Sequential(torch.nn.BatchNorm2d(3), known[0]).train()
    asking = own_condition(
        "asking", show=lambda self, batch: (batch.images, model(batch.images))[0]
    )
    ran((model, known[1]), table_of(asking))
    assert model.training
    assert not model[0].num_batches_tracked


NO_MEASURES = [{"predicted": [0] * 8}, {"haze": [0.5]}, {"haze": 0.5}, {"haze": ["a"] * 8}]


@pytest.mark.parametrize("figures", [*NO_MEASURES, {"haze": [[0.5, 1.0]] * 8}], ids=str)
def test_a_measure_that_would_hide_an_answer_is_refused(figures, known):
    measuring = own_condition("measuring", measure=lambda self, batch, images: figures)
    with pytest.raises(
        ValueError, match=r"'measuring' must measure .*none of table, .*got [018] numbers as"
    ):
        ran(known, table_of(measuring))


@pytest.mark.parametrize("kind", [lambda x: x, list, lambda x: list(x.numpy())])
def test_a_measure_may_be_of_any_numbers(kind, known, tmp_path):
    """A record holds them, which only knows Python's."""
    means = own_condition("mean", measure=lambda self, batch, x: {"level": kind(x.mean((1, 2, 3)))})
    record = ran(known, table_of(means), records=RecordFolder(tmp_path)).record(
        means, UNDEFENDED, 0
    )
    assert record["measured"]["level"] == _mean_of(known[1][0][0]).tolist()


def test_no_measure_hides_a_column(known):
    """`FRAME_COLUMNS` are those of every frame."""
    assert {*frame_of(known, table_of(own_condition("plain")))} == {*FRAME_COLUMNS}
