"""The pages' commands have settings that exist, their links lead somewhere, and the site builds."""

import re
import runpy
import subprocess
from pathlib import Path

import pytest

from training.config.data_sets import DATA
from training.config.recipes import recipe_files
from training.config.settings import settings_of

ROOT = Path(__file__).parents[1]
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
}
COMMAND = re.compile(
    r"(?:python|torchrun[^`\n]*) training/(\w+)\.py( train| clean| score)?([^`\n]*)"
)
SETTINGS = runpy.run_path(str(ROOT / "docs/settings.py"))
SCHEMAS = {
    command.removeprefix("training/").replace(".py", ""): schema
    for _, command, schema in SETTINGS["COMMANDS"]
}
CHOICES = {"recipe": {path.stem for path in recipe_files()}, "data": set(DATA)}


def commands(text):
    """The script and the settings of each command on a page, in a block or in a line of text."""
    # recipes that a page shows how to write
    own = {f"recipe={name}" for name in re.findall(r"`recipes/(\w+)\.yaml`", text)}
    found = []
    text = re.sub(r"\$\w+", "0", text.replace("\\\n", " "))  # a shell's variables
    for script, verb, rest in COMMAND.findall(text):
        words = [word.strip("'\";") for word in rest.partition(" #")[0].split()]
        found.append((script + verb, [word for word in words if "=" in word and word not in own]))
    return found


COMMANDS = [(page, *command) for page, text in PAGES.items() for command in commands(text)]


def unknown(script, settings):
    """The settings that the script does not have, and recipes or data sets that do not exist."""
    known, found = set(settings_of(SCHEMAS[script])), []
    for word in settings:
        key, _, value = word.partition("=")
        if key in CHOICES and script in ("fit", "reattack"):
            is_known = set(value.split(",")) <= CHOICES[key]
        else:
            is_known = key in known
        found += [] if is_known else [word]
    return found


@pytest.mark.parametrize("page", sorted({page for page, *_ in COMMANDS}))
def test_commands_have_settings_that_exist(page):
    for on, script, settings in COMMANDS:
        assert on != page or unknown(script, settings) == []


@pytest.mark.parametrize(
    ("script", "setting"),
    [("fit", "train.epoch=3"), ("fit", "recipe=moire_att"), ("reattack", "suites=paper"),
     ("synthesise", "sizes=512"), ("frontier", "run=runs")],
)  # fmt: skip
def test_a_setting_that_does_not_exist_is_noticed(script, setting):
    assert unknown(script, [setting]) == [setting]


def test_commands_of_every_script_are_found():
    scripts = {script for _, script, _ in COMMANDS}
    assert scripts - {"demoire", "detect"} == set(SCHEMAS)


def test_the_page_of_settings_is_as_they_are_declared():
    """`python docs/settings.py` writes it anew."""
    assert PAGES["docs/settings.md"] == SETTINGS["page"]()


def test_links_lead_to_files_and_figures_have_theirs():
    for page, text in PAGES.items():
        for target in re.findall(r"\]\((?!https?:)([^)#\s]+)", text):
            assert (ROOT / page).parent.joinpath(target).exists(), (page, target)
        for name in re.findall(r"benchmarks/results/[\w.-]+\w", text):
            assert (ROOT / name).is_file(), (page, name)


def missing_sources(text):
    """The paths of sources that a page names and that do not exist."""
    paths = set(re.findall(r"\b(?:moireaug|training)/[\w/]+\.py\b", text))
    return {path for path in paths if not (ROOT / path).is_file()}


@pytest.mark.parametrize("page", [*PAGES, "CONTRIBUTING.md"])
def test_sources_that_pages_name_exist(page):
    assert not missing_sources((ROOT / page).read_text(encoding="utf-8"))


def test_a_source_that_does_not_exist_is_noticed():
    named = "`moireaug/attacks/patch.py`, `moireaug/attacks/pixel.py`"
    assert missing_sources(named) == {"moireaug/attacks/patch.py"}


def test_every_page_is_in_the_navigation():
    listed = set(re.findall(r": ([\w/]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE))
    assert {f"docs/{name}" for name in listed} == set(PAGES) - {"README.md"}


MKDOCS = ROOT / ".venv-docs" / "bin" / "mkdocs"


@pytest.mark.skipif(not MKDOCS.exists(), reason="`make docs` installs mkdocs, and builds the site")
def test_the_site_builds_without_warnings(tmp_path):
    command = [str(MKDOCS), "build", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    assert "Formatting signatures requires" not in done.stderr
    page = (tmp_path / "api" / "capture" / "index.html").read_text(encoding="utf-8")
    assert "packed Bayer planes" in page  # the docstrings are there
