"""Tables of a kernel's means over cells."""

import numpy as np
import pytest

import xcg
from xcg.compiled.cell_means import cell_means


@pytest.mark.parametrize(
    "kernel", [xcg.Lucy(0.5), xcg.Gaussian(0.5, cutoff=1.5)], ids=["lucy", "gaussian"]
)
def test_means_of_smooth_kernels_come_from_a_table(kernel):
    """Means that differ from their integrals are not tabulated, so that results do not show a wrong table."""
    code = kernel.over_cells(3)
    means = cell_means((0.7, 0.7, 0.7), 3, code, 1.0 / (code.norm * kernel.cutoff**3))
    assert means.least < np.inf
    assert means.table.min() >= 0.0
