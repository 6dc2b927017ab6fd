"""Generated pages are what their scripts write, and links in the documentation lead somewhere."""

import ast
import importlib
import inspect
import pkgutil
import re
import runpy
from typing import get_args

import pytest

from tests import ROOT
from tests.architecture import nodes_of_package


def test_table_of_fields_is_current():
    pages = runpy.run_path(str(ROOT / "docs" / "fields.py"))["pages"]()
    assert len(pages) == 2
    for path, text in pages.items():
        assert path.read_text() == text, "run python docs/fields.py"


def test_packings_beside_table_1_are_current():
    from docs.works import table

    page = (ROOT / "docs" / "works.md").read_text()
    assert page.split("<!-- table 1 -->")[1].strip() == table(), "run python -m docs.works"


def anchors_of(path):
    """Anchors that Sphinx makes of the headings of a page."""
    text = re.sub(r"```.*?```", "", path.read_text(), flags=re.DOTALL)
    titles = [
        re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title)
        for title in re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    ]
    return {re.sub(r"[^\w\- ]", "", title.strip().lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize(
    "page", ["README.md", *(f"docs/{p.name}" for p in (ROOT / "docs").glob("*.md"))]
)
def test_links_have_targets(page):
    path = ROOT / page
    for target, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", path.read_text()):
        if not target.startswith("http"):
            there = path.parent / target if target else path
            assert there.exists(), f"{page} links to {target}"
            assert not anchor or anchor in anchors_of(there), f"{page} links to {target}#{anchor}"


def test_no_line_of_text_is_a_comment():
    """A line that begins with % is left out of the site."""
    for page in (ROOT / "docs").glob("*.md"):
        text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
        assert re.findall(r"^\s*%.*$", text, re.MULTILINE) == [], page.name


def test_entries_of_the_glossary_are_whole():
    _, entries = (ROOT / "docs" / "reference.md").read_text().split("{.glossary}\n")
    for entry in entries.strip().split("\n\n"):
        term, first, *rest = entry.split("\n")
        assert not term.startswith((":", " "))
        assert " : " not in term
        assert first.startswith(": "), term
        assert all(line.startswith("  ") for line in rest), term


def test_every_function_has_an_example_on_a_page():
    import xcg

    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    blocks = "".join(
        code
        for page in pages
        for code in re.findall(r"```.*?\n(.*?)```", page.read_text(), re.DOTALL)
    )
    functions = [n for n in xcg.__all__ if inspect.isfunction(getattr(xcg, n))]
    methods = [n for n in dir(xcg.CoarseGrainAccessor) if not n.startswith("_")]
    assert [n for n in functions if not re.search(rf"\.{n}\(", blocks)] == []
    assert [n for n in methods if not re.search(rf"\.cg\.{n}\(", blocks)] == []


def test_glossary_is_a_list_of_terms():
    text = (ROOT / "docs" / "reference.md").read_text().partition("{.glossary}\n")[2]
    terms = []
    for entry in text.strip().split("\n\n"):
        term, meaning, *rest = entry.split("\n")
        assert meaning.startswith(": "), entry
        assert all(line.startswith("  ") for line in rest), entry
        terms.append(term)
    assert terms == sorted(terms, key=str.lower)


def test_every_public_name_has_a_page():
    import xcg

    listed = set()
    # kernels are listed on the page of theory, below their shapes
    for page in ("api.md", "theory.md"):
        listed |= set(
            re.findall(r"^   ([\w.]+)$", (ROOT / "docs" / page).read_text(), re.MULTILINE)
        )
    modules = {"FIELDS", "datasets", "readers"}  # FIELDS has the page on fields
    assert set(xcg.__all__) - modules <= listed
    for name in listed:
        assert pkgutil.resolve_name(f"xcg.{name}").__doc__, name


def test_every_kernel_has_its_shape_on_the_page_of_theory():
    from xcg.fields.sums.kernels import KernelName

    text = (ROOT / "docs" / "theory.md").read_text().partition("## Kernels\n")[2]
    table = text.partition("| kernel | shape")[2].partition("\n\n")[0]
    assert re.findall(r"^\| `([\w ]+)`", table, re.MULTILINE) == [*get_args(KernelName)]


def test_names_of_the_api_are_alphabetical_within_their_groups():
    groups = (ROOT / "docs" / "api.md").read_text().split("\n## ")[1:]
    for group in groups:
        paths = re.findall(r"^   ([\w.]+)$", group, re.MULTILINE)
        names = [path.rpartition(".")[2].lower() for path in paths]
        assert names == sorted(names), group.partition("\n")[0]


def test_words_of_the_index_lead_to_one_answer():
    """The search of the site finds answers of "How do I ...?" by these words."""
    page = (ROOT / "docs" / "how_do_i.md").read_text()
    answers = page.split("\n### ")[1:]
    words = [re.findall(r"<!-- index: (.*) -->", answer) for answer in answers]
    assert [answer for answer, lists in zip(answers, words, strict=True) if len(lists) != 1] == []
    titles = {}
    for answer, (line,) in zip(answers, words, strict=True):
        for entry in line.split(", "):
            assert entry not in titles
            titles[entry] = answer.partition("\n")[0]
    asked = {
        "rose diagram": "rose",
        "velocity autocorrelation": "autocorrelation",
        "pandas": "pandas",
        "Excel": "Excel",
        "CSV": "CSV",
        "stress tensor": "component of a tensor",
        "batch": "batch",
        "superquadric": "superquadrics",
        "units": "unit",
        "periodic": "periodic",
        "volume fraction near wall": "wall",
        "compare two simulations": "compare",
        "principal stress": "principal",
        "radial distribution": "radial distribution",
        "time average": "average",
    }
    for entry, word in asked.items():
        assert word in titles[entry], (entry, titles[entry])


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("rho_p = rho / phi", r"$\rho_{p} = \dfrac{\rho}{\phi}$"),
        (
            "d32 = sum d_i^3 Psi / sum d_i^2 Psi",
            r"$d_{32} = \dfrac{\sum d_{i}^{3} \Psi}{\sum d_{i}^{2} \Psi}$",
        ),
        (
            "dev sigma = sigma - tr(sigma) / D I",
            r"$\operatorname{dev} \sigma = \sigma - \dfrac{\operatorname{tr} (\sigma)}{D} I$",
        ),
        ("sum (m_i v_i^2 + b) / 2 v_i Psi", r"$\sum \dfrac{m_{i} v_{i}^{2} + b}{2} v_{i} \Psi$"),
        (
            "mu = |dev sigma| / p, where p > 0",
            r"$\mu = \dfrac{\lvert \operatorname{dev} \sigma \rvert}{p}$, where $p > 0$",
        ),
        (
            "n_c <f.n>, a = 3, or 1 in a plane",
            r"$n_{c} \langle f \cdot n \rangle$, $a = 3$, or $1$ in a plane",
        ),
        ("sqrt(p / rho_p) M^-1", r"$\sqrt{\dfrac{p}{\rho_{p}}} M^{-1}$"),
        ("sum v'_i^2 Psi", r"$\sum {v'_{i}}^{2} \Psi$"),
    ],
)
def test_formulas_become_mathematics(formula, expected):
    from docs.formula import mathematics

    assert mathematics(formula) == expected


def test_all_formulas_are_whole_mathematics():
    from docs.formula import mathematics
    from xcg.fields.formulas.registry import FIELDS, listed

    for name in listed(registered=False):
        text = mathematics(FIELDS[name].formula)
        assert text.count("$") % 2 == 0, name
        for part in re.findall(r"\$(.*?)\$", text):
            assert part.count("{") == part.count("}"), (name, part)
            assert "/" not in part.replace("//", ""), (name, part)


@pytest.mark.parametrize("script", sorted((ROOT / "docs").glob("*.py")), ids=lambda path: path.stem)
def test_scripts_import_names_of_the_package_that_exist(script):
    for node in ast.walk(ast.parse(script.read_text())):
        if isinstance(node, ast.ImportFrom) and str(node.module).partition(".")[0] in (
            "xcg",
            "tests",
        ):
            module = importlib.import_module(node.module)
            for alias in node.names:
                if not hasattr(module, alias.name):
                    importlib.import_module(f"{node.module}.{alias.name}")


def test_words_of_warnings_on_their_page_are_those_of_the_package():
    """Words in italics in the table of warnings are parts of the messages."""
    page = (ROOT / "docs" / "scale.md").read_text()
    rows = page.split("\n## Warnings\n")[1].split("\n## ")[0]
    observations = [line.split("|")[1] for line in rows.splitlines() if line.startswith("| ")]
    phrases = re.findall(r"\*([^*]+)\*", " ".join(observations))
    assert len(phrases) > 10
    known = "\n".join(
        node.value
        for nodes in nodes_of_package(".py").values()
        for node in nodes
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    )
    assert [phrase for phrase in phrases if phrase not in known] == []


def test_first_steps_list_every_extra():
    import tomllib

    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    page = (ROOT / "docs" / "first_steps.md").read_text()
    assert [name for name in extras if f"| `{name}` |" not in page] == []
