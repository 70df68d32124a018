"""One shot, one photo, whichever library it comes through; and none imports another's library."""

import subprocess
import sys

import pytest
import torch
from torchvision.transforms.v2 import functional as F

from moireaug import Shot, capture
from moireaug.transforms import albumentations, kornia, torchvision


def through_kornia(image, shot):
    if image.dtype == torch.uint8:
        pytest.skip("kornia takes no uint8")
    transform = kornia.RandomMoire(shot.scene, p=1, keepdim=True)
    return transform(image, params={**kornia.to_params(shot), "batch_prob": torch.ones(1)})


def through_pil(image, shot):
    if image.dtype != torch.uint8:
        pytest.skip("PIL images are uint8")
    picture = F.to_pil_image(image)
    return F.pil_to_tensor(torchvision.apply_shot(picture, shot))


def through_albumentations(image, shot):
    array = albumentations.apply_to_one(image.permute(1, 2, 0).numpy(), shot)
    return torch.from_numpy(array).permute(2, 0, 1)


WAYS = {
    "torchvision": torchvision.apply_shot,
    "PIL": through_pil,
    "kornia": through_kornia,
    "albumentations": through_albumentations,
}


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32], ids=str)
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("name", WAYS)
def test_all_libraries_give_the_same_photo(name, channels, dtype, registered):
    image = torch.rand(channels, 10, 14, generator=torch.Generator().manual_seed(0))
    image = (image * 255).round().to(dtype) if dtype == torch.uint8 else image
    shot = registered.sample(1, (10, 14), torch.Generator().manual_seed(1))
    photo = WAYS[name](image, Shot.from_dict(shot.to_dict()))
    assert torch.equal(photo, torchvision.apply_shot(image, shot))
    if channels == 3:
        shown = image.float() / 255 if dtype == torch.uint8 else image
        expected = capture(shown[None], shot)[0]
        expected = (expected * 255).round().to(dtype) if dtype == torch.uint8 else expected
        assert torch.equal(photo, expected)


@pytest.mark.parametrize("name", WAYS)
def test_every_library_refuses_a_shot_of_other_images(name, registered):
    image = torch.zeros(3, 10, 14, dtype=torch.uint8 if name == "PIL" else torch.float32)
    with pytest.raises(ValueError, match=r"(of|for) 3 images"):
        WAYS[name](image, registered.sample(3, (10, 14)))


NORMALISED = torch.rand(1, 3, 9, 12) * 2 - 1
REFUSED = {"3 channels": torch.rand(1, 4, 9, 12), "Undo the normalisation": NORMALISED}


@pytest.mark.parametrize("library", [torchvision, kornia, albumentations], ids=str)
def test_every_library_refuses_the_same_pictures(library, registered):
    for p in (-0.1, 1.5, "often", None, True, float("nan")):
        with pytest.raises(ValueError, match=r"p must be a probability in \[0, 1\]; got"):
            library.RandomMoire(registered, p=p)
    transform = library.RandomMoire(registered, p=1)
    for sentence, images in REFUSED.items():
        with pytest.raises(ValueError, match=sentence):
            if library is albumentations:
                transform(image=images[0].permute(1, 2, 0).numpy())
            else:
                transform(images)


@pytest.mark.parametrize("p", [0.0, 0.5, 1.0])
@pytest.mark.parametrize(
    ("library", "dtype"),
    [(torchvision, torch.uint8), (torchvision, torch.float32), (kornia, torch.float32)],
    ids=str,
)
def test_the_memory_layout_is_kept(library, dtype, p):
    images = (torch.rand(6, 3, 12, 9) * (255 if dtype == torch.uint8 else 1)).to(dtype)
    transform, photos = library.RandomMoire(p=p), []
    for given in (images, images.to(memory_format=torch.channels_last)):
        torch.manual_seed(0)
        photos.append(transform(given))
        assert photos[-1].stride() == given.stride()
    assert torch.equal(*photos)


# one process each, as what is imported stays; after each statement, what must not be there yet
IMPORTS = [
    [
        ("import moireaug", ("torchvision", "albumentations")),
        ("import moireaug.effects.denoise", ("cv2",)),
        ("moireaug.transforms.kornia.RandomMoire", ("torchvision", "albumentations")),
        ("moireaug.transforms.RandomMoire", ("albumentations",)),
        ("from moireaug.transforms import RandomMoire; RandomMoire()", ("albumentations",)),
    ],
    [("import moireaug; moireaug.transforms.albumentations.RandomMoire()", ("torchvision",))],
]


def test_a_library_imports_no_other():
    lines = ["import os, sys, torch"]
    for statements in IMPORTS:
        lines.append("if not os.fork():")
        for statement, absent in statements:
            check = f"assert m not in sys.modules, ({statement!r}, m)"
            lines += [f"    {statement}", f"    for m in {absent!r}: {check}"]
        lines += ["    os._exit(0)", "assert os.wait()[1] == 0"]
    done = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr.strip() == "", done.stderr


def test_an_unknown_name_lists_the_transforms():
    import moireaug

    with pytest.raises(AttributeError, match="it has AdversarialMoire, RandomMoire, "):
        _ = moireaug.transforms.RandomMoires
    assert {"RandomMoire", "kornia"} <= set(dir(moireaug.transforms))
