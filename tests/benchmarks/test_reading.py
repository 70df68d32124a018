"""The benchmarks of codes and text that are read in photos of screens."""

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from benchmarks import codes, text, text_pairs


def test_codes(ran, tmp_path):
    _, table = ran("codes")
    assert set(table["code"]) == {"Data Matrix"}  # others are too large at this size
    assert table["photo, zxing-cpp"].between(0, 1).all() and (table["moire"] > 0.1).all()
    assert (tmp_path / "codes.png").stat().st_size > 1000


def test_real_photos_of_codes_are_read_at_each_size(tmp_path):
    picture = (255 * codes.drawn("QR", 7, 256)).byte().permute(1, 2, 0).contiguous().numpy()
    for name, pixels in (("code.png", picture), ("blank.png", np.full_like(picture, 255))):
        Image.fromarray(pixels).save(tmp_path / name)
    rows = codes.rows_of_real(tmp_path, codes.Sizes(modules=(1, 4)))
    assert [row["module"] for row in rows] == [0, 1, 4] and {row["n"] for row in rows} == {2}
    assert rows[0]["zxing-cpp"] == rows[2]["zxing-cpp"] == 0.5
    assert rows[0]["median_pixels"] == pytest.approx(7 / 2, abs=0.3)  # of 7 and of none


def test_codes_as_they_are_drawn_are_read():
    for code in codes.TEXTS:
        picture = codes.drawn(code, 2, 256)
        photo = (255 * picture).byte().permute(1, 2, 0).contiguous().numpy()
        readers = [name for name in codes.READERS if (name, code) != ("OpenCV", "Data Matrix")]
        assert all(codes.READERS[name](code, photo) for name in readers), code
        blank = np.full_like(photo, 255)
        assert not any(codes.READERS[name](code, blank) for name in readers)
    assert codes.drawn("QR", 8, 128) is None


def test_text(ran, tmp_path):
    pytest.importorskip("rapidocr_onnxruntime")
    _, table = ran("text")
    assert set(table["state"]) == {"picture", "photo", "twin", "cleaned"}
    assert (table.loc[table["state"] == "picture", "error"] < 0.05).all()
    assert (tmp_path / "text.png").stat().st_size > 1000


def test_pages_are_drawn_with_their_text():
    for kind in ("page", "interface"):
        page, again, other = (text.drawn(kind, 16, 256, seed) for seed in (0, 0, 1))
        assert torch.equal(page.picture, again.picture) and page.text == again.text != other.text
        assert len(page.text) > 40 and not set(page.text) & set(" \n")
        assert page.picture.shape == (3, 256, 256) and page.picture.std() > 0.1


def test_a_photo_is_brought_to_its_screenshot_s_frame():
    pages = [text.drawn(kind, 26, 400, seed).picture for seed, kind in enumerate(text.KINDS)]
    screenshot = (255 * torch.cat(pages, 2)).byte().permute(1, 2, 0).contiguous().numpy()
    seen = np.array([[120, 40], [560, 70], [540, 370], [100, 350]], np.float32)
    corners = np.array([[0, 0], [599, 0], [599, 399], [0, 399]], np.float32)
    to_photo = cv2.getPerspectiveTransform(seen, corners)
    photo = cv2.warpPerspective(screenshot, to_photo, (600, 400))
    part = text_pairs.part_of(photo, screenshot)
    middle = np.s_[40:-40, 40:-40]
    difference = part.photo[middle].astype(float) - part.picture[middle]
    assert np.abs(difference).mean() < 0.25 * screenshot.std()
    assert part.panel_pixels == pytest.approx(420, abs=5)  # between the inner two of four corners
    assert part.shrink == pytest.approx(4032 / 600)
    assert text_pairs.part_of(np.full_like(photo, 128), screenshot) is None
