"""Demoiréing networks before the model: the paper's table 5, and attackers who know the network."""

from moireaug.evaluation.attackers import MoireAttacker
from moireaug.evaluation.autoattack import APGDAttacker
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier, averaging_classifier
from moireaug.evaluation.conditions import Condition, controls
from moireaug.evaluation.tables import Cell, Table, cross, worst_of
from training.suites.config import PaperConfig
from training.suites.paper import paper_attacks

PAPER_NETWORKS = ("mopnet", "mddm", "fhde2net", "amnet")
LARGER_EPS = 8 / 255  # the paper's other bound
MISSING_WEIGHTS = "no weights were given"


def demoireing(config: PaperConfig) -> Table:
    """Paper, table 5: the attacks after demoiréing networks. The attackers know of none of them,
    except APGD, which goes through each network's own gradient."""
    classifiers: dict[str, Classifier] = {"undefended": UNDEFENDED}
    for name, network in config.networks.items():
        classifiers[name] = averaging_classifier(name, network)
    missing = {name: MISSING_WEIGHTS for name in PAPER_NETWORKS if name not in classifiers}
    eps, steps = config.middle, config.steps
    columns: dict[str, Condition] = controls(eps) | paper_attacks(config)
    columns["ma_8"] = MoireAttacker(eps=LARGER_EPS, steps=steps, until_fooled=False)
    cells = cross(classifiers, columns)
    for name, classifier in classifiers.items():
        apgd = APGDAttacker(eps=eps, steps=steps, known_classifier=classifier)
        cells.append(Cell(name, "adaptive", (apgd,), classifier))
        cells.append(worst_of([cell for cell in cells if cell.row == name], name, eps))
    return Table(
        "demoireing",
        tuple(cells),
        pictures=tuple(("undefended", column) for column in columns),
        empty=missing,
    )
