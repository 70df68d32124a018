"""detect.py: simulated photos in, a detector out, and scores of photos that it has not seen."""

import json
import resource
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch
from PIL import Image

from moireaug import Scene, defenses
from moireaug.synthesis.pictures import Pictures
from tests.synthesis.folders import put
from training import detect
from training.detection import fit, measures, score
from training.detection.examples import Examples
from training.detection.labelled import collection_of, read_labelled, truth_of
from training.detection.measures import auc
from training.detection.network import (
    CROP_SIDE,
    WHOLE_SIDE,
    Detector,
    as_photo,
)

SCENE = "phone_at_monitor"


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A detector of a few rounds on a network of random weights, and its folder."""
    root = tmp_path_factory.mktemp("detector")
    put(root / "pictures", sizes=[(400, 300), (300, 420), (500, 380)])
    torch.manual_seed(0)
    settings = [f"images={root / 'pictures'}", f"out={root / 'out'}", "weights=null", "n=4"]
    detect.main(["train", *settings, f"scene={SCENE}"])
    return root


def test_examples_depend_on_their_number_alone(tmp_path):
    put(tmp_path, sizes=[(400, 300), (300, 420)])
    examples, again = (Examples(Pictures(tmp_path, 1), Scene.preset(SCENE), 3) for _ in range(2))
    made = examples[5]
    for one, other in zip(made, again[5], strict=True):
        assert torch.equal(one.image, other.image) and one[1:] == other[1:]
    for look, side in (("crop", CROP_SIDE), ("whole", WHOLE_SIDE)):
        of_look = [example for example in made if example.look == look]
        assert {example.is_screen for example in of_look} == {False, True}
        assert {tuple(example.image.shape) for example in of_look} == {(3, side, side)}
    other = examples[6]
    assert not torch.equal(made[0].image, other[0].image)


def test_large_pictures_train_as_small_as_the_detector_looks_at_photos(tmp_path, monkeypatch):
    """A crop of a ramp shows as many values of it as in a photo of 1024 px."""
    ramp = np.linspace(0, 255, 4096).astype(np.uint8)
    Image.fromarray(np.tile(ramp, (3072, 1))).convert("RGB").save(tmp_path / "ramp.png")
    monkeypatch.setattr("training.detection.examples.DRAWN", 0.0)
    examples = Examples(Pictures(tmp_path, 1), Scene.preset(SCENE), 0)
    original = examples[0][0].image.float()
    assert 256 / 1024 <= (original.amax() - original.amin()) / 255 <= 352 / 1024


def test_a_trained_detector_scores_a_folder(trained, capsys):
    metrics = json.loads((trained / "out" / "metrics.json").read_text())
    assert metrics["auc"].keys() == {"crop", "whole"} and metrics["examples"]["crop: original"] == 4
    photos = trained / "photos"
    for number, label in enumerate(("Real", "screens") * 2):
        path = photos / "one" / label / f"{number}.jpg"
        path.parent.mkdir(parents=True, exist_ok=True)
        codes = np.random.default_rng(number).integers(0, 256, (200, 300, 3), dtype=np.uint8)
        Image.fromarray(codes).save(path)
    out = trained / "scores"
    detector = trained / "out" / "detector.pt"
    capsys.readouterr()
    detect.main(["score", f"in={photos}", f"detector={detector}", f"out={out}"])
    printed = capsys.readouterr().out
    assert "one: 2 screens, 2 others, AUC" in printed and "Mean AUC of 1" in printed
    table = pd.read_csv(out / "scores.csv")
    assert list(table.columns) == ["photo", "score", "screen"] and len(table) == 4
    found = json.loads((out / "measures.json").read_text())["one"]
    is_screen = table.photo.str.contains("screens")
    assert found["auc"] == auc(table.score[is_screen], table.score[~is_screen])
    with Image.open(out / "roc.png") as plot:
        assert plot.width > 300
    assert (out / "mistakes.png").exists()
    unlabelled = photos / "one" / "screens"  # no figures of the earlier photos stay beside theirs
    detect.main(["score", f"in={unlabelled}", f"detector={detector}", f"out={out}"])
    assert [file.name for file in out.iterdir()] == ["scores.csv"]


def test_the_sheet_of_mistakes_holds_no_photo_that_is_right(tmp_path, monkeypatch):
    folder = tmp_path / "phones"  # as one of its collections, which is another than the top
    scores = {"screen/found": 0.9, "screen/missed": 0.5, "real/alarm": 0.6, "real/passed": 0.1}
    scores |= {"phones/screen/found": 0.9, "phones/real/passed": 0.1}
    codes = {"screen/found": 10, "screen/missed": 20, "real/alarm": 30, "real/passed": 40}
    codes |= {"phones/screen/found": 50, "phones/real/passed": 60}
    for name, code in codes.items():
        path = folder / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (1200, 900), (code, code, code)).save(path)
    rows = [{"photo": f"{name}.png", "score": one} for name, one in scores.items()]
    table = pd.DataFrame(rows)
    table["truth"] = [truth_of(name) for name in table.photo]
    kept = []

    def sheet(rows):
        kept.extend(max(picture.size) for row in rows for picture in row)
        return measures.sheet(rows)

    monkeypatch.setattr(score, "sheet", sheet)
    score.judge(table, 0.5, folder, tmp_path)  # a score at the threshold is no screen's
    found = json.loads((tmp_path / "measures.json").read_text())
    assert {name: row["auc"] for name, row in found.items()} == {".": 0.75, "phones": 1.0}
    with Image.open(tmp_path / "mistakes.png") as sheet:
        assert {code for _, (code, *_) in sheet.getcolors()} == {20, 30, 255}
    assert kept == [1024, 1024], "all of them at once, as large as they are"


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"a.png": False, "b.png": False}, "none of the 2 photos in .* could be scored"),
        ({"one/real/a.png": True, "two/screen/b.png": True}, "none of one, two does: put both"),
        (
            {"one/real/a.png": True, "one/screen/a.png": False, "two/screen/b.png": True},
            "none of one, two does",
        ),
    ],
)
def test_photos_that_cannot_be_judged_overwrite_nothing(files, message, tmp_path, monkeypatch):
    monkeypatch.setattr(Detector, "load", lambda file: SimpleNamespace(threshold=torch.zeros(1)))
    monkeypatch.setattr(score, "score_of", lambda *_: 0.5)
    for name, is_whole in files.items():
        path = tmp_path / "photos" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (40, 30)).save(path)
        if not is_whole:
            path.write_bytes(path.read_bytes()[:40])
    scores = tmp_path / "scores.csv"
    scores.write_text("of before")
    with pytest.raises(SystemExit, match=message):
        detect.main(["score", f"in={tmp_path / 'photos'}", "detector=FILE", f"out={tmp_path}"])
    assert scores.read_text() == "of before" and len(list(tmp_path.iterdir())) == 2


def test_a_detector_replays_from_its_file_and_rejects_photos(trained):
    detector = Detector.load(trained / "out" / "detector.pt")
    photos = torch.rand(2, 3, 230, 300, generator=torch.Generator().manual_seed(0))
    scores = detector(photos)
    assert scores.shape == (2,)
    assert torch.allclose(scores[1:], detector(photos[1:]), atol=1e-4)
    classifier = torch.nn.Sequential(torch.nn.AdaptiveAvgPool2d(1), torch.nn.Flatten())
    threshold = scores.mean().item()
    rejecting = defenses.Rejecting(classifier, detector, threshold)
    assert rejecting(photos).shape[0] == 2


def test_a_detector_that_does_not_fit_gets_a_sentence(tmp_path):
    torch.save({"backbone": "resnet18", "state": {}}, tmp_path / "old.pt")
    with pytest.raises(ValueError, match=r"old.pt' holds no detector of this version"):
        Detector.load(tmp_path / "old.pt")


def test_a_full_disk_leaves_the_earlier_detector_and_says_so(tmp_path):
    (tmp_path / "detector.pt").write_text("earlier")
    _, hard = limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, hard))
    try:
        with pytest.raises(OSError, match=r"detector\.pt could not be written"):
            Detector("resnet18").save(tmp_path / "detector.pt")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["earlier"]


def test_ordinary_photos_are_read_one_by_one_as_small_as_they_are_scored(tmp_path, capsys):
    put(tmp_path, sizes=[(3000, 2000)])
    (tmp_path / "torn.png").write_bytes(b"")
    (kept,) = fit.usable(Pictures(tmp_path, 1))
    (said,) = capsys.readouterr().out.splitlines()
    assert said.startswith("left out: ") and "torn.png" in said
    assert max(kept.size) == 1024
    name, _ = Pictures(tmp_path, 1).names
    with Image.open(tmp_path / name) as photo:
        assert torch.equal(as_photo(kept), as_photo(photo.convert("RGB")))


def test_two_calls_at_once_do_not_mix_their_features():
    detector = Detector("resnet18").eval()
    ours, theirs = torch.rand(2, 1, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    alone = detector.features(ours)
    stage = detector.network.model.layer2

    def call_again(*_):
        handle.remove()
        detector.features(theirs)

    handle = stage.register_forward_hook(call_again)
    assert torch.equal(detector.features(ours), alone)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["weight"], "takes train or score first; got 'weight'"),
        ([], "takes train or score first; got nothing"),
        (["train"], "weights must be given"),
        (["train", "weights=null", "backbone=mobilenet_v2"], "backbone must be a ResNet"),
        (["train", "weights=null", "images=nowhere"], "nowhere is not a folder"),
        (["train", "weights=null", "n=3"], "n must"),
        (["train", "weights=null", "scene=paper"], "scene=paper has no screen of a known size"),
        (["score", "in=nowhere", "detector=none.pt"], "none.pt"),
        (["score", "in=.", "detector=none.pt"], "out=runs/scores lies in in=., and what"),
    ],
)
def test_a_wrong_command_is_refused(command, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match=message):
        detect.main(command)


def test_the_truth_and_the_collection_are_read_off_the_folders():
    assert truth_of("a/Data/Real/1.jpg") is False and truth_of("screens/2.jpg") is True
    for name in ("a/b/screen.jpg", "realme/a.jpg", "Screenshots/a.png"):
        assert truth_of(name) is None
    assert truth_of("screen/Realme 8/1.jpg") is True and truth_of("real_2/1.jpg") is False
    assert collection_of("a/Data/real/1.jpg") == "a"
    assert collection_of("real/1.jpg") == collection_of("1.jpg") == ""


def test_labelled_photos_train_too(trained, capsys):
    """Screens that no scene simulates, all red, are told from others that are blue."""
    for number in range(6):
        for label, bands in (("real", (0, 0, 1)), ("screen", (1, 0, 0))):
            path = trained / "own" / ("b" if number > 2 else "a") / label / f"{number}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            noise = np.random.default_rng(number).integers(100, 256, (230, 300, 1))
            Image.fromarray((noise * bands).astype(np.uint8)).save(path)
    (trained / "own" / "a" / "real" / "torn.png").write_bytes(b"")
    out = trained / "labelled"
    own = [f"labelled={trained / 'own' / 'a'}", f"out={out}", f"images={trained / 'pictures'}"]
    torch.manual_seed(0)
    detect.main(["train", "weights=null", "n=4", f"scene={SCENE}", *own])
    printed = capsys.readouterr().out
    assert "left out: " in printed and "left out in turn: 3 screens, 3 others, AUC 1.00" in printed
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["labelled"] == 6 and metrics["cross_validated"]["auc"] == 1
    detector = Detector.load(out / "detector.pt")
    found = read_labelled(detector, trained / "own" / "b")
    assert found.names == [f"{label}/{n}.png" for label in ("real", "screen") for n in (3, 4, 5)]
    scores = detector.heads(found.crops, found.wholes)
    assert scores[found.is_screen].min() > scores[~found.is_screen].max()


@pytest.mark.parametrize("folder", ["own/a/real", "pictures"])
def test_labelled_photos_of_one_kind_are_refused_before_the_training(folder, trained, monkeypatch):
    monkeypatch.setattr(fit, "look_at", pytest.fail)
    settings = [f"images={trained / 'pictures'}", f"out={trained / 'no'}", "weights=null", "n=4"]
    with pytest.raises(SystemExit, match=r"of both kinds; .* 0 in screen lie"):
        detect.main(["train", *settings, f"labelled={trained / folder}"])


def test_ordinary_pictures_set_the_threshold(trained):
    detector = Detector.load(trained / "out" / "detector.pt")
    left_out = fit.sources(fit.Config(images=str(trained / "pictures"), weights=None))[1]
    scores = [fit.score_of(detector, picture) for picture in left_out]
    assert detector.threshold.item() == pytest.approx(np.quantile(scores, 0.9), abs=1e-3)


def test_where_ordinary_photos_are_named_no_others_are_drawn(tmp_path, monkeypatch):
    put(tmp_path, sizes=[(400, 300), (300, 420)])
    monkeypatch.setattr(fit.DrawnPictures, "draw", lambda *_: pytest.fail("drawn in vain"))
    assert len([*fit.sources(fit.Config(ordinary=str(tmp_path), weights=None))[1]]) == 2


def test_all_pictures_train_where_others_set_the_threshold(tmp_path):
    put(tmp_path, sizes=[(400, 300), (300, 420), (500, 380)])
    of_images = fit.Config(images=str(tmp_path), weights=None)
    assert len(fit.sources(of_images)[0].names) == 2
    assert len(fit.sources(replace(of_images, ordinary=str(tmp_path)))[0].names) == 3
