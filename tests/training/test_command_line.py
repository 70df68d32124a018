"""Paths on a command line are taken as they are, whatever Hydra's grammar makes of them; unknown
keys get a sentence."""

import re
from pathlib import Path

import pytest

from tests.training.small import configured
from training.config.command_line import check_keys, quote_paths
from training.config.commands import parse
from training.config.compose import recipe_files
from training.config.schema import Config, ReattackConfig
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
    ("recipe=moire_att", "Did you mean 'moire_at'?"),
    ("data=sign", "Did you mean 'signs'?"),
    ("data.name=cifar10", "pass data=cifar10"),
    ("sceen=paper", "Did you mean 'scene'?"),
    ("moire_at", "settings are given as key=value; got 'moire_at'"),
    ("reattack.eps=4/255", "reattack.eps must be a list, as in"),
    ("scene.preset=paper", "pass scene whole, as in scene='{preset: paper, ...}'."),
    ("data.root.x=1", "'data.root.x' is no setting: pass data.root=VALUE"),
    ("train.lr=fast", "train.lr: Value 'fast' of type 'str' could not be converted to Float."),
    ("data.train=1.5", "data.train: Value '1.5' of type 'float' could not be converted to Integer"),
    ("reattack.eps=[a]", "reattack.eps: Value 'a' of type 'str' could not be converted to Float."),
    ("+train.epoch=3", "Did you mean 'epochs'?"),
    ("+colour=red", "got 'colour'"),
    ("seed=", "seed= has no value: leave it out, or pass one"),
    ("recipe=", "recipe= has no value"),
    ("runs=", "runs= has no value"),
]


@pytest.mark.parametrize(("override", "sentence"), KEYS)
def test_an_unknown_key_gets_the_nearest_one(override, sentence):
    with pytest.raises(SystemExit) as error:
        check_keys(["seed=1", "scene={preset: paper}", "recipe=clean,moire_at", override], Config)
    assert sentence in str(error.value)


def test_what_hydra_takes_is_taken():
    good = ["seed=0,1", "seed=range(3)", "train.lr=1e-3", "data.root='a b'", "data.root=null"]
    good += [
        "++train.epochs=3",
        "trainer.devices=2",
        "reattack.eps=[0.1,1]",
        "scene=screen_photo",
        "data=folder",
    ]
    check_keys(
        [*good, "weights=runs/${seed}.pt", "hydra.verbose=true", "~train.lr", "--cfg", "job"],
        Config,
    )


def test_what_to_train_must_be_said():
    """Recipes are listed, each with what it is for; a command that only prints needs none."""
    for given in ([], ["seed=1"], ["-m", "seed=0,1"], ["~recipe"], ["--config-dir", "DIR"]):
        with pytest.raises(SystemExit, match="error: say what to train") as error:
            check_keys(given, Config)
        listed = re.findall(r"^  recipe=(.*)\n      \w", str(error.value), re.MULTILINE)
        assert listed == [path.stem for path in recipe_files()], "with a line each"
    for given in (["--help"], ["--cfg", "job"], ["-c", "job", "seed=1"], ["--info", "defaults"]):
        check_keys(given, Config)
    check_keys(["seed=1"], ReattackConfig)


def test_a_folder_of_configurations_must_be_there(tmp_path):
    """Hydra would pass over one that is not."""
    for flag in ([f"--config-dir={tmp_path}"], ["--config-dir", str(tmp_path)]):
        check_keys(["-m", "recipe=baseline,clean", *flag], Config)
    for flag in (["--config-dir=gone"], ["--config-dir", "gone"], ["-cd", "gone"]):
        with pytest.raises(SystemExit, match="error: --config-dir gone: there is no such folder"):
            check_keys(["recipe=clean", *flag], Config)


def test_a_recipe_is_not_given_to_an_attack():
    with pytest.raises(SystemExit, match="error: recipe= says how a model is trained"):
        check_keys(["recipe=moire_at"], ReattackConfig)
