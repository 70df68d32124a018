"""Paths on a command line are taken as they are, whatever Hydra's grammar makes of them; what it
refuses gets a sentence."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from hydra.errors import HydraException

from tests.training.small import configured, inside
from training import fit
from training.config.checks import check_overrides
from training.config.command_line import quote_paths, why_refused
from training.config.compose import RECIPE_GROUPS, register
from training.config.plain_commands import parse
from training.config.recipes import plain_training, recipe_files, require_recipe
from training.config.schema import Config
from training.demoireing import clean

PLAIN = ("2024_11", "1e5", "true", "josé", "Photos (1)", "it's", "a=b", "a&b", "#1", "a;b", "!")
PLAIN += ("a,b", "{a}", "[a", "a:b", "runs/moire_at", "a b", " a ", "not\udcffUTF-8")
OTHERS = {"'a,b'": "a,b", r"a\,b": "a,b", "null": None, "~/a": str(Path.home() / "a")}
PATHS = dict(zip(PLAIN, PLAIN, strict=True)) | OTHERS


@pytest.mark.parametrize("given", PATHS)
def test_a_path_comes_through_hydras_grammar(given):
    override = quote_paths([f"data.root={given}"], Config)
    assert quote_paths(override, Config) == override, "further processes of a run get it again"
    assert configured("recipe=clean", *override).data.root == PATHS[given]


@pytest.mark.parametrize("name", ["a (b) é.yaml", "not\udcffUTF-8.yml", "2024_11.yaml"])
def test_a_scenes_file_may_have_any_name(name):
    override = quote_paths([f"scene={name}"], Config)
    assert configured("recipe=clean", *override).scene == name
    for given in ("paper", "[a.yaml,b.yaml]", "{preset: paper}"):
        assert quote_paths([f"scene={given}"], Config) == [f"scene={given}"]


def test_a_sweep_of_paths_stays_one():
    sweep = ["weights=a.pt,b.pt", "runs=runs/${seed}", "-m"]
    assert quote_paths(sweep, Config) == sweep
    assert quote_paths(["runs=2024_11", *sweep], Config)[0] == "runs='2024_11'"


def test_the_scripts_expand_a_home_too():
    cfg = parse(["in=~/a", "out=b", "weights=c"], clean.Config, "", "")
    assert (cfg.in_, cfg.out) == (str(Path.home() / "a"), "b")


KEYS = [
    ("train.epoch=3", "Did you mean 'epochs'?"),
    ("recipe=moire_att", "Available options in 'recipe':\n\tbaseline\n\tclean\n\tmoire_at\n"),
    ("epochs=3", "a key in 'epochs' must be one of 'recipe', "),
    ("sceen=paper", "Did you mean 'scene'?"),
    ("moire_at", "Error parsing override 'moire_at'\nmissing EQUAL"),
    ("reattack.eps=4/255", "Pass reattack.eps whole, as in reattack.eps=[0.00784313725"),
    ("scene.preset=paper", "Pass scene whole, as in scene='{preset: paper, ...}'."),
    ("train=3", "Its settings: train.target, train.layers"),
    ("train.lr=fast", "train.lr: Value 'fast' of type 'str' could not be converted to Float."),
    (
        "data.train=1.5",
        "data.train: Value '1.5' of type 'float' could not be converted to Integer.",
    ),
    ("seed=", "seed: Value '' of type 'str' could not be converted to Integer."),
]


@pytest.mark.parametrize(("override", "sentence"), KEYS)
def test_what_hydra_refuses_gets_a_sentence(override, sentence):
    with pytest.raises(HydraException) as error:
        configured("recipe=clean", override)
    assert sentence in why_refused(error.value, Config)


@pytest.mark.parametrize("override", ["+advers=3", "+adversary.step=1", "++train.lrr=0.1"])
def test_an_added_setting_that_nothing_reads_is_refused(override):
    """Hydra adds any key after a plus."""
    key = override.lstrip("+").partition("=")[0]
    with pytest.raises(ValueError, match=f"a key in '{key}' must be one of"):
        configured("recipe=clean", override)
    assert configured("recipe=clean", "+train.lr=0.1").train.lr == 0.1


def test_a_refused_line_of_a_sweep_ends_before_its_first_job(tmp_path, monkeypatch):
    monkeypatch.setattr(fit, "fit", lambda cfg: pytest.fail("time was spent"))
    done = inside("fit.py", "-m", "recipe=clean", "train.epochs=1,two", cwd=tmp_path)
    assert done.returncode == 1 and done.stderr.endswith("could not be converted to Integer.\n")
    assert done.stderr.startswith("error: train.epochs: Value 'two'"), done.stderr


def test_a_recipe_of_another_folder_states_its_name(tmp_path, monkeypatch):
    monkeypatch.setattr(fit, "fit", lambda cfg: print(cfg.recipe, cfg.train.init))
    recipe = tmp_path / "recipe/mine.yaml"
    recipe.parent.mkdir()
    given = ["--config-dir", str(tmp_path), "recipe=mine"]
    recipe.write_text("# @package _global_\ntrain: {init: clean}\n")
    refused = inside("fit.py", *given, cwd=tmp_path)
    assert refused.stderr.startswith("error: recipe has no value: state it in the file, as in")
    recipe.write_text("# @package _global_\nrecipe: mine\ntrain: {init: clean}\n")
    assert inside("fit.py", *given, cwd=tmp_path).stdout == "mine clean\n"


def test_what_to_train_must_be_said():
    """Recipes are listed, each with what it is for; a command that only prints needs none."""
    for given in ([], ["seed=1"], ["-m", "seed=0,1"], ["~recipe"], ["--config-dir", "DIR"]):
        with pytest.raises(SystemExit, match="error: say what to train") as error:
            require_recipe(given)
        listed = re.findall(r"^  recipe=(.*)\n      \w", str(error.value), re.MULTILINE)
        assert listed == [path.stem for path in recipe_files()], "with a line each"
    for given in (["--help"], ["--cfg", "job"], ["-c", "job", "seed=1"], ["+recipe=clean"]):
        require_recipe(given)


UNUSABLE = [
    ("train: {init: clean", r"could not be read as YAML: .*expected ',' or '}'"),
    ("- clean", "must be a YAML mapping of settings"),
    ("recipe: other", "which is the name of the file"),
    ("advers: {share: 1}", r"'advers' must be one of .*Did you mean 'adversary'\?"),
    ("train: {lrr: 1}", r"must be one of .*Did you mean 'lr'\?"),
    ("train: 3", r"train: .* Its settings: train\.target, "),
    ("seed: often", "seed: Value 'often' of type 'str'"),
]


@pytest.mark.parametrize(("text", "sentence"), UNUSABLE)
def test_a_recipe_that_cannot_be_used_stops_its_own_run(text, sentence, tmp_path, monkeypatch):
    monkeypatch.setattr("training.config.recipes.RECIPES", tmp_path)
    (tmp_path / "good.yaml").write_text("# Good.\ntrain: {init: clean}\n")
    (tmp_path / "bad.yaml").write_text(f"# Bad.\n{text}\n")
    (tmp_path / ".#good.yaml").symlink_to("an editor's lock")
    for given in (["recipe=bad"], ["-m", "recipe=good,bad"]):
        with pytest.raises(SystemExit, match=rf"error: .*bad\.yaml.*{sentence}"):
            require_recipe(given)
    require_recipe(["recipe=good"])
    register("test", Config, RECIPE_GROUPS, "")
    with pytest.raises(SystemExit, match=r"recipe=bad\n      Bad\n  recipe=good\n"):
        require_recipe([])


@pytest.mark.parametrize("recipe", ["clean", "baseline"])
def test_what_others_are_compared_with_has_all_the_settings_of_its_recipe(
    recipe, tmp_path, monkeypatch
):
    """A run that is implied would displace the one that is asked for, else."""
    monkeypatch.setattr("training.config.recipes.RECIPES", tmp_path)
    path = tmp_path / f"{recipe}.yaml"
    path.write_text("train: {weight_decay: 0.1, batch_size: 32, length: 1}")
    other = configured("recipe=moire_fast", "train.init=clean", "train.lr=0.5").train
    expected = replace(other, init="random", weight_decay=0.1, batch_size=32, length=1.0)
    found = plain_training(recipe, other)
    assert found == expected and isinstance(found.length, float)
    path.write_text("# All by default.\n{}")
    assert plain_training(recipe, other) == replace(other, init="random", length=1.0)
    for text, said in (
        ("adversary: {share: 0.5}\nscene: paper", rf"{recipe}\.yaml sets adversary, scene, and a"),
        ("train: {lrr: 1}", r"Did you mean 'lr'\?"),
        ("train:", "train: "),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=said):
            plain_training(recipe, other)


def test_a_recipe_whose_run_could_not_be_read_is_refused_before_it_trains(tmp_path, monkeypatch):
    monkeypatch.setattr("training.config.recipes.RECIPES", tmp_path)
    (tmp_path / "moire+pgd.yaml").write_text("train: {init: clean}\n")
    with pytest.raises(SystemExit, match=r"moire\+pgd\.yaml cannot be the name of"):
        require_recipe(["recipe=moire+pgd"])


def test_a_recipe_is_not_given_to_an_attack():
    with pytest.raises(ValueError, match="recipe= says how a model is trained"):
        check_overrides(configured(name="reattack"), ["recipe=moire_at"])
