"""Calibrate a scene to your camera.

You need photos of a screen and the pictures that it showed, aligned and with the same file names,
in the folders PAIRS/photo and PAIRS/original. Without them, this script makes some with a camera
that the search does not know. The search varies a preset's ranges until its photos match the
statistics of yours: strength of the moiré by scale, tone, tint, sharpness, noise.

    python examples/calibrate_to_your_camera.py
    python examples/calibrate_to_your_camera.py --pairs PAIRS --size 384 --evaluations 400

Prints the mean distance during the search, the statistics of both, and three of the ranges. Writes
report.html and scene.yaml, which the commands take as `scene=`.
"""

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import torch
from PIL import Image
from skimage import data
from torchvision.transforms.v2.functional import to_dtype, to_image, to_pil_image

from moireaug import Scene
from moireaug.transforms import RandomMoire

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the repository, for `training`

from training import calibrate
from training.config import scenes

START = "screen_photo"
PICTURE_NAMES = ("astronaut", "chelsea", "coffee", "rocket")  # pictures of scikit-image


def make_pairs(folder: Path) -> None:
    """Photograph pictures with a camera of low gain, a blue tint and a soft lens."""
    preset = Scene.preset(START)
    camera = replace(
        preset,
        lens=replace(preset.lens, blur=(0.9, 1.0)),
        sensor=replace(preset.sensor, gain=(1.4, 1.6)),
        develop=replace(preset.develop, blue=(1.15, 1.25)),
    )
    for kind in ("photo", "original"):
        (folder / kind).mkdir()
    for seed, name in enumerate(PICTURE_NAMES):
        picture = Image.fromarray(getattr(data, name)()).resize((256, 256))
        images = to_dtype(to_image(picture), torch.float32, scale=True)[None]
        photos = camera.capture(images, torch.Generator().manual_seed(seed))
        picture.save(folder / "original" / f"{name}.png")
        to_pil_image(photos[0]).save(folder / "photo" / f"{name}.png")


def main() -> None:
    """Fit a scene, and compare its ranges with the original ones."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--pairs", help="a folder with photo/ and original/")
    parser.add_argument("--size", type=int, default=128, help="side of the crops, in pixels")
    parser.add_argument("--evaluations", type=int, default=60)
    parser.add_argument("--out", default="calibrated", help="a folder")
    args = parser.parse_args()

    with tempfile.TemporaryDirectory() as made:
        if args.pairs is None:
            make_pairs(Path(made))
        settings = calibrate.Config(
            pairs=args.pairs or made, scene=START, out=args.out, size=args.size,
            fit=True, evaluations=args.evaluations,
        )  # fmt: skip
        calibrate.calibrate(settings)

    found = scenes.load(str(Path(args.out) / "scene.yaml"))
    start = Scene.preset(START)
    for part, field in (("lens", "blur"), ("sensor", "gain"), ("develop", "blue")):
        before, after = (getattr(getattr(scene, part), field) for scene in (start, found))
        print(f"{part}.{field}: {before} before, {after} now")
    print(RandomMoire(scene=found, p=0.5))  # ready for training


if __name__ == "__main__":
    main()
