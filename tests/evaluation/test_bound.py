"""What eps counts in an evaluation: in its rows, its keys, its records and its noise."""

import json
from dataclasses import dataclass

import pytest
import torch

from moireaug import Scene, expose
from moireaug.attacks import MoireAttack
from moireaug.attacks.bounds import bound_on_reading
from moireaug.evaluation import Cell, Table, evaluate, images_frame, rates
from moireaug.evaluation.attackers import MoireAttacker, PixelAttacker
from moireaug.evaluation.classifiers import UNDEFENDED
from moireaug.evaluation.conditions import Condition, EvalBatch, Photo, RandomNoise
from moireaug.evaluation.records import EvalSetup, Records
from moireaug.evaluation.runner import Runner, jobs_of
from tests.evaluation.haze import CONDITIONS, EPS, SCENE, table_of


def test_keys_of_noise_on_a_reading_have_its_bound_and_others_are_shared(known):
    model, batches = known
    keys = {}
    for bound in ("codes", "light"):
        runner = Runner(model, batches, EvalSetup(SCENE, bound=bound), Records())
        keys[bound] = {name: runner.key(c, UNDEFENDED, 0) for name, c in CONDITIONS.items()}
    same = [name for name in CONDITIONS if keys["codes"][name] == keys["light"][name]]
    assert same == ["moire", "pgd"]


def test_rows_and_records_say_what_eps_counts(known, tmp_path):
    model, batches = known
    settings = {"suite": "worst_case", "scene": SCENE, "steps": 1, "n": 2, "progress": False}
    success = {}
    for bound in ("codes", "light"):
        frame = evaluate(model, batches, bound=bound, folder=tmp_path, identity="m", **settings)
        lines = rates(frame).set_index(["row", "column"])
        units = lines["bound"]["eps_4"].to_dict()
        noisy = dict.fromkeys(("random", "ma", "apgd", "worst"), bound)
        assert units == {"clean": "", "moire": "", "pgd": "codes"} | noisy
        success[bound] = lines["psnr"]["eps_4", "ma"]
    assert success["codes"] > success["light"] + 3
    bounds = set()
    for file in tmp_path.glob("records-*.jsonl"):
        bounds |= {json.loads(line)["bound"] for line in file.read_text().splitlines()}
    assert bounds == {"", "codes", "light"}
    with pytest.raises(ValueError, match="bound must be one of 'codes', 'light'; got 'raw'"):
        evaluate(model, batches, bound="raw", **settings)


def test_a_worst_case_states_its_strongest_attack_in_any_order(known):
    weak = PixelAttacker(attack="pgd", eps=EPS / 2, steps=3)
    conditions = (Photo(), weak, CONDITIONS["ma"])
    for ordered in (conditions, conditions[::-1]):
        table = Table("mine", (Cell("mine", "worst", ordered, worst=True),))
        runner = Runner(*known, EvalSetup(SCENE, bound="light"), Records())
        list(runner.run(jobs_of([table]), (0,)))
        frame = images_frame([table], runner, (0,))
        assert frame.loc[0, ["eps", "bound", "steps"]].tolist() == [EPS, "light", 2]


@dataclass(frozen=True, kw_only=True)
class Own(Condition):
    """An attack of the user's, which says no more of its bound than eps."""

    kind = "own"

    def show(self, batch):
        attack = MoireAttack(batch.model, scene=SCENE, eps=self.eps, steps=1, bound=batch.bound)
        return attack(batch.images, batch.labels, shot=batch.shot).images

    def measure(self, batch, images):
        return {"level": images.mean((1, 2, 3))}


def test_a_folder_tells_the_bounds_of_ones_own_attack_apart(known, tmp_path):
    model, batches = known
    levels = {}
    for bound in ("codes", "light"):
        frame = evaluate(
            model,
            batches,
            lambda config: table_of(Own(eps=EPS)),
            SCENE,
            bound=bound,
            n=2,
            folder=tmp_path,
            identity="m",
            progress=False,
        )
        assert set(frame["bound"]) == {bound}
        levels[bound] = frame["level"].tolist()
    assert levels["codes"] != levels["light"]


def test_eps_of_noise_on_the_photo_counts_codes(known):
    model, batches = known
    images, labels = (part[:2] for part in batches[0])
    for noise_at, unit in (("raw", "light"), ("photo", "codes")):
        attack = MoireAttack(model, scene=SCENE, steps=1, bound="light", noise_at=noise_at)
        assert attack(images, labels).bound == unit
        attacker = MoireAttacker(eps=EPS, steps=1, noise_at=noise_at)
        assert attacker.eps_unit("light") == unit and attacker.eps_unit("codes") == "codes"


@pytest.mark.parametrize("scene", [SCENE, Scene.preset("paper")])
@pytest.mark.parametrize("bound", ["codes", "light"])
def test_random_noise_lies_at_the_ends_of_the_boxes(known, bound, scene, monkeypatch):
    model, batches = known
    images, labels = (part[:2] for part in batches[0])
    shot = scene.sample(2, images.shape[-2:], torch.Generator().manual_seed(0))
    clean, shown = expose(images, shot), []

    def keep(raw, shot):
        shown.append(raw)
        return images

    monkeypatch.setattr("moireaug.evaluation.conditions.develop", keep)
    g = torch.Generator().manual_seed(1)
    batch = EvalBatch(model, images, labels, labels, shot, g, bound=bound)
    RandomNoise(eps=EPS).show(batch)
    box = bound_on_reading(EPS, bound, scene).box(clean)
    for sign in (1.0, -1.0):
        end = clean + box.noise(torch.full_like(clean, sign * EPS))
        share = torch.isclose(shown[0], end, rtol=0, atol=1e-6).float().mean()
        assert share > 0.4, sign
