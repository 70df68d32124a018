"""A device's memory changes no figure: where a batch does not fit, the model takes it in parts, and
all is drawn as before."""

import copy
import dataclasses

import pytest
import torch

from moireaug.evaluation.attackers import MoireAttacker, PixelAttacker, PoseUnknown
from moireaug.evaluation.autoattack import SquareAttacker
from moireaug.evaluation.conditions import EvalBatch, RandomNoise
from moireaug.evaluation.judges import UNDEFENDED
from moireaug.evaluation.memory import within_memory
from moireaug.evaluation.scene_batches import SceneBatches
from tests.evaluation.haze import EPS, SCENE

CONDITIONS = {
    "noise": RandomNoise(eps=EPS),
    "restarts": MoireAttacker(eps=EPS, steps=2, restarts=2),
    "unknown pose": PoseUnknown(eps=EPS, steps=2, shots=2),
    "search": SquareAttacker(eps=EPS, steps=8),
    "pixels": PixelAttacker(attack="pgd", eps=EPS, steps=2),
}
MAX_IMAGES = 2  # of 6 that fit


@pytest.fixture(scope="module")
def batch(known):
    """In float64, where no gradient's sign hangs on the size of a part."""
    model, ((images, labels), _) = known
    shot = SCENE.sample(6, (8, 8), torch.Generator().manual_seed(1))
    model, images = copy.deepcopy(model).double(), images[:6, :, :8, :8].double()
    return EvalBatch(model, images, labels[:6], labels[:6], shot, torch.Generator())


def limited(model):
    """The model on a device that holds few images."""

    def small(images):
        if len(images) > MAX_IMAGES:
            raise torch.OutOfMemoryError("too much")
        return model(images)

    return small


@pytest.mark.parametrize("condition", CONDITIONS.values(), ids=CONDITIONS)
def test_the_images_do_not_depend_on_the_memory(condition, batch):
    shown = []
    for model in (batch.model, limited(batch.model)):
        batch.generator.manual_seed(2)
        shown.append(within_memory(condition.show, dataclasses.replace(batch, model=model)))
    assert torch.allclose(*shown, atol=1e-6)


def test_nor_do_the_answers(batch):
    answers = []
    for model in (batch.model, limited(batch.model)):
        whole = SceneBatches([torch.arange(6)], [dataclasses.replace(batch, model=model)])
        answers.append(whole.predictions(UNDEFENDED, batch.images))
    assert torch.equal(*answers)


def test_a_randomised_model_draws_as_if_the_failed_attempt_had_not_been(batch):
    drawn = []

    def model(images):
        noise = torch.rand(len(images))
        if len(images) > MAX_IMAGES:
            raise torch.OutOfMemoryError("too much")
        drawn.append(noise)
        return batch.model(images)

    torch.manual_seed(0)
    within_memory(lambda own: own.model(own.images), dataclasses.replace(batch, model=model))
    torch.manual_seed(0)
    assert torch.equal(torch.cat(drawn), torch.rand(6))


def test_what_does_not_fit_at_all_is_refused_with_advice(batch):
    def none(images):
        raise torch.OutOfMemoryError("not even one")

    with pytest.raises(torch.OutOfMemoryError, match="not even one") as error:
        within_memory(CONDITIONS["pixels"].show, dataclasses.replace(batch, model=none))
    assert error.value.__notes__ == ["The batch has 6 images: pass smaller batches."]
