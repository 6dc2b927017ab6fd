"""Open the files of a DEM code as one lazy scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import xarray as xr
from numpy.typing import ArrayLike

from xcg.readers.arguments import Arguments, Missing, Paths
from xcg.readers.chunks import Chunks, is_automatic
from xcg.readers.ends import lacks_ids, read_ends, warn_of_missing_facts
from xcg.readers.engine import BUILT_IN, Engine
from xcg.readers.indexed import indexed_arrays
from xcg.readers.listing import list_series
from xcg.readers.saved import open_saved, saved_path
from xcg.readers.series import make_series, with_origin
from xcg.readers.series_setup import setup_of
from xcg.scene.build import to_dataset
from xcg.scene.schema import Shape, Sides
from xcg.steps.faults import OnError


def open_scene(
    particles: Paths,
    contacts: Paths | None = None,
    walls: Paths | Mapping[str, str | Sequence[str]] | None = None,
    *,
    engine: str | Engine | type[Engine] | None = None,
    names: Mapping[str, Any] | Sequence[str | None] | str | None = None,
    times: ArrayLike | None = None,
    box: ArrayLike | Mapping[str, Sequence[float]] | None = None,
    periodic: str | bool | Sequence[str] | Sequence[bool] | None = None,
    lattice: ArrayLike | Mapping[str, ArrayLike] | None = None,
    shear_rate: Mapping[str, ArrayLike] | None = None,
    gravity: Sequence[float] | None = None,
    density: float | None = None,
    diameter: float | None = None,
    mass: float | None = None,
    frozen: int | Sequence[int] | None = None,
    units: Mapping[str, float] | str | None = None,
    dimension: int | None = None,
    plane: str | None = None,
    thickness: float | None = None,
    shape: Shape | None = None,
    allow_unknown: bool = False,
    sides: Sides = "mean",
    missing: Missing = "raise",
    chunks: Chunks = "auto",
    on_error: OnError = "raise",
    **engine_options: Any,
) -> xr.Dataset:
    """Open the output of a DEM code as a lazy scene.

    Headers are read at once; of the bodies only the first and the last step of the particles, to
    learn the variables, sizes and extent. The rest is read when it is computed, each file once for
    all its variables.

    Parameters
    ----------
    particles : path, glob or list of them
        Files with particles. Globs are sorted by the numbers in them (9 before 10, 0.15 before
        0.2). Or one scene that xcg saved (``.zarr``, or ``.nc``, which may be called ``.nc4``,
        ``.h5`` or ``.hdf5``), beside which there are `chunks` and `on_error` only.
    contacts : path, glob or list of them, optional
        Files with contacts.
    walls : path, glob or list of them, or mapping, optional
        Files with contacts with walls, for engines that keep them apart (LIGGGHTS
        ``wall/gran/local``). For LAMMPS, whose ``fix wall/gran ... contacts`` puts them into
        columns of the particles, a mapping from names of walls to these columns: ``{"side":
        "f_side[*]"}``, or the names of six columns, force and point. The walls are partners -2, -3,
        ... in their order; see `xcg.select_walls`.
    engine : str or Engine, optional
        What wrote the files, guessed from their first bytes by default: one of
        {engines};
        the name of an engine that an installed package registers; or a class or object derived from
        `xcg.readers.Engine`.
    names : mapping, list or text, optional
        From columns in the files to variables of the scene, before what the engine knows by itself;
        None drops a column; ``{"particles": {...}, "contacts": {...}}`` gives names of each kind of
        file. Components are single names: ``position_x``, ``velocity_x``,
        ``contact_force_x``, ``contact_point_x``, ``contact_normal_x``, and so on for y and z.
        Further names are

        - ``particle_id``, ``species``, ``body_id``, ``frozen``, ``coordination_number``,
          ``diameter`` or ``radius``, ``density``, ``mass``, ``volume``; any other name is one more
          variable of particles,
        - ``scaled_x`` for positions in fractions of the box,
        - ``contact_i``, ``contact_j`` (the force acts on i), ``overlap``,
        - ``contact_branch_x`` for the vector from j to i as the code saw it: in periodic boxes of
          less than two diameters it is the side on which grains touch (LAMMPS: ``dx dy dz``, taken
          by themselves),
        - ``normal_force_x`` and ``tangential_force_x``, which add up to the contact force.

        For LIGGGHTS, the words of ``compute pair/gran/local`` and ``wall/gran/local`` in any order,
        such as ``"pos id force contactArea delta history"`` or a list of them; ``{"contacts": "pos
        id force delta", "walls": "pos id force"}`` where they differ. For tables without a line of
        names (CSV, or text with blanks) a list of the names of all columns in their order, ``["id",
        "x", "y", "z", None, "radius"]``, where None skips a column; with files of contacts
        ``{"particles": [...], "contacts": [...]}``.
    times : array (t,), optional
        Time of each step in the particle files, in their order and in their unit of time; also
        durations, or dates, which count in s from the first. Pieces of one step have the same time.
        Contacts whose steps are listed as the particles' steps are get these times, too.
    box : array (3, 2), array (t, 3, 2) or mapping, optional
        Edges of the domain in the files' unit of length, in place of the headers'.
    periodic : str or bool, optional
        Periodic axes, for example "xy", in place of the headers'; "" or False for none, True for
        all.
    lattice : array (3, 3), array (t, 3, 3) or mapping, optional
        Vectors a, b, c to the next periodic images of a tilted box, or its tilts by name, ``{"xy":
        0.01}``, in the files' unit of length, in place of the headers' (see
        `xcg.scene_from_arrays`). In boxes of Lees & Edwards the tilt is the offset of the images.
    shear_rate : mapping, optional
        Velocity gradients of the images: ``{"xy": 0.1}`` is dv_x/dy (s-1; a number, or one a step),
        ``{"xx": -0.1}`` that of a box that is compressed along x with its grains.
        By default the rate at which tilts change from step to step, which is right where particles
        that leave a sheared box change their velocity (LAMMPS: ``fix deform ... remap v``); ``{}``
        for images of equal velocity (``remap x``).
    gravity : three floats, optional
        Acceleration of gravity (m s-2, or reduced).
    density : float, optional
        Density of the material (kg m-3, or reduced) for files that hold neither mass nor density.
    diameter, mass : float, optional
        Diameter (m) and mass (kg) of all particles, for files that hold neither sizes nor masses.
    frozen : int or sequence of int, optional
        Species that are fixed in place and act as walls: they get ``frozen = 1``, all others 0.
    units : mapping or str, optional
        Factors from the files' units to SI, for example ``{"length": 1e-3}``; "SI", "reduced", or a
        unit system of LAMMPS by name ("lj", "si", "cgs", "micro", "nano"). By default what the
        headers say (``si``, ``cgs``, ``micro``, ``nano``; ``lj`` is "reduced"), and SI where they
        say nothing (LAMMPS: with a warning). What contradicts the headers is refused.
    dimension : {2, 3}, optional
        By default what the files say (2 in MercuryDPM's ``.data`` of 8 columns, and where its
        ``.restart`` states two dimensions of the system or of the particles), or 2 where all
        particles lie in one plane across an axis (and `plane` is that plane), else 3.
    plane : str, optional
        The two axes of a one-layer scene, for example "xz".
    thickness : float, optional
        Depth of a one-layer scene (m); by default 1 unit of length where files say that grains are
        discs, else that of the box where it is finite, else the largest diameter.
    shape : {"sphere", "disc"}, optional
        How volume follows from diameter. By default what the files say (``particleDimensions`` in
        the ``.restart`` of MercuryDPM), else spheres.
    allow_unknown : bool
        Take contacts with ids that are not among the particles as contacts with a wall.
    sides : {"mean", "first", "separate"}
        What becomes of contacts that are listed from both sides, (i, j, f) and (j, i, -f'), with f'
        up to a quarter from f and points up to 0.15 of the smaller radius apart: one contact with
        the mean of both sides (default), or as the first row has it, with a warning; or two. Rows
        whose forces and points agree to 1e-4 are always one; rows (i, j) in one order at different
        points always count each.
    missing : {"raise", "skip", "empty"}
        What to do about steps of particles without a step of contacts: raise an error that lists
        them, leave them out with a warning, or take them as steps in which nothing touches (MFiX
        writes no file of contacts then).
    chunks : int, "auto", mapping or None
        Steps in a chunk, as xarray takes it: a number; -1 for all in one; "auto" (default) for as
        many as make a task of a tenth of a second or more, by the rows and bytes in the headers,
        but no more than dask's ``array.chunk-size`` (128 MiB) of arrays: one of 100,000 grains,
        tens of 1000; a mapping such as ``{"time": 10}`` or ``{"time": (10, 5)}``. Rows of a step
        stay together. None gives arrays without dask, which are read when they are used and then
        kept; so does "auto" for a single step, which has no chunks to share among workers.
    on_error : {"raise", "skip"}
        What to do about files that are missing from a list, empty, or garbled or cut off in a
        header: stop with an error that names the file (default), or leave out what cannot be
        indexed, with a warning and the attribute ``skipped_files``; the whole steps of a file of
        many steps stay. Faults in bodies appear when these are computed, see ``on_error`` of
        `xcg.coarse_grain`.
    **engine_options
        Of one engine only. LAMMPS, LIGGGHTS, XYZ, tables, HDF5 and VTK: ``timestep``, the time
        between two steps of the simulation, for files without times. HDF5: ``mapping``, from
        variables to datasets. H5MD: ``group``, the name of the group of particles, where there are
        several. MercuryDPM: ``restart``, the restart file with gravity, dimensions, boundaries and
        densities (by default the one beside the ``.data`` file).

    Returns
    -------
    xarray.Dataset
        The scene, with dask arrays where it has several steps: ``position`` and ``velocity``
        (time, particle, component) in m and m s-1, ``diameter``, ``mass``, ... (time, particle),
        ``contact_force`` and ``contact_point`` (time, contact, component) in N and m, ... Rows fill
        a prefix, particles sorted by id; the rest is padding (``particle_id == -1``,
        ``contact_i == -1``, NaN). ``box`` (time, component, bound) is in memory.

    Raises
    ------
    FileNotFoundError
        If a path does not exist or a glob matches nothing.
    SceneError
        If the files are not what they should be; the message names file, step and row or column.
        Faults in bodies appear when they are read. Also if names of files do not show which of
        their numbers is the step, if steps go back within a file, if steps of two runs would be
        mixed, or if a piece of a step is missing.

    Warns
    -----
    SceneWarning
        If a step occurs twice with the same particles (the later one counts), steps are left out, a
        LAMMPS file does not name its units, files of contacts are of another box, or columns and
        words of headers are not understood: they resemble variables, forces, contacts with walls,
        times or units that are not read. If contacts contradict the positions and radii of spheres
        (a force across a gap, none across one, a false overlap, a point off both surfaces, a normal
        of another length or sign), sizes, masses, volumes, positions and box contradict each other,
        or most particles are of one body; the message says what becomes of these. If no particle of
        the first step is in the last or the second one, where names of files or a column separate the
        steps, as they may be pieces of one step.

    Notes
    -----
    A file of one step that states neither time nor number has them in its name: a decimal is a
    time, and of several numbers the one that varies from file to file counts. Files of one step
    that have no particle (or no pair of grains in contact) in common are its pieces, and are
    joined.

    Particles and contacts are paired by time where both kinds of file hold it, else by step number.
    One file of particles and one of contacts, given by name, are paired whatever the numbers in
    their names. Contacts of steps without particles are left out with a warning.

    Steps that share one text file are read from where they begin. In a gzipped file they are
    reached by decompressing all before them, going on from the last step that was read.

    What the headers of files said is remembered in the user's cache until the files change
    (``XCG_INDEX_CACHE=0`` turns this off).

    Times of tables may be durations or dates of any type (timedelta64, datetime64, ISO 8601 texts):
    they become seconds, dates from the first of the particles, which is the attribute ``start``.
    Times of a table that differ by less than 1e-9 of the largest interval are one.

    Without times in the files, `times` or ``timestep``, the coordinate ``time`` is the step number,
    its ``long_name`` says so, and what takes differences of times is refused.

    Images of grains in files (``ix iy iz``) and unwrapped positions (``xu yu zu``) become
    ``image``, the periods that each grain went through; without it, grains are taken to move less
    than half a period from step to step.

    Values in the files come before `density`, and box, periodicity and gravity given here before
    those in the files.

    Examples
    --------
    >>> ds = xcg.open_scene("particles.*.dump", contacts="contacts.*.dump")  # doctest: +SKIP
    >>> ds = xcg.open_scene(
    ...     "compress*.liggghts", contacts="pair*.txt", walls="wall_pair*.txt", density=2500, timestep=1e-5
    ... )  # doctest: +SKIP
    >>> ds = xcg.open_scene("run.data", contacts="run.fstat", engine="mercury")  # doctest: +SKIP
    >>> ds = xcg.open_scene(
    ...     "particles.dump", contacts="contacts.dump",
    ...     names={"c_nc": "coordination_number", "c_1[1]": "contact_i", "c_1[2]": "contact_j"},
    ... )  # doctest: +SKIP
    """
    arguments = Arguments(**locals())
    if engine is None and "mapping" not in engine_options:
        saved = saved_path(particles)
        if saved:
            scene = open_saved(saved, chunks)
            arguments.check_beside_saved(saved)
            return scene
    listing = list_series(arguments)
    ends = read_ends(arguments, listing)
    warn_of_missing_facts(arguments, listing, ends)
    numbered = lacks_ids(listing, ends)
    setup = setup_of(arguments, listing, ends)
    series, measured = make_series(arguments, listing, ends, setup)
    arrays: Any
    if chunks is None or (is_automatic(chunks) and len(series.steps) == 1):
        arrays = indexed_arrays(series)
    else:
        from xcg.readers.lazy import lazy_arrays  # slow to import: it needs dask.array

        arrays = lazy_arrays(series, chunks)
    scene = to_dataset(
        arrays,
        time=series.times,
        step=[step.particles.step for step in series.steps],
        box=series.boxes,
        setup=setup,
        measured=measured,
    )
    return with_origin(scene, arguments, listing, numbered=numbered)


if open_scene.__doc__:  # there is none under python -OO
    open_scene.__doc__ = open_scene.__doc__.replace("{engines}", ", ".join(BUILT_IN))
