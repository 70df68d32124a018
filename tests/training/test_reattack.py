"""The attack on given weights and on a run: what it writes, and settings that it would ignore are
refused before it begins."""

import pytest
import torch

from tests.training.small import BRIEF, configured
from tests.training.strangers import attack, images, put
from training import reattack
from training.config.checks import merge_run_settings
from training.config.schema import Reattack
from training.runs import trained

pytestmark = pytest.mark.usefixtures("as_the_command_is")


def test_reattack_of_weights_on_a_folder(tmp_path):
    from torchvision.models import get_model

    root = images(tmp_path / "images", "n01", "n02") / "test"
    (tmp_path / "labels.csv").write_text("wnid,class_index\nn01,7\nn02,123\n")
    torch.manual_seed(0)
    torch.save(get_model("squeezenet1_1").state_dict(), tmp_path / "weights.pth")
    given = ["model=squeezenet1_1", f"weights={tmp_path / 'weights.pth'}", "scene=paper_code"]
    given += ["data=folder", f"data.root={root}", f"data.class_index={tmp_path / 'labels.csv'}"]
    given += ["data.size=32", "reattack.n=4", "reattack.steps=1", "reattack.batch_size=2"]
    cfg = configured(*given, f"runs={tmp_path / 'runs'}", name="reattack")
    metrics = reattack.reattack(cfg, [])
    assert metrics["baseline"] is None and metrics["start"] is None
    assert metrics["reattack"][0]["n"] == 4
    (page,) = (tmp_path / "runs/reattack/squeezenet1_1").glob("folder-test-*/ladder/report.html")
    assert page.stat().st_size > 10_000


REFUSED = [
    (["model=resnet18"], r"model= does not go with run=\S+, which has its own model"),
    (["weights=FILE"], "weights= does not go with run="),
    (["+recipe=moire_at"], "recipe= says how a model is trained"),
    (["seed=3"], "seed= says how a model is trained.* reattack.seed is the attack's"),
    (["train.lr=0.2"], "train.lr= says how a model is trained"),
    (["resume=true"], "resume= says how"),
    (["data.augment=shift"], "data.augment= says how"),
    (["targets={resnet18: FILE}"], "targets= is for suite=transfer or trust or paper;"),
    (["demoire=torch:relu", "suite=jpeg"], "demoire= is for suite=defences or demoireing or"),
    (["reattack.eps=[0.01]", "suite=recipes"], "reattack.eps= is for suite=ladder or full_ladder"),
    (["reattack.eps=[0.01]", "suite=worst_case"], "suite=worst_case has no use for it"),
    (["networks=DIR", "suite=jpeg"], "networks= is for suite=demoireing or paper; suite=jpeg"),
    (["trainer.devices=2"], "trainer.devices= has no effect here"),
    (["data.workers=2"], "data.workers= says how a model is trained"),
    (["reattack.steps=-1"], r"reattack.steps must be in \[0, 100000\]; got -1"),
]


def test_what_an_attack_on_a_run_cannot_obey_is_refused(tmp_path, nothing_attacked):
    folder = put(tmp_path)
    for given, message in REFUSED:
        with pytest.raises(ValueError, match=message):
            attack(folder, *given)
    assert not (folder / "reattack").exists()


def test_a_run_that_cannot_be_written_is_attacked_into_another_folder(tmp_path):
    folder = put(tmp_path / "media")
    before = sorted(tmp_path.rglob("media/**/*"))
    given = [*BRIEF, f"runs={tmp_path / 'elsewhere'}"]
    cfg = configured(f"run={folder}", "trainer.accelerator=cpu", *given, name="reattack")
    reattack.reattack(cfg, given)
    assert sorted(tmp_path.rglob("media/**/*")) == before
    assert (tmp_path / "elsewhere/clean/seed0/records").is_dir()
    assert list(tmp_path.glob("elsewhere/clean/seed0/reattack/*/ladder/report.html"))


def test_the_scene_need_not_allow_what_the_training_searched(tmp_path, monkeypatch):
    """The attack has a search of its own."""
    attacked = ["adversary.kind=moire_attack", "adversary.share=0.5", "adversary.eps=0.02"]
    folder = put(tmp_path, *attacked, "adversary.steps=1", "adversary.optimise=[noise,view]")
    monkeypatch.setattr(reattack, "attack_by_suite", lambda cfg, subject: None)
    assert attack(folder, "scene=paper_code", "suite=jpeg") == {}


def test_another_suite_than_the_ladder_is_not_made_weak_by_its_run(tmp_path):
    run = trained.read(put(tmp_path, *BRIEF))
    sizes = {}
    for suite in ("ladder", "standard", "worst_case"):
        given = [f"run={run.folder}", f"suite={suite}", "reattack.n=3"]
        cfg = merge_run_settings(run.cfg, configured(*given, name="reattack"), given)
        sizes[suite] = (cfg.reattack.n, cfg.reattack.steps, cfg.reattack.eps)
    default = (3, Reattack().steps, None)
    assert sizes == {"ladder": (3, 1, [0.02]), "standard": default, "worst_case": default}


def test_weights_are_attacked_without_settings_of_training(nothing_attacked):
    for setting in ("train.lr=0.2", "+recipe=clean"):
        given = ["model=resnet18", "weights=DEFAULT", setting]
        with pytest.raises(ValueError, match="says how a model is trained"):
            reattack.reattack(configured(*given, name="reattack"), given)


@pytest.mark.parametrize(
    ("trained_on", "classes", "message"),
    [
        ("ab", "abc", "was trained on 2 classes, and the data folder has 3"),
        ("abc", "abd", "class 2 of .* is 'c', and 'd' in the data folder"),
        ("abc", "abc", None),
    ],
)
def test_data_of_other_classes_is_refused(trained_on, classes, message, tmp_path, monkeypatch):
    own = ["data=folder", "data.size=24", "data.root=gone"]
    folder = put(tmp_path / "runs", *own, classes=tuple(trained_on))
    root = images(tmp_path / "images", *classes)
    given = ["data=folder", f"data.root={root}", "suite=jpeg", "data.val=1"]
    seen = []

    def reached(cfg, *_):
        seen.append(cfg)
        raise StopIteration

    monkeypatch.setattr(reattack, "suite_config", reached)
    with pytest.raises(ValueError if message else StopIteration, match=message):
        attack(folder, *given)
    assert message or seen[0].data.size == 24, "the size that the model was trained on"
