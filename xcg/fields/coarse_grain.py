"""Continuum fields of a scene: `coarse_grain`, and `explain`, which only plans it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import xarray as xr

from xcg.fields.accessible import accessible_of, walls_of, with_accessible
from xcg.fields.advice import advise, advise_on_steps
from xcg.fields.evaluate import CoarseGraining
from xcg.fields.grids.frames import Cylindrical, Rotated, check_axis, in_frame
from xcg.fields.layout import LARGE, check_size
from xcg.fields.like import request_like, with_nodes_of
from xcg.fields.plan import Plan, make_plan
from xcg.fields.presets import lammps, pysammos
from xcg.fields.request import Preset, Request, SharedOptions, takes
from xcg.fields.support import effective_count, text_of_floors
from xcg.scene.bodies import group_bodies
from xcg.scene.scene import Scene
from xcg.steps.analysis import run

# names of other programs: from a request in them to one in names of xcg, and what turns its result
# into theirs
PRESETS: dict[
    Preset, Callable[[Scene, Request], tuple[Request, Callable[[xr.Dataset], xr.Dataset]]]
] = {
    "pysammos": pysammos.translate,
    "lammps": lammps.translate,
}
AnyRequest = TypeVar("AnyRequest", bound=SharedOptions)


@takes(Request)
def coarse_grain(scene: Scene, request: Request) -> xr.Dataset:
    """Coarse-grain a scene to continuum fields.

    Fields of a lazy scene are lazy: data are read and fields computed when values are needed, with
    one task for each chunk of time.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene, from `open_scene` or `scene_from_arrays`.
    {arguments}

    Returns
    -------
    xarray.Dataset
        Fields with dimensions (time, x, y, z, phase, component, direction), as far as they apply:
        ``phase`` with `by` only.
        Sums are zero where nothing reaches; ratios are NaN there, and ``sample_count`` says how
        many particles each node saw.

    Raises
    ------
    SceneError
        If the scene lacks what the fields need.
    ValueError
        If an argument is wrong; the message says what was expected.

    Notes
    -----
    A field is ``sum_i q_i Psi(r - r_i)`` over particles or, for contact stress, ``sum f_ij a_ij
    int_0^1 Psi(r - r_i + s a_ij) ds`` over both sides of every contact. Sources: Goldhirsch (2010);
    Weinhart et al. (2012). Friction coefficient, inertial number, fabric and anisotropies differ
    from those of `microstructure` by constant factors, see the table "Factors to the fields" of the
    page on microstructure (docs/microstructure.md#factors-to-the-fields).

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.simple_cubic(4)
    >>> f = coarse_grain(ds, ["volume_fraction"], axes="z")
    >>> f.volume_fraction.dims
    ('time', 'z')
    """
    return answer(scene, request, of_steps=True)


def answer(
    scene: Scene, request: Request, plan: Plan | None = None, *, of_steps: bool = False
) -> xr.Dataset:
    """Coarse-grain a scene for functions built on it.

    Parameters
    ----------
    plan : Plan, optional
        Plan of the request, if it has been made.
    of_steps : bool
        Whether the fields are those of single steps for the user, with advice on these.
    """
    named = request.fields is not None
    walls = []
    if request.surfaces is not None or request.per is not None:
        walls = walls_of(request)
    like = request.like
    if like is not None:
        request = request_like(request)
    call = request.call("coarse_grain")
    scene, request = prepare(scene, request)
    preset = request.preset
    if preset is not None:
        request, rename = PRESETS[preset](scene, request)
    if plan is None:
        plan = make_plan(scene, request)
    if plan.nodes.count >= LARGE:
        numbers = sum(map(math.prod, plan.shapes.values()))
        check_size(scene, request, plan.nodes, numbers)
    advise(scene, plan)
    if of_steps:
        advise_on_steps(scene, plan, named=named)
    result = run(scene, CoarseGraining(plan), call=call, on_error=request.on_error)
    if walls:
        result = with_accessible(result, scene, plan, request, walls)
    if like is not None:
        result = with_nodes_of(result, like)
    if preset is not None:
        result = rename(result)
    return result


@takes(Request)
def explain(scene: Scene, request: Request) -> Plan:
    """Plan what `coarse_grain` with the same arguments will do, without doing it; printing the plan explains it.

    With ``by_body``, spheres in memory are grouped first, as the plan is that of the bodies; with
    ``preset="lammps"``, the plan is that of the fields which the preset's are made of.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    {arguments}

    Returns
    -------
    Plan
        Its text names fields, variables read, nodes, kernel, sums, loops, the rule for contacts,
        memory, the noise of velocity and temperature that a dense packing would have, the values
        that single steps show where the true one is 0, and the time for the accessible fraction.

    Raises
    ------
    SceneError, ValueError
        As `coarse_grain`.

    Examples
    --------
    >>> import xcg
    >>> print(explain(xcg.datasets.simple_cubic(4), "volume_fraction", axes="z"))  # doctest: +ELLIPSIS
    fields    volume_fraction
    ...
    """
    walls = walls_of(request)
    if request.like is not None:
        request = request_like(request)
    scene, request = prepare(scene, request)
    if request.preset is not None:
        request, _ = PRESETS[request.preset](scene, request)
    plan = make_plan(scene, request)
    advise(scene, plan)
    cost = None
    if walls:
        accessible = accessible_of(scene, plan, walls)
        cost = accessible.text(accessible.seconds())
    return replace(
        plan,
        effective_count=effective_count(scene, plan),
        floors=text_of_floors(scene, plan),
        walls=cost,
    )


def prepare(scene: Scene, request: AnyRequest) -> tuple[Scene, AnyRequest]:
    """Group the spheres of bodies, and turn the scene into the frame, of a request.

    The request that is returned holds of the bodies, in the axes of the frame.
    """
    if request.by_body is not None:
        scene = Scene(group_bodies(scene.ds, request.by_body))
        request = replace(request, by_body=None)
    if request.frame is None:
        return scene, request
    return _in_frame(scene, request, request.frame)


def _in_frame(
    scene: Scene, request: AnyRequest, frame: Rotated | Cylindrical
) -> tuple[Scene, AnyRequest]:
    """Turn a scene into a frame, unless it is in one, and the axes of a request with it."""
    if not scene.cylindrical:
        ds = scene.with_measures().ds
        if isinstance(frame, Cylindrical):
            check_axis(ds, frame)
        scene = Scene(in_frame(ds, frame))
    if not scene.cylindrical:
        return scene, replace(request, frame=None)
    letters = {ord("r"): "x", ord("t"): "y"}  # of the components that stand in their places
    dims: dict[str, Any] = {}
    for name in ("pressure_dims", "shear_dims"):
        axes = getattr(request, name)
        dims[name] = axes and axes.translate(letters)
    return scene, replace(request, **dims)
