"""Properties of the whole series: from the arguments, the headers of files, or their ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from xcg.common.messages import warn_user
from xcg.readers.arguments import Arguments
from xcg.readers.engine import StepRef
from xcg.readers.files.text import source_of
from xcg.readers.listing import Listing
from xcg.readers.paths import not_against_headers, units_of_headers
from xcg.scene.schema import COMPONENTS, Frame, Setup, Shape, periodic_axes


def setup_of(arguments: Arguments, listing: Listing, ends: Mapping[StepRef, Frame]) -> Setup:
    """Return what holds for all steps: from the arguments, else the headers, else the ends."""
    first = next(iter(ends))
    flat = _flat_plane(list(ends.values()))
    plane = arguments.plane
    dimension = arguments.dimension
    if dimension is None:
        dimension = listing.steps[0].particles.dimension or len(flat or COMPONENTS)
        if plane:
            dimension = len(plane)
    if dimension == 2:
        plane = plane or flat or "xy"
    periodic = _within(plane, first.periodic or "")
    if arguments.periodic is not None:
        axes = periodic_axes(arguments.periodic, plane)
        if first.periodic is not None:
            _check_periodic(_within(plane, axes), periodic, source_of(first))
        periodic = axes
        if arguments.box is None and first.box is None:
            # no file tells the period across a layer, and nothing depends on it
            periodic = _within(flat, periodic)
    units: Any = arguments.units
    if units is None:
        units = units_of_headers(listing.refs)
    else:
        not_against_headers(units, listing.refs)
    shape, thickness = shape_of(arguments, listing)
    setup = Setup.make(
        units=units,
        gravity=arguments.gravity,
        dimension=dimension,
        plane=plane,
        thickness=thickness,
        shape=shape,
        sides=arguments.sides,
        periodic=periodic,
        **arguments.alike,
    )
    if arguments.gravity is None and first.gravity is not None:
        x, y, z = (g * setup.factor((1, 0, -2)) for g in first.gravity)
        setup = replace(setup, gravity=(x, y, z))
    return setup


def _check_periodic(axes: str, of_header: str, source: str) -> None:
    """Warn if axes are given as periodic that are not so in the header; others may be left out on purpose."""
    added = "".join(axis for axis in axes if axis not in of_header)
    if added:
        names = "names no periodic axis"
        if of_header:
            names = f"names {of_header!r}"
        warn_user(
            f"periodic={axes!r}, but the header of {source} {names}: grains at both edges of {added!r} become "
            "neighbours; leave periodic= out, unless the header is wrong"
        )


def shape_of(arguments: Arguments, listing: Listing) -> tuple[Shape, float | None]:
    """Return the shape of grains, and the thickness of discs (m), which is 1 in the files' unit."""
    of_files = listing.steps[0].particles.shape
    thickness = arguments.thickness
    if arguments.shape is None and of_files == "disc" and thickness is None:
        units = arguments.units
        if units is None:
            units = units_of_headers(listing.refs)
        thickness = Setup.make(units=units).scales[0]
    return arguments.shape or of_files or "sphere", thickness


def _flat_plane(frames: Sequence[Frame]) -> str | None:
    """Return the axes of the plane that all particles lie in, None if they do not."""
    positions = [frame["position"] for frame in frames]
    if any(len(position) < 3 for position in positions):
        return None
    extended = [k for k in range(3) if any(np.ptp(position[:, k]) > 0 for position in positions)]
    if len(extended) != 2:
        return None
    return "".join(COMPONENTS[k] for k in extended)


def _within(plane: str | None, periodic: str) -> str:
    """Return periodic axes without the one across a plane, along which 2D boxes may be periodic."""
    return "".join(
        axis for axis in periodic if plane is None or axis in plane or axis not in COMPONENTS
    )
