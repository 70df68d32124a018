"""The templates: their environment, titles and pictures."""

import base64
import io
import re
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from PIL import Image
from torch import Tensor

import training.report.numbers as numbers
from training.runs.metrics import Metrics, PlainMetrics

PICTURE_SIDE = 165  # pixels, to which small pictures are enlarged by a whole factor
EXAMPLE_SIDE = 300  # pixels, to which large ones are cut
NUMBER_FILTERS = (
    "percent",
    "points",
    "codes",
    "eps_with_unit",
    "number",
    "duration",
    "capital",
    "short",
    "tied",
)


def render(template: str, **context: Any) -> str:
    """Return a template filled in; HTML is escaped."""
    return environment().get_template(template).render(**context)


@cache
def environment() -> Environment:
    """Return the environment of all templates."""
    templates = Environment(
        loader=PackageLoader("training.report"),
        autoescape=lambda name: name is not None and name.endswith(".html.j2"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    for name in NUMBER_FILTERS:
        templates.filters[name] = getattr(numbers, name)
    templates.filters["title_of"] = title_of
    templates.filters["embedded_picture"] = embedded_picture
    return templates


@cache
def read_toml(file: str) -> dict[str, Any]:
    """Return the content of a TOML file of the templates."""
    folder = resources.files("training.report").joinpath("templates")
    return tomllib.loads(folder.joinpath(file).read_text("utf-8"))


def title_of(name: str, section: str) -> str:
    """Return the title of a row or column: see titles.toml."""
    titles = read_toml("titles.toml")
    if name in titles[section]:
        return titles[section][name]
    for pattern in titles["patterns"]:
        if match := re.fullmatch(pattern["match"], name):
            return pattern["title"].format(*match.groups())
    return name


def name_of(metrics: Metrics | PlainMetrics) -> str:
    """Return the name of a model: its recipe, or its architecture where it was not trained
    here."""
    return metrics.model if metrics.recipe == "pretrained" else metrics.recipe


def embedded_picture(image: Any) -> dict[str, Any]:
    """Return a picture (H, W, 3) uint8 for a page: its data URI and its size there."""
    pixels = np.asarray(image)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    height, width = pixels.shape[:2]
    factor = max(1, round(PICTURE_SIDE / max(height, width)))
    return {
        "uri": uri(file.getvalue(), "image/png"),
        "width": width * factor,
        "height": height * factor,
        "enlarged": factor > 1,
    }


def picture_cells(pictures: Mapping[str, Tensor | None]) -> list[dict[str, Any]]:
    """Return the cells of an example: pictures (3, H, W) uint8 by title; None is left out."""
    cells = []
    for title, picture in pictures.items():
        if picture is not None:
            cells.append({"title": title, "image": picture.permute(1, 2, 0).contiguous().numpy()})
    return cells


def middle_of(picture: Tensor) -> Tensor:
    """Return the middle of a picture (3, H, W), at most `EXAMPLE_SIDE` pixels wide and high, as a
    copy: a view would keep all of it."""
    top, left = (max(0, (length - EXAMPLE_SIDE) // 2) for length in picture.shape[1:])
    return picture[:, top : top + EXAMPLE_SIDE, left : left + EXAMPLE_SIDE].clone()


def uri(data: bytes, kind: str) -> str:
    """Return data as a data URI. SVGs too are embedded as images, so that their ids cannot
    clash."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
