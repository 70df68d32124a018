"""The torchvision transform: what is kept, what moves, what is drawn, and what is refused."""

import dataclasses
import itertools

import numpy as np
import PIL.Image
import pytest
import torch
from torch.utils.data import DataLoader, Dataset
from torchvision import tv_tensors
from torchvision.transforms.v2 import functional as F

from moireaug import Develop, Panel, Scene, Sensor, capture
from moireaug.scene.by_name import with_values
from moireaug.transforms import RandomMoire
from moireaug.transforms._leaves import apply_shot
from tests.transforms.common import CAMERA, FRAMES, REGISTERED, sample_of_leaves, values

DTYPES = (torch.uint8, torch.float16, torch.bfloat16, torch.float32, torch.float64)
SHAPES = ((3, 9, 12), (1, 9, 12), (2, 3, 9, 12), (2, 1, 9, 12))
LEAVES = {
    torch.as_tensor: SHAPES,
    tv_tensors.Image: SHAPES,
    tv_tensors.Video: ((4, 3, 9, 12), (1, 1, 9, 12), (2, 2, 3, 9, 12)),
}
FRAME_DTYPES = [("registered", dtype) for dtype in DTYPES]
FRAME_DTYPES += [("camera", torch.uint8), ("camera", torch.float32)]


@pytest.mark.parametrize(("frame", "dtype"), FRAME_DTYPES, ids=str)
def test_type_shape_dtype_and_range_are_kept(dtype, frame):
    transform = RandomMoire(FRAMES[frame], p=1)
    for leaf, shapes in LEAVES.items():
        for shape in shapes:
            image = leaf(values(shape, dtype))
            before = image.clone()
            out = transform(image)
            assert type(out) is type(image) and out.shape == image.shape and out.dtype == dtype
            assert out.isfinite().all() and out.min() >= 0
            assert out.max() <= (255 if dtype == torch.uint8 else 1)
            assert not torch.equal(out, image), (leaf, shape)
            assert torch.equal(image, before), "the input was modified"


def test_pil_modes_are_kept():
    for mode in ("RGB", "L", "RGBA", "LA"):
        channels = 4 if mode == "RGBA" else 3
        image = PIL.Image.fromarray(values((9, 12, channels), torch.uint8).numpy()).convert(mode)
        out = RandomMoire(REGISTERED, p=1)(image)
        assert out.mode == mode and out.size == image.size
        assert np.any(np.asarray(out) != np.asarray(image))
        if "A" in mode:
            assert np.array_equal(np.asarray(out)[..., -1], np.asarray(image)[..., -1])


def test_a_grey_image_is_shown_as_grey_rgb():
    grey = values((1, 9, 12), torch.float32)
    shot = REGISTERED.sample(1, (9, 12))
    rgb = apply_shot(grey.expand(3, -1, -1), shot)
    expected = F.rgb_to_grayscale(rgb)
    # torchvision rounds the weights
    torch.testing.assert_close(apply_shot(grey, shot), expected, atol=2e-4, rtol=0)


def test_registered_photos_leave_all_else_alone():
    for as_image in (tv_tensors.Image, F.to_pil_image):
        sample = sample_of_leaves(as_image(values((3, 9, 12), torch.uint8)))
        sample |= {"features": np.zeros((5, 7)), "number": np.array(3)}  # no images
        out = RandomMoire(REGISTERED, p=1)(sample)
        assert out["image"] is not sample["image"]
        assert all(out[k] is sample[k] for k in sample if k != "image")


def test_what_is_not_chosen_comes_back_as_it_came():
    images = values((3, 9, 12), torch.uint8), values((2, 3, 9, 12), torch.float32)
    for scene, image in itertools.product((REGISTERED, CAMERA), images):
        sample = sample_of_leaves(tv_tensors.Image(image))
        if image.ndim == 4 and scene is CAMERA:
            sample = {k: sample[k] for k in ("image", "label", "name")}
        out = RandomMoire(scene, p=0)(sample)
        assert all(out[k] is sample[k] for k in sample)


def test_every_image_of_a_batch_has_its_own_draw():
    batch = values((1, 3, 9, 12), torch.float32).expand(32, -1, -1, -1)
    photos = RandomMoire(REGISTERED, p=1)(batch)
    assert len({p.numpy().tobytes() for p in photos}) == 32
    torch.manual_seed(0)
    transform = RandomMoire(REGISTERED, p=0.5)
    assert "RandomMoire(p=0.5" in repr(transform)
    out = transform(batch)
    kept = [torch.equal(o, b) for o, b in zip(out, batch, strict=True)]
    assert 6 < sum(kept) < 26


def test_a_video_is_one_scene_filmed_by_hand():
    quiet = with_values(REGISTERED, {"sensor.read_noise": 0.0})
    frames = values((1, 3, 9, 12), torch.float32).expand(3, -1, -1, -1)
    filmed = RandomMoire(quiet, p=1)(tv_tensors.Video(frames))
    in_camera_frame = dataclasses.replace(quiet, develop=Develop(registered=False))
    still = RandomMoire(in_camera_frame, p=1)(tv_tensors.Video(frames))
    assert torch.equal(still[0], still[1]) and torch.equal(still[0], still[2])
    noisy = RandomMoire(CAMERA, p=1)(tv_tensors.Video(frames))
    assert not torch.equal(noisy[0], noisy[1]), "sensor noise differs from frame to frame"
    pair = RandomMoire(quiet, p=1)(tv_tensors.Video(frames.expand(2, -1, -1, -1, -1)))
    within = [(video[1:] - video[:-1]).abs().mean() for video in (filmed, *pair)]
    assert min(within) > 0 and max(within) < 0.1 * (pair[0] - pair[1]).abs().mean()


def test_images_of_one_sample_share_the_draw():
    image = values((3, 9, 12), torch.float32)
    images = map(tv_tensors.Image, (image, image, values((3, 7, 20), torch.float32)))
    a, b, c = RandomMoire(REGISTERED, p=1)(*images)
    assert torch.equal(a, b) and c.shape == (3, 7, 20)


def test_the_global_seed_reproduces_and_the_photo_is_a_capture():
    image, transform = values((2, 3, 9, 12), torch.float32), RandomMoire(REGISTERED, p=1)
    torch.manual_seed(5)
    a, b = transform(image), transform(image)
    torch.manual_seed(5)
    assert torch.equal(a, transform(image)) and not torch.equal(a, b)
    torch.manual_seed(5)
    torch.rand(2)
    assert torch.equal(a, capture(image, REGISTERED.sample(2, (9, 12))))


def test_nan_in_a_skipped_row_does_not_matter():
    batch = torch.rand(8, 3, 9, 12)
    torch.manual_seed(3)
    chosen = torch.rand(8) < 0.5
    batch[~chosen] = torch.nan
    batch.requires_grad_()
    torch.manual_seed(3)
    out = RandomMoire(REGISTERED, p=0.5)(batch)
    out[chosen].sum().backward()
    assert out[chosen].isfinite().all() and out[~chosen].isnan().all()
    assert batch.grad.isfinite().all() and batch.grad[chosen].abs().sum() > 0


def test_gradients_flow_to_a_grey_image():
    image = torch.rand(1, 9, 12, requires_grad=True)
    RandomMoire(REGISTERED, p=1)(image).sum().backward()
    assert image.grad.isfinite().all() and image.grad.abs().sum() > 0


def test_samples_without_an_image_and_empty_batches():
    for label in (3, np.array(3)):
        assert RandomMoire(REGISTERED, p=1)({"label": label}) == {"label": label}
    for scene in (REGISTERED, CAMERA):
        empty = torch.rand(0, 3, 9, 12)
        assert RandomMoire(scene, p=1)(empty) is empty
    box = tv_tensors.BoundingBoxes([[1.0, 2.0, 5.0, 6.0]], format="XYXY", canvas_size=(9, 12))
    assert not torch.equal(RandomMoire(CAMERA, p=1)(box), box)


class Same(Dataset):
    def __init__(self, transform):
        self.transform = transform

    def __len__(self):
        return 4

    def __getitem__(self, i):
        return self.transform(torch.full((3, 9, 12), 0.5))


def test_workers_draw_differently_and_reproducibly():
    loader = DataLoader(Same(RandomMoire(REGISTERED, p=1)), batch_size=1, num_workers=2)
    torch.manual_seed(0)
    first, second = (torch.cat(list(loader)) for _ in range(2))
    assert len({x.numpy().tobytes() for x in (*first, *second)}) == 8
    torch.manual_seed(0)
    assert torch.equal(first, torch.cat(list(loader)))


def test_a_scene_without_effects_keeps_grey_in_half_precision():
    scene = Scene(panel=Panel(layout="even"), sensor=Sensor(cfa="none"))
    for dtype in (torch.float16, torch.bfloat16):
        grey = torch.linspace(0, 1, 257).to(dtype).reshape(1, 1, 257)
        assert torch.equal(RandomMoire(scene, p=1)(grey), grey)


IMAGE = torch.rand(3, 9, 12)
PAIR = tv_tensors.Image(torch.rand(2, 3, 9, 12))
ROTATED = tv_tensors.BoundingBoxes(torch.rand(1, 5), format="CXCYWHR", canvas_size=(9, 12))
BOXES = tv_tensors.BoundingBoxes(torch.rand(2, 4), format="XYXY", canvas_size=(9, 12))


@pytest.mark.parametrize(
    ("sample", "error", "sentence"),
    [
        (torch.rand(9, 12), ValueError, r"\(C, H, W\).*got \(9, 12\)\. Give a grey image its"),
        (torch.rand(3, 0, 8), ValueError, r"at least 1 x 1 pixels, .* got \(0, 8\)"),
        (torch.rand(2, 2, 3, 9, 12), ValueError, "tv_tensors.Video"),
        (IMAGE * torch.nan, ValueError, "finite"),
        ((IMAGE * 9).to(torch.int32), TypeError, "uint8 or floating point"),
        (PIL.Image.new("P", (12, 9)), ValueError, r"mode RGB, L, RGBA, LA; got P.*v2\.RGB"),
        (PIL.Image.new("CMYK", (12, 9)), ValueError, "got CMYK"),
        ((tv_tensors.Image(IMAGE), PAIR), ValueError, "batch size; got 1 and 2"),
        ((tv_tensors.Image(IMAGE), ROTATED), ValueError, "rotated boxes"),
        ((PAIR, BOXES), ValueError, "which of 2 images"),
        ((PAIR, tv_tensors.Mask(torch.ones(9, 12))), ValueError, "which of 2"),
    ],
)
def test_errors_are_sentences(sample, error, sentence):
    with pytest.raises(error, match=sentence):
        RandomMoire(CAMERA, p=1)(sample)


@pytest.mark.parametrize("p", [0.0, 1.0])
def test_what_is_not_chosen_is_refused_all_the_same(p):
    transform, picture = RandomMoire(REGISTERED, p=p), np.zeros((9, 12, 3), np.uint8)
    for sample in (picture, picture[..., 0] / 1.0, (picture, 3), {"image": picture[None]}):
        with pytest.raises(TypeError, match=r"moireaug\.transforms\.albumentations\.RandomMoire"):
            transform(sample)
    channels_last = {(9, 12, 3): r"permute\(2, 0, 1\)", (2, 9, 12, 1): r"permute\(0, 3, 1, 2\)"}
    for shape, order in channels_last.items():
        for dtype in (torch.uint8, torch.float32):
            with pytest.raises(ValueError, match=order):
                transform(torch.zeros(shape, dtype=dtype))


def test_deep_pil_images_are_not_sent_where_they_turn_white():
    for mode in ("I", "F", "I;16"):
        with pytest.raises(ValueError, match=r"Scale it to float in \[0, 1\]"):
            RandomMoire(REGISTERED, p=1)(PIL.Image.new(mode, (12, 9)))
