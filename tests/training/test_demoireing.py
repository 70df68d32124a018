"""Demoiréing networks by their command, small: files, figures, resuming, starting."""

import contextlib
import csv
import io
import json
import re
import sys
import warnings

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from hydra.core.global_hydra import GlobalHydra
from PIL import Image

from moireaug.defenses import demoire
from moireaug.evaluation.visibility import psnr, ssim
from moireaug.synthesis.pictures import Pictures
from tests.synthesis.folders import put
from tests.training.small import configured, same
from training import demoire as command
from training.demoireing import fit as demoireing
from training.demoireing import testing
from training.demoireing.batches import PairNumbers
from training.demoireing.clean import clean_codes
from training.demoireing.module import Demoireing
from training.demoireing.pairs import SimulatedPairs
from training.demoireing.testing import fidelity_scores
from training.demoireing.train import start_as_identity
from training.runs.layout import read_metrics
from training.runs.run import Run
from training.system.files import read_checkpoint
from training.trainer import ranks

pytestmark = pytest.mark.usefixtures("as_the_command_is")

FEW = ["scene=[screen_photo]", "test.unseen=[dashcam_at_led_sign]"]
FEW += ["data.size=32", "data.val=2", "data.test=2", "test.size=32", "demoire.width=0.25"]
FEW += ["train.steps=2", "train.check_every=1", "train.batch_size=2", "trainer.accelerator=cpu"]
FILES = {"report.html", "metrics.json", "scores.csv", "config.yaml"}
FILES |= {"weights.pt", "best.ckpt", "last.ckpt"}


def configure(*overrides):
    return configured(*FEW, *overrides, name="demoire")


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """Two pairs of photo and original, with a pairs.csv beside them."""
    folder = tmp_path_factory.mktemp("real")
    rows = ["photo,original"]
    draw = np.random.default_rng(1)
    for name in ("a", "b"):
        original = draw.integers(0, 256, (50, 70, 3), dtype=np.uint8)
        photo = (0.5 * original + 60).astype(np.uint8)
        Image.fromarray(original).save(folder / f"{name}_shown.png")
        Image.fromarray(photo).save(folder / f"{name}.png")
        rows.append(f"{name}.png,{name}_shown.png")
    (folder / "pairs.csv").write_text("\n".join(rows))
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory, real):
    """One run of the command: its folder and what was printed."""
    cwd, given = tmp_path_factory.mktemp("whole"), ["train", *FEW, f"pairs={real}"]
    out, err = io.StringIO(), io.StringIO()
    GlobalHydra.instance().clear()
    torch.set_num_threads(1)
    with (
        pytest.MonkeyPatch.context() as patch,
        warnings.catch_warnings(record=True) as warned,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        warnings.simplefilter("default")
        patch.setattr(sys, "argv", ["demoire.py", *given])
        patch.chdir(cwd)
        command.main(given)
    assert not warned and "Warning" not in err.getvalue(), err.getvalue()
    return cwd / "runs/drawn-esdnet/demoire/seed0", out.getvalue()


def test_a_run_leaves_what_it_promises(whole):
    folder, out = whole
    assert {path.name for path in folder.iterdir()} == FILES
    m = json.loads((folder / "metrics.json").read_text())
    about = [m[key] for key in ("recipe", "data", "model", "target")]
    assert about == ["demoire", "drawn", "esdnet", "clean"]
    assert [h["steps"] for h in m["train"]["history"]] == [1, 2]
    simulated = ("screen_photo", "seen"), ("dashcam_at_led_sign", "unseen")
    groups = {(*scene, by) for scene in simulated for by in ("twin", "original")}
    groups |= {("real photos", "real", "original")}
    assert {(row["group"], row["kind"], row["reference"]) for row in m["test"]} == groups
    scores = list(csv.DictReader((folder / "scores.csv").read_text().splitlines()))
    assert len(scores) == 2 * (2 * (2 + 3) + 2)
    for row in m["test"]:
        mine = {"photo": [], "cleaned": [], "twin": []}
        for line in scores:
            if (line["group"], line["reference"]) == (row["group"], row["reference"]):
                mine[line["state"]].append(float(line[row["measure"]]))
        assert row["n"] == 2 and row["before"] == pytest.approx(np.mean(mine["photo"]), rel=1e-4)
        assert row["gain"] == pytest.approx(row["after"] - row["before"], abs=1e-4)
        if row["reference"] == "original" and row["kind"] != "real":
            assert row["twin"] == pytest.approx(np.mean(mine["twin"]), rel=1e-4)
        else:
            assert row["twin"] is None and not mine["twin"]
    before = {row["measure"]: row["before"] for row in m["test"] if row["kind"] == "real"}
    # a photo of another tone matches after the map
    assert before["psnr"] < 18 and before["mapped_psnr"] > 45 and before["mapped_ssim"] > 0.999
    assert out.splitlines()[-1].endswith("Report: runs/drawn-esdnet/demoire/seed0/report.html")


def test_the_page_shows_every_kind_of_pair(whole):
    page = (whole[0] / "report.html").read_text()
    titles = re.findall(r'<span class="title">([^<]*)</span>', page)
    simulated = ["photo", "cleaned", "twin", "original", "removed × 4"]
    photographed = ["photo", "cleaned", "original", "removed × 4"]
    assert titles == 2 * simulated + 2 * photographed
    assert not re.findall(r'(?:src|href)="(?!data:)', page), "it needs nothing but itself"
    assert not re.findall(r"[>\s](?:nan|None|inf)[<\s]", page.split("<details>")[0])


def test_a_resumed_run_equals_an_uninterrupted_one(whole, tmp_path, real, monkeypatch, capsys):
    torch.set_num_threads(1)  # as in the other one
    cfg = configure(f"pairs={real}", f"runs={tmp_path}")
    folder = Run(cfg).folder
    step = Demoireing.training_step

    def lost(module, batch, index):
        if module.global_step == 1:
            raise RuntimeError("a worker was killed")
        return step(module, batch, index)

    with monkeypatch.context() as patch, pytest.raises(RuntimeError, match="was killed"):
        patch.setattr(Demoireing, "training_step", lost)
        demoireing.fit(cfg)
    kept = read_checkpoint(folder / "last.ckpt")["history"]
    assert len(kept) == 1 and Run(cfg).stage() == "begun"
    found = demoireing.fit(cfg)
    assert "Resuming" in capsys.readouterr().out and same(folder, whole[0])
    assert found["train"]["history"][:1] == kept
    known = read_metrics(whole[0])
    for ours, theirs in zip(found["test"], known["test"], strict=True):
        assert ours | {"milliseconds": 0} == theirs | {"milliseconds": 0}


def test_a_finished_run_is_shown_and_tested_on_other_pairs(
    whole, tmp_path, real, capsys, monkeypatch
):
    folder = whole[0]
    again = configure(f"pairs={real}", f"runs={folder.parents[2]}")
    known = demoireing.fit(again)
    assert "already finished" in capsys.readouterr().out
    monkeypatch.setattr(ranks, "fit", lambda *args: pytest.fail("trained again"))
    (tmp_path / "pairs.csv").write_text(f"photo,original\n{real}/a.png,{real}/a_shown.png")
    other = configure(f"pairs={tmp_path}", f"runs={folder.parents[2]}", "data.test=1")
    found = demoireing.fit(other)
    assert {r["n"] for r in found["test"]} == {1} and found["train"] == known["train"]
    assert read_metrics(folder) == found
    with (tmp_path / "pairs.csv").open("a") as table:  # of the same name
        table.write(f"\n{real}/b.png,{real}/b_shown.png")
    monkeypatch.setattr(testing, "MAX_REAL_EXAMPLES", 1)
    found = demoireing.fit(other)
    assert {r["kind"]: r["n"] for r in found["test"]} == {"seen": 1, "unseen": 1, "real": 2}
    page = (folder / "report.html").read_text()
    assert "real photos: a<" in page and "real photos: b<" not in page


def test_a_network_learns_to_take_stripes_away(monkeypatch):
    torch.manual_seed(0)
    cfg = configure()
    network = demoire.build("esdnet", width=0.25)
    start_as_identity(network)
    module = Demoireing(network, cfg.demoire, cfg.train)
    monkeypatch.setattr(Demoireing, "log", lambda *args, **kwargs: None)
    stripes = 60 * torch.sin(torch.arange(32) / 1.5) * torch.tensor([1.0, -1, 0])[:, None, None]
    twins = torch.randint(60, 196, (2, 3, 1, 1)).expand(2, 3, 32, 32)
    batch = ((twins + stripes).to(torch.uint8), twins.to(torch.uint8))
    optimizer = module.configure_optimizers()["optimizer"]
    for index in range(14):
        optimizer.zero_grad()
        module.training_step(batch, index).backward()
        optimizer.step()
    photos, targets = (codes.float() / 255 for codes in batch)
    assert psnr(module.eval()(photos), targets).mean() > psnr(photos, targets).mean() + 3


def test_an_esdnet_and_an_amnet_start_as_the_identity():
    photo = torch.randint(0, 256, (3, 50, 70), dtype=torch.uint8)
    for name in ("esdnet", "amnet"):
        network = demoire.build(name, width=0.25).eval()
        assert not torch.equal(clean_codes(network, photo), photo)
        assert start_as_identity(network) and torch.equal(clean_codes(network, photo), photo), name
    network = demoire.build("esdnet", width=0.25).eval()
    assert start_as_identity(network)
    images = torch.rand(2, 3, 64, 96)
    for level, found in enumerate(network.outputs(images)):
        wanted = F.avg_pool2d(images, 2**level)
        assert (found - wanted).abs().max() < 1e-6, level
    assert not start_as_identity(demoire.build("esdnet", width=0.125)), "eight channels are too few"


def test_ranks_and_epochs_share_the_numbers_out():
    drawn = []
    for epoch in range(3):
        for rank in range(2):
            numbers = PairNumbers(6, 2, rank)
            numbers.set_epoch(epoch)
            drawn += list(numbers)
            assert len(numbers) == 3
    assert sorted(drawn) == list(range(18))


def test_scenes_take_turns_with_the_target_asked_for(tmp_path):
    put(tmp_path)
    cfg = configure("scene=[phone_at_phone,screen_photo]")
    scenes = list(demoireing.training_scenes(cfg).values())
    for target in ("twin", "original"):
        pairs = SimulatedPairs(Pictures(tmp_path, 32), scenes, 32, target, seed=3)
        for k in range(3):
            assert pairs.pair(k).shot.scene == scenes[k % 2]
            photo, wanted = pairs[k]
            assert torch.equal(photo, pairs.pair(k).photo)
            assert torch.equal(wanted, getattr(pairs.pair(k), target))


def test_fidelity_is_that_of_the_textbook():
    wanted = torch.full((3, 40, 40), 0.5)
    wanted[:, ::2] = 0.25
    found = fidelity_scores(wanted + 0.1, wanted)
    assert found["psnr"] == pytest.approx(20, abs=1e-4) and found["mapped_psnr"] > 45
    assert float(psnr(wanted[None], wanted[None])) == pytest.approx(100)
    assert float(ssim(wanted[None], wanted[None])) == pytest.approx(1)
    flat = torch.full((1, 3, 40, 40), 0.5)
    expected = (2 * 0.5 * 0.6 + 1e-4) / (0.5**2 + 0.6**2 + 1e-4)  # luminance alone
    assert float(ssim(flat, torch.full_like(flat, 0.6))) == pytest.approx(expected, abs=1e-4)
