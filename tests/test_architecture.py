"""The layers stay apart, and the import stays light."""

import ast
import subprocess
import sys
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "xcg"

# floors from the ground up; a module imports only from lower floors
FLOORS = [
    ["kernels"],
    ["picks", "schema", "smoothing", "symbols", "threads"],
    ["notices"],
    ["faults"],
    ["complete", "conform", "grid"],
    ["plausible"],
    ["cells", "scene"],
    ["contacts", "moments", "over_time", "reach", "regions", "phases", "bodies"],
    ["fields", "labels", "quantities", "sums"],
    ["plan", "readers", "tape"],
    ["pysammos"],
    ["coarse_grain", "datasets", "detection", "microstructure", "particle_stress", "slices", "statistics"],
    ["balance", "width_sweep", "chains"],
    ["writers"],
    ["accessor"],
    ["__init__"],
    ["cli"],
]


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_kernels_import_neither_xarray_nor_dask():
    code = """
import sys
for name in ("xarray", "dask", "pandas", "vtk"):
    sys.modules[name] = None
import xcg.kernels.deposit
"""
    # importing xcg itself would pull xarray in, so its __init__ is left out
    stub = f"import sys, types; p = types.ModuleType('xcg'); p.__path__ = [{str(PACKAGE)!r}]; sys.modules['xcg'] = p\n"
    names = [f.stem for f in sorted((PACKAGE / "kernels").glob("[a-z]*.py"))]
    done = run(stub + code + "\n".join(f"import xcg.compiled.{n}" for n in names))
    assert done.returncode == 0, done.stderr


def test_import_defers_what_is_heavy():
    heavy = ("vtk", "vtkmodules", "matplotlib", "sklearn", "h5py", "click")
    done = run(f"import sys, xcg; print([m for m in {heavy} if m in sys.modules])")
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def _floor(name):
    found = [k for k, floor in enumerate(FLOORS) if name in floor]
    assert found, f"xcg/{name} stands on no floor: add it to FLOORS"
    return found[0]


def test_imports_only_go_down():
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        own = parts[0]
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("xcg"):
                continue
            module = (node.module or "").split(".")[1:]
            for target in [module[0]] if module else [a.name for a in node.names]:
                if target != own:
                    assert _floor(target) <= _floor(own), f"{path.name} imports {target} from a higher floor"
