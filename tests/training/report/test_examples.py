"""The pictures of a report: of each image, with every model's answers."""

import numpy as np
import torch

from moireaug import Scene
from moireaug.evaluation import SuiteConfig
from moireaug.evaluation.records import RecordFolder
from moireaug.evaluation.suites.ladder import ladder, main_attack
from tests.evaluation.conftest import classifier
from tests.evaluation.haze import ran
from training.report.examples import run_examples

SCENE = Scene.preset("screen_photo")


class Silent(torch.nn.Module):
    """Answers NaN to every image."""

    def forward(self, images):
        return torch.full((len(images), 4), torch.nan) + 0 * images.mean((1, 2, 3))[:, None]


def test_pictures_for_a_report(tmp_path):
    images = torch.rand(8, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    model = classifier().eval()
    with torch.no_grad():
        batches = [(images, model(images).argmax(1))]
    table = ladder(SuiteConfig(scene=SCENE, eps=(8 / 255,), steps=2))
    runners = {}
    for name, own in (("ours", model), ("broken", Silent())):
        records = RecordFolder(tmp_path / name)
        runners[name] = ran((own, batches), table, seed=0, records=records)
    shown = run_examples(runners, main_attack(table), {0: "zero"})
    assert len(shown) == 4
    cells = shown[0]["cells"]
    assert [len(c["predictions"]) for c in cells] == [2, 2, 1, 0], (
        "the broken model has all wrong already"
    )
    assert all(c["image"].shape == (16, 16, 3) and c["image"].dtype.name == "uint8" for c in cells)
    assert cells[0]["predictions"][0][2]
    assert cells[0]["predictions"][1] == ("broken", "no answer", False)
    assert (cells[0]["image"] == (255 * images[0]).round().byte().permute(1, 2, 0).numpy()).all()
    photo, attacked, change = (cells[i]["image"].astype(int) for i in (1, 2, 3))
    assert abs(change - np.clip(127.5 + 4 * (attacked - photo), 0, 255)).max() <= 0.5
