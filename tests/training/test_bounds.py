"""Numbers that no training or attack can use are refused before anything is spent."""

import contextlib

import pytest

from tests.training.small import configured
from training import fit
from training.config.checks import check_classifier, check_run
from training.config.recipes import recipe_files
from training.config.schema import Config, ReattackConfig
from training.config.settings import settings_of, with_values
from training.demoireing.schema import DemoireConfig
from training.recipe.phases import ClassificationTask

SCHEMAS = (ReattackConfig, DemoireConfig)
BOUNDED = [key for key, one in settings_of(Config).items() if one.bounds]
# by a recipe that tunes a network of one's own
NEEDED = ["weights=FILE", "model=resnet18", "data=folder", "data.root=DIR", "data.size=224"]
UNBOUNDED = {"demoire.width"}  # the networks check it


def test_every_number_of_the_settings_has_bounds():
    for schema in SCHEMAS:
        for key, one in settings_of(schema).items():
            is_number = one.type in (int, float, int | None, float | None)
            assert is_number == bool(one.bounds) or key in UNBOUNDED, key


def test_every_setting_says_what_it_is():
    for schema in SCHEMAS:
        assert all(one.help for one in settings_of(schema).values())


def test_every_default_and_recipe_is_within_them():
    for path in recipe_files():
        given = NEEDED if path.stem == "moire_tune" else []
        assert ClassificationTask().check(configured(f"recipe={path.stem}", *given)) is None
    for data in ("cifar10", "folder"):  # no recipe says anything of the data
        assert ClassificationTask().check(configured("recipe=moire_at", f"data={data}")) is None


@pytest.mark.parametrize("key", BOUNDED)
def test_a_number_beyond_its_bounds_is_refused(key):
    low, high = settings_of(Config)[key].bounds
    tried = [low - 1, float("nan"), float("inf")] + ([] if high is None else [high * 1.01 + 1])
    for value in tried:
        with pytest.raises(
            ValueError, match=rf"{key} must be (at least {low}|in \[{low}, {high}\]); got"
        ):
            check_classifier(with_values(configured(), {key: value}))


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("train.batch_size=0", "train.batch_size must be at least 1; got 0"),
        ("trainer.devices=99999", "trainer.devices must be 1 to .* or auto; got 99999"),
        ("reattack.eps=[0.01,0.01]", "eps must be one or more different bounds"),
        ("reattack.eps=[0.0156862745,0.015686274509803921]", "different bounds"),  # 4/255, rounded
        ("trainer.deterministic=foo", "trainer.deterministic must be true, false or warn"),
        ("trainer.precision=bf16-true", "trainer.precision must be one of .*bf16-mixed"),
        ("trainer.precision=64", "trainer.precision must be one of"),
        ("trainer.accelerator=mps", "trainer.accelerator must be one of"),
        ("reattack.eps=[nan]", "eps must be a number"),
        ("adversary.natural=0.9", "parts of one batch"),
        ("adversary.kind=pdg", "Did you mean 'pgd'"),
        ("train.init=cleen", "Did you mean 'clean'"),
        ("data.augment=flip", "data.augment must be one of"),
    ],
)
def test_nothing_is_begun(override, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        given = "recipe=moire_at", "trainer.accelerator=cpu", f"runs={tmp_path / 'runs'}"
        fit.fit(configured(*given, override))
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("devices", "fine"),
    [
        *[(1, 1), (2, 1), ("auto", 1)],
        *[(-1, 0), (0, 0), (1.5, 0), (None, 0), ([0], 0), ("0,1", 0), ("abc", 0)],
    ],
)
def test_devices_that_are_there_are_taken(devices, fine):
    cfg = with_values(configured(), {"trainer.accelerator": "cpu", "trainer.devices": devices})
    refused = pytest.raises(ValueError, match=r"trainer\.devices must be 1 to")
    with contextlib.nullcontext() if fine else refused:
        check_run(cfg)
