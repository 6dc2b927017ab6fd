"""Rows of the table of mutations are of the package as it is."""

from tests.architecture import PACKAGE
from tests.mutations import TABLE, files_of


def test_each_mutation_changes_one_place():
    stale = [
        (row.file, row.old) for row in TABLE if (PACKAGE / row.file).read_text().count(row.old) != 1
    ]
    assert not stale


def test_tests_of_mutations_exist():
    names = " ".join(row.tests for row in TABLE).split()
    assert files_of(names)
