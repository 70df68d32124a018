"""Runs beside one another on a folder of images that has changed between them."""

import json
import shutil

import pytest
from PIL import Image

from tests.training.small import TINY, inside

pytestmark = pytest.mark.usefixtures("as_the_command_is")


def test_a_gain_is_over_the_images_that_the_folder_holds_now(tmp_path):
    """An image that is added later is seen by the baseline, too."""
    for half, n in (("train", 24), ("test", 5)):
        for k, colour in enumerate(("red", "blue")):
            (tmp_path / "images" / half / colour).mkdir(parents=True)
            for i in range(n):
                shade = [40, 40, 40]
                shade[2 * k] += 5 * i + 20
                path = tmp_path / "images" / half / colour / f"{i}.png"
                Image.new("RGB", (24, 24), tuple(shade)).save(path)
    given = ["data=folder", f"data.root={tmp_path / 'images'}", "data.val=8", "reattack.n=24"]
    settings = [*TINY, *given, "model=small_resnet", "reattack.eps=[0.02]", "reattack.steps=1"]
    inside("fit.py", "recipe=baseline", *settings, cwd=tmp_path)
    shutil.copy(tmp_path / "images/test/red/0.png", tmp_path / "images/test/red/9.png")
    done = inside("fit.py", "recipe=moire_aug", *settings, cwd=tmp_path)
    assert done.returncode == 0 and not done.stderr, (done.stdout, done.stderr)
    found = json.loads(next(tmp_path.glob("runs/*/moire_aug/seed0/metrics.json")).read_text())
    assert {row["n"] for row in found["baseline"]["reattack"]} == {11}
    assert set(found["gain"]) == {row["name"] for row in found["reattack"]}
