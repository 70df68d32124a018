"""Photograph a picture off a screen.

Shows the three steps of every capture: a scene, a shot drawn from it, and the photo. The same shot
without subpixels on the screen gives the same photo without moiré.

    python examples/photograph_a_picture.py
    python examples/photograph_a_picture.py --picture FILE --scene phone_at_phone --out photo.png

Prints the scene's plan, where the camera stood, and how strong the moiré is. Writes the picture,
its photo and the photo without moiré side by side. Takes a few seconds.
"""

import argparse
from pathlib import Path

import torch
from PIL import Image
from skimage import data
from torchvision.transforms.v2.functional import to_dtype, to_image
from torchvision.utils import save_image

from moireaug import capture
from moireaug.common.image_files import read_picture
from moireaug.mixtures import as_scenes, sample_one
from moireaug.synthesis import without_moire


def main() -> None:
    """Photograph one picture."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--picture", help="an image file; scikit-image's cat if left out")
    parser.add_argument("--scene", default="screen_photo", help="a preset, or anywhere")
    parser.add_argument("--seed", type=int, default=0, help="another seed gives another shot")
    parser.add_argument("--side", type=int, default=320, help="longer side, in pixels")
    parser.add_argument("--out", default="photo.png", help="a picture's file")
    args = parser.parse_args()

    Path(args.out).parent.mkdir(parents=True, exist_ok=True)  # before the work
    picture = read_picture(args.picture) if args.picture else Image.fromarray(data.chelsea())
    picture.thumbnail((args.side, args.side))
    images = to_dtype(to_image(picture), torch.float32, scale=True)[None]  # (1, 3, H, W), [0, 1]

    scene = as_scenes(args.scene)  # or a mixture, of which one scene is drawn
    generator = torch.Generator().manual_seed(args.seed)
    shot = sample_one(scene, size=images.shape[-2:], generator=generator)
    print(shot.scene.plan())

    photo = capture(images, shot)
    twin = capture(images, without_moire(shot))

    drawn = shot.numbers()  # (B,) tensors by name
    yaw, pitch, roll = (drawn[f"view.{angle}"].item() for angle in ("yaw", "pitch", "roll"))
    print(f"The camera stood at yaw {yaw:.1f}, pitch {pitch:.1f}, roll {roll:.1f} degrees.")
    moire = 255 * (photo - twin).square().mean().sqrt()
    print(f"The moiré is {moire:.1f} of 255 codes RMS.")
    save_image(torch.cat([images, photo, twin]), args.out)
    print(f"Written: {args.out}: the picture, its photo, and the photo without moiré.")


if __name__ == "__main__":
    main()
