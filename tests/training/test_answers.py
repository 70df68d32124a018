"""A network that is to keep its answers: unlabelled pictures, the frozen original, and the real
command from weights to report, resumed and attacked again."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from torch import nn
from torch.utils.data import TensorDataset

from moireaug.attacks import predicted
from moireaug.scenes import Scene
from tests.training.small import BRIEF, TINY, configured, inside, same
from training.attack.protocol import protocol_of
from training.classifier import train as training_of_classifiers
from training.classifier.adversaries import TrainingAdversary
from training.classifier.original import SHARES, Original, divergence, keep_answers
from training.classifier.train import classifier_of
from training.config.data_sets import Data
from training.config.schema import Adversary
from training.data.load import load
from training.data.splits import Splits
from training.models import classifiers as models
from training.recipe.phases import ClassificationTask, load_data
from training.report import run_parts
from training.report.numbers import points
from training.runs import trained
from training.runs.layout import read_metrics
from training.runs.metrics import RunMetrics
from training.system.files import read_checkpoint

pytestmark = pytest.mark.usefixtures("as_the_command_is")

CLASSES = 5
SMALL = ["recipe=moire_tune", "model=small_resnet", "data=folder", "data.size=24"]
SMALL += [one for one in TINY if not one.startswith(("data.", "train.epochs"))]
SMALL += [*BRIEF, "train.epochs=2", "train.batch_size=8", "data.train=16", "data.val=4"]
SMALL += ["scene=screen_photo", "shrink=1.5"]


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """Twenty pictures in a folder and one below it, without any labels."""
    root = tmp_path_factory.mktemp("pictures")
    (root / "more").mkdir()
    draw = np.random.default_rng(0)
    for k in range(20):
        codes = draw.integers(0, 256, (5, 4, 3), dtype=np.uint8)
        image = Image.fromarray(codes).resize((40, 30), Image.Resampling.BICUBIC)
        image.save(root / ("more" if k % 4 == 0 else "") / f"{k}.png")
    (root / "notes.txt").write_text("no picture")
    return root


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    """Weights of a network that gives the pictures several answers."""
    torch.manual_seed(3)
    model = models.as_model("small_resnet", CLASSES)
    path = tmp_path_factory.mktemp("network") / "small.pth"
    with torch.no_grad():
        model.head.weight.mul_(20)
    torch.save(model.state_dict(), path)
    return path


def unlabelled(root, **settings):
    return load(Data(name="folder", root=str(root), size=24, **settings), "answers")


def test_any_folder_of_pictures_is_split(pictures):
    splits = unlabelled(pictures)
    assert [len(part) for part in (splits.train, splits.val, splits.test)] == [17, 1, 2]
    seen = torch.stack([part[i][0] for part in splits[:3] for i in range(len(part))])
    assert len(seen.flatten(1).unique(dim=0)) == 20  # no picture in two parts
    assert len(unlabelled(pictures, test=1).train) == 17  # fewer to test on move none


def test_a_few_pictures_are_repeated_as_often_as_each_other(pictures):
    train = unlabelled(pictures, val=8, train=25).train
    _, counts = (
        torch.stack([image for image, _ in train]).flatten(1).unique(dim=0, return_counts=True)
    )
    assert sorted(counts.tolist()) == [2] * 5 + [3] * 5
    assert len(unlabelled(pictures, val=8, train=4).train) == 4


def test_the_parts_of_a_folder_stay_apart(pictures, tmp_path):
    shutil.copytree(pictures, tmp_path / "train")
    shutil.copytree(pictures / "more", tmp_path / "test")
    splits = unlabelled(tmp_path, val=2)
    assert [len(part) for part in (splits.train, splits.val, splits.test)] == [18, 2, 5]


def test_folders_that_cannot_be_split_get_a_sentence(tmp_path):
    for advice in ("images, or train/ and test/ with images", "at least 3"):
        with pytest.raises(ValueError, match=advice):
            unlabelled(tmp_path)
        Image.new("RGB", (9, 9)).save(tmp_path / "one.png")
    with pytest.raises(ValueError, match="pictures inside"):
        unlabelled(tmp_path / "none")


def test_the_original_is_frozen_and_its_own_answers_cost_nothing():
    model = models.as_model("small_resnet", CLASSES)
    original, images = Original(model), torch.rand(4, 3, 24, 24)
    wanted = original.logits(images)
    assert divergence(wanted, wanted) == 0
    with torch.no_grad():
        for weight in model.parameters():
            weight.add_(1)
    assert torch.equal(original.logits(images), wanted) and not wanted.requires_grad
    other = torch.randn_like(wanted).requires_grad_()
    probabilities = (wanted.softmax(1), other.softmax(1))
    by_hand = (probabilities[0] * (probabilities[0] / probabilities[1]).log()).sum(1).mean()
    torch.testing.assert_close(divergence(other, wanted), by_hand)
    (gradient,) = torch.autograd.grad(divergence(other, wanted), other)
    torch.testing.assert_close(gradient, (probabilities[1] - probabilities[0]).detach() / 4)


@pytest.mark.parametrize(("kept", "share"), [(0.0, 1.0), (0.7, 0.4), (1.0, 0.2)])
def test_weights_move_towards_the_original_until_its_answers_are_kept(kept, share):
    """Pictures as bright as 0 to 0.9, and a network that calls those above a bound bright."""
    model = nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(3, 2))
    with torch.no_grad():
        model[2].weight.copy_(torch.tensor([[0.0] * 3, [1 / 3] * 3]))
        model[2].bias.copy_(torch.tensor([0.05, 0.0]))
        original = Original(model)
        model[2].bias.copy_(torch.tensor([0.75, 0.0]))  # of the new weights: 7 of 10 change
    codes = (torch.arange(10) * 25.5).round().to(torch.uint8)
    images = TensorDataset(codes[:, None, None, None].expand(-1, 3, 4, 4), torch.zeros(10))
    asked = []
    original.model.register_forward_hook(lambda *_: asked.append(1))
    blend = keep_answers(model, original, images, kept)
    assert len(asked) == 1, "its answers are the same for every share"
    assert blend.new_share == share and (blend.equal_answers >= kept) == (kept < 1)
    bias = model[2].bias[0].item()
    assert bias == pytest.approx(0.05 + 0.7 * share)


def test_the_twin_is_photographed_without_moire():
    photos = []
    for moire in (True, False):
        scene = Scene.preset("screen_photo").with_shrink(1.5)
        adversary = TrainingAdversary(nn.Identity(), scene, Adversary(natural=1.0, moire=moire))
        torch.manual_seed(0)
        photos.append(adversary.photograph(torch.full((3, 3, 24, 24), 0.6)))
    assert adversary.scene.sensor.exposure == "mean"
    texture = [photo.std((2, 3)).mean() for photo in photos]  # noise and vignetting in both
    assert texture[0] > texture[1] and (photos[0] - photos[1]).square().mean().sqrt() > 2 / 255


@pytest.fixture(scope="module")
def tuned(pictures, network, tmp_path_factory):
    """Return the folder of the real command's run, and what it printed."""
    cwd = tmp_path_factory.mktemp("tuned")
    given = (*SMALL, f"weights={network}", f"data.root={pictures}", "data.test=3")
    done = inside("fit.py", *given, cwd=cwd)
    assert done.returncode == 0, done.stderr
    (folder,) = cwd.glob("runs/*/moire_tune/seed0")
    return folder, given, done.stdout


def test_a_run_is_compared_with_the_network_before(tuned, network):
    folder, _, said = tuned
    metrics = read_metrics(folder)
    assert metrics["baseline"]["recipe"] == "original" and metrics["start"] is None
    assert metrics["baseline"]["clean_accuracy"] == 1.0  # its answers are the labels
    assert metrics["gain"].keys() == metrics["correct"].keys() and "original" in said
    page = (folder / "report.html").read_text()
    assert "photos answered like their originals" in page
    (attack,) = [row["success"] for row in metrics["reattack"] if row["headline"]]
    (photo,) = [row["success"] for row in metrics["reattack"] if row["name"] == "moire"]
    added = f" and {points(attack - photo, 0)} points."  # by the noise, at the end of the sentence
    assert added in page.replace("\N{NO-BREAK SPACE}", " ")

    run = trained.read(folder)
    before, after = torch.load(network), run.model().state_dict()
    assert any(not torch.equal(before[name], after[name]) for name in before)
    kept = run.original_model().state_dict()
    assert all(torch.equal(before[name], kept[name]) for name in before)
    checkpoint, train = read_checkpoint(folder / "best.ckpt"), metrics["train"]
    share, equal = (checkpoint[name] for name in ("new_share", "equal_answers"))
    assert share in SHARES and f"{share:.0%} new" in said
    assert (train["new_share"], train["equal_answers"]) == (share, equal)
    line = (
        f"Its weights are {100 * share:.0f} % new and answer {100 * equal:.1f} % of the validation"
    )
    assert line in said and line in page.replace("\N{NO-BREAK SPACE}", " ")
    fresh = models.as_model("small_resnet", CLASSES, str(folder / "best.ckpt"), whole=True)
    assert all(torch.equal(value, after[name]) for name, value in fresh.state_dict().items())


@pytest.mark.parametrize("equal", [0.9, 0.97])
def test_a_report_says_where_answers_are_not_kept(tuned, equal):
    metrics = RunMetrics.read(tuned[0])
    train = replace(metrics.train, new_share=0.2, equal_answers=equal)
    text = "\n".join(run_parts(replace(metrics, train=train)))
    assert ("less than train.kept=0.97" in text) == (equal == 0.9)
    assert "Its weights are 20 % new" in text


def test_a_blend_that_does_not_keep_the_answers_warns(network, tmp_path, capsys):
    cfg = configured(*SMALL, f"weights={network}", "data.root=DIR", "train.kept=0.99")
    classifier = classifier_of(cfg, CLASSES)
    with torch.no_grad():
        classifier.model.head.weight.neg_()
    images = torch.randint(0, 256, (8, 3, 24, 24), dtype=torch.uint8)
    splits = Splits(None, TensorDataset(images, torch.zeros(8)), None, {}, CLASSES)
    args = classifier, classifier.original, splits, {}, tmp_path / "best.ckpt"
    assert training_of_classifiers.blend_best(*args).equal_answers < 0.99
    assert "warning: that is less than train.kept=0.99" in capsys.readouterr().out


def test_labels_are_the_answers_of_the_original(pictures, network):
    cfg = configured(*SMALL, f"weights={network}", f"data.root={pictures}")
    splits = load_data(cfg)
    assert splits.num_classes == CLASSES and splits.classes[4] == "4"
    original = classifier_of(cfg, CLASSES).original.model
    images, labels = protocol_of(cfg, splits, original=original).batches[0]
    assert torch.equal(labels, predicted(original(images)))


def test_a_run_is_resumed_and_attacked_again_with_its_own_original(tuned, tmp_path, monkeypatch):
    folder, given, _ = tuned
    shutil.copytree(folder.parents[2], tmp_path / "runs")
    copied = tmp_path / "runs" / folder.relative_to(folder.parents[2])
    again = inside("reattack.py", f"run={copied}", "reattack.n=2", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    (page,) = copied.glob("reattack/*/ladder/metrics.json")
    assert read_metrics(page.parent)["baseline"]["clean_accuracy"] == 1.0

    (copied / "metrics.json").unlink()
    resumed = inside("fit.py", *given, "resume=true", cwd=tmp_path)
    assert resumed.returncode == 0 and "Resuming" in resumed.stdout, resumed.stderr
    assert same(folder, copied)


@pytest.mark.parametrize(
    ("given", "advice"),
    [
        (["weights=null"], "pass weights=FILE and model=NAME"),
        (["train.init=clean"], "train.init=clean does not go with train.target=answers"),
        (["adversary.natural=0"], "nothing to learn on clean images"),
        (["data.class_index=labels.csv"], "answers uses none"),
        (
            ["data=signs", "data.root=null"],
            "signs are drawn, of 24 px: pass data=folder data.root=DIR",
        ),
    ],
)
def test_what_does_not_go_together_gets_a_sentence(given, advice, network, monkeypatch):
    monkeypatch.setattr(training_of_classifiers, "train_model", lambda *_: pytest.fail("trained"))
    with pytest.raises(ValueError, match=advice):
        ClassificationTask().check(
            configured(*SMALL, f"weights={network}", "data.root=DIR", *given)
        )
