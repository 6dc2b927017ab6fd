# Sourced by the scripts beside this one: an environment of its own in a temporary folder, and the core part of the tests.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
root=$PWD
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# readers, fields, averages, packings, chains and writers; none of them needs an optional package
core=(
  tests/test_datasets.py tests/chains/test_search.py tests/fields/test_coarse_grain.py
  tests/fields/formulas/test_averages.py tests/packing/test_pairs.py tests/readers/engines/test_lammps.py
  tests/readers/engines/test_mercury.py tests/writers/test_vtkhdf.py
)
runner=("pytest>=8.0" "pytest-benchmark>=5.0" "hypothesis>=6.100")

# environment PYTHON: an empty one in $work/venv
environment() {
  "$1" -m venv "$work/venv"
  python=$work/venv/bin/python
  "$python" -m pip install --quiet --upgrade pip
}

# run_core: the core tests on what is installed, away from the package's sources
run_core() {
  mkdir -p "$work/run"
  for name in .ci tests docs examples pyproject.toml README.md CITATION.cff LICENSE; do ln -sfn "$root/$name" "$work/run/$name"; done
  (cd "$work/run" && "$python" -c 'import xcg, sys; assert "site-packages" in xcg.__file__, xcg.__file__; print(xcg.__file__, sys.version)')
  # warnings are of versions that a developer may never see: they do not fail here
  (cd "$work/run" && "$python" -m pytest -q -p no:cacheprovider -W default "${core[@]}" "$@")
}
