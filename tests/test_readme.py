"""Every snippet of Python on a page runs as it stands, after those before it on the page."""

import re
import warnings
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def snippets(text):
    """The code of each block, below as many empty lines as stand above it on the page: errors then
    name its line."""
    return ["\n" * text[: block.start(1)].count("\n") + block[1] for block in BLOCK.finditer(text)]


TEXTS, PAGES = {}, {}
for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
    name = path.relative_to(ROOT).as_posix()
    TEXTS[name] = path.read_text(encoding="utf-8")
    blocks = snippets(TEXTS[name])
    if blocks:
        PAGES[name] = blocks


@pytest.mark.parametrize("page", PAGES)
def test_snippets_define_what_they_use(page, capsys, tmp_path, monkeypatch):
    (tmp_path / "DIR").mkdir()  # where pages say that pictures are
    Image.effect_noise((300, 280), 40).convert("RGB").save(tmp_path / "DIR" / "picture.png")
    monkeypatch.chdir(tmp_path)
    names = {}
    for code in PAGES[page]:
        if "import torchattacks" in code:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # warnings of its imports
                pytest.importorskip("torchattacks")
        exec(compile(code, page, "exec"), names)
    assert names.keys() > {"__builtins__"}
    assert "Traceback" not in capsys.readouterr().err


def test_the_pages_that_show_code_are_found():
    assert len(PAGES["README.md"]) >= 4  # torchvision, kornia, albumentations, any classifier
    shown = {f"docs/{name}.md" for name in ("getting_started", "evaluation", "pairs")}
    assert PAGES.keys() >= shown | {"docs/appendix/extending.md", "docs/performance.md"}


def test_no_snippet_is_overlooked():
    """Python fenced in another way (indented, ```py, ~~~) would not be run."""
    for page, text in TEXTS.items():
        fences = re.findall(r"^\s*(?:```|~~~)\s*py", text, re.MULTILINE)
        assert len(fences) == len(PAGES.get(page, ())), page
