"""One shot, one photo, whichever library it comes through; and none imports another's library."""

import subprocess
import sys

import pytest
import torch
from torchvision.transforms.v2 import functional as F

from moireaug import Shot, capture
from moireaug.transforms import albumentations, kornia, torchvision
from tests.transforms.common import REGISTERED


def through_kornia(image, shot):
    transform = kornia.RandomMoire(shot.scene, p=1, keepdim=True)
    return transform(image, params={**kornia.to_params(shot), "batch_prob": torch.ones(1)})


def through_pil(image, shot):
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
DTYPES = {"kornia": [torch.float32], "PIL": [torch.uint8]}  # of those that do not take both


def rounded(image):
    return (image * 255).round().to(torch.uint8)


@pytest.mark.parametrize("name", WAYS)
def test_all_libraries_give_the_same_photo(name):
    shot = REGISTERED.sample(1, (10, 14), torch.Generator().manual_seed(1))
    again = Shot.from_dict(shot.to_dict())
    for channels in (1, 3):
        image = torch.rand(channels, 10, 14, generator=torch.Generator().manual_seed(0))
        for given in (image, rounded(image)):
            if given.dtype not in DTYPES.get(name, (torch.uint8, torch.float32)):
                continue
            photo = WAYS[name](given, again)
            assert torch.equal(photo, torchvision.apply_shot(given, shot)), (channels, given.dtype)
            if channels == 1:
                continue
            if given is image:
                assert torch.equal(photo, capture(image[None], shot)[0])
            else:
                assert torch.equal(photo, rounded(capture(given[None].float() / 255, shot)[0]))


@pytest.mark.parametrize("name", WAYS)
def test_every_library_refuses_a_shot_of_other_images(name):
    image = torch.zeros(3, 10, 14, dtype=torch.uint8 if name == "PIL" else torch.float32)
    with pytest.raises(ValueError, match=r"(of|for) 3 images"):
        WAYS[name](image, REGISTERED.sample(3, (10, 14)))
    if name in ("torchvision", "PIL"):  # others replay at any size
        with pytest.raises(ValueError, match="1 images of 10 x 13; got 1 of 10 x 14"):
            WAYS[name](image, REGISTERED.sample(1, (10, 13)))


NORMALISED = torch.rand(1, 3, 9, 12) * 2 - 1
REFUSED = {"3 channels": torch.rand(1, 4, 9, 12), "Undo the normalisation": NORMALISED}


@pytest.mark.parametrize("library", [torchvision, kornia, albumentations], ids=str)
def test_every_library_refuses_the_same_pictures(library):
    for p in (-0.1, 1.5, "often", None, True, float("nan")):
        with pytest.raises(ValueError, match=r"p must be a probability in \[0, 1\]; got"):
            library.RandomMoire(REGISTERED, p=p)
    transform = library.RandomMoire(REGISTERED, p=1)
    for sentence, images in REFUSED.items():
        with pytest.raises(ValueError, match=sentence):
            if library is albumentations:
                transform(image=images[0].permute(1, 2, 0).numpy())
            else:
                transform(images)


@pytest.mark.parametrize("p", [0.0, 0.5, 1.0])
def test_the_memory_layout_is_kept(p):
    pictures = torch.rand(6, 3, 12, 9)
    given = [(torchvision, rounded(pictures)), (torchvision, pictures), (kornia, pictures)]
    for library, images in given:
        transform, photos = library.RandomMoire(p=p), []
        for laid_out in (images, images.to(memory_format=torch.channels_last)):
            torch.manual_seed(0)
            photos.append(transform(laid_out))
            assert photos[-1].stride() == laid_out.stride()
        assert torch.equal(*photos)


# after each statement, what must not be there yet; an indented one runs in a fork of its own
IMPORTS = """
import moireaug  # torchvision albumentations
import moireaug.camera.effects.denoise  # cv2
    moireaug.transforms.albumentations.RandomMoire()  # torchvision
moireaug.transforms.kornia.RandomMoire  # torchvision albumentations
moireaug.transforms.RandomMoire()  # albumentations
"""


def test_a_library_imports_no_other():
    lines = ["import os, sys, torch"]
    for line in IMPORTS.strip().splitlines():
        indent = line[: len(line) - len(line.lstrip())]
        absent = line.partition("# ")[2].split()
        lines += ["if not os.fork():"] if indent else []
        lines += [line, f"{indent}for m in {absent}: assert m not in sys.modules, ({line!r}, m)"]
        lines += ["    os._exit(0)", "assert os.wait()[1] == 0"] if indent else []
    done = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr.strip() == "", done.stderr


def test_a_number_in_the_scenes_place_is_taken_for_p():
    """torchvision's own transforms, such as RandomHorizontalFlip, take p there."""
    for library in (torchvision, kornia, albumentations):
        with pytest.raises(TypeError, match=r"got 0\.5\. For a probability, pass p=0\.5\."):
            library.RandomMoire(0.5)


def test_an_unknown_name_lists_the_transforms():
    import moireaug

    with pytest.raises(AttributeError, match="it has AdversarialMoire, RandomMoire, "):
        _ = moireaug.transforms.RandomMoires
    assert {"RandomMoire", "kornia"} <= set(dir(moireaug.transforms))
