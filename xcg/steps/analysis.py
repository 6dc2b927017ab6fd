"""Analyses: a result for each step of a scene, eager, lazy or distributed, with labels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.compiled._jit import THREADS
from xcg.scene.conform import takes_scene
from xcg.scene.frame import particle_rows, steps_in
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import OF_STEP, PADDING, Frame, Setup, Variable
from xcg.steps.faults import SKIPPED, Compute, OnError, Result, check_on_error, guarded
from xcg.steps.labels import AXES, call_of, label
from xcg.steps.mapping import is_lazy, lazy_results

# a frame, its periodic images, and its name in messages
Step: TypeAlias = tuple[Frame, Lattice, str]
_LAST = ("component", "direction", "bound")  # dimensions of a row, in the order of tasks


@dataclass(frozen=True)
class FrameAnalysis:
    """Base class of analyses of the steps of a scene.

    A subclass is a frozen dataclass whose fields are its options. It says which variables a step is
    computed from (`reads`), what comes out (`rows`, `coords`), and computes one step from plain
    arrays (`frame`); `run` does the rest: it checks the scene, maps the steps over chunks of time,
    lazily where the scene is, and labels the results.

    Parameters
    ----------
    threads : int
        Threads that may share a step. `run` sets it: all of the machine's where steps follow each
        other, one where they run side by side.
    setup : Setup
        Periodic axes, dimension, axes and unit system of the scene. `run` sets it, before `prepare`.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> import xcg
    >>> @dataclass(frozen=True)
    ... class MeanSpeed(xcg.FrameAnalysis):
    ...     power: float = 1.0
    ...
    ...     def reads(self, scene):
    ...         return ["velocity"]
    ...
    ...     def rows(self, scene):
    ...         return {"mean_speed": xcg.Variable((), "m s^-1", "mean speed of the particles")}
    ...
    ...     def frame(self, frame, lattice, source):
    ...         speed = np.linalg.norm(frame["velocity"], axis=1)
    ...         return {"mean_speed": (speed**self.power).mean() ** (1 / self.power)}
    >>> MeanSpeed(power=2).run(xcg.datasets.random_scene(200)).mean_speed.dims
    ('time',)
    """

    # name in messages, in the history and of dask's tasks; by default that of the class
    name: ClassVar[str] = ""
    # variables that are read, too, where the scene has them
    optional: ClassVar[tuple[str, ...]] = ()

    threads: int = field(default=1, kw_only=True, repr=False, compare=False)
    setup: Setup = field(default=Setup(), kw_only=True, repr=False, compare=False)

    # --- what a subclass defines -------------------------------------------------------------------

    def prepare(self, scene: Scene) -> Self:
        """Check the options against a scene, and return the analysis with defaults filled in.

        By default itself. A scene answers without reading: `columns` (variables by name), `setup`
        (periodic axes, dimension, units), `sizes` (diameters), `edges` of the box and `corners` of
        the particles' extent. Images of a step are those along the periodic axes of the returned
        `setup`, along which the box of each step has to be finite.
        """
        return self

    def reads(self, scene: Scene) -> Iterable[str]:
        """Return the variables of the scene that a step is computed from.

        All are required. The class attribute `optional` lists further variables, which are read
        where the scene has them. Particle ids and the box need not be listed.
        """
        raise NotImplementedError(f"{type(self).__name__}.reads is missing")

    def rows(self, scene: Scene) -> Mapping[str, Variable]:
        """Return dimensions, units (SI), and name in words of each result."""
        raise NotImplementedError(f"{type(self).__name__}.rows is missing")

    def coords(self, scene: Scene) -> Mapping[str, xr.Variable]:
        """Return the coordinates of the result beside time; they give dimensions their lengths."""
        return {}

    def sizes(self, scene: Scene, ds: xr.Dataset) -> Mapping[str, int | None]:
        """Return the lengths of dimensions that have no coordinate.

        By default as in the scene. None is the largest number of rows that a step turns out to
        have; lazy scenes need a number.
        """
        return {}

    def attrs(self, scene: Scene) -> Mapping[str, Any]:
        """Return attributes of the result."""
        return {}

    @property
    def lags(self) -> tuple[int, ...]:
        """Other steps that a step is computed with, as offsets: ``(1,)`` for the next."""
        return ()

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> Mapping[str, ArrayLike]:
        """Compute the results of one step.

        Parameters
        ----------
        frame : dict of numpy.ndarray
            Variables by name: particles sorted by id, contacts, both without padding. A variable
            of the step alone, such as time, is a number.
        lattice : Lattice
            Box and periodic images of the step.
        source : str
            Name of the step, for messages.

        Returns
        -------
        dict
            Array or number by the names of `rows`. Rows of particles or contacts are as in
            `frame`.
        """
        raise NotImplementedError(f"{type(self).__name__}.frame is missing")

    def frames(self, now: Step, *others: Step | None) -> Mapping[str, ArrayLike]:
        """Compute the results of a step with others, in the order of `lags`; None for no such step."""
        raise NotImplementedError(f"{type(self).__name__}.frames is missing")

    def after(self, result: xr.Dataset, ds: xr.Dataset) -> xr.Dataset:
        """Return the result as users see it: by default as it is labelled."""
        return result

    # --- what it has by that -----------------------------------------------------------------------

    def run(self, ds: xr.Dataset, *, on_error: OnError = "raise") -> xr.Dataset:
        """Compute the analysis for each step of a scene, lazily where the scene is.

        Parameters
        ----------
        ds : xarray.Dataset
            A scene, or a selection of one.
        on_error : {"raise", "skip"}
            "skip" leaves out steps that cannot be read or computed: they are NaN, and marked in the
            coordinate ``skipped``.

        Returns
        -------
        xarray.Dataset
            The results, time first.

        Raises
        ------
        SceneError
            If the scene lacks variables.
        TypeError
            If a dimension has no length; when it is computed, if a result is missing or has another
            shape than `rows` says.
        """
        return _run_selection(ds, self, on_error=on_error)

    def call(self) -> str:
        """Return the call for the history: the name and all options that are not None."""
        options = {
            option.name: getattr(self, option.name) for option in fields(self) if option.repr
        }
        return call_of(self.name or type(self).__name__, options)


@takes_scene
def _run_selection(scene: Scene, analysis: FrameAnalysis, *, on_error: OnError) -> xr.Dataset:
    return run(scene, analysis, on_error=on_error)


def run(
    scene: Scene, analysis: FrameAnalysis, *, call: str = "", on_error: OnError = "raise"
) -> xr.Dataset:
    """Run an analysis of a scene; `call` replaces the call in the history."""
    call = call or analysis.call()
    name = analysis.name or type(analysis).__name__
    scene.require((), name)
    ds = scene.ds
    analysis = replace(analysis, setup=scene.setup).prepare(scene)
    required = list(analysis.reads(scene))
    scene.require(required, name)
    outputs = analysis.rows(scene)
    coords = analysis.coords(scene)
    lengths: dict[Any, int | None] = {**ds.sizes, **dict.fromkeys(AXES, 3)}
    for coord in coords.values():
        lengths |= coord.sizes
    lengths |= analysis.sizes(scene, ds)
    read = _variables_of_task(ds, [*required, *(n for n in analysis.optional if n in ds)])
    dims = {dim for output in outputs.values() for dim in output.dims}
    if any(lengths.get(dim) is None for dim in dims):
        _check_lengths(name, outputs, lengths, lazy=is_lazy(ds, read))
    shapes = {n: tuple(lengths[dim] for dim in output.dims) for n, output in outputs.items()}
    threads = THREADS
    if any(len(ds.variables[n].chunksizes.get("time", ())) > 1 for n in read):
        threads = 1  # of several chunks at once
    task = _Task(replace(analysis, threads=threads), name, outputs, shapes, read)
    labelled = {*coords, *AXES}
    ragged = [n for n, output in outputs.items() if output.dims and output.dims[0] not in labelled]
    if ragged:
        task = _RaggedTask(**vars(task), ragged=tuple(ragged))
    series = ds
    beside: list[str] = []
    if analysis.lags:
        series, beside = _with_others(ds, read, analysis.lags)
    results = {
        n: (tuple(length or 0 for length in shapes[n]), output.dtype)
        for n, output in outputs.items()
    }
    arrays: dict[str, Any] = {}
    if outputs:
        tasks = name.replace("_", "-")
        arrays = map_over_time(series, [*read, *beside], task, results, tasks, on_error)
    result = label(ds, outputs, arrays, call, coords=coords, **analysis.attrs(scene))
    return analysis.after(result, ds)


def _check_lengths(
    name: str,
    outputs: Mapping[str, Variable],
    lengths: Mapping[Any, int | None],
    *,
    lazy: bool,
) -> None:
    """Raise TypeError for a dimension whose length is not known; that of lists is known where a scene is in memory."""
    for result, output in outputs.items():
        for dim in output.dims:
            of_lazy = ""
            if dim in lengths:
                of_lazy = " of a lazy scene"
            if dim not in lengths or (lazy and lengths[dim] is None):
                raise TypeError(
                    f"{name}: the dimension {dim!r} of {result!r}{of_lazy} has no length; return one in sizes(), "
                    "or a coordinate in coords()"
                )


def _variables_of_task(ds: xr.Dataset, required: Sequence[str]) -> dict[str, str]:
    """Return the variables of a task with the dimension of their rows, "" for one value a step.

    These are the required variables, the ids that mark padding, and the box.
    """
    ids = ["particle_id"]
    if any("contact" in ds.variables[name].dims for name in required):
        ids.append("contact_i")
    row_dims: dict[str, str] = {}
    for name in (*ids, *required, *(name for name in OF_STEP if name in ds)):
        dims = ds.variables[name].dims
        row_dims[name] = next((str(dim) for dim in dims if dim not in ("time", *AXES)), "")
    return row_dims


def map_over_time(
    ds: xr.Dataset,
    names: Iterable[str],
    compute: Compute,
    results: Mapping[str, Result],
    tasks: str,
    on_error: OnError = "raise",
) -> dict[str, Any]:
    """Arrays of all results, time first: computed if the scene is in memory, else one task a chunk of time.

    Parameters
    ----------
    ds : xarray.Dataset
        A Dataset with the dimension ``time``.
    names : iterable of str
        Variables and coordinates that `compute` needs; each must have the dimension ``time``.
    compute : callable
        Takes and returns mappings from names to arrays, time first. It travels to the workers, so
        it must pickle.
    results : mapping
        Shape of one step, and type, of everything that `compute` returns.
    tasks : str
        Name of the tasks.
    on_error : {"raise", "skip"}
        "skip" fills the steps that cannot be read or computed with NaN (-1 in integers), warns of
        each when it is computed, and adds the result ``skipped``, True for these steps.

    Returns
    -------
    dict
        NumPy or dask arrays by the names in `results`, and ``skipped`` where steps may be.
    """
    variables = ds.variables
    inputs = {
        name: variables[name].transpose("time", ..., *_LAST, missing_dims="ignore")
        for name in names
    }
    numbers = None
    skips = on_error != "raise"
    if skips:
        check_on_error(on_error)
        results = {**results, SKIPPED: ((), "bool")}
        numbers = _numbers(ds)
    if not ds.sizes["time"]:
        return {name: np.empty((0, *shape), dtype) for name, (shape, dtype) in results.items()}
    if any(values.chunks is not None for values in inputs.values()):
        return lazy_results(inputs, compute, results, tasks, numbers, on_error)
    arrays = {name: values.to_numpy() for name, values in inputs.items()}
    if skips:
        return guarded(results, numbers, {}, {}, arrays, compute)
    return compute(arrays)


def _numbers(ds: xr.Dataset) -> NDArray | None:
    """Numbers of the steps, which messages about faults name; None where the scene has lost them."""
    if "step" not in ds.coords or ds["step"].dims != ("time",) or ds["step"].chunks is not None:
        return None
    return ds["step"].to_numpy()


# --- one chunk of time ----------------------------------------------------------------------------


def _with_others(
    ds: xr.Dataset, read: Iterable[str], lags: Sequence[int]
) -> tuple[xr.Dataset, list[str]]:
    """Add the variables of other steps to each step, as ``name@lag``, and whether there is one."""
    beside: dict[str, xr.Variable] = {}
    steps = np.arange(ds.sizes["time"])
    for lag in lags:
        other = steps + lag
        exists = (other >= 0) & (other < len(steps))
        beside[f"exists@{lag}"] = xr.Variable("time", exists)
        for name in read:
            values = ds.variables[name].isel(time=np.clip(other, 0, len(steps) - 1))
            beside[f"{name}@{lag}"] = values.to_base_variable()
    return ds.assign(beside), list(beside)


@dataclass(frozen=True, eq=False)
class _Task:
    """Analysis of a chunk of time, whose results have the same shape in each step."""

    analysis: FrameAnalysis
    name: str
    outputs: Mapping[str, Variable]
    shapes: Mapping[str, tuple[int | None, ...]]
    row_dims: Mapping[str, str]  # dimension of the rows of each variable

    def __call__(self, arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
        """Return the results of all steps, time first."""
        analysis = self.analysis
        if analysis.lags:
            return self.stack(self._with_other_steps(arrays), arrays)
        steps = steps_in(arrays, analysis.setup.periodic, self.row_dims)
        return self.stack((analysis.frame(*step) for step in steps), arrays)

    def _with_other_steps(self, arrays: Mapping[str, NDArray]) -> Iterator[Mapping[str, ArrayLike]]:
        """Yield the results of each step with those at its lags, None for one outside the series."""
        periodic = self.analysis.setup.periodic
        of_step = {name: a for name, a in arrays.items() if "@" not in name}
        series: list[Iterable[Step | None]] = [steps_in(of_step, periodic, self.row_dims)]
        for lag in self.analysis.lags:
            end = f"@{lag}"
            others = {n.removesuffix(end): a for n, a in arrays.items() if n.endswith(end)}
            exists = others.pop("exists").tolist()
            steps = steps_in(others, periodic, self.row_dims)
            series.append(step if here else None for here, step in zip(exists, steps, strict=True))
        for now, *others_of_step in zip(*series, strict=True):
            assert now is not None
            yield self.analysis.frames(now, *others_of_step)

    def stack(
        self, of_steps: Iterable[Mapping[str, ArrayLike]], arrays: Mapping[str, NDArray]
    ) -> dict[str, NDArray]:
        """Stack the results of the steps of arrays; a single step is not copied."""
        steps = len(arrays["particle_id"])
        stacked: dict[str, NDArray] = {}
        for t, results in enumerate(of_steps):
            for name, output in self.outputs.items():
                values = self.values_of(name, results)
                if values.shape != self.shapes[name]:
                    raise self.wrong_shape(name, values)
                if steps == 1 and values.dtype == output.dtype:
                    stacked[name] = values[None]
                    continue
                if name not in stacked:
                    stacked[name] = np.full((steps, *values.shape), output.fill, output.dtype)
                stacked[name][t] = values
        return stacked

    # Errors of the program, which on_error="skip" passes on.

    def values_of(self, name: str, results: Mapping[str, ArrayLike]) -> NDArray:
        """Return a result as an array; raise TypeError if it is missing."""
        if name not in results:
            raise TypeError(
                f"{self.name}: the result {name!r} is missing; frame() returned {sorted(results)}"
            )
        return np.asarray(results[name])

    def wrong_shape(
        self, name: str, values: NDArray, expected: tuple[int | None, ...] = ()
    ) -> TypeError:
        """Return the error of a result that has another shape than `rows` says."""
        return TypeError(
            f"{self.name}: the result {name!r} has the shape {values.shape}, expected "
            f"{expected or self.shapes[name]} for the dimensions {self.outputs[name].dims}"
        )


@dataclass(frozen=True, eq=False)
class _RaggedTask(_Task):
    """Analysis of a chunk of time in which steps may have fewer rows than the result."""

    ragged: tuple[str, ...]  # results of such rows: of particles, contacts, or lists of any length

    def stack(
        self, of_steps: Iterable[Mapping[str, ArrayLike]], arrays: Mapping[str, NDArray]
    ) -> dict[str, NDArray]:
        """Stack the results of the steps of arrays, padded to the declared lengths.

        Where a length was not declared, it is that of the step that has most.
        """
        shapes = dict(self.shapes)
        if any(None in shape for shape in shapes.values()):
            of_steps = list(of_steps)
            shapes = self._shapes_of(of_steps)
        steps = len(arrays["particle_id"])
        stacked: dict[str, NDArray] = {}
        for t, results in enumerate(of_steps):
            rows_of = self._rows(arrays, t)
            for name, output in self.outputs.items():
                shape = tuple(length or 0 for length in shapes[name])
                values = self.values_of(name, results)
                rows: Any = ...
                fits = values.shape == shape
                if name in self.ragged:
                    count = len(values) if values.ndim else 0
                    fits = values.shape == (count, *shape[1:]) and count <= shape[0]
                    rows = rows_of.get(output.dims[0], slice(count))
                if not fits:
                    raise self.wrong_shape(name, values, shape)
                in_order = not isinstance(rows, np.ndarray) or rows.dtype == bool
                if (
                    steps == 1
                    and in_order
                    and values.shape == shape
                    and values.dtype == output.dtype
                ):
                    stacked[name] = values[None]
                    continue
                if name not in stacked:
                    stacked[name] = np.full((steps, *shape), output.fill, output.dtype)
                stacked[name][t, rows] = values
        return stacked

    def _shapes_of(
        self, of_steps: Sequence[Mapping[str, ArrayLike]]
    ) -> dict[str, tuple[int | None, ...]]:
        """Return the shapes of the results, with the lengths that were not declared."""
        most: dict[str, int] = {}
        for name, shape in self.shapes.items():
            if None in shape[:1]:
                lengths = [len(self.values_of(name, results)) for results in of_steps]
                dim = self.outputs[name].dims[0]
                most[dim] = max([most.get(dim, 0), *lengths])
        return {
            name: tuple(
                most.get(dim, 0) if length is None else length
                for dim, length in zip(self.outputs[name].dims, shape, strict=True)
            )
            for name, shape in self.shapes.items()
        }

    def _rows(self, arrays: Mapping[str, NDArray], t: int) -> dict[str, Any]:
        """Return the rows of particles and contacts in padded arrays."""
        rows: dict[str, Any] = {"particle": particle_rows(arrays["particle_id"][t])}
        if "contact_i" in arrays:
            rows["contact"] = arrays["contact_i"][t] != PADDING
        return rows
