"""Suites: which tables answer which question, each a short definition. A cell is one rung before one judge.

Rows and columns are laid out so that the controls stand beside the attack that they control: the same shots without
noise, and with noise of random sign.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from moireaug.defenses import restore_mean
from moireaug.evaluation import recipes, rungs, threat
from moireaug.evaluation.adaptive import blind, strong, through, turnable
from moireaug.evaluation.given import Given, controls
from moireaug.evaluation.rungs import MOIRE, NO_MOIRE, Rung, in_scene, moire_attack, random_noise
from moireaug.evaluation.sweep import MODEL, Judge, other
from moireaug.evaluation.table import Cell, Table, crossed, table, worst_of
from moireaug.scene.fields import bounds, one_of
from moireaug.scene.scene import Scene


def _rivals(g: Given) -> dict[str, Rung]:
    """The paper's attacks at one eps."""
    return {
        "MA": moire_attack(g.eps, g.steps),
        "BIM": rungs.rival("bim", g.eps, g.steps, "BIM"),
        "PGD": rungs.rival("pgd", g.eps, g.steps, "PGD"),
        "C&W": rungs.rival("cw", g.eps, g.steps, "C&W"),
        "MI-FGSM": rungs.rival("mifgsm", g.eps, g.steps, "MI-FGSM"),
    }


CW = "C&W has no bound: c = 1, a learning rate of 0.01, as many steps as the others, and no search for c."


def _published(g: Given) -> bool:
    """The paper compares at ε = 4."""
    return rungs.label(g.eps) == "4"


def success(g: Given) -> Table:
    """Paper, table 1: rotated, rotated and dimmed, targeted and untargeted Moiré Attacks by eps."""
    cells = {}
    for e in (2 / 255, 4 / 255, 6 / 255, 8 / 255):
        columns = {"rotated": rungs.ROTATED, "rotated and dim": NO_MOIRE, "moiré, δ = 0": MOIRE}
        columns |= {"random noise": random_noise(e), "untargeted MA": moire_attack(e, g.steps)}
        columns |= {"targeted MA": moire_attack(e, g.steps, targeted=True)}
        cells |= crossed([(f"ε = {rungs.label(e)}", MODEL)], columns)
    note = "“Rotated” is the photo of a screen without subpixels, as bright as its image; “rotated and dim” as dark as "
    note += "the photo. Targets are random other classes, one an image; the paper’s is always “hen”."
    shown = tuple((row, column) for row, column in cells if row == "ε = 4")
    return table("success", "Success of the Moiré Attack (paper, table 1)", "bound", cells, note=note, pictures=shown)


def mean_normalised(g: Given) -> Table:
    """Paper, table 2: the photo's mean brought to the clean image's; and to a fixed mean, as a deployed system can."""
    restored = Judge("restored", "mean of the clean image", lambda b, shown: b.model(restore_mean(shown, b.images)))  # type: ignore[operator]
    judges = [("as it is", MODEL), ("mean restored", restored), ("gain to a grey mean", g.judge("gain"))]
    columns = controls(4 / 255) | {
        f"MA ε = {rungs.label(e)}": moire_attack(e, g.steps) for e in (2 / 255, 4 / 255, 6 / 255, 8 / 255)
    }
    note = "“Mean restored” subtracts the difference to the clean image’s mean, which only an experimenter knows. The "
    note += "random noise is of ε = 4."
    title = "After mean normalisation (paper, table 2)"
    return table("mean_normalised", title, "brightness", crossed(judges, columns), note=note)


def jpeg(g: Given) -> Table:
    """Paper, table 3: the attacks after JPEG."""
    judges = [("no defence", MODEL), *((f"quality {q}", g.judge(f"jpeg_{q}")) for q in (20, 40, 60, 80))]
    columns = controls(g.eps) | _rivals(g)
    note = "The attacker does not know of the compression. The rivals perturb the image, which no camera saw. "
    note += CW
    title, shown = "Under JPEG compression (paper, table 3)", tuple(("no defence", c) for c in columns)
    cells = crossed(judges, columns)
    return table("jpeg", title, "JPEG", cells, note=note, pictures=shown, published=_published(g))


def defences(g: Given) -> Table:
    """Paper, table 4: the attacks after other input transformations."""
    names = [n for n in g.defences if not n.startswith("jpeg_") and n != "gain"]
    judges = [("no defence", MODEL), *((g.judge(n).title, g.judge(n)) for n in names)]
    note = "The attacker does not know of the defence. " + CW + "".join(f" {n}: {why}." for n, why in g.without.items())
    columns = controls(g.eps) | _rivals(g)
    title = "Under input transformations (paper, table 4)"
    return table("defences", title, "defence", crossed(judges, columns), note=note, published=_published(g))


def transfer(g: Given) -> Table:
    """Paper, table 6: the attacked model's pictures before other models."""
    columns = controls(g.eps) | _rivals(g)
    judges = [("the attacked model", MODEL), *((n, other(n, m)) for n, m in g.targets.items() if m is not None)]
    lost = [n for n, m in g.targets.items() if m is None]
    note = "Each row counts the images that its own model has right when clean. " + CW
    note += f" Weights not at hand: {', '.join(lost)}." if lost else ""
    title = "Transfer to other models (paper, table 6)"
    made = table("transfer", title, "judged by", crossed(judges, columns), published=_published(g))
    return dataclasses.replace(made, rows=(*made.rows, *lost), note=note)


def budget(g: Given) -> Table:
    """Paper, section 4.5 and figure 4: how far, and how visibly, by eps."""
    cells = {}
    for e in (4 / 255, 8 / 255, 16 / 255, 32 / 255):
        columns = {"moiré, δ = 0": MOIRE, "random noise": random_noise(e), "MA": moire_attack(e, g.steps)}
        columns["BIM"] = rungs.rival("bim", e, g.steps, "BIM")
        cells |= crossed([(f"ε = {rungs.label(e)}", MODEL)], columns)
    note = "Below each attack, how visible its change is: against the photo without noise for MA, against the clean "
    note += "image for BIM."
    shown = tuple(key for key in cells if key[1] in ("MA", "BIM"))
    title = "Budget: success and visibility (paper, figure 4)"
    return table("budget", title, "bound", cells, note=note, visible=("MA", "BIM"), pictures=shown)


def factors(g: Given) -> Table:
    """Paper, figure 6: rotation, and the factor alpha by which the picture is enlarged on the screen."""
    low, high = bounds(g.scene.panel.scale)
    usual = (low + high) / 2

    def turned(roll: float) -> Callable[[Scene], Scene]:
        return lambda s: dataclasses.replace(s, view=dataclasses.replace(s.view, roll=roll))

    def enlarged(alpha: float) -> Callable[[Scene], Scene]:
        panel, sensor = (low * alpha / usual, high * alpha / usual), g.scene.sensor.scale * alpha / usual
        return lambda s: dataclasses.replace(
            s, panel=dataclasses.replace(s.panel, scale=panel), sensor=dataclasses.replace(s.sensor, scale=sensor)
        )

    # of odd multiples a point-sampled photo reads one sensor pixel, of even ones the mean of two, which is a filter
    alphas = (1, 3, 5) if g.scene.develop.resize == "point" else (1, 2, 3)
    variants = [(f"roll {r}°", turned(float(r))) for r in (0, 5, 10, 15, 30, 45)]
    variants += [(f"alpha {a}", enlarged(float(a))) for a in alphas]
    columns = {"no moiré": NO_MOIRE, "moiré, δ = 0": MOIRE, "random noise": random_noise(g.eps)}
    columns["MA"] = moire_attack(g.eps, g.steps)
    cells = {}
    for name, scene in variants:
        cells |= crossed([(name, MODEL)], {c: in_scene(r, name, scene) for c, r in columns.items()})
    note = "With alpha the sensor grows too, so that a panel pixel stays as many sensor pixels wide as in the scene."
    shown = tuple((name, "moiré, δ = 0") for name, _ in variants)
    title = "Factors of the moiré (paper, figure 6)"
    return table("factors", title, "factor", cells, note=note, pictures=shown)


def noise_position(g: Given) -> Table:
    """Paper, appendix E: noise on the raw reading against noise on the developed photo ("Moiré + BIM")."""
    after = moire_attack(g.eps, g.steps, name="noise on the photo", noise_at="photo")
    columns = controls(g.eps) | {"MA": moire_attack(g.eps, g.steps), "Moiré + BIM": after}
    judges = [("no defence", MODEL), *((f"JPEG {q}", g.judge(f"jpeg_{q}")) for q in (20, 40))]
    title = "Noise before or after demosaicing (paper, appendix E)"
    return table("noise_position", title, "compression", crossed(judges, columns), published=_published(g))


def natural(g: Given) -> Table:
    """Paper, section 3.1 and figure 3: no attack at all, displays x cameras x angles."""
    cells: dict[tuple[str, str], Cell] = {}
    for display, camera in threat.PAIRS:
        row = f"{display}, {camera}"
        seen = {a: (lambda s, a=a, d=display, c=camera: threat.scene(d, c, a)) for a in threat.ANGLES}
        for angle, scene in seen.items():
            cells[row, f"{angle}°"] = Cell((in_scene(MOIRE, f"{row}, {angle}", scene),))
        cells[row, "all"] = Cell(tuple(in_scene(MOIRE, f"{row}, {a}", s) for a, s in seen.items()))
        cells[row, "all, no moiré"] = Cell(tuple(in_scene(NO_MOIRE, f"{row}, {a}", s) for a, s in seen.items()))
    shown = (*((f"{d}, {threat.PAIRS[0][1]}", "90°") for d in threat.DISPLAYS),)
    shown += tuple((f"{threat.PAIRS[-1][0]}, {threat.PAIRS[-1][1]}", f"{a}°") for a in threat.ANGLES)
    note = (
        "Nobody attacks: photos with natural moiré alone, brought back to the image’s frame. 90° is frontal. The last "
    )
    note += "column is the same photos of panels without subpixels. The scenes’ figures are in `evaluation/threat.py`."
    title = "Natural moiré: displays, cameras, angles (paper, section 3.1)"
    return table("threat", title, "display, camera", cells, note=note, pictures=shown)


ADAPTED = ("jpeg_60", "median_3", "pixel_deflection")  # one of each kind: a codec, a filter, a randomised one


def adaptive(g: Given) -> Table:
    """What an attacker gains who knows of the defence, searches harder, or does not know the pose."""
    plain = moire_attack(g.eps, g.steps)
    cells = crossed([("no defence", MODEL)], controls(g.eps) | {"MA": plain})
    cells["no defence", "adaptive MA"] = Cell((strong(g.eps, g.steps),))
    cells["no defence", "MA, pose unknown"] = Cell((blind(g.eps, g.steps),))
    parts, why = turnable(g.scene)
    if parts:
        turning = moire_attack(g.eps, g.steps, name="turns the camera", optimise=("noise", *parts))
        cells["no defence", "MA turns the camera"] = Cell((turning,))
    for name in ADAPTED:
        judge, defence = g.judge(name), g.defences[name]
        cells |= crossed([(judge.title, judge)], controls(g.eps) | {"MA": plain})
        knows = through(strong(g.eps, g.steps, name=f"through {judge.title}"), defence)
        cells[judge.title, "adaptive MA"] = Cell((knows,), judge)
    for row in dict.fromkeys(row for row, _ in cells):
        tried = [cell for (r, column), cell in cells.items() if r == row and column != "clean"]
        cells[row, "worst case"] = worst_of(tried)
    note = "“Adaptive MA” attacks the model with its defence (BPDA; four draws a step of a randomised one), by the "
    note += "margin, with halved steps and two restarts. “Pose unknown”: the noise was found by expectation over four "
    note += (
        "other draws of the scene a step. “Worst case”: each image counts as fooled where any column of its row but "
    )
    note += "the first fools it; a randomised defence is drawn anew for each."
    note += f" No attacker turns the camera: {why}" if why else ""
    return table("adaptive", "Adaptive attackers", "defence", cells, note=note)


SUITES: dict[str, Callable[[Given], Table]] = {
    "success": success,
    "mean_normalised": mean_normalised,
    "jpeg": jpeg,
    "defences": defences,
    "transfer": transfer,
    "budget": budget,
    "factors": factors,
    "noise_position": noise_position,
    "threat": natural,
    "adaptive": adaptive,
    "worst_case": recipes.worst_case,
    "unseen": recipes.unseen,
}
RECIPES = ("worst_case", "unseen")
GROUPS = {"paper": tuple(name for name in SUITES if name not in RECIPES), "recipes": RECIPES}


def tables_of(suite: str, given: Given) -> list[Table]:
    """The tables of a suite, or of a group of them; "trust" has none, since its checks are not one.

    Raises:
        ValueError: an unknown suite; the message lists the known ones.
    """
    one_of("suite", suite, (*SUITES, *GROUPS, "trust"))
    return [make(given) for name, make in SUITES.items() if suite == name or name in GROUPS.get(suite, ())]
