"""Numbers that no training or attack can use are refused before anything is spent."""

import contextlib
import dataclasses

import pytest
from omegaconf import OmegaConf

from tests.training.small import configured
from training import bounds, fit
from training.schema import Config, as_values

NUMBERS = ("int", "float")


def numeric_fields(schema):
    found = []
    for outer in dataclasses.fields(schema):
        if dataclasses.is_dataclass(outer.default_factory):
            inner = dataclasses.fields(outer.default_factory)
            found += [f"{outer.name}.{f.name}" for f in inner if f.type.split(" | ")[0] in NUMBERS]
        elif outer.type.split(" | ")[0] in NUMBERS:
            found.append(outer.name)
    return found


def test_every_number_of_the_schema_has_bounds():
    assert sorted(numeric_fields(Config)) == sorted(bounds.BOUNDS)


def test_every_default_and_recipe_is_within_them():
    for recipe in ("clean", "baseline", "moire_at", "moire_fast", "pgd_at"):
        assert fit.check(configured(f"recipe={recipe}")) is None
    for data in ("cifar10", "folder"):  # no recipe says anything of the data
        assert fit.check(configured("recipe=moire_at", f"data={data}")) is None


@pytest.fixture(scope="module")
def untyped():
    return as_values(configured())


@pytest.mark.parametrize("key", bounds.BOUNDS)
def test_a_number_beyond_its_bounds_is_refused(key, untyped):
    low, high = bounds.BOUNDS[key]
    tried = [low - 1, float("nan"), float("inf")] + ([] if high is None else [high * 1.01 + 1])
    for value in tried:
        loose = OmegaConf.create(untyped)
        OmegaConf.update(loose, key, value)
        with pytest.raises(
            ValueError, match=rf"{key} must be (at least {low}|in \[{low}, {high}\]); got"
        ):
            bounds.check(loose)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("train.batch_size=0", "train.batch_size must be at least 1; got 0"),
        ("trainer.devices=99999", "trainer.devices must be 1 to .* or auto; got 99999"),
        ("reattack.eps=[0.01,0.01]", "reattack.eps must be different bounds"),
        ("trainer.deterministic=foo", "trainer.deterministic must be true, false or warn"),
        ("trainer.precision=bf16-true", "trainer.precision must be one of .*bf16-mixed"),
        ("trainer.precision=64", "trainer.precision must be one of"),
        ("reattack.eps=[nan]", "eps must be a number"),
        ("adversary.natural=0.9", "parts of one batch"),
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
        *[(1, 1), (2, 1), ("2", 1), ("auto", 1)],
        *[(-1, 0), (0, 0), (1.5, 0), (None, 0), ([0], 0), ("0,1", 0), ("abc", 0)],
    ],
)
def test_devices_that_are_there_are_taken(devices, fine, untyped):
    cfg = OmegaConf.create(untyped)
    OmegaConf.update(cfg, "trainer", {"accelerator": "cpu", "devices": devices})
    refused = pytest.raises(ValueError, match=r"trainer\.devices must be 1 to")
    with contextlib.nullcontext() if fine else refused:
        bounds.check(cfg)
