"""In the camera's frame the picture moves, and so do masks, boxes and points with it."""

import math

import pytest
import torch
from torchvision import tv_tensors
from torchvision.transforms.v2 import functional as F

from moireaug import Develop, Lens, Scene, View, transforms
from moireaug.transforms import RandomMoire
from moireaug.transforms._leaves import apply_shot
from tests.transforms.common import CAMERA, CLEAR, SQUARE, sample_of_leaves, values


def test_pil_alpha_moves_with_the_picture_in_the_cameras_frame(marked):
    alpha = (marked[:1] * 255).to(torch.uint8)
    image = F.to_pil_image(torch.cat([alpha.expand(3, -1, -1), alpha]), mode="RGBA")
    shot = CAMERA.sample(1, (48, 64), torch.Generator().manual_seed(1))
    out = F.pil_to_tensor(apply_shot(image, shot))
    assert torch.equal(out[-1:], shot.to_photo_mask(alpha[None])[0])


def test_camera_frame_moves_only_what_is_in_the_picture():
    sample = sample_of_leaves(tv_tensors.Image(values((3, 9, 12), torch.uint8)))
    out = RandomMoire(CAMERA, p=1)(sample)
    for k in ("mask", "boxes", "points"):
        assert type(out[k]) is type(sample[k])
        assert out[k].shape == sample[k].shape and out[k].dtype == sample[k].dtype
        assert not torch.equal(out[k], sample[k])
    assert all(out[k] is sample[k] for k in ("label", "name", "id"))


@pytest.mark.parametrize("seed", range(4))
def test_what_is_carried_lands_on_the_light(seed, marked, find):
    x1, y1, x2, y2 = SQUARE
    centre = tv_tensors.KeyPoints([[(x1 + x2) / 2, (y1 + y2) / 2]], canvas_size=(48, 64))
    boxes = tv_tensors.BoundingBoxes([SQUARE], format="XYXY", canvas_size=(48, 64))
    mask = tv_tensors.Mask(marked[0].to(torch.uint8))
    torch.manual_seed(seed)
    image, centre, boxes, mask = RandomMoire(CLEAR, p=1)(
        tv_tensors.Image(marked), centre, boxes, mask
    )
    light, box = find(image)
    assert (centre[0] - light).norm() < 1.0
    assert (boxes[0] - box).abs().max() < 2.0
    mask_light, mask_box = find(mask[None])
    assert (mask_light - light).norm() < 1.0 and (mask_box - boxes[0]).abs().max() <= 1.0


def test_every_upright_box_format_moves_alike():
    shot = CAMERA.sample(1, (48, 64), torch.Generator().manual_seed(2))
    boxes = tv_tensors.BoundingBoxes(torch.tensor([SQUARE]), format="XYXY", canvas_size=(48, 64))
    expected = apply_shot(boxes, shot)
    for form in ("XYXY", "XYWH", "CXCYWH"):
        for dtype in (torch.float32, torch.float64, torch.int64):
            given = F.convert_bounding_box_format(boxes, new_format=form).to(dtype)
            out = apply_shot(given, shot)
            assert out.format.value == form and out.dtype == dtype
            back = F.convert_bounding_box_format(out.to(torch.float64), new_format="XYXY")
            assert (back - expected).abs().max() < (1e-4 if dtype.is_floating_point else 1.5)


def test_boxes_enclose_bent_edges_and_are_clamped():
    lens, view = Lens(k1=-0.2), View(zoom=1.0, fit=False)
    shot = Scene(lens=lens, view=view, develop=Develop(registered=False)).sample(1, (48, 64))
    whole = {"format": "XYXY", "canvas_size": (48, 64)}
    inner = tv_tensors.BoundingBoxes([[8.0, 6.0, 56.0, 42.0]], **whole)
    out = apply_shot(inner, shot)[0]
    corners = shot.to_photo(torch.tensor([[[8.0, 6.0], [56.0, 42.0]]]))[0].flatten()
    edge = shot.to_photo(torch.tensor([[[32.0, 6.0]]]))[0, 0, 1]
    assert out[1] <= edge + 1e-4 and out[1] <= corners[1] + 1e-4 and out[0] <= corners[0] + 1e-4
    outer = tv_tensors.BoundingBoxes([[0.0, 0.0, 64.0, 48.0]], **whole)
    assert apply_shot(outer, shot).tolist() == [[0.0, 0.0, 64.0, 48.0]]
    free = tv_tensors.BoundingBoxes([[0.0, 0.0, 64.0, 48.0]], **whole, clamping_mode=None)
    assert apply_shot(free, shot)[0, 0] < 0


def test_empty_leaves_stay_empty():
    for leaf in (
        tv_tensors.BoundingBoxes(torch.zeros(0, 4), format="XYXY", canvas_size=(9, 12)),
        tv_tensors.KeyPoints(torch.zeros(0, 2), canvas_size=(9, 12)),
        tv_tensors.Mask(torch.zeros(0, 9, 12, dtype=torch.bool)),
    ):
        _, out = RandomMoire(CAMERA, p=1)(tv_tensors.Image(torch.rand(3, 9, 12)), leaf)
        assert type(out) is type(leaf) and out.shape == leaf.shape


def test_whole_points_are_rounded():
    shot = CAMERA.sample(1, (48, 64), torch.Generator().manual_seed(0))
    points = torch.tensor([[[12, 4], [40, 30], [5, 44]]])
    assert torch.equal(shot.to_photo(points), shot.to_photo(points.double()).round().long())


def test_points_that_nobody_has_seen_stay_unknown():
    shot = CAMERA.sample(1, (48, 64), torch.Generator().manual_seed(0))
    moved = shot.to_photo(torch.tensor([[[math.nan, math.nan], [40.0, 30.0]]]))
    assert moved[0, 0].isnan().all()
    assert torch.equal(moved[:, 1:], shot.to_photo(torch.tensor([[[40.0, 30.0]]])))


def test_points_and_masks_of_other_shapes_are_refused():
    for registered in (False, True):
        develop = Develop(registered=registered)
        shot = Scene(develop=develop, view=View(roll=20.0)).sample(2, (8, 9))
        for points in (torch.zeros(3, 2), torch.zeros(2, 3, 3), torch.zeros(1, 3, 2)):
            with pytest.raises(ValueError, match=r"must have the shape \(2, N, 2\)"):
                shot.to_photo(points)
        for mask in (torch.zeros(2, 8, 9), torch.zeros(1, 1, 8, 9), torch.zeros(2, 1, 9, 9)):
            with pytest.raises(ValueError, match=r"must have the shape \(2, C, 8, 9\)"):
                shot.to_photo_mask(mask)


def test_batch_masks_and_points_follow_their_own_image():
    torch.manual_seed(0)
    images = tv_tensors.Image(torch.rand(6, 3, 12, 12))
    masks = tv_tensors.Mask(torch.ones(6, 12, 12))
    points = tv_tensors.KeyPoints(torch.full((6, 1, 2), 3.0), canvas_size=(12, 12))
    new, mask, point = RandomMoire(CAMERA, p=0.5)(images, masks, points)
    kept = [torch.equal(a, b) for a, b in zip(new, images, strict=True)]
    assert 0 < sum(kept) < 6
    assert [bool((m == 1).all()) for m in mask] == kept
    assert [p.tolist() == [[3.0, 3.0]] for p in point] == kept
    assert isinstance(mask, tv_tensors.Mask) and point.canvas_size == (12, 12)


def test_the_leaves_of_a_sample_share_one_shot(monkeypatch):
    """Drawn once for each size, not for each leaf."""
    drawn = []

    def counted(scene, u, size):
        drawn.append(size)
        return scene.draw(u, size)

    monkeypatch.setattr(transforms.torchvision, "draw_one", counted)
    image = tv_tensors.Image(values((3, 9, 12), torch.uint8))
    sample = sample_of_leaves(image) | {"small": tv_tensors.Image(image[:, :6, :8])}
    RandomMoire(CAMERA, p=1)(sample)
    assert drawn == [(9, 12), (6, 8)]
