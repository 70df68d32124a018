"""Problems: some images of a batch are rendered as they are within it."""

import pytest
import torch

from tests.attacks.common import attack_by


@pytest.mark.parametrize("name", ["pgd", "patch", "ma", "ma photo", "ma turned", "ma eot"])
def test_a_subset_renders_its_own_rows(name, model, batch):
    images, _ = batch
    rows = torch.tensor([4, 1])
    problem = attack_by(name, model).problem(images, None, torch.Generator().manual_seed(0))
    point = problem.start(0.1, torch.Generator().manual_seed(1), random_pose=True)
    subset = problem.subset(rows)
    own_point = {name: x[rows] for name, x in point.items()}
    assert torch.equal(subset.render(own_point), problem.render(point)[rows])
    assert subset.shape == (2, *problem.shape[1:])
    assert not torch.equal(problem.render(point), problem.render(problem.clean_point()))
    assert len(problem.forward_views(point)) == problem.views * len(images)
    shot = problem.shot_of(point)
    if shot is not None:
        numbers = subset.shot_of(own_point).numbers()
        for key, values in shot.numbers().items():
            assert torch.equal(numbers[key], values[rows])
