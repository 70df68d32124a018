"""How visible a change is: LPIPS by a file of weights, as torchmetrics has it, for attacks alone;
other weights are refused. SSIM at any size."""

import numpy as np
import pytest
import torch
import torchvision
from torchmetrics.functional.image import lpips as published

from moireaug.evaluation import SuiteConfig, evaluate, rates
from moireaug.evaluation.classifiers import UNDEFENDED
from moireaug.evaluation.conditions import Clean
from moireaug.evaluation.records import EvalSetup, Records
from moireaug.evaluation.runner import Job, Runner, jobs_of
from moireaug.evaluation.suites.ladder import ladder
from moireaug.evaluation.visibility import LPIPS, ssim, visibility
from moireaug.scenes import Scene
from tests.defaults import DTYPES, defaults


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    return torchvision.models.squeezenet1_1()


@pytest.fixture(scope="module")
def weights(network, tmp_path_factory):
    path = tmp_path_factory.mktemp("lpips") / "squeezenet1_1.pth"
    torch.save(network.state_dict(), path)
    return path


@pytest.fixture(scope="module")
def measure(weights):
    return LPIPS(weights)


@pytest.fixture(scope="module")
def images():
    return torch.rand(3, 3, 32, 32, generator=torch.Generator().manual_seed(1))


def noisy(images, size):
    noise = torch.rand(images.shape, generator=torch.Generator().manual_seed(2)) - 0.5
    return (images + size * noise).clamp(0, 1)


def test_the_figures_are_those_of_torchmetrics(network, measure, images, monkeypatch):
    monkeypatch.setattr(published, "_get_tv_model_features", lambda *_: network.features)
    expected = published.learned_perceptual_image_patch_similarity(
        noisy(images, 0.3), images, "squeeze", reduction="none", normalize=True
    )
    found = measure(noisy(images, 0.3), images)
    assert found.shape == (3,) and torch.allclose(found, expected, rtol=1e-5)


def test_many_images_are_measured_as_one_is(measure):
    a, b = torch.rand(11, 3, 20, 24), torch.rand(11, 3, 20, 24)
    each = [measure(a[i : i + 1], b[i : i + 1]) for i in range(11)]
    assert torch.allclose(measure(a, b), torch.cat(each), rtol=1e-4)


def test_reading_weights_draws_nothing(weights):
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    LPIPS(weights)
    assert torch.rand(1) == expected


def test_the_figures_are_the_same_under_other_defaults(measure, weights, images):
    changed = noisy(images, 0.3)
    expected = measure(changed, images)
    for dtype in DTYPES:
        with defaults(dtype):
            assert torch.equal(LPIPS(weights)(changed, images), expected)


def test_it_stands_beside_the_other_figures_where_it_is_given(measure, images):
    changed = noisy(images, 0.1)
    without, beside = visibility(changed, images), visibility(changed, images, measure)
    assert beside.pop("lpips") == pytest.approx(measure(changed, images).tolist())
    assert beside == without


def test_another_file_or_too_small_images_get_a_sentence(network, weights, known, tmp_path):
    path, other = tmp_path / "weights.pth", "does not hold the weights of one of squeezenet"
    with pytest.raises(ValueError, match=r"no weights file .* of one of .*squeezenet1_1, alexnet"):
        LPIPS(path)
    path.write_bytes(b"no weights")
    with pytest.raises(ValueError, match=r"could not be read \(\w+\): it is damaged"):
        LPIPS(path)
    for content, says in (
        ({}, "holds something other than a state_dict"),
        ([1, 2], "holds something other than a state_dict"),
        ({"fc.weight": torch.zeros(5)}, other),
        (network.state_dict() | {"features.0.bias": torch.zeros(65)}, other),
    ):
        torch.save(content, path)
        with pytest.raises(ValueError, match=says):
            LPIPS(path)
    with pytest.raises(ValueError, match="at least 17 x 17 pixels; got a side of 16"):
        evaluate(*known, lpips=weights, progress=False)


def test_an_evaluation_measures_every_attack_and_no_control(known, weights):
    model, batches = known
    larger = [(torch.nn.functional.interpolate(x[:6], scale_factor=2), y[:6]) for x, y in batches]
    frame = evaluate(model, larger[:1], eps=4 / 255, steps=1, lpips=weights, progress=False)
    lines = rates(frame).set_index("row")
    measured = lines.index[lines["lpips"].notna()]
    assert list(measured) == ["ma_4", "ma_4_targeted", "pgd_4"]
    assert (lines.loc[measured, "lpips"] > 0).all()
    assert np.isfinite(lines.loc[measured, "psnr"]).all()


def test_records_without_it_are_others(known, measure):
    scene = Scene.preset("screen_photo")
    runners = [
        Runner(*known, EvalSetup(scene, lpips=given), Records()) for given in (None, measure)
    ]
    differing = []
    for condition, (classifier,) in jobs_of(
        [ladder(SuiteConfig(scene=scene, eps=(4 / 255,), steps=1))]
    ):
        keys = {runner.key(condition, classifier, 0) for runner in runners}
        if len(keys) == 2:
            differing.append(condition.name)
    assert differing == ["ma_4", "ma_4_targeted", "pgd_4", "apgd_4"]


def test_a_control_whose_records_are_shared_is_given_none(known, measure):
    class Told(Clean):
        kind = "told"

        def measure(self, batch, images):
            return {"told": [batch.lpips is not None] * len(images)}

    class ToldAttack(Told):
        kind = "told_attack"
        control = False

    for condition, told in ((Told(), 0.0), (ToldAttack(), 1.0)):
        runner = Runner(*known, EvalSetup(Scene(), lpips=measure), Records())
        (_,) = runner.run([Job(condition, (UNDEFENDED,))], (0,))
        assert runner.record(condition, UNDEFENDED, 0)["measured"]["told"] == [told] * 8


def test_structural_similarity_is_defined_at_any_size():
    for side in (1, 3, 5, 6, 16):
        images = torch.rand(2, 3, side, 9, generator=torch.Generator().manual_seed(0))
        assert ssim(images, images).tolist() == pytest.approx([1.0, 1.0])
        changed = ssim((images + 0.3).clamp(0, 1), images)
        assert changed.shape == (2,) and ((changed > -1) & (changed < 0.99)).all()
