"""The kornia transform: the augmentation contract, replay, and the scenes that it refuses."""

import copy

import pytest
import torch
from kornia.augmentation import AugmentationSequential, RandomHorizontalFlip, VideoSequential

from moireaug import Develop, Panel, Scene, Sensor, View, capture
from moireaug.transforms import kornia
from moireaug.transforms.kornia import RandomMoire, from_params, to_params
from tests.transforms.common import REGISTERED


@pytest.mark.parametrize("keepdim", [False, True])
def test_shape_dtype_and_range_are_kept(keepdim):
    transform = RandomMoire(REGISTERED, p=1, keepdim=keepdim)
    for shape in ((3, 9, 12), (1, 9, 12), (2, 3, 9, 12), (2, 1, 9, 12)):
        for dtype in (torch.float16, torch.bfloat16, torch.float32, torch.float64):
            image = torch.rand(shape).to(dtype)
            before = image.clone()
            out = transform(image)
            assert out.shape == (shape if keepdim or len(shape) == 4 else (1, *shape))
            assert out.dtype == dtype and out.min() >= 0 and out.max() <= 1
            assert not torch.equal(out.reshape(shape), image)
            assert torch.equal(image, before), "the input was modified"


ANNOTATIONS = {
    "mask": torch.rand(2, 1, 9, 12).round(),
    "bbox_xyxy": torch.tensor([[[1.0, 2.0, 5.0, 6.0]]]).expand(2, -1, -1),
    "keypoints": torch.rand(2, 4, 2) * 9,
}


def test_masks_boxes_and_keypoints_stay():
    steps = AugmentationSequential(RandomMoire(REGISTERED, p=1), data_keys=["input", *ANNOTATIONS])
    image = torch.rand(2, 3, 9, 12)
    photo, *others = steps(image, *ANNOTATIONS.values())
    assert not torch.equal(photo, image)
    assert all(map(torch.equal, others, ANNOTATIONS.values()))
    assert torch.equal(steps.transform_matrix, torch.eye(3).expand(2, 3, 3))


@pytest.mark.parametrize("same_on_batch", [False, True])
def test_one_draw_per_image_unless_same_on_batch(same_on_batch):
    batch = torch.rand(1, 3, 9, 12).expand(4, -1, -1, -1)
    photos = RandomMoire(REGISTERED, p=1, same_on_batch=same_on_batch)(batch)
    assert len({p.numpy().tobytes() for p in photos}) == (1 if same_on_batch else 4)


@pytest.mark.parametrize("p", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("same_on_batch", [False, True])
def test_p_and_replay(p, same_on_batch):
    torch.manual_seed(1)
    batch = torch.rand(8, 3, 9, 12)
    flip = RandomHorizontalFlip(p=0.5)
    transform = RandomMoire(REGISTERED, p=p, same_on_batch=same_on_batch)
    steps = AugmentationSequential(flip, copy.deepcopy(transform), data_keys=["input"])
    out = steps(batch)
    assert torch.equal(out, steps(batch, params=steps._params))
    assert p == 0 or not torch.equal(out, steps(batch))
    torch.manual_seed(2)
    out = transform(batch)
    kept = torch.tensor([torch.equal(a, b) for a, b in zip(out, batch, strict=True)])
    assert torch.equal(~kept, transform._params["batch_prob"] > 0.5)
    assert kept.float().mean() == 1 - p or (p == 0.5 and (same_on_batch or 0 < kept.sum() < 8))
    torch.manual_seed(2)
    assert torch.equal(out, transform(batch))


def test_parameters_hold_the_whole_shot():
    shot = REGISTERED.sample(3, (9, 12))
    params = to_params(shot)
    assert all(v.shape == (3,) for v in params.values())
    assert from_params(REGISTERED, (9, 12), params).to_dict() == shot.to_dict()
    transform, image = RandomMoire(REGISTERED, p=1), torch.rand(3, 3, 9, 12)
    out = transform(image)
    assert torch.equal(out, capture(image, from_params(REGISTERED, (9, 12), transform._params)))


def test_skipped_rows_cost_nothing_and_may_hold_nan(monkeypatch):
    transform, batch = RandomMoire(REGISTERED, p=0.5), torch.rand(8, 3, 9, 12)
    torch.manual_seed(0)
    params = transform.forward_parameters(batch.shape)
    chosen = params["batch_prob"] > 0.5
    assert 0 < chosen.sum() < 8
    batch[~chosen] = torch.nan
    batch.requires_grad_()
    seen, real = [], kornia.photograph
    monkeypatch.setattr(kornia, "photograph", lambda x, s: seen.append(len(x)) or real(x, s))
    out = transform(batch, params=params)
    assert seen == [int(chosen.sum())]
    out[chosen].sum().backward()
    assert out[chosen].isfinite().all() and out[~chosen].isnan().all()
    assert batch.grad.isfinite().all() and batch.grad[chosen].abs().sum() > 0


def test_in_a_video_sequence_frames_share_the_shot():
    clip = torch.rand(2, 1, 3, 9, 12).expand(-1, 4, -1, -1, -1)
    moire = RandomMoire(REGISTERED, p=1)
    out = VideoSequential(moire, data_format="BTCHW", same_on_frame=True)(clip)
    assert out.shape == clip.shape
    assert torch.equal(out[:, 0], out[:, 3])
    assert not torch.equal(out[0, 0], out[1, 0])


def test_an_empty_batch():
    assert RandomMoire(REGISTERED, p=1)(torch.rand(0, 3, 9, 12)).shape == (0, 3, 9, 12)


@pytest.mark.parametrize("scene", ["paper", "paper_code"])
def test_the_cameras_frame_is_taken_for_images_alone(scene):
    with pytest.raises(ValueError, match=r"registered=True, or use moireaug\.transforms"):
        RandomMoire(scene)
    image, labels = torch.rand(2, 3, 9, 12), torch.tensor([[1.0], [2.0]])
    moire = RandomMoire(scene, p=1, images_only=True)
    photo, same = AugmentationSequential(moire, data_keys=["input", "class"])(image, labels)
    assert not torch.equal(photo, image) and torch.equal(same, labels)
    shot = from_params(Scene.preset(scene), (9, 12), moire._params)
    assert torch.equal(photo, capture(image, shot))


def test_images_only_refuses_what_would_have_to_move():
    for p in (0.0, 0.5, 1.0):
        moire = RandomMoire("paper", p=p, images_only=True)
        for key, annotation in ANNOTATIONS.items():
            steps = AugmentationSequential(moire, data_keys=["input", key])
            with pytest.raises(ValueError, match="images_only=True takes no"):
                steps(torch.rand(2, 3, 9, 12), annotation)


@pytest.mark.parametrize("p", [0.5, 1.0])
def test_parameters_of_one_image_replay_on_all_rows(p):
    transform, batch = RandomMoire(REGISTERED, p=p), torch.rand(4, 3, 9, 12)
    torch.manual_seed(0)
    while not (transform(batch[:1]) != batch[:1]).any():
        pass
    params = transform._params
    photos = transform(batch, params=params)
    for row in range(4):
        assert torch.equal(photos[row : row + 1], transform(batch[row : row + 1], params=params))
        assert not torch.equal(photos[row], batch[row])
    transform(batch[:2])
    with pytest.raises(ValueError, match="parameters are of 2 images; got 4"):
        transform(batch, params=transform._params)


@pytest.mark.filterwarnings("ignore:Dynamo detected a call to a `functools.lru_cache`")
def test_one_graph_gives_the_same_photos_as_no_graph():
    """As of kornia's RandomBrightness; traced alone, because a compiler draws other random
    numbers."""
    torch._dynamo.reset()
    scene = Scene(panel=Panel(scale=(2.0, 3.0)), sensor=Sensor(exposure="point"))
    transform, batch = RandomMoire(scene, p=0.5), torch.rand(6, 3, 8, 8)
    compiled = torch.compile(transform, fullgraph=True, backend="eager")
    torch.manual_seed(2)
    photos = compiled(batch)
    torch.manual_seed(2)
    assert torch.allclose(photos, transform(batch), atol=1e-6)
    changed = (photos != batch).flatten(1).any(1)
    assert changed.any() and not changed.all()


def test_a_frontal_scene_in_the_cameras_frame_is_taken():
    scene = Scene(view=View(fov=30.0), develop=Develop(registered=False))
    assert RandomMoire(scene, p=1)(torch.rand(1, 3, 8, 8)).shape == (1, 3, 8, 8)


def test_errors_are_sentences():
    with pytest.raises(TypeError, match="images_only must be True or False; got 'no'"):
        RandomMoire("paper", images_only="no")
    with pytest.raises(TypeError):
        RandomMoire(REGISTERED, p=1)(torch.zeros(1, 3, 9, 12, dtype=torch.uint8))
