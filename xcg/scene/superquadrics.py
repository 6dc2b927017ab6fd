"""Integrals over superquadrics."""

from __future__ import annotations

from typing import Any


def superquadric_integrals(n1: Any, n2: Any) -> tuple[Any, Any, Any]:
    """Return the volume over abc, and the integrals of x^2 over a^3bc and of z^2 over abc^3, of superquadrics."""
    from scipy.special import beta  # slow to import

    e1 = 2.0 / n1
    e2 = 2.0 / n2
    return (
        2 * e1 * e2 * beta(e1 / 2 + 1, e1) * beta(e2 / 2, e2 / 2),
        0.5 * e1 * e2 * beta(1.5 * e2, e2 / 2) * beta(e1 / 2, 2 * e1 + 1),
        2 * e1 * e2 * beta(e2 / 2, e2 / 2 + 1) * beta(1.5 * e1, e1 + 1),
    )
