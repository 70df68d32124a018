"""Suite demoireing: networks before the model, and an attacker who knows of them."""

import pytest
from torch import nn
from torchvision.transforms.functional import gaussian_blur

from moireaug import Scene
from moireaug.defenses.demoire import Demoire
from moireaug.evaluation import rates
from tests.evaluation.haze import cell_of, frame_of
from training.report.published import with_paper
from training.suites.config import PaperConfig
from training.suites.paper import demoireing

SCENE = Scene.preset("screen_photo")


def smooth(images):
    """Blurs: noise that was found without it does not come through."""
    return gaussian_blur(images, 7)


def grey(images):
    """Shows the same grey, whatever it is shown."""
    return 0.5 + 0 * images


NETWORKS = {"mddm": nn.Identity(), "smooth": smooth, "grey": grey}


@pytest.fixture(scope="module")
def measured(known):
    """(table, rates) of three networks before the small model, 8 images."""
    networks = {name: Demoire(network) for name, network in NETWORKS.items()}
    config = PaperConfig(scene=SCENE, eps=(12 / 255,), steps=4, networks=networks)
    table = demoireing(config)
    return table, rates(frame_of((known[0], known[1][:1]), table))


def test_networks_are_rows_and_what_is_missing_says_why(measured):
    table, _ = measured
    assert table.rows == ["undefended", *NETWORKS, "mopnet", "fhde2net", "amnet"]
    assert set(table.empty) == {"mopnet", "fhde2net", "amnet"}
    assert all("no weights were given" in why for why in table.empty.values())


def test_an_identity_is_no_defence(measured):
    table, lines = measured
    for column in table.columns:
        found = cell_of(lines, "mddm", column), cell_of(lines, "undefended", column)
        if column not in ("adaptive", "worst"):  # whose search draws its own numbers
            assert found[0]["outcomes"] == found[1]["outcomes"], column


def test_the_papers_figures_are_of_its_own_bound(measured):
    _, lines = measured
    assert with_paper(lines, 4 / 255)["paper"].notna().any()
    assert with_paper(lines, 2 / 255)["paper"].isna().all()


def test_a_networks_name_is_free():
    with pytest.raises(ValueError, match="'jpeg_60' cannot name a target or a defence"):
        PaperConfig(scene=SCENE, networks={"jpeg_60": smooth})


def test_who_knows_of_the_network_goes_through_it(measured):
    _, lines = measured
    knows, grey_box = (cell_of(lines, "smooth", column) for column in ("adaptive", "ma"))
    assert knows["success"] > grey_box["success"]
    assert cell_of(lines, "smooth", "worst")["success"] >= knows["success"]
    grey = lines[lines["row"] == "grey"]
    assert grey["outcomes"].nunique() == 1  # nobody comes through it, and nothing is left to see
