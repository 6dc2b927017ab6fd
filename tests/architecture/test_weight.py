"""The weight of the package, which may fall and not rise: modules, lines of code, length of a module."""

import ast
import io
import tokenize

from tests import ROOT

PACKAGE = ROOT / "xcg"
MOST_MODULES, MOST_LINES, LONGEST, SHORTEST = 148, 23797, 450, 60
# tables of rows
SHORT = {"__init__.py", "fields/formulas/rows/orientation.py"}
ADVICE = "the package grew: take out as much as you add, or raise the limit above in this commit and say why"
_NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}


def lines_of_code(text: str) -> int:
    """Count lines without docstrings, comments and blanks."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        documented = isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef))
        if documented and ast.get_docstring(node, clean=False) is not None:
            lines -= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    return len(lines)


def test_lines_are_counted_without_docstrings_comments_and_blanks():
    assert (
        lines_of_code('"""Doc."""\n\n# why\nx = (\n    1\n)\n\n\ndef f():\n    """Doc\n    more."""\n    return x\n')
        == 5
    )


def test_the_package_does_not_grow():
    texts = {path.relative_to(PACKAGE).as_posix(): path.read_text() for path in PACKAGE.rglob("*.py")}
    assert len(texts) <= MOST_MODULES, ADVICE
    lines = sum(map(lines_of_code, texts.values()))
    assert lines <= MOST_LINES, ADVICE
    lengths = {name: len(text.splitlines()) for name, text in texts.items()}
    assert max(lengths.values()) <= LONGEST
    faces = {name for name in lengths if name.endswith("/__init__.py")}
    assert {name for name, length in lengths.items() if length < SHORTEST} <= SHORT | faces
