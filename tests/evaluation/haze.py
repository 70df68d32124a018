"""A small evaluation that was run: four conditions, of a model and of the model behind haze."""

import torch

from moireaug import Scene
from moireaug.evaluation import Cell, Table, images_frame
from moireaug.evaluation.attackers import MoireAttacker, PixelAttacker
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier
from moireaug.evaluation.conditions import Photo, RandomNoise
from moireaug.evaluation.records import EvalSetup, Records
from moireaug.evaluation.runner import Runner, jobs_of
from moireaug.evaluation.tables import cross

SCENE = Scene.preset("screen_photo")
EPS = 8 / 255


def hazy(images):
    """A randomised defence."""
    return (images + 0.3 * torch.rand(images.shape)).clamp(0, 1)


HAZE = Classifier("haze", defence=hazy)
CONDITIONS = {
    "moire": Photo(),
    "random": RandomNoise(eps=EPS),
    "ma": MoireAttacker(eps=EPS, steps=2),
    "pgd": PixelAttacker(attack="pgd", eps=EPS, steps=2),
}


TABLE = Table("mine", tuple(cross({"none": UNDEFENDED, "haze": HAZE}, CONDITIONS)))


class Kept(Records):
    """Records that keep the pictures too."""

    def __init__(self):
        super().__init__()
        self.pictures = {}

    def keep_picture(self, name, shown):
        self.pictures[name] = shown


def table_of(*conditions, classifier=UNDEFENDED):
    return Table("mine", tuple(Cell(c.name, "shown", (c,), classifier) for c in conditions))


def ran(known, tables=TABLE, indices=None, seed=3, records=None, scene=SCENE):
    """The runner that has run one or more tables on a model and its batches, by default on all."""
    model, batches = known
    tables = [tables] if isinstance(tables, Table) else tables
    setup = EvalSetup(scene, seed)
    runner = Runner(model, batches, setup, Kept() if records is None else records)
    for _ in runner.run(jobs_of(tables), range(len(batches)) if indices is None else indices):
        pass
    return runner


def frame_of(known, table, **settings):
    """The frame of images of a table that was run on all batches."""
    indices = range(len(known[1]))
    return images_frame([table], ran(known, table, indices, **settings), indices)


def results(runner):
    """Everything but the time, which differs."""
    found = {}
    for key, record in runner.records.items():
        found[key] = {name: value for name, value in record.items() if name != "seconds"}
    return found


def cell_of(lines, row, column, table=None):
    """The line of that row and column in a frame of rates."""
    is_wanted = (lines["row"] == row) & (lines["column"] == column)
    if table is not None:
        is_wanted &= lines["table"] == table
    return lines[is_wanted].iloc[0]
