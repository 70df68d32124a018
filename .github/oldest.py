"""Print pip's constraints to the oldest versions that pyproject.toml declares, with the last fixes
of each."""

import itertools
import re
import tomllib
from pathlib import Path

project = tomllib.loads(Path("pyproject.toml").read_text())["project"]
extras = project["optional-dependencies"].values()
for requirement in itertools.chain(project["dependencies"], *extras):
    if match := re.match(r"([\w.-]+)(?:\[.*\])?>=([\w.]+)", requirement):
        print(f"{match[1]}=={match[2]}.*")
