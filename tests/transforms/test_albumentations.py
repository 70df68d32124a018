"""The albumentations transforms: targets, replay and serialisation."""

import dataclasses
import itertools
import json

# isort: skip  # after moireaug, which keeps it from asking for its newest version
import albumentations as A
import numpy as np
import pytest
import torch

from moireaug import Develop, Panel, Scene, Sensor, Shot, View
from moireaug.transforms import albumentations as moire
from moireaug.transforms._albumentations_base import torch_generator
from moireaug.transforms.albumentations import RandomMoire
from tests.transforms.common import CAMERA, CLEAR, FRAMES, REGISTERED, SQUARE


def values(shape, dtype, seed=0):
    x = np.random.default_rng(seed).random(shape)
    return (x * 255).round().astype(dtype) if dtype == np.uint8 else x.astype(dtype)


@pytest.mark.parametrize("frame", ["registered", "camera"])
def test_shape_dtype_and_range_are_kept(frame):
    steps = A.Compose([RandomMoire(FRAMES[frame], p=1)])
    for dtype in (np.uint8, np.float32):
        for shape in ((9, 12, 3), (9, 12), (9, 12, 1)):
            image = values(shape, dtype)
            before = image.copy()
            out = steps(image=image)["image"]
            assert out.shape == shape and out.dtype == dtype and np.any(out != image)
            assert out.min() >= 0 and out.max() <= (255 if dtype == np.uint8 else 1)
            assert np.array_equal(image, before), "the input was modified"


def compose(scene, kind=A.Compose):
    boxes = A.BboxParams(format="pascal_voc", label_fields=["kinds"])
    points = A.KeypointParams(format="xyas", remove_invisible=False, angle_in_degrees=True)
    return kind([RandomMoire(scene, p=1)], bbox_params=boxes, keypoint_params=points)


def sample(image, box, points):
    mask = (image[..., 0] > 0.5).astype(np.uint8)
    given = {"image": image, "mask": mask, "masks": np.stack([mask, mask])}
    return given | {"bboxes": [box], "kinds": [1], "keypoints": points}


def test_registered_photos_leave_all_else_alone():
    given = sample(values((48, 64, 3), np.float32), SQUARE, [(35.0, 14.0, 30.0, 2.0)])
    out = compose(REGISTERED)(**given)
    assert out["mask"] is given["mask"] and out["masks"] is given["masks"]
    assert np.allclose(out["bboxes"], [SQUARE])
    assert np.allclose(out["keypoints"], given["keypoints"])


@pytest.mark.parametrize("seed", range(4))
def test_what_is_carried_lands_on_the_light(seed, marked, find):
    x1, y1, x2, y2 = SQUARE
    # points right, as long as the rectangle is wide
    tip = ((x1 + x2) / 2 - 0.5, (y1 + y2) / 2 - 0.5, 0.0, 10.0)
    image = marked.permute(1, 2, 0).numpy()
    steps = compose(CLEAR, A.ReplayCompose)
    steps.set_random_seed(seed)
    out = steps(**sample(image, SQUARE, [tip]))
    light, box = find(torch.from_numpy(out["image"]).permute(2, 0, 1))
    (x, y, angle, length), *_ = out["keypoints"]
    assert (torch.tensor([x, y]) + 0.5 - light).norm() < 1.0
    assert (torch.tensor(out["bboxes"][0]) - box).abs().max() < 2.0
    mask_light, _ = find(torch.from_numpy(out["mask"])[None])
    assert (mask_light - light).norm() < 1.0 and np.array_equal(out["masks"][1], out["mask"])

    shot = Shot.from_dict(out["replay"]["transforms"][0]["params"]["shot"])
    left, right = shot.to_photo(torch.tensor([[[x1, (y1 + y2) / 2], [x2, (y1 + y2) / 2]]]))[0]
    along = right - left
    seen = torch.atan2(along[1], along[0]).rad2deg().item()
    assert abs((seen - angle + 180) % 360 - 180) < 3
    assert length == pytest.approx(along.norm().item(), rel=0.25)


def test_masks_of_any_type_move():
    for dtype in (np.uint8, np.uint16, np.int32, np.float32, bool):
        mask = np.ones((9, 12, 2), dtype)
        steps = A.Compose([RandomMoire(CAMERA, p=1)], seed=0)
        out = steps(image=values((9, 12, 3), np.uint8), mask=mask)["mask"]
        assert out.dtype == dtype and out.shape == mask.shape and set(np.unique(out)) == {0, 1}


def test_empty_targets_stay_empty():
    out = compose(CAMERA)(image=values((9, 12, 3), np.uint8), bboxes=[], kinds=[], keypoints=[])
    assert len(out["bboxes"]) == 0 and len(out["keypoints"]) == 0


@pytest.mark.parametrize("frame", ["registered", "camera"])
def test_replay_is_exact_and_survives_json(frame):
    image = values((9, 12, 3), np.uint8)
    moire_step = RandomMoire(FRAMES[frame], p=1)
    steps = A.ReplayCompose([moire_step, A.HorizontalFlip(p=0.5)])
    out = steps(image=image)
    assert np.array_equal(A.ReplayCompose.replay(out["replay"], image=image)["image"], out["image"])
    shot = out["replay"]["transforms"][0]["params"]["shot"]
    assert json.loads(json.dumps(shot)) == shot
    photo = moire.apply_to_one(image, Shot.from_dict(shot))
    assert any(np.array_equal(out["image"], x) for x in (photo, photo[:, ::-1]))


def test_a_transform_replays_the_shot_of_another_scene():
    image = values((9, 12, 3), np.uint8)
    own, other = RandomMoire(REGISTERED, p=1), RandomMoire(CAMERA, p=1)
    for scene in (REGISTERED, CAMERA):
        shot = scene.sample(1, (9, 12), torch.Generator().manual_seed(0)).to_dict()
        expected = moire.apply_to_one(image, Shot.from_dict(shot))
        assert np.array_equal(own.apply(image, shot=shot), expected)
        assert np.array_equal(other.apply(image, shot=shot), expected)


def test_a_pipeline_survives_json():
    steps = A.Compose([RandomMoire(REGISTERED, p=0.25)])
    again = A.from_dict(json.loads(json.dumps(A.to_dict(steps))))
    assert again[0].scene == REGISTERED and again[0].p == 0.25


def test_p_and_seed():
    image = values((9, 12, 3), np.uint8)
    kept = A.Compose([RandomMoire(REGISTERED, p=0)])(image=image)["image"]
    assert kept is image
    runs = []
    for seed in (1, 1, 2):
        steps = A.Compose([RandomMoire(REGISTERED, p=0.5)], seed=seed)
        runs.append(np.stack([steps(image=image)["image"] for _ in range(16)]))
    changed = [np.any(x != image) for x in runs[0]]
    assert np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])
    assert 0 < sum(changed) < 16


def test_torchs_global_generator_is_left_alone():
    steps = A.Compose([RandomMoire(REGISTERED, p=1)], seed=1)
    torch.manual_seed(0)
    steps(image=values((9, 12, 3), np.uint8))
    after = torch.rand(1)
    torch.manual_seed(0)
    assert torch.equal(after, torch.rand(1))


def test_errors_are_sentences():
    with pytest.raises(TypeError, match="scenes"):
        RandomMoire(scenes="paper")
    with pytest.raises(ValueError, match=r"transpose\(1, 2, 0\)"):
        RandomMoire(REGISTERED, p=1)(image=values((3, 9, 12), np.uint8))


def test_integer_key_points_in_a_direct_call():
    points = np.array([[3, 4, 0, 0, 10], [7, 2, 0, 1, 10]])
    image = values((9, 12, 3), np.uint8)
    for columns in (2, 5):
        moved = []
        for dtype in (int, np.float32):
            step = RandomMoire(CAMERA, p=1)
            step.set_random_seed(0)
            given = points[:, :columns].astype(dtype)
            moved.append(step(image=image, keypoints=given)["keypoints"])
        assert np.array_equal(*moved) and moved[0].dtype == np.float32
        assert np.any(moved[0][:, :2] % 1 != 0)


MOVED = Scene(
    panel=Panel(layout="even"),
    view=View(roll=20.0, zoom=0.8, shift_x=0.3, fit=False),
    sensor=Sensor(cfa="none"),
    develop=Develop(registered=False),
)


@pytest.mark.parametrize("times", [1, 2])
def test_a_replay_lands_on_the_light_at_any_size(times, marked, find):
    small = values((40, 60, 3), np.uint8)
    steps = compose(MOVED, A.ReplayCompose)
    replay = steps(image=small, bboxes=[], kinds=[], keypoints=[])["replay"]
    step = A.ReplayCompose._restore_for_replay(replay["transforms"][0])
    image = np.repeat(np.repeat(marked.permute(1, 2, 0).numpy(), times, 0), times, 1)
    x1, y1, x2, y2 = (v * times for v in SQUARE)
    sides = np.array([64, 48, 64, 48]) * times
    out = step(
        image=image,
        bboxes=np.array([[x1, y1, x2, y2]]) / sides,
        keypoints=np.array([[(x1 + x2) / 2 - 0.5, (y1 + y2) / 2 - 0.5]]),
    )
    light, box = find(torch.from_numpy(out["image"]).permute(2, 0, 1))
    assert (torch.from_numpy(out["keypoints"][0]) + 0.5 - light).norm() < 1.0
    assert (torch.from_numpy(out["bboxes"][0] * sides) - box).abs().max() < 2.0 * times


def test_a_compose_measures_how_much_of_a_box_is_visible():
    scene = dataclasses.replace(MOVED, view=View(shift_x=0.5, fit=False))
    boxes = [(20.0, 10.0, 50.0, 40.0), (50.0, 10.0, 60.0, 20.0)]  # the second leaves the photo
    for least, clip, each in itertools.product((0.0, 0.9), (False, True), (False, True)):
        settings = {"min_visibility": least, "clip": clip, "check_each_transform": each}
        params = A.BboxParams("pascal_voc", label_fields=["kinds"], **settings)
        steps = A.Compose([RandomMoire(scene, p=1)], bbox_params=params)
        out = steps(image=values((48, 64, 3), np.uint8), bboxes=boxes, kinds=[1, 2])
        kept = [] if least else [(52, 10, 64, 40)]
        assert len(out["bboxes"]) == len(kept), settings
        assert not kept or np.allclose(out["bboxes"], kept, atol=1e-4)


@pytest.mark.parametrize("dtype", [">f4", np.longdouble])
def test_floats_that_torch_does_not_read(dtype):
    known = values((9, 12, 3), np.float64 if dtype == np.longdouble else np.float32)
    mask = (known[..., 0] * 100).astype(np.int32)
    shown = []
    for image, of_mask in ((known, np.int32), (known.astype(dtype), ">i4")):
        step = RandomMoire(CAMERA, p=1)
        step.set_random_seed(0)
        shown.append(step(image=image, mask=mask.astype(of_mask)))
        assert shown[-1]["image"].dtype == image.dtype
        assert shown[-1]["mask"].dtype == np.dtype(of_mask)
    for target in ("image", "mask"):
        assert np.array_equal(shown[0][target], shown[1][target])


def test_torch_keeps_32_bits_of_a_seed():
    """Which is why no more of them are drawn; and the photos of a seed stay as they were."""
    whole = int(np.random.default_rng(3).integers(2**63))
    drawn, kept = torch_generator(np.random.default_rng(3)), torch.Generator().manual_seed(whole)
    assert whole > 2**32 and drawn.initial_seed() == whole % 2**32
    assert torch.equal(torch.rand(99, generator=drawn), torch.rand(99, generator=kept))
