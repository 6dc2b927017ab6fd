"""The conda recipe asks for what pyproject.toml asks for."""

import re
import tomllib

from tests import ROOT

# names of packages that conda-forge calls otherwise
OF_CONDA = {
    "dask[array]": "dask-core",
    "isal": "python-isal",
    "lazy_loader": "lazy-loader",
    "vtk": "vtk-base",
}


def test_the_conda_recipe_has_version_and_requirements_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    recipe = (ROOT / "conda" / "recipe.yaml").read_text()
    run = recipe.split("  run:\n")[1].split("\n\n")[0]
    found = {match[1]: match[2] or "" for match in re.finditer(r"- ([\w-]+) ?(>=[\d.]+)?\n?", run)}
    found.pop("python")
    expected = {}
    for requirement in project["dependencies"]:
        name, least = re.fullmatch(r"([\w\[\]-]+)(>=[\d.]+)?", requirement).groups()
        expected[OF_CONDA.get(name, name.lower())] = least or ""
    assert found == expected
    assert f'version: "{project["version"]}"' in recipe
    assert f'python_min: "{project["requires-python"].removeprefix(">=")}"' in recipe
