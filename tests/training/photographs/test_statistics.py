"""Statistics of photos against closed forms: waves, lattices, noise, colour, blocks."""

import math

import numpy as np
import pytest
import torch

from moireaug import Scene, capture
from moireaug.synthesis.twins import without_moire
from training.photographs.spectra import peaks, spectrum
from training.photographs.statistics import BANDS, STATISTICS, compare, measure, percentiles
from training.photographs.tone import ColourMap, psnr

SIDE = 192
CODE = 1 / 255


def wave(frequency, angle=0.0, phase=0.3):
    """Return a cosine (SIDE, SIDE) of amplitude 1, its wave vector turned counter-clockwise."""
    y, x = torch.meshgrid(*2 * [torch.arange(SIDE) + 0.5], indexing="ij")
    along = x * math.cos(math.radians(angle)) - y * math.sin(math.radians(angle))
    return torch.cos(2 * math.pi * (frequency * along + phase))


def grey(level=0.5):
    return torch.full((3, SIDE, SIDE), level)


def with_red(added):
    """Return a grey picture with so much added to its red channel."""
    picture = grey()
    picture[0] += added
    return picture[None]


def photograph():
    """Return a smooth colourful picture with edges."""
    y, x = torch.meshgrid(*2 * [torch.linspace(0, 1, SIDE)], indexing="ij")
    picture = torch.stack([0.2 + 0.6 * x, 0.3 + 0.4 * y, 0.5 + 0.3 * (x - y)])
    picture[:, 60:130, 40:90] = picture[:, 60:130, 40:90].flip(0) * 0.7
    return picture[None]


def test_a_sinusoid_of_a_bands_wavelength_has_its_rms_there():
    for sigma in (low for low, _ in BANDS[:3]):
        best = math.sqrt(math.log(4) / (6 * math.pi**2)) / sigma  # where its gain is largest
        found = measure(with_red(6 * CODE * wave(best)), grey()[None])[0]
        inside = found[f"chroma_{sigma}_{2 * sigma}"]
        assert inside == pytest.approx(6 / math.sqrt(2), rel=0.02)
        assert found[f"luma_{sigma}_{2 * sigma}"] == pytest.approx(inside / 3, rel=0.02)
        others = [found[f"chroma_{low}_{high}"] for low, high in BANDS if low != sigma]
        assert max(others) < 0.85 * inside, sigma


def test_the_broad_band_has_the_gain_of_its_two_gaussians():
    frequency = 1 / 16
    blurred = [math.exp(-2 * (math.pi * sigma * frequency) ** 2) for sigma in (1.5, 8)]
    found = measure(with_red(6 * CODE * wave(frequency)), grey()[None])[0]
    wanted = 6 / math.sqrt(2) * (blurred[0] - blurred[1])
    assert found["chroma"] == pytest.approx(wanted, rel=0.02)


@pytest.mark.parametrize(("frequency", "angle"), [(0.05, 0), (0.083, 30), (0.111, 90), (0.2, 135)])
def test_stripes_are_found_where_they_are(frequency, angle):
    found = measure(with_red(6 * CODE * wave(frequency, angle)), grey()[None])[0]
    assert found["peaks"] == 1
    assert found["peak_frequency"] == pytest.approx(frequency, abs=0.001)
    assert found["peak_angle"] == pytest.approx(angle, abs=1)
    # R - G has all of it, and the luma a third
    strength = 6 / math.sqrt(2) * math.sqrt(1 + 1 / 9)
    assert found["peak_strength"] == pytest.approx(strength, rel=0.03)
    assert found["chroma_2d"] < 0.03 and found["luma_2d"] < 0.03


def test_a_lattice_is_two_dimensional_and_harmonics_are_not():
    lattice = measure(with_red(3 * CODE * (wave(0.08, 20) + wave(0.08, 110))), grey()[None])[0]
    stripes = measure(with_red(3 * CODE * (wave(0.06, 20) + wave(0.12, 20))), grey()[None])[0]
    uneven = measure(with_red(3 * CODE * (wave(0.08, 20) + wave(0.08, 110) / 2)), grey()[None])[0]
    assert lattice["chroma_2d"] > 0.95 and lattice["peaks"] == 2
    assert stripes["chroma_2d"] < 0.05 and stripes["peaks"] == 2
    assert uneven["chroma_2d"] == pytest.approx(2 * 0.25 / 1.25, abs=0.05)


def test_stripes_under_noise_stay_stripes():
    noise = 2 * CODE * torch.randn(3, SIDE, SIDE)
    found = measure(with_red(6 * CODE * wave(0.08, 50)) + noise, grey()[None])[0]
    assert found["chroma_2d"] < 0.1
    assert found["peak_frequency"] == pytest.approx(0.08, abs=0.002)
    assert found["peak_angle"] == pytest.approx(50, abs=2)


def test_white_noise_has_its_level_no_peaks_and_no_direction():
    found = measure((grey() + 3 * CODE * torch.randn(3, SIDE, SIDE))[None], grey()[None])[0]
    assert found["noise"] == pytest.approx(3, rel=0.05)
    assert found["peaks"] == 0 == found["peak_strength"]
    assert found["chroma_2d"] > 0.6
    assert found["chroma_1_2"] > 3 * found["chroma_8_16"]


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_a_flat_picture_gives_zeros(level):
    flat = grey(level)[None]
    for original in (flat, None):
        found = measure(flat, original)[0]
        assert all(map(math.isfinite, found.values()))
        for name in found.keys() - {"white", "black", "psnr", "psnr_mapped", "sharpness"}:
            assert found[name] == pytest.approx(0, abs=1e-3), name
        assert found["white"] == pytest.approx(255 * level) == found["black"]


def test_the_pictures_own_content_is_no_moire():
    picture = photograph()
    picture[:, 0] += 8 * CODE * wave(0.1, 40)
    assert measure(picture, picture)[0]["peaks"] == 0
    assert measure(picture)[0]["peaks"] >= 1  # nobody says that it is the picture's own


def test_a_colour_map_is_recovered():
    original = photograph()[0]
    r, g, b = original
    photo = torch.stack([0.1 + 0.7 * r + 0.05 * g**2, 0.05 + 0.8 * g, 0.2 + 0.5 * b + 0.1 * r])
    codes, wanted = 255 * photo.numpy(), 255 * original.numpy()
    there = ColourMap.fit(wanted, codes)
    assert np.abs(there(wanted) - codes).max() < 0.1
    found = measure(photo[None], original[None])[0]
    assert found["psnr"] == pytest.approx(psnr(codes, wanted)) and found["psnr"] < 25
    assert found["psnr_mapped"] > 45
    assert found["sharpness"] == pytest.approx(1, abs=0.03)


def test_levels_of_a_photo_with_a_cast_and_a_blur():
    original = photograph()
    blurred = torch.nn.functional.avg_pool2d(original, 3, 1, 1, count_include_pad=False)
    cast = torch.tensor([10, 0, -6]).view(3, 1, 1) * CODE
    greys = grey() + (torch.arange(SIDE) / SIDE - 0.5) * 0.6
    found = measure((greys + cast)[None], greys[None])[0]
    assert found["cast_red"] == pytest.approx(10, abs=0.1)
    assert found["cast_blue"] == pytest.approx(-6, abs=0.1)
    assert found["white"] - found["black"] == pytest.approx(0.98 * 0.6 * 255, rel=0.02)
    assert measure(blurred, original)[0]["sharpness"] < 0.9


def test_blocks_are_seen_wherever_they_begin():
    generator = np.random.default_rng(0)
    small = generator.normal(0, 3, (SIDE // 8 + 1, SIDE // 8 + 1))
    blocky = np.kron(small, np.ones((8, 8)))[3 : SIDE + 3, 5 : SIDE + 5]
    smooth = generator.normal(0, 1, (SIDE, SIDE))
    plain = torch.from_numpy(128 + smooth).float().expand(3, -1, -1) / 255
    with_blocks = torch.from_numpy(128 + smooth + blocky).float().expand(3, -1, -1) / 255
    assert measure(plain[None])[0]["blocks"] < 0.15
    assert measure(with_blocks[None])[0]["blocks"] > 0.8


def test_a_simulated_photo_has_more_chroma_than_its_twin():
    scene = Scene.preset("screen_photo")
    shown = grey(0.7).expand(6, -1, -1, -1)
    shot = scene.sample(6, (SIDE, SIDE), torch.Generator().manual_seed(3))
    photos = measure(capture(shown, shot), shown)
    twins = measure(capture(shown, without_moire(shot)), shown)
    assert len(photos) == 6 and all(row.keys() == STATISTICS.keys() for row in photos)
    gains = [photo["chroma"] / twin["chroma"] for photo, twin in zip(photos, twins, strict=True)]
    assert min(gains) > 1 and max(gains) > 2, gains


def test_numbers_are_compared_by_their_ratio_where_they_are_large():
    chroma = STATISTICS["chroma"]
    assert compare(4.0, 8.0, chroma) == pytest.approx(math.log(2), abs=0.01)
    assert compare(8.0, 4.0, chroma) == pytest.approx(-math.log(2), abs=0.01)
    assert compare(0.0, 0.01, chroma) == pytest.approx(0.04, rel=0.01)
    assert percentiles(range(101)) == (10, 50, 90)


def test_a_window_of_nothing_has_no_peaks():
    nothing = np.zeros((SIDE, SIDE), np.float32)
    assert not any(peaks(spectrum([nothing], None, nothing)))
