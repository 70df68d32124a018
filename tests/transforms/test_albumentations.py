"""The albumentations transforms: targets, replay and serialisation."""

import dataclasses
import json

# isort: skip  # after moireaug, which keeps it from asking for its newest version
import albumentations as A
import numpy as np
import pytest
import torch

from moireaug import Develop, Panel, Scene, Sensor, Shot, View
from moireaug.transforms import albumentations as moire
from moireaug.transforms.albumentations import RandomMoire


def values(shape, dtype, seed=0):
    x = np.random.default_rng(seed).random(shape)
    return (x * 255).round().astype(dtype) if dtype == np.uint8 else x.astype(dtype)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.parametrize("shape", [(9, 12, 3), (9, 12), (9, 12, 1)], ids=str)
@pytest.mark.parametrize("frame", ["registered", "camera"])
def test_shape_dtype_and_range_are_kept(shape, dtype, frame, request):
    image = values(shape, dtype)
    before = image.copy()
    out = A.Compose([RandomMoire(request.getfixturevalue(frame), p=1)])(image=image)["image"]
    assert out.shape == shape and out.dtype == dtype and np.any(out != image)
    assert out.min() >= 0 and out.max() <= (255 if dtype == np.uint8 else 1)
    assert np.array_equal(image, before), "the input was modified"


def compose(scene, kind=A.Compose):
    return kind(
        [RandomMoire(scene, p=1)],
        bbox_params=A.BboxParams(format="pascal_voc", label_fields=["kinds"]),
        keypoint_params=A.KeypointParams(
            format="xyas", remove_invisible=False, angle_in_degrees=True
        ),
    )


def sample(image, box, points):
    mask = (image[..., 0] > 0.5).astype(np.uint8)
    return {
        "image": image,
        "mask": mask,
        "masks": np.stack([mask, mask]),
        "bboxes": [box],
        "kinds": [1],
        "keypoints": points,
    }


def test_registered_photos_leave_all_else_alone(registered, square):
    given = sample(values((48, 64, 3), np.float32), square, [(35.0, 14.0, 30.0, 2.0)])
    out = compose(registered)(**given)
    assert out["mask"] is given["mask"] and out["masks"] is given["masks"]
    assert np.allclose(out["bboxes"], [square]) and np.allclose(
        out["keypoints"], given["keypoints"]
    )


@pytest.mark.parametrize("seed", range(4))
def test_what_is_carried_lands_on_the_light(seed, clear, marked, square, find):
    x1, y1, x2, y2 = square
    # points right, as long as the rectangle is wide
    tip = ((x1 + x2) / 2 - 0.5, (y1 + y2) / 2 - 0.5, 0.0, 10.0)
    image = marked.permute(1, 2, 0).numpy()
    steps = compose(clear, A.ReplayCompose)
    steps.set_random_seed(seed)
    out = steps(**sample(image, square, [tip]))
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


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int32, np.float32, bool])
def test_masks_of_any_type_move(dtype, camera):
    mask = np.ones((9, 12, 2), dtype)
    steps = A.Compose([RandomMoire(camera, p=1)], seed=0)
    out = steps(image=values((9, 12, 3), np.uint8), mask=mask)["mask"]
    assert out.dtype == dtype and out.shape == mask.shape and set(np.unique(out)) == {0, 1}


def test_empty_targets_stay_empty(camera):
    out = compose(camera)(image=values((9, 12, 3), np.uint8), bboxes=[], kinds=[], keypoints=[])
    assert len(out["bboxes"]) == 0 and len(out["keypoints"]) == 0


@pytest.mark.parametrize("frame", ["registered", "camera"])
def test_replay_is_exact_and_survives_json(frame, request):
    image = values((9, 12, 3), np.uint8)
    steps = A.ReplayCompose(
        [RandomMoire(request.getfixturevalue(frame), p=1), A.HorizontalFlip(p=0.5)]
    )
    out = steps(image=image)
    assert np.array_equal(A.ReplayCompose.replay(out["replay"], image=image)["image"], out["image"])
    shot = out["replay"]["transforms"][0]["params"]["shot"]
    assert json.loads(json.dumps(shot)) == shot
    photo = moire.apply_to_one(image, Shot.from_dict(shot))
    assert any(np.array_equal(out["image"], x) for x in (photo, photo[:, ::-1]))


def test_a_transform_replays_the_shot_of_another_scene(registered, camera):
    image = values((9, 12, 3), np.uint8)
    own, other = RandomMoire(registered, p=1), RandomMoire(camera, p=1)
    for scene in (registered, camera):
        shot = scene.sample(1, (9, 12), torch.Generator().manual_seed(0)).to_dict()
        expected = moire.apply_to_one(image, Shot.from_dict(shot))
        assert np.array_equal(own.apply(image, shot=shot), expected)
        assert np.array_equal(other.apply(image, shot=shot), expected)


def test_a_pipeline_survives_json(registered):
    steps = A.Compose([RandomMoire(registered, p=0.25)])
    again = A.from_dict(json.loads(json.dumps(A.to_dict(steps))))
    assert again[0].scene == registered and again[0].p == 0.25


def test_p_and_seed(registered):
    image = values((9, 12, 3), np.uint8)
    kept = A.Compose([RandomMoire(registered, p=0)])(image=image)["image"]
    assert kept is image
    runs = []
    for seed in (1, 1, 2):
        steps = A.Compose([RandomMoire(registered, p=0.5)], seed=seed)
        runs.append(np.stack([steps(image=image)["image"] for _ in range(16)]))
    changed = [np.any(x != image) for x in runs[0]]
    assert np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])
    assert 0 < sum(changed) < 16


def test_torchs_global_generator_is_left_alone(registered):
    steps = A.Compose([RandomMoire(registered, p=1)], seed=1)
    torch.manual_seed(0)
    steps(image=values((9, 12, 3), np.uint8))
    after = torch.rand(1)
    torch.manual_seed(0)
    assert torch.equal(after, torch.rand(1))


def test_errors_are_sentences(registered):
    with pytest.raises(TypeError, match="scenes"):
        RandomMoire(scenes="paper")
    with pytest.raises(ValueError, match=r"transpose\(1, 2, 0\)"):
        RandomMoire(registered, p=1)(image=values((3, 9, 12), np.uint8))


@pytest.mark.parametrize("columns", [2, 5])
def test_integer_key_points_in_a_direct_call(columns, camera):
    points = np.array([[3, 4, 0, 0, 10], [7, 2, 0, 1, 10]])[:, :columns]
    image, moved = values((9, 12, 3), np.uint8), []
    for given in (points, points.astype(np.float32)):
        step = RandomMoire(camera, p=1)
        step.set_random_seed(0)
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
def test_a_replay_lands_on_the_light_at_any_size(times, marked, square, find):
    small = values((40, 60, 3), np.uint8)
    steps = compose(MOVED, A.ReplayCompose)
    replay = steps(image=small, bboxes=[], kinds=[], keypoints=[])["replay"]
    step = A.ReplayCompose._restore_for_replay(replay["transforms"][0])
    image = np.repeat(np.repeat(marked.permute(1, 2, 0).numpy(), times, 0), times, 1)
    x1, y1, x2, y2 = (v * times for v in square)
    sides = np.array([64, 48, 64, 48]) * times
    out = step(
        image=image,
        bboxes=np.array([[x1, y1, x2, y2]]) / sides,
        keypoints=np.array([[(x1 + x2) / 2 - 0.5, (y1 + y2) / 2 - 0.5]]),
    )
    light, box = find(torch.from_numpy(out["image"]).permute(2, 0, 1))
    assert (torch.from_numpy(out["keypoints"][0]) + 0.5 - light).norm() < 1.0
    assert (torch.from_numpy(out["bboxes"][0] * sides) - box).abs().max() < 2.0 * times


@pytest.mark.parametrize("each", [False, True])
@pytest.mark.parametrize("clip", [False, True])
@pytest.mark.parametrize(("least", "kept"), [(0.0, 1), (0.9, 0)])
def test_a_compose_measures_how_much_of_a_box_is_visible(least, kept, clip, each):
    scene = dataclasses.replace(MOVED, view=View(shift_x=0.5, fit=False))
    boxes = [(20.0, 10.0, 50.0, 40.0), (50.0, 10.0, 60.0, 20.0)]  # the second leaves the photo
    settings = {"min_visibility": least, "clip": clip, "check_each_transform": each}
    params = A.BboxParams("pascal_voc", label_fields=["kinds"], **settings)
    steps = A.Compose([RandomMoire(scene, p=1)], bbox_params=params)
    out = steps(image=values((48, 64, 3), np.uint8), bboxes=boxes, kinds=[1, 2])
    assert len(out["bboxes"]) == kept
    assert not kept or np.allclose(out["bboxes"], [(52, 10, 64, 40)], atol=1e-4)


@pytest.mark.parametrize("dtype", [">f4", np.longdouble, ">i4"])
def test_numbers_that_torch_does_not_read(dtype, camera):
    step = RandomMoire(camera, p=1)
    step.set_random_seed(0)
    known = values((9, 12, 3), np.float64 if dtype == np.longdouble else np.float32)
    mask = (known[..., 0] * 100).astype(np.int32)
    shown = step(image=known, mask=mask)
    step.set_random_seed(0)
    if np.dtype(dtype).kind == "f":
        given = known.astype(dtype)
        out = step(image=given)["image"]
        assert out.dtype == given.dtype and np.array_equal(out, shown["image"])
    else:
        out = step(image=known, mask=mask.astype(dtype))["mask"]
        assert out.dtype == np.dtype(dtype) and np.array_equal(out, shown["mask"])
