r"""Compare a scene with real photos of screens, and fit it to them.

    python training/calibrate.py pairs=FILE.csv scene=screen_photo     # columns photo, original
    python training/calibrate.py pairs=DIR scene=FILE.yaml             # DIR/photo/*, DIR/original/*
    python training/calibrate.py photos=DIR picture=FILE               # of one picture on a screen
    python training/calibrate.py photos=DIR                            # of unknown pictures
    python training/calibrate.py pairs=FILE.csv scene=screen_photo fit=true seconds=600

Measures crops of the photos, and photos of the same crops by the scene: strength of the moiré by
scale, stripes or lattice, tone, tint, sharpness, noise. With `picture`, each photo is first
registered to the picture; without originals, only the photos are measured. `fit=true` searches the
scene's ranges so that the two agree, and writes scene.yaml, which every command takes as
scene=FILE: the fitted scene if it is better in unseen shots of the same pictures; otherwise an
earlier fit is kept, or the scene is written unchanged.

Writes report.html, statistics.csv and statistics.png into
runs/calibrate/<pairs or photos>-<scene>-<hash>/, or where out=DIR says.
"""

import sys
from pathlib import Path

if __name__ == "__main__":  # search the repository, not this folder: a user has a models.py too
    sys.path[: not sys.flags.safe_path] = [str(Path(__file__).resolve().parents[1])]

# before torch is loaded, as it sets how torch's threads wait
import training  # noqa: F401  # isort: skip
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import pandas as pd
import yaml

from moireaug import Scene
from moireaug.common.files import shown, write_bytes, write_text
from moireaug.synthesis.pairs import check_aligned
from training.calibration import fit
from training.calibration.compare import (
    StatisticRow,
    compare_statistics,
    cut_crops,
    measure_crops,
    photograph_crops,
    terminal_parts,
)
from training.calibration.page import draw, example_blocks, page
from training.config import scenes
from training.config.data_sets import MAX_SEED
from training.config.plain_commands import parse, report_errors
from training.config.settings import setting
from training.data.real_pairs import (
    ScreenPhoto,
    find_images,
    find_pairs,
    read_codes,
    read_pairs,
    read_registered,
)
from training.photographs.statistics import MIN_CROP_SIDE
from training.runs.identity import fingerprint_of
from training.system.files import free_name, make_folder, require_outside

EXAMPLE = "python training/calibrate.py pairs=FILE.csv scene=screen_photo"


@dataclass
class Config:
    """All settings of the command."""

    pairs: str | None = setting(None, "CSV file or a folder")
    photos: str | None = setting(None, "folder of photos of one picture, or of unknown ones")
    picture: str | None = setting(None, "what the screen showed in all photos")
    scene: str = setting("screen_photo", "preset, or YAML file")
    out: str | None = setting(None, "folder of the results; null: in runs/calibrate/")
    size: int = setting(384, "side of the crops, in pixels", bounds=(MIN_CROP_SIDE, None))
    crops: int = setting(6, "crops of each picture", bounds=(1, None))
    seed: int = setting(0, "of the photos and the search", bounds=(0, MAX_SEED - 1))
    fit: bool = setting(False, "search the scene's ranges")
    evaluations: int = setting(400, "of the fit, at most", bounds=(1, None))
    seconds: float = setting(900.0, "of the fit, at most", bounds=(0, None))


def calibrate(cfg: Config) -> list[StatisticRow]:
    """Measure, fit if asked to, write and print; return the table."""
    check(cfg)
    scene, name = scenes.load_one(cfg.scene), shown(Path(cfg.scene).stem)
    if cfg.pairs or cfg.picture:
        check_aligned(scene)
    out = Path(cfg.out) if cfg.out else folder_of(cfg, scene)
    if cfg.photos:
        require_outside(out, cfg.photos, "photos")
    make_folder(out, "out=DIR")
    crops = cut_crops(pictures_of(cfg), cfg.size, cfg.crops, cfg.seed)
    real = measure_crops(crops.photos, crops.originals)
    fitted = None
    if cfg.fit:
        fitted = fit.fit(scene, crops, real, cfg.evaluations, cfg.seconds, cfg.seed)
        print(f"fit: {fitted.sentence()}")
        if fitted.scene is not scene:
            scene, name = fitted.scene, f"{name}, fitted"
            write_scene(out / "scene.yaml", scene)
        elif not (out / "scene.yaml").exists():  # an earlier fit stays
            write_scene(out / "scene.yaml", scene)
    simulated = theirs = None
    if crops.originals is not None:
        simulated = photograph_crops(scene, crops.originals, cfg.seed)
        theirs = measure_crops(simulated, crops.originals)
    table = compare_statistics(real, theirs)
    plot = draw(table, name)
    write_bytes(out / "statistics.png", plot)
    rows = pd.DataFrame([row.to_dict() for row in table])
    write_text(out / "statistics.csv", rows.to_csv(index=False))
    examples = example_blocks(crops, simulated, name)
    write_text(out / "report.html", page(table, crops, scene, name, plot, examples, fitted))
    print(*terminal_parts(table, name), sep="\n")
    print(f"Written: {out / 'report.html'}")
    return table


def folder_of(cfg: Config, scene: Scene) -> Path:
    """Return where the results of these photos and this scene lie by default; others of the same
    names get another folder."""
    photos = Path(str(cfg.pairs or cfg.photos)).resolve()
    picture = str(Path(cfg.picture).resolve()) if cfg.picture else None
    identity = {"photos": str(photos), "picture": picture, "scene": scene.to_dict()}
    name = f"{photos.name}-{Path(cfg.scene).stem}-{fingerprint_of(identity)[:6]}"
    return Path("runs") / "calibrate" / name


def check(cfg: Config) -> None:
    """Refuse settings that do not go together."""
    if (cfg.pairs is None) == (cfg.photos is None):
        raise ValueError(f"pass either pairs= or photos=, as in: {EXAMPLE}")
    if cfg.picture and not cfg.photos:
        raise ValueError(
            "picture= says what was on the screen in photos=DIR: leave it out with pairs="
        )
    if cfg.fit and cfg.photos and not cfg.picture:
        raise ValueError(
            "fit=true needs to know what was on the screen: pass picture=FILE, or pairs="
        )


def pictures_of(cfg: Config) -> Iterator[ScreenPhoto]:
    """Yield the photos with their originals, as far as these are known."""
    if cfg.pairs:
        yield from read_pairs(find_pairs(Path(cfg.pairs)))
        return
    photos = find_images(Path(str(cfg.photos)))
    if not photos:
        raise ValueError(f"no images in {cfg.photos}: pass photos=DIR of a folder with some.")
    if cfg.picture:
        yield from read_registered(photos, Path(cfg.picture))
        return
    for path in photos:
        yield ScreenPhoto(shown(path.stem), read_codes(path), None)


def write_scene(path: Path, scene: Scene) -> None:
    """Write a fitted scene; that of an earlier fit is kept beside it under another name."""
    if path.exists():
        earlier = free_name(path)
        os.replace(path, earlier)
        print(f"{path} held an earlier fit; it is now {earlier}")
    write_text(path, yaml.safe_dump(scene.to_dict(), sort_keys=False))
    print(f"Written: {path}")


def main(argv: Sequence[str]) -> None:
    """Run the command line, or exit with a one-line error."""
    with report_errors("Interrupted before the report was written."):
        calibrate(parse(argv, Config, EXAMPLE, __doc__))


if __name__ == "__main__":
    main(sys.argv[1:])
