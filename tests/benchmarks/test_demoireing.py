"""What removes moiré is judged by how much of it is left, and by what it does to an original."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from PIL import Image

from benchmarks import demoireing

ROOT = Path(__file__).resolve().parents[2]


def test_the_excess_is_what_the_photo_has_more_of_than_the_original():
    rows = []
    for pair, (photo, original) in enumerate([(6.0, 1.0), (4.0, 3.0)]):
        for picture, moire, psnr in (("photo", photo, 20.0), ("original", original, 99.0)):
            for by, left, gain in (("nothing", 1.0, 0.0), ("half", 0.5, pair - 0.5)):
                numbers = {"psnr_mapped": psnr + gain, "chroma": left * moire, "luma": moire}
                rows.append({"pair": pair, "picture": picture, "cleaned by": by} | numbers)
    nothing, half = demoireing.summary(pd.DataFrame(rows)).to_dict("records")
    assert nothing["gain"] == nothing["gained"] == nothing["chroma removed"] == 0
    # photos have 10 codes together and originals 4: half of 10 is 5 of the excess of 6
    assert half["chroma removed"] == pytest.approx(5 / 6) and half["luma removed"] == 0
    assert half["gain"] == 0 and half["gained"] == 1 and half["low"] < -1 < 1 < half["high"]
    assert half["original, PSNR"] == 99


def test_filters_blur_the_colours_that_they_say():
    x = torch.arange(64) / 64
    stripes = 0.5 + 0.2 * torch.sin(2 * torch.pi * 8 * x)  # a period of 8 pixels
    grey = stripes.expand(3, 64, 64)
    colour = torch.stack([grey[0], 1 - grey[0], torch.full((64, 64), 0.5)])
    middle = (slice(None), slice(16, 48), slice(16, 48))

    def contrast(picture):
        return float(picture[middle].std((1, 2)).amax())

    for sigma in (0.6, 4.0):
        kept = np.exp(-2 * (np.pi * sigma / 8) ** 2)
        blurred = contrast(demoireing.blur(grey[None], sigma)[0]) / contrast(grey)
        assert blurred == pytest.approx(kept, abs=0.01)
    luma = contrast(demoireing.blur_colour(grey)) / contrast(grey)
    assert luma == pytest.approx(np.exp(-2 * (np.pi * 0.8 / 8) ** 2), abs=0.01)
    assert contrast(demoireing.blur_colour(colour)) < 0.4 * contrast(colour)


def test_the_script_cleans_pairs_and_keeps_each_picture(tmp_path, monkeypatch, capsys):
    rng = np.random.default_rng(0)
    lines = ["photo,original"]
    for k in range(3):
        grey = rng.integers(60, 200, (12, 12, 1)).repeat(8, 0).repeat(8, 1)
        picture = grey.repeat(3, 2)
        stripes = 20 * np.sin(np.arange(96) * 2 * np.pi / 7)[:, None] * np.array([2, -1, 0])
        names = [f"photo{k}.png", f"original{k}.png"]
        for name, codes in zip(names, (picture + stripes, picture), strict=True):
            Image.fromarray(codes.round().astype(np.uint8)).save(tmp_path / name)
        lines.append(",".join(names))
    (tmp_path / "pairs.csv").write_text("\n".join(lines))
    arguments = ["pairs.csv", "--every", "2", "--threads", "1", "--out", "."]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["demoireing.py", *arguments])
    runpy.run_path(str(ROOT / "benchmarks/demoireing.py"), run_name="__main__")
    rows = pd.read_csv("demoireing.csv")
    assert set(rows["cleaned by"]) == {"nothing", "screen", *demoireing.FILTERS}
    assert len(rows) == 2 * 2 * 5 and rows.notna().all().all()
    assert "chroma removed" in capsys.readouterr().out
    photos = rows[rows.picture == "photo"].set_index("cleaned by")
    strong = "Gaussian blur, colour 4 px, luma 0.8 px"
    assert photos.loc[strong].chroma.max() < 0.3 * photos.loc["nothing"].chroma.min()

    monkeypatch.setattr(sys, "argv", ["demoireing.py", "nothing.csv"])
    with pytest.raises(SystemExit):
        runpy.run_path(str(ROOT / "benchmarks/demoireing.py"), run_name="__main__")
    assert "nothing.csv" in capsys.readouterr().err
