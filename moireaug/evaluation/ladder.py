"""The ladder: how much of an attack's success is the camera, how much the moiré, how much the noise.

Every rung shows a model the same images through the same shots; each adds one thing to the rung before. The paper's
tables lack the rungs between clean and attacked: on ImageNet the moiré alone often fools as many images as the attack.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from moireaug.evaluation import rungs
from moireaug.evaluation.rungs import Model, Rung
from moireaug.evaluation.sweep import MODEL, Batch, Index, Job, Row, complete, gather, sweep
from moireaug.scene.scene import Scene, as_scene


def middle(eps: Sequence[float]) -> float:
    """The bound that stands for the others: of the targeted attack, the rival's and the pictures."""
    return sorted(eps)[len(eps) // 2]


def ladder(eps: Sequence[float] = (2 / 255, 4 / 255, 8 / 255), steps: int = 20) -> list[Rung]:
    """The rungs, in order: controls first, then the Moiré Attack at each eps, targeted at the middle one, then PGD.

    Args:
        eps: bounds of the Moiré Attack, in [0, 1] units.
        steps: gradient steps of every attack.
    """
    eps = sorted(eps)
    return [
        rungs.CLEAN,
        rungs.DIMMED,
        rungs.NO_MOIRE,
        rungs.MOIRE,
        rungs.random_noise(eps[-1]),
        *[rungs.moire_attack(e, steps) for e in eps],
        rungs.moire_attack(middle(eps), steps, targeted=True),
        rungs.rival("pgd", middle(eps), steps, "PGD"),
    ]


def climb(
    model: Model,
    batches: Sequence[Batch],
    scene: Scene | str | dict,
    steps: Sequence[Rung] | None = None,
    *,
    seed: int = 0,
) -> Iterator[list[Row]]:
    """Climb the ladder batch by batch; yields the rows so far after each batch.

    Args:
        model: [0, 1] images to logits; left as it was found.
        batches: (images (B, 3, H, W) in [0, 1], labels (B,)), by place.
        scene: whose shots are drawn, one per image; the draws depend on the seed and the batch's place alone, so that
            two models meet the same photos.
        steps: the rungs, `ladder()` by default; CLEAN must be among them.
        seed: of shots, targets and random starts.
    """
    wanted = list(ladder() if steps is None else steps)
    jobs = complete([Job(rung, (MODEL,)) for rung in wanted])
    index = Index()
    for place in range(len(batches)):
        for new in sweep(model, batches.__getitem__, [place], as_scene(scene), jobs, seed=seed):
            index.add(new)
        yield [gather(index, rung, MODEL) for rung in wanted]
