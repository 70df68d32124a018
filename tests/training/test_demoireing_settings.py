"""Settings of a demoiréing run that cannot be used get a sentence, before any time is spent."""

import functools
from dataclasses import asdict

import pytest
import torch
import yaml
from hydra.errors import HydraException
from lightning.fabric.utilities.exceptions import MisconfigurationException
from PIL import Image

from moireaug.defenses import demoire
from tests.training.small import configured
from training.demoireing import fit as demoireing
from training.runs.run import Run
from training.system import machine
from training.trainer import ranks
from training.trainer.make import OriginRecord

SHOWN = {"test": [], "train": {"steps": 1, "seconds": 1, "pairs_per_second": 1, "best_steps": 1}}
FEW = ["train.steps=4", "train.check_every=1", "data.val=2", "data.test=2"]


def put_uneven(folder):
    """A pair of two sizes; the photo lies on its side, and its EXIF data say so."""
    (folder / "uneven").mkdir()
    lying = Image.new("RGB", (20, 30))
    exif = lying.getexif()
    exif[0x0112] = 6
    lying.save(folder / "uneven/uneven.png", exif=exif)
    Image.new("RGB", (30, 21)).save(folder / "uneven/shown.png")
    (folder / "uneven/pairs.csv").write_text("photo,original\nuneven.png,shown.png\n")


SENTENCES = {
    "data.root=nowhere": "nowhere is not a folder",
    "model=esdnett": "Did you mean 'esdnet'?",
    "recipe=../../x": "recipe=../../x cannot be the name of a run's folder",
    "demoire.target=twins": "Did you mean 'twin'?",
    "demoire.width=0": "width",
    "train.check_every=3": "must be a multiple of train.check_every",
    "train.lr=-1": "train.lr must be in [1e-08, 10]; got -1",
    "trainer.precision=bf16-true": "trainer.precision must be one of '32-true'",
    "trainer.strategy=foo": "foo",
    "demoire.vgg=missing.pth": "missing.pth",
    "model=mddm demoire.vgg=vgg.pth": "demoire.vgg= has no effect on mddm",
    "scene=[]": "name at least one",
    "scene=paper": "registered",
    "scene=screen_foto": "Did you mean 'screen_photo'?",
    "test.unseen=[screen_photo]": "which is trained on too",
    "weights=nowhere.pt": "nowhere.pt'",
    "pairs=uneven": "uneven.png is 30 x 20 and uneven/shown.png 30 x 21 pixels: a pair must",
    "resume=true": "leave resume=true out, and that run is moved aside",
    "trainer.accelerator=cpu trainer.devices=2 train.batch_size=3": "number, 2; got 3",
}


def test_wrong_settings_get_a_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    put_uneven(tmp_path)
    for given, sentence in SENTENCES.items():
        cfg = configured(*FEW, f"runs={tmp_path}", name="demoire")
        for setting in given.split():
            name, _, value = setting.partition("=")
            *sections, field = name.split(".")
            section = functools.reduce(getattr, sections, cfg)
            assert hasattr(section, field)
            setattr(section, field, yaml.safe_load(value))
        there = Run(cfg).folder / "best.ckpt"
        there.parent.mkdir(parents=True, exist_ok=True)
        there.write_bytes(b"of a run with other settings")
        before = sorted(tmp_path.rglob("*.ckpt"))
        with pytest.raises((ValueError, TypeError, MisconfigurationException)) as error:
            demoireing.fit(cfg)
        assert sentence in str(error.value), given
        assert sorted(tmp_path.rglob("*.ckpt")) == before, "it is not moved aside"


def test_the_test_runs_where_it_is_said_to(tmp_path, monkeypatch):
    """Lightning leaves a trained network on the CPU."""
    cfg = configured(*FEW, f"runs={tmp_path}", name="demoire")
    network, devices = demoire.build("esdnet", width=0.25), []
    monkeypatch.setattr(machine, "device", lambda accelerator: torch.device("meta"))
    monkeypatch.setattr(demoireing, "test_network", lambda net, *_: devices.append(net) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        demoireing.test_and_report(Run(cfg), network, {}, None)
    assert next(devices[0].parameters()).device.type == "meta"


def test_a_finished_run_is_shown_without_its_start_file(tmp_path, monkeypatch):
    monkeypatch.setattr(Run, "stage", lambda run: "finished")
    monkeypatch.setattr(demoireing, "read_metrics", lambda folder: SHOWN)
    given = ["weights=gone.pt", "demoire.vgg=gone.pth", f"runs={tmp_path}"]
    assert demoireing.fit(configured(*FEW, *given, name="demoire")) == SHOWN


def test_a_run_does_not_go_on_and_is_not_shown_with_other_first_weights(tmp_path, monkeypatch):
    start, seen = tmp_path / "start.pt", []
    demoire.save(demoire.build("amnet", width=0.25), start)
    cfg = configured(*FEW, f"weights={start}", f"runs={tmp_path}", "model=amnet", name="demoire")
    monkeypatch.setattr(ranks, "fit", lambda trainer, *_: seen.append(trainer) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        demoireing.fit(cfg)
    (record,) = (one for one in seen[0].callbacks if isinstance(one, OriginRecord))
    state = demoire.build("amnet", width=0.25).state_dict()
    checkpoint = {"state_dict": state, "epoch": 0} | asdict(record.origin)
    torch.save(checkpoint, Run(cfg).folder / "best.ckpt")
    monkeypatch.setattr(demoireing, "read_metrics", lambda folder: SHOWN)
    monkeypatch.setattr(Run, "stage", lambda run: "finished")
    assert demoireing.fit(cfg) == SHOWN
    demoire.save(demoire.build("amnet", width=0.25), start)
    for pairs in (False, True):
        monkeypatch.setattr(demoireing, "has_other_pairs", lambda run, pairs=pairs: pairs)
        with pytest.raises(ValueError, match=r"start\.pt no longer holds the weights"):
            demoireing.fit(cfg)


def test_settings_of_classifiers_are_refused():
    for given in ("data.augment=shift", "data=folder", "adversary.share=0.5"):
        with pytest.raises(HydraException):
            configured(given, name="demoire")
