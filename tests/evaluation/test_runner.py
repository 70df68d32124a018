"""The runner: the same figures however the work is split, and nothing computed twice."""

import math
from dataclasses import dataclass

import pytest
import torch

from moireaug import Scene
from moireaug.evaluation import Cell, Table, images_frame, rates
from moireaug.evaluation.attackers import MoireAttacker
from moireaug.evaluation.conditions import (
    Clean,
    Condition,
    Photo,
    PhotoWithoutMoire,
    RandomNoise,
    Rotated,
)
from moireaug.evaluation.judges import UNDEFENDED, Judge, averaging_judge
from moireaug.evaluation.records import Records
from moireaug.evaluation.runner import jobs_of
from moireaug.evaluation.tables import cross
from tests.evaluation.haze import EPS, HAZE, TABLE, ran, results, table_of


@dataclass(frozen=True, kw_only=True)
class Mine(Condition):
    """Shows what a function of the batch says."""

    kind = "mine"
    function: object = None
    title: str = "mine"

    @property
    def base_name(self):
        return self.title

    def show(self, batch):
        return self.function(batch)

    def settings(self):
        return {"kind": self.kind, "title": self.title}


@pytest.fixture(scope="module")
def complete(known):
    return ran(known)


def test_any_cut_of_the_work_gives_the_same_figures(known, complete):
    whole = results(complete)
    # the clean images before the model, four conditions before it and behind the haze
    assert len(whole) == 2 * (1 + 4 * 2)
    halves = results(ran(known, indices=(1,))) | results(ran(known, indices=(0,)))
    assert halves == whole
    alone = results(ran(known, table_of(RandomNoise(eps=EPS), judge=HAZE)))
    assert alone.items() <= whole.items()


def test_another_seed_gives_others(known, complete):
    other = ran(known, table_of(Photo(), MoireAttacker(eps=EPS, steps=2)), seed=4)
    assert not results(complete).keys() & results(other).keys()
    clean = complete.record(Clean(), UNDEFENDED, 0)
    assert other.record(Clean(), UNDEFENDED, 0)["targets"] != clean["targets"]


def test_what_is_done_is_not_done_again(known):
    calls = []

    def show(batch):
        calls.append(len(batch.images))
        return batch.images

    judges = {"none": UNDEFENDED, "haze": HAZE}
    both = Table("mine", tuple(cross(judges, {"mine": Mine(function=show)})))
    first = ran(known, both)
    assert calls == [8, 8]
    ran(known, both, records=first.records)
    assert calls == [8, 8]
    half = Records()
    half.append([r for r in first.records._records.values() if r["judge"] != "haze"])
    again = ran(known, both, records=half)
    assert calls == [8, 8, 8, 8] and results(again) == results(first)


@pytest.fixture(scope="module")
def contrary(known):
    """A model that says the opposite of bright images."""

    def model(x):
        return torch.where((x.mean((1, 2, 3)) > 0.5)[:, None], -1, 1) * known[0](x)

    return model


def test_success_is_counted_on_what_the_judge_has_right(known, contrary):
    stranger = Judge("stranger", model=contrary)
    judges = {"model": UNDEFENDED, "stranger": stranger, "haze": HAZE}
    table = Table("mine", tuple(cross(judges, {"moire": Photo()})))
    runner = ran(known, table)
    asked = {r["judge"] for r in runner.records._records.values() if r["condition"] == "clean"}
    assert asked == {"model", "stranger"}
    frame = images_frame([table], runner, (0, 1)).set_index("row")
    # behind a defence, the model without it counts
    assert frame.loc["model", "counted"].sum() == frame.loc["haze", "counted"].sum() == 16
    right = []
    for index in (0, 1):
        clean = runner.record(Clean(), stranger, index)
        right += [p == y for p, y in zip(clean["predicted"], clean["labels"], strict=True)]
    assert frame.loc["stranger", "counted"].tolist() == right and 0 < sum(right) < 16


def test_a_judge_of_another_model_behind_a_defence_counts_on_that_model(known, contrary):
    frames = []
    for defence in (None, lambda x: 1 - x):
        table = table_of(Photo(), judge=Judge("both", model=contrary, defence=defence))
        frames.append(images_frame([table], ran(known, table), (0, 1)))
    bare, behind = frames
    assert behind["counted"].equals(bare["counted"]) and 0 < bare["counted"].sum() < 16
    assert not behind["predicted"].equals(bare["predicted"])


def test_a_target_is_another_class(complete):
    for r in complete.records._records.values():
        assert all(t != y and 0 <= t < 4 for t, y in zip(r["targets"], r["labels"], strict=True))


def test_conditions_of_one_scene_share_their_shots(known):
    seen = {}

    def spy(name):
        def show(batch):
            seen[name] = batch.shot.to_dict()
            return batch.images

        return Mine(function=show, title=name)

    far = Scene.preset("phone_at_laptop")
    ran(known, table_of(spy("a"), spy("b"), spy("c").at("far", far), spy("d").at("far", far)), (0,))
    assert seen["a"] == seen["b"] and seen["c"] == seen["d"] and seen["a"] != seen["c"]


def test_rotated_is_bright_and_still_turned(known):
    grey = torch.full((2, 3, 32, 32), 0.6)
    batches = [(grey, torch.zeros(2, dtype=torch.long))]
    table = table_of(Rotated(), PhotoWithoutMoire())
    runner = ran((known[0], batches), table, (0,), scene=Scene.preset("paper"))
    rotated = runner.records.pictures[runner.picture_name(Rotated())]
    plain = runner.records.pictures[runner.picture_name(PhotoWithoutMoire())]
    middle = (..., slice(12, 20), slice(12, 20))
    assert torch.allclose(rotated[middle], grey[middle], atol=1e-5)
    assert torch.allclose(plain[middle], grey[middle] / 3, atol=1e-5)
    assert rotated[..., 0, 0].max() < 0.6 or rotated.amin() < 0.1  # the dark beside a turned screen


def test_measures_are_means_over_the_images_that_got_noise(known):
    attack = MoireAttacker(eps=EPS, steps=1)
    runner = ran(known, table_of(attack))
    frame = images_frame([table_of(attack)], runner, (0, 1))
    noisy = frame[frame["largest"] > 0]
    assert len(frame) == 16 and 0 < len(noisy) < 16  # the others are wrong without an attack
    (line,) = rates(frame).to_dict("records")
    assert line["n"] == 16
    for name in ("psnr", "ssim", "largest", "ciede2000"):
        assert line[name] == pytest.approx(noisy[name].mean())
    frame[["largest", "psnr"]] = 0.0, 100.0
    (line,) = rates(frame).to_dict("records")
    assert math.isnan(line["psnr"]) and math.isnan(line["largest"])  # nothing to measure


class Dropping:
    """A randomised defence that loses every tenth image."""

    randomised = True
    identity = "dropping"

    def __call__(self, images):
        return images * (torch.rand(len(images), 1, 1, 1) < 0.9)


def test_a_worst_case_behind_a_randomised_defence_pools_no_unlucky_draws():
    """One draw for each of the 64 answers would lose some image but once in 800 times."""

    def bright(x):
        level = 8 * (x.mean((1, 2, 3)) - 0.3)
        return torch.stack([-level, level], 1)

    batches = [(torch.full((16, 3, 8, 8), 0.6), torch.ones(16, dtype=torch.long))]
    conditions = (Photo(), PhotoWithoutMoire(), RandomNoise(eps=EPS), Rotated())
    accuracies = []
    for judge in (Judge("dropping", Dropping()), averaging_judge("dropping", Dropping())):
        table = Table("mine", (Cell("mine", "worst", conditions, judge, worst=True),))
        runner = ran((bright, batches), table, (0,))
        accuracies += rates(images_frame([table], runner, (0,)))["accuracy"].tolist()
    assert accuracies[0] < accuracies[1] == 1


def test_two_conditions_of_one_name_are_refused():
    tables = [table_of(MoireAttacker(eps=EPS, steps=steps)) for steps in (1, 2)]
    with pytest.raises(ValueError, match=r"two conditions are called 'ma_8'.*steps=1.*steps=2"):
        jobs_of(tables)


def test_records_that_are_missing_are_counted(known):
    runner = ran(known, indices=(0,))
    jobs = jobs_of([TABLE])
    assert runner.missing(jobs, (0,)) == 0 and runner.missing(jobs, (0, 1)) == 9
