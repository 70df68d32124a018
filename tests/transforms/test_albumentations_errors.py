"""What the albumentations transforms refuse beside numpy arrays, and where they send it."""

import re

import albumentations as A
import numpy as np
import PIL.Image
import pytest
import torch
from albumentations.pytorch import ToTensorV2

from moireaug.transforms import albumentations as moire
from tests.transforms.common import CAMERA, REGISTERED

IMAGE = np.zeros((9, 12, 3), np.uint8)
TENSOR = torch.zeros(3, 9, 12)
ONE, SEVERAL = "must be a numpy array; got", "must be a numpy array or a list of them; got"
BEFORE = "Put this transform before ToTensorV2, or use moireaug.transforms.RandomMoire or Adv"
CONVERT = "Convert it with np.asarray first"
SAMPLES = {
    "image tensor": ({"image": TENSOR}, f"image {ONE} torch.Tensor. {BEFORE}"),
    "images tensor": ({"images": TENSOR[None]}, f"images {SEVERAL} torch.Tensor. {BEFORE}"),
    "images of tensors": ({"images": [TENSOR]}, f"images {SEVERAL} torch.Tensor. {BEFORE}"),
    "volume": ({"volume": TENSOR[None]}, f"volume {SEVERAL} torch.Tensor. {BEFORE}"),
    "mask": ({"image": IMAGE, "mask": TENSOR[0]}, f"mask {ONE} torch.Tensor. {BEFORE}"),
    "masks": ({"image": IMAGE, "masks": TENSOR}, f"masks {SEVERAL} torch.Tensor. {BEFORE}"),
    "PIL image": ({"image": PIL.Image.fromarray(IMAGE)}, f"image {ONE} PIL.Image.Image. {CONVERT}"),
    "list": ({"image": IMAGE.tolist()}, f"image {ONE} list. {CONVERT}"),
    "mask list": ({"image": IMAGE, "mask": IMAGE.tolist()}, f"mask {ONE} list. {CONVERT}"),
}


@pytest.fixture(params=["RandomMoire", "AdversarialMoire"])
def transform(request):
    if request.param == "RandomMoire":
        return moire.RandomMoire(CAMERA, p=1)
    model = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(3 * 9 * 12, 3))
    return moire.AdversarialMoire(model, CAMERA, steps=1, p=1)


def test_what_is_no_numpy_array_is_refused_in_a_sentence(transform):
    for sample, sentence in SAMPLES.values():
        with pytest.raises(TypeError, match=re.escape(sentence)):
            transform(**sample, label=1)


def test_a_transform_after_totensor_is_sent_before_it(transform):
    with pytest.raises(TypeError, match=BEFORE):
        A.Compose([ToTensorV2(), transform])(image=IMAGE, label=1)


def test_tensors_in_a_replay_are_refused():
    out = A.ReplayCompose([moire.RandomMoire(CAMERA, p=1)])(volume=IMAGE[None])
    with pytest.raises(TypeError, match=BEFORE):
        A.ReplayCompose.replay(out["replay"], volume=TENSOR[None])


def test_masks_that_stay_may_be_tensors():
    mask = TENSOR[0]
    assert moire.RandomMoire(REGISTERED, p=1)(image=IMAGE, mask=mask)["mask"] is mask


def test_lists_of_arrays_are_taken():
    out = moire.RandomMoire(CAMERA, p=1)(images=[IMAGE, IMAGE], masks=[IMAGE[..., 0]])
    assert out["images"].shape == (2, *IMAGE.shape) and out["masks"].shape == (1, 9, 12)


UNLIKE = [
    ([IMAGE, IMAGE[:8]], "must have the same shape; got (9, 12, 3), (8, 12, 3). Call"),
    ([IMAGE, IMAGE[..., 0]], "must have the same shape; got (9, 12, 3), (9, 12)."),
    ([IMAGE, IMAGE.astype(np.float32)], "the same dtype; got uint8, float32. Call"),
]


def test_pictures_of_one_call_that_differ_are_refused():
    for images, sentence in UNLIKE:
        with pytest.raises(ValueError, match=re.escape(sentence)):
            moire.RandomMoire(CAMERA, p=1)(images=images)


def test_pictures_of_several_sizes_are_not_attacked_together():
    transform = moire.AdversarialMoire(lambda x: x.mean((2, 3)), CAMERA, steps=1, p=1)
    with pytest.raises(ValueError, match=r"the same height and width; got \(9, 12\), \(8, 12\)\."):
        transform(images=[IMAGE, IMAGE[:8]], label=1)
