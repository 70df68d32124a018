"""Settings of a run: what they mean, and sentences for invalid ones."""

import re

import pytest
import torch

from tests.training.small import NO_DATA, TINY, baseline_config, configured, start_config
from tests.training.strangers import images
from training import fit, reattack
from training.classifier.module import Classifier
from training.classifier.train import classifier_of, seed_of_draws, trainer_of
from training.classifier.tuning import tuning_of
from training.config.data_sets import AUGMENTATIONS, Data
from training.config.schema import Train, Trainer
from training.config.settings import with_absolute_paths
from training.data.augmentation import augment
from training.data.load import load
from training.recipe import phases
from training.runs.run import Run
from training.system import machine

pytestmark = pytest.mark.usefixtures("as_the_command_is")


PLANS = [
    (["recipe=clean"], None, None),
    (["recipe=baseline"], "clean", None),
    (["recipe=moire_fast", "train.init=random"], None, "baseline"),  # shorter than its baseline
    (["recipe=pgd_at", "weights=FILE", "scene={preset: paper}"], "clean", "baseline"),
]
VARIED = ("recipe", "adversary", "train")


@pytest.mark.parametrize(("given", "start", "baseline"), PLANS)
def test_the_runs_that_a_recipe_needs_have_its_settings(given, start, baseline):
    cfg = configured(*given, *TINY[:4])
    ours = Run(cfg).settings
    for other, recipe in ((start_config(cfg), start), (baseline_config(cfg), baseline)):
        if recipe is None:
            assert other is None
            continue
        theirs, own = Run(other).settings, Run(configured(f"recipe={recipe}")).settings
        assert theirs["recipe"] == recipe and theirs["adversary"] == own["adversary"]
        init = own["train"]["init"] if recipe == start else ours["train"]["init"]
        length = own["train"]["length"]
        assert theirs["train"] == ours["train"] | {"init": init, "length": length}
        assert {k: v for k, v in theirs.items() if k not in VARIED} == {
            k: v for k, v in ours.items() if k not in VARIED
        }


def test_the_plain_runs_of_a_job_are_not_composed_by_hydra(monkeypatch):
    cfg = configured("recipe=moire_at", "data=gtsrb")
    composing = "hydra._internal.config_loader_impl.ConfigLoaderImpl.load_configuration"
    monkeypatch.setattr(composing, lambda *_: pytest.fail("composed again, for a second"))
    assert start_config(cfg).recipe == "clean" and baseline_config(cfg).recipe == "baseline"


def test_a_wrong_model_is_found_before_the_data_are_made(monkeypatch, tmp_path):
    monkeypatch.setattr(phases, "load", lambda cfg: pytest.fail("time was spent"))
    cfg = configured("recipe=clean", "model=resnet19", f"runs={tmp_path}")
    with pytest.raises(ValueError, match=r"no model named 'resnet19'.*resnet18"):
        fit.fit(cfg)


SENTENCES = [
    (["data=folder", "data.root=nowhere"], "is not a folder"),
    (["data=cifar10", "data.root=nowhere"], "data.download=true"),
    (["scene=screen_foto"], "Did you mean 'screen_photo'?"),
    (["resume=true", "data.train=32"], "does not exist: leave it out"),
    (["train.init=clean", "data.train=32"], "use random"),
    (["data=folder"], "needs data.root=DIR"),
    (["data=gtsrb", "data.root=null"], "data=gtsrb needs data.root=DIR"),
    (["reattack.eps=[2,4]"], "Divide by 255?"),
    (["data.root=somewhere"], "has no effect on data=signs"),
    (["data=folder", "data.download=true"], "has no effect on data=folder"),
    (["adversary.natural=0.3"], "leave adversary.* out"),
]


@pytest.mark.parametrize(("given", "sentence"), SENTENCES)
def test_wrong_settings_get_a_sentence(given, sentence, tmp_path):
    given = ["recipe=clean", *given, "data.val=16", "data.test=16", f"runs={tmp_path}"]
    with pytest.raises((TypeError, ValueError), match=re.escape(sentence)):
        fit.fit(configured(*given))
    assert not (tmp_path / "clean/seed0/metrics.json").exists()


def test_untrained_weights_are_not_attacked():
    with pytest.raises(ValueError, match="nothing to attack"):
        reattack.reattack(configured(name="reattack"), [])


def test_an_augmentation_is_never_that_of_another_name():
    images = torch.rand(1, 3, 16, 16)
    assert all(augment(images, kind).shape == images.shape for kind in AUGMENTATIONS)
    with pytest.raises(KeyError, match="mirror"):
        augment(images, "mirror")


@pytest.mark.parametrize("kind", ["shift", "shift_flip"])
def test_augmentation_moves_whole_images(kind):
    images = torch.rand(64, 3, 16, 16)
    moved = augment(images, kind)
    for image, patch in zip(images, moved[:, :, 4:12, 4:12], strict=True):
        sources = torch.stack([image, image.flip(-1)] if kind == "shift_flip" else [image])
        windows = sources.unfold(2, 8, 1).unfold(3, 8, 1).movedim(1, 3).flatten(0, 2)
        assert (windows == patch).flatten(1).all(1).any()
    assert not torch.equal(moved, images) and torch.equal(augment(images, "none"), images)


def test_affine_augmentation_draws_for_each_image_and_repeats():
    images = torch.rand(1, 3, 16, 12).expand(8, -1, -1, -1)
    torch.manual_seed(1)
    first = augment(images, "affine")
    torch.manual_seed(1)
    assert torch.equal(augment(images, "affine"), first)
    assert first.shape == images.shape and first.min() >= 0 and first.max() <= 1
    assert len({tuple(image.flatten().tolist()) for image in first}) == 8


def test_augmentation_is_as_exact_under_autocast():
    images = torch.rand(2, 3, 224, 224)
    torch.manual_seed(1)
    exact = augment(images, "affine")
    torch.manual_seed(1)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(augment(images, "affine"), exact)


def test_small_folders_are_read_once(tmp_path):
    root = images(tmp_path, "a", "b")
    splits = load(Data(name="folder", root=str(root), size=8, val=2))
    first = [image for image, _ in splits.train]
    for path in root.rglob("*.png"):
        path.unlink()
    again = [image for image, _ in splits.train]
    assert first and all(torch.equal(*pair) for pair in zip(first, again, strict=True))


def test_ranks_and_steps_draw_differently(monkeypatch):
    cfg = configured("recipe=moire_at", *TINY, "adversary.natural=0")
    batch = (torch.randint(0, 256, (4, 3, 24, 24), dtype=torch.uint8), torch.arange(4))
    model, seen = classifier_of(cfg, 16), []
    monkeypatch.setattr(Classifier, "log", lambda *args, **kwargs: None)
    monkeypatch.setattr(model, "_strength", lambda: 1.0)
    monkeypatch.setattr(
        model, "adversary", lambda images, *rest: seen.append(torch.rand(3)) or images
    )

    def draws(rank, index):
        monkeypatch.setattr(Classifier, "global_rank", property(lambda self: rank))
        model.training_step(batch, index)
        return seen[-1]

    assert torch.equal(draws(0, 0), draws(0, 0))
    assert len({tuple(draws(r, i).tolist()) for r in (0, 1) for i in (0, 1)}) == 4


def test_precision_follows_the_hardware_unless_it_is_given(tmp_path, monkeypatch):
    file = tmp_path / "cpuinfo"
    monkeypatch.setattr(machine, "CPUINFO", file)
    for flags, asked, got in (
        (None, None, "32-true"),  # no such file
        ("avx512f amx_bf16 amx_tile", None, "bf16-mixed"),
        ("avx512f avx512_bf16", None, "bf16-mixed"),
        ("avx512f", None, "32-true"),
        ("avx512f amx_bf16", "32-true", "32-true"),
        ("avx512f", "bf16-mixed", "bf16-mixed"),
    ):
        if flags:
            file.write_text(f"model name : some\nflags : {flags}\n")
        settings = Trainer(accelerator="cpu", precision=asked)
        made = trainer_of(settings, tuning_of(Train(), fine=False), 1, tmp_path, NO_DATA)
        assert made.precision == got, (flags, asked)


def test_a_data_set_brings_its_epochs():
    for given, epochs in (([], 5), (["data=cifar10"], 30), (["data=gtsrb", "train.epochs=7"], 7)):
        assert configured(*given).train.epochs == epochs


def test_a_recipe_does_not_repeat_the_draws_of_its_start():
    cfg = configured("recipe=moire_at", *TINY)
    assert seed_of_draws(cfg) == seed_of_draws(baseline_config(cfg))
    epochs = 1000  # the order of images in epoch e is that of draws + e
    assert abs(seed_of_draws(cfg) - seed_of_draws(start_config(cfg))) > epochs
    assert abs(seed_of_draws(cfg) - seed_of_draws(configured("recipe=moire_at", "seed=1"))) > epochs


def test_one_path_in_two_projects_is_two_data_sets(tmp_path, monkeypatch):
    """Two projects may share a folder of runs; `images` and `images/` are one folder."""
    for key in ("data.root", "data.class_index", "weights"):
        marks = []
        for place, path in (("one", "a.b"), ("two", "a.b"), ("one", "a.b/")):
            (tmp_path / place).mkdir(exist_ok=True)
            monkeypatch.chdir(tmp_path / place)
            cfg = configured("recipe=clean", "data=folder", f"{key}={path}")
            marks.append(Run(with_absolute_paths(cfg)).fingerprint)
        assert marks[0] != marks[1] and marks[0] == marks[2], key
    assert with_absolute_paths(configured("weights=IMAGENET1K_V1")).weights == "IMAGENET1K_V1"
