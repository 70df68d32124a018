"""The runner: the same figures however work is split, nothing done twice, models left as found."""

import math
from dataclasses import dataclass

import pytest
import torch
from torch import nn

from moireaug import Scene
from moireaug.defenses import Rejecting
from moireaug.evaluation import Cell, Table, images_frame, rates
from moireaug.evaluation.attackers import MoireAttacker
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier, averaging_classifier
from moireaug.evaluation.conditions import (
    BrightPhotoWithoutMoire,
    Clean,
    Condition,
    Photo,
    PhotoWithoutMoire,
    RandomNoise,
)
from moireaug.evaluation.records import Records
from moireaug.evaluation.runner import jobs_of
from moireaug.evaluation.suites.trust import CleanTwice, PhotoGradient
from moireaug.evaluation.tables import cross
from tests.evaluation.conftest import classifier
from tests.evaluation.haze import CONDITIONS, EPS, HAZE, TABLE, frame_of, ran, results, table_of


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
    first, second = ran(known, indices=(0,)), ran(known, indices=(1,))
    assert results(first) | results(second) == whole
    jobs = jobs_of([TABLE])
    assert first.missing(jobs, (0,)) == 0 and first.missing(jobs, (0, 1)) == 9
    alone = results(ran(known, table_of(RandomNoise(eps=EPS), classifier=HAZE)))
    assert alone.items() <= whole.items()


def test_another_seed_gives_others(known, complete):
    for r in complete.records.values():
        assert all(t != y and 0 <= t < 4 for t, y in zip(r["targets"], r["labels"], strict=True))
    other = ran(known, table_of(Photo(), MoireAttacker(eps=EPS, steps=2)), seed=4)
    assert not results(complete).keys() & results(other).keys()
    clean = complete.record(Clean(), UNDEFENDED, 0)
    assert other.record(Clean(), UNDEFENDED, 0)["targets"] != clean["targets"]


def test_what_is_done_is_not_done_again(known):
    calls = []

    def show(batch):
        calls.append(len(batch.images))
        return batch.images

    classifiers = {"none": UNDEFENDED, "haze": HAZE}
    both = Table("mine", tuple(cross(classifiers, {"mine": Mine(function=show)})))
    first = ran(known, both)
    assert calls == [8, 8]
    ran(known, both, records=first.records)
    assert calls == [8, 8]
    half = Records()
    half.append([r for r in first.records.values() if r["judge"] != "haze"])
    again = ran(known, both, records=half)
    assert calls == [8, 8, 8, 8] and results(again) == results(first)


@pytest.fixture(scope="module")
def contrary(known):
    """A model that says the opposite of bright images."""

    def model(x):
        return torch.where((x.mean((1, 2, 3)) > 0.5)[:, None], -1, 1) * known[0](x)

    return model


def test_success_is_counted_on_what_the_classifier_has_right(known, contrary):
    stranger = Classifier("stranger", model=contrary)
    classifiers = {"model": UNDEFENDED, "stranger": stranger, "haze": HAZE}
    table = Table("mine", tuple(cross(classifiers, {"moire": Photo()})))
    runner = ran(known, table)
    asked = {r["judge"] for r in runner.records.values() if r["condition"] == "clean"}
    assert asked == {"model", "stranger"}
    frame = images_frame([table], runner, (0, 1)).set_index("row")
    # behind a defence, the model without it counts
    assert frame.loc["model", "counted"].sum() == frame.loc["haze", "counted"].sum() == 16
    right = []
    for index in (0, 1):
        clean = runner.record(Clean(), stranger, index)
        right += [p == y for p, y in zip(clean["predicted"], clean["labels"], strict=True)]
    assert frame.loc["stranger", "counted"].tolist() == right and 0 < sum(right) < 16


def test_another_model_behind_a_defence_counts_on_itself(known, contrary):
    frames = []
    for defence in (None, lambda x: 1 - x):
        table = table_of(Photo(), classifier=Classifier("both", model=contrary, defence=defence))
        frames.append(frame_of(known, table))
    bare, behind = frames
    assert behind["counted"].equals(bare["counted"]) and 0 < bare["counted"].sum() < 16
    assert not behind["predicted"].equals(bare["predicted"])


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
    table = table_of(BrightPhotoWithoutMoire(), PhotoWithoutMoire())
    runner = ran((known[0], batches), table, (0,), scene=Scene.preset("paper"))
    rotated = runner.records.pictures[runner.picture_name(BrightPhotoWithoutMoire())]
    plain = runner.records.pictures[runner.picture_name(PhotoWithoutMoire())]
    middle = (..., slice(12, 20), slice(12, 20))
    assert torch.allclose(rotated[middle], grey[middle], atol=1e-5)
    assert torch.allclose(plain[middle], grey[middle] / 3, atol=1e-5)
    assert rotated[..., 0, 0].max() < 0.6 or rotated.amin() < 0.1  # the dark beside a turned screen


def test_measures_are_means_over_the_images_that_got_noise(known):
    frame = frame_of(known, table_of(MoireAttacker(eps=EPS, steps=1)))
    noisy = frame[frame["largest"] > 0]
    assert len(frame) == 16 and 0 < len(noisy) < 16  # the others are wrong without an attack
    (line,) = rates(frame).to_dict("records")
    assert line["n"] == 16
    for name in ("psnr", "ssim", "largest", "ciede2000"):
        assert line[name] == pytest.approx(noisy[name].mean())
    frame[["largest", "psnr"]] = 0.0, 100.0
    (line,) = rates(frame).to_dict("records")
    assert math.isnan(line["psnr"]) and math.isnan(line["largest"])  # nothing to measure


def dropping(images):
    """A randomised defence that loses every tenth image."""
    return images * (torch.rand(len(images), 1, 1, 1) < 0.9)


dropping.randomised = True


def test_worst_cases_pool_no_unlucky_draws():
    """One draw for each of the 64 answers would lose some image but once in 800 times."""

    def bright(x):
        level = 8 * (x.mean((1, 2, 3)) - 0.3)
        return torch.stack([-level, level], 1)

    batches = [(torch.full((16, 3, 8, 8), 0.6), torch.ones(16, dtype=torch.long))]
    conditions = (Photo(), PhotoWithoutMoire(), RandomNoise(eps=EPS), BrightPhotoWithoutMoire())
    accuracies = []
    for dropped in (
        Classifier("dropping", dropping),
        averaging_classifier("dropping", dropping),
    ):
        table = Table("mine", (Cell("mine", "worst", conditions, dropped, worst=True),))
        accuracies += rates(frame_of((bright, batches), table))["accuracy"].tolist()
    assert accuracies[0] < accuracies[1] == 1


def test_two_conditions_of_one_name_are_refused():
    tables = [table_of(MoireAttacker(eps=EPS, steps=steps)) for steps in (1, 2)]
    with pytest.raises(ValueError, match=r"two conditions are called 'ma_8'.*steps=1.*steps=2"):
        jobs_of(tables)


@pytest.mark.parametrize(
    ("part", "body"),
    [
        ("model", nn.Sequential(classifier(), nn.BatchNorm1d(4))),
        ("defence", nn.BatchNorm2d(3)),
        ("attacked", nn.Sequential(classifier(), nn.BatchNorm1d(4))),
    ],
)
def test_a_model_or_defence_is_left_as_it_was_found(part, body, known):
    """It classifies in evaluation mode, without gradients, and keeps its statistics."""
    seen = []

    class Spy(nn.Module):
        def forward(self, x):
            seen.append((self.training, torch.is_grad_enabled()))
            return x

    stranger = nn.Sequential(body, Spy()).train()
    state = {k: v.clone() for k, v in stranger.state_dict().items()}
    if part == "attacked":
        ran((stranger, known[1]), table_of(Photo()))
    else:
        ran(known, table_of(Photo(), classifier=Classifier("stranger", **{part: stranger})))
    assert seen and not any(training or grad for training, grad in seen)
    assert stranger.training
    assert all(torch.equal(v, stranger.state_dict()[k]) for k, v in state.items())


def test_no_logits_or_one_get_a_sentence(known):
    bad = Classifier("bad", model=lambda shown: shown)
    with pytest.raises(ValueError, match=r"must return logits \(B, K\)"):
        ran(known, table_of(Clean(), classifier=bad), (0,))
    with pytest.raises(ValueError, match="logits of at least two classes; got 1"):
        ran((lambda x: x.mean((1, 2, 3))[:, None], known[1]), indices=(0,))


def test_a_model_may_work_in_place(known, monkeypatch):
    monkeypatch.setattr(torch.cuda, "device_count", None)  # whoever asks for it fails
    model, batches = known
    table, answers = table_of(*CONDITIONS.values(), CleanTwice(), PhotoGradient()), []
    for one in (lambda x: model(x - 0.1), lambda x: model(x.sub_(0.1))):
        records = results(ran((one, batches), table, (0,))).values()
        answers.append([(record["predicted"], record["measured"]) for record in records])
    assert answers[0] == answers[1]


def test_a_defence_may_work_in_place_and_is_clipped(known):
    model, batches = known
    kept = [images.clone() for images, _ in batches]
    answers = []
    for defence in (lambda x: (x * 3).clamp(0, 1), lambda x: x.mul_(3)):
        classifier = Classifier("defence", defence=defence)
        runner = ran((model, batches), table_of(Clean(), Photo(), classifier=classifier), (0,))
        answers.append([record["predicted"] for record in results(runner).values()])
    assert answers[0] == answers[1]
    assert all(torch.equal(a, b) for a, (b, _) in zip(kept, batches, strict=True))


def test_a_photos_gradient_is_of_the_attacks_loss(known):
    """A rejection that outweighs the label hides it from the attack: no gradient is left."""
    images = known[1][0][0]
    labels = torch.zeros(len(images), dtype=torch.int64)

    def model(x):
        brightness = x.mean((1, 2, 3))
        return torch.stack([brightness - 2, 0 * brightness, 0 * brightness], 1)

    shares = []
    for attacked in (model, Rejecting(model, lambda x: torch.ones(len(x)), 0.5)):
        runner = ran((attacked, [(images, labels)]), table_of(PhotoGradient()), (0,))
        measured = [record["measured"] for record in results(runner).values()]
        shares += [set(values["zero_gradients"]) for values in measured if values]
    assert shares == [{0.0}, {1.0}]
