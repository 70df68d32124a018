"""The explorer's page: what its events answer, and the page itself in a browser."""

import multiprocessing
import os
import re
import runpy
import shutil
import socket
import sys
import warnings
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image

from moireaug import Scene
from training.explorer.controls import CONTROLS, values_of

# Gradio and its imports issue warnings of their own
pytestmark = pytest.mark.filterwarnings("ignore")

SCRIPT = Path(__file__).resolve().parents[3] / "training/explore.py"
NAMES = ("chromium", "chromium-browser", "chromium-headless-shell")
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
VALUES = values_of(Scene.preset("screen_photo"))


@pytest.fixture(scope="module", autouse=True)
def _page():
    """Import Gradio, which takes seconds, in no process that does not need it."""
    global gradio, page, layout
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gradio = pytest.importorskip("gradio", reason="the extra [explore] is not installed")
        from training.explorer import layout, page


def test_an_event_returns_all_that_the_page_shows():
    settings = ("screen_photo", "traffic sign", None, 0, *VALUES)
    told, photo, crop, spectrum, plan, python, yaml = layout.show_photo(*settings)
    assert told.startswith("256 x 256 pixels, photographed in ")
    assert photo.shape == (256, 256, 3) and crop.shape == spectrum.shape == (384, 384, 3)
    assert plan == str(Scene.preset("screen_photo").plan((256, 256)))
    assert 'Scene.preset("screen_photo")' in python and yaml == "preset: screen_photo\n"
    # a cleared number of the shot is the first
    _, cleared, *_ = layout.show_photo("screen_photo", "traffic sign", None, None, *VALUES)
    assert np.array_equal(photo, cleared)


def test_a_refusal_is_a_sentence_and_leaves_the_rest(tmp_path):
    large = tmp_path / "large.png"
    Image.new("RGB", (3000, 2000)).save(large)
    folded = list(VALUES)
    at = folded.index(-0.03)  # lens.k1 of the preset
    folded[at : at + 2] = [-0.9, -0.9]
    for file, seed, values, said in (
        (str(large), 0, VALUES, "large.png has 3000 x 2000 pixels"),
        (None, 0, folded, "fold the photo onto itself"),
        (None, 1e20, VALUES, "below 2^53; got 1e+20"),
        (None, -1, VALUES, "must be at least 0"),
    ):
        told, *rest = layout.show_photo("screen_photo", "cat", file, seed, *values)
        assert told.startswith("**Not possible:**") and said in told
        assert len(rest) == 6 and all(one == gradio.skip() for one in rest)


def test_a_preset_has_the_controls_of_what_it_states():
    settings = ("grey screen", None, 0)
    of_crops = [f"sensor.{name}" for name in ("shrink", "pixels", "crop_x", "crop_y")]
    for name, hidden in (
        ("screen_photo", {"panel.scale", "sensor.scale"}),
        ("paper", {"panel.width", "sensor.pitch", *of_crops}),
    ):
        values = layout.preset_updates(name)[: len(VALUES)]
        groups = layout.preset_updates(name)[len(VALUES) :]
        told = {c.name: group["visible"] for c, group in zip(CONTROLS, groups, strict=True)}
        assert {key for key, visible in told.items() if visible == "hidden"} == hidden
        *_, yaml = layout.show_photo(name, *settings, *values)
        assert yaml == f"preset: {name}\n"  # of the hidden ones, nothing is read


def serve(writer, port):
    sys.argv = [str(SCRIPT), "browser=false", f"port={port}"]
    with open(writer, "w", buffering=1) as sys.stdout:
        runpy.run_path(str(SCRIPT), run_name="__main__")


@pytest.fixture
def url():
    """Serve the page in a process of its own, whose threads and sockets end with it."""
    with socket.socket() as probe:
        probe.bind((page.HOST, 0))
        port = probe.getsockname()[1]
    reader, writer = os.pipe()
    server = multiprocessing.get_context("fork").Process(target=serve, args=(writer, port))
    server.start()
    os.close(writer)
    with open(reader) as said:
        yield re.search(r"http://\S+", said.readline())[0]
    server.kill()
    server.join()


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium: apt-get install chromium")
def test_a_slider_changes_the_photo_in_a_browser_without_hosts(url):
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    hosts = set()
    with api.sync_playwright() as playwright:
        options = ["--no-sandbox", "--disable-gpu"]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
        tab = browser.new_page()
        tab.set_default_timeout(120_000)
        tab.on("request", lambda request: hosts.add(urlsplit(request.url).hostname))
        tab.goto(url)
        photo = tab.locator("#photo img")
        photo.wait_for()
        assert tab.locator("#panel-width-from").is_visible()
        assert not tab.locator("#panel-scale-from").is_visible(), "the preset states the width"
        before = photo.get_attribute("src")
        tab.locator("#panel-lit_x-from input[type=range]").press("Home")
        api.expect(photo).not_to_have_attribute("src", before, timeout=120_000)
        after = photo.get_attribute("src")
        assert tab.request.get(before).body() != tab.request.get(after).body()
        browser.close()
    assert hosts == {"127.0.0.1"}
