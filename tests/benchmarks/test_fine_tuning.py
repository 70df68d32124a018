"""Fine-tuning learns to answer photographed crops as the crops themselves."""

import pytest
import torch
from torch import nn

from benchmarks import fine_tuning


class IsBright(nn.Module):
    """Answers 1 for pictures brighter than a learned bound."""

    def __init__(self):
        super().__init__()
        self.bound = nn.Parameter(torch.tensor(0.5))

    def forward(self, images):
        brightness = 40 * (images.mean((1, 2, 3)) - self.bound)
        return torch.stack([-brightness, brightness], 1)


def crops(n):
    return torch.rand(n, 3, 1, 1).expand(-1, -1, 4, 4)


def test_answers_move_to_photos_and_not_without_any(monkeypatch):
    monkeypatch.setattr(fine_tuning, "LEARNING_RATE", 0.02)
    effort = fine_tuning.Effort(steps=40, batch=16)
    teacher = IsBright()
    photographs = {"itself": lambda images: images, "darker": lambda images: 0.6 * images}
    students = {"as it was": teacher}
    for name, photograph in photographs.items():
        torch.manual_seed(0)
        students[name] = fine_tuning.trained(teacher, crops, photograph, effort)
    assert teacher.bound == 0.5 and abs(students["itself"].bound - 0.5) < 2e-3  # rounding
    assert students["darker"].bound < 0.45

    originals = torch.linspace(0.15, 0.95, 9)[:, None, None, None].expand(-1, 3, 4, 4)
    rows = fine_tuning.rows_of("bright", students, originals, 0.6 * originals)
    before, itself, darker = rows
    assert before["original as before"] == 1 and before["photo as original"] == pytest.approx(6 / 9)
    assert itself["photo as original"] == before["photo as original"]
    assert darker["photo as original before"] > before["photo as original before"]
