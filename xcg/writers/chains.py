"""Force chains as files: CSV as Force Chain Finder writes it, VTP, and temporal VTKHDF, both for ParaView."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.analysis.chain_results import ChainStep, require_chains, steps_of
from xcg.scene.frame import with_time
from xcg.scene.schema import Frame
from xcg.writers.files import check_file, whole_file, write_by_vtk
from xcg.writers.formats import hdf5_file

if TYPE_CHECKING:
    import h5py

# header of Force Chain Finder, spelling and trailing comma included; its stresses are
# tension-positive
FCF_COLUMNS = (
    "LiggghtsId,X,Y,Z,radius,chainId,minorStress,minorDirX,minorDirY,minorDirZ,"
    "PrincipleStress0,PrincipleStress1,PrincipleStress2,"
    "StressDir00,StressDir10,StressDir20,StressDir01,StressDir11,StressDir21,StressDir02,StressDir12,StressDir22,"
    "linkNodes,"
)
_FCF = (
    "position",
    "diameter",
    "chain_id",
    "parent_id",
    "major_stress",
    "major_direction",
    "principal_stress",
    "principal_direction",
)
VTK_VARIABLES = (
    "position",
    "diameter",
    "chain_id",
    "links",
    "major_stress",
    "major_direction",
    "link_chain",
    "contact_j",
    "contact_force",
)


def to_csv(fc: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool = False) -> list[Path]:
    """Write chains in the columns of Force Chain Finder: one row a particle, by id; **tension is positive there**.

    ``minorStress`` is minus the major stress, ``PrincipleStress0`` to ``2`` are minus the principal
    stresses (here in rising order), ``StressDir0k`` to ``2k`` the direction of the k-th, and
    ``linkNodes`` the id of the particle that a particle was reached from, "starting" for the first
    of a chain.

    Parameters
    ----------
    fc : xarray.Dataset
        A result of `force_chains`.
    path : str or path
        The file; for several steps a name with ``{step}``, which becomes the number of the time
        step.
    overwrite : bool
        Replace files that exist.

    Returns
    -------
    list of pathlib.Path
        The files.

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`.
    FileExistsError
        If a file exists and `overwrite` is False; before any step is computed.
    FileNotFoundError
        If its folder does not exist.
    ValueError
        If there are several steps and `path` is one name for some of them.
    """
    require_chains(fc, "to_csv")
    files = targets(fc, path, overwrite=overwrite)
    for step, file in zip(steps_of(fc, _FCF), files, strict=True):
        lines = [FCF_COLUMNS, *_fcf_rows(step.arrays)]
        with whole_file(file, overwrite=overwrite) as part:
            part.write_text("\n".join(lines) + "\n")
    return files


def _fcf_rows(arrays: Frame) -> Iterator[str]:
    numbers = np.column_stack(
        [
            -arrays["major_stress"],
            arrays["major_direction"],
            -arrays["principal_stress"],
            arrays["principal_direction"].reshape(-1, 9),
        ]
    )
    for p in np.flatnonzero(arrays["chain_id"] >= 0):
        source = ",".join(f"{v:.9g}" for v in (*arrays["position"][p], arrays["diameter"][p] / 2))
        stress = ",".join(f"{v:.9g}" for v in numbers[p])
        link = f'"{arrays["parent_id"][p]}"'
        if arrays["parent_id"][p] < 0:
            link = "starting"
        yield f"{arrays['particle_id'][p]},{source},{arrays['chain_id'][p]},{stress},{link},"


def targets(fc: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool) -> list[Path]:
    """Name the file of each step, and refuse names that are taken, before any step is computed; errors as `to_csv`."""
    pattern = os.fspath(path)
    count = with_time(fc).sizes.get("time", 1)
    if count > 1 and "{step}" not in pattern:
        raise ValueError(
            f"path={pattern!r} is one file, and there are {count} steps; put {{step}} into the name"
        )
    numbers: Sequence[int] = range(count)
    if "step" in fc.coords:
        numbers = np.atleast_1d(fc["step"].to_numpy()).tolist()
    files = [Path(pattern.replace("{step}", str(number))) for number in numbers]
    twice = next((file for file in files if files.count(file) > 1), None)
    if twice is not None:
        raise ValueError(
            f"{twice} is the name of several steps, whose numbers are equal; give others by assign_coords(step=...)"
        )
    for file in files:
        check_file(file, overwrite=overwrite)
    return files


# --- points and lines ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Mesh:
    """Points, lines between them, and values on both."""

    points: NDArray
    lines: NDArray
    point_data: dict[str, NDArray]
    line_data: dict[str, NDArray]

    @classmethod
    def of(cls, step: ChainStep) -> _Mesh:
        """Members of chains as points, links as lines.

        A link across a periodic boundary ends at an image of its second particle, a point of its
        own that is marked ``image``.
        """
        arrays = step.arrays
        contact, i, j = step.links()
        members = np.flatnonzero(arrays["chain_id"] >= 0)
        point = np.full(len(arrays["chain_id"]), -1)
        point[members] = np.arange(len(members))
        position = arrays["position"]
        away = position[j] - position[i]
        nearest = step.lattice.shortest(away)
        crossing = np.flatnonzero((nearest != away).any(axis=1))
        source = np.concatenate([members, j[crossing]])
        ends = point[j]
        ends[crossing] = len(members) + np.arange(len(crossing))
        points = np.concatenate([position[members], (position[i] + nearest)[crossing]])
        major = arrays["major_stress"]
        return cls(
            points,
            np.stack([point[i], ends], axis=1),
            {
                "id": arrays["particle_id"][source],
                "radius": arrays["diameter"][source] / 2,
                "chain_id": arrays["chain_id"][source],
                "links": arrays["links"][source],
                "major_stress": major[source],
                "major_direction": arrays["major_direction"][source],
                "image": (np.arange(len(source)) >= len(members)).astype("int64"),
            },
            {
                "chain_id": arrays["link_chain"][contact],
                "stress": 0.5 * (major[i] + major[j]),
                "force": arrays["contact_force"][contact],
                "force_magnitude": np.linalg.norm(arrays["contact_force"][contact], axis=1),
            },
        )


def to_vtp(fc: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool = False) -> list[Path]:
    """Write chains as VTK PolyData: members as points, for glyphs, and links as lines.

    Points hold ``id``, ``radius`` (m), ``chain_id``, ``links``, ``major_stress`` (Pa, compression
    positive), ``major_direction`` and ``image``, 1 for an end beyond a periodic boundary; lines
    hold ``chain_id``, ``stress`` (mean of both ends, Pa), ``force`` and ``force_magnitude`` (N).

    Parameters
    ----------
    fc : xarray.Dataset
        A result of `force_chains`.
    path : str or path
        The file; for several steps a name with ``{step}``, which becomes the number of the time
        step.
    overwrite : bool
        Replace files that exist.

    Returns
    -------
    list of pathlib.Path
        The files.

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`.
    FileExistsError
        If a file exists and `overwrite` is False; before any step is computed.
    FileNotFoundError
        If its folder does not exist.
    ValueError
        If there are several steps and `path` is one name for some of them.
    """
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    require_chains(fc, "to_vtp")
    files = targets(fc, path, overwrite=overwrite)
    for step, file in zip(steps_of(fc, VTK_VARIABLES), files, strict=True):
        write_by_vtk(vtkXMLPolyDataWriter(), polydata_of(step), file, overwrite=overwrite)
    return files


def polydata_of(step: ChainStep) -> Any:
    """Return the chains of a step as vtkPolyData, see `to_vtp`."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData

    mesh = _Mesh.of(step)
    points = vtkPoints()
    points.SetData(numpy_to_vtk(mesh.points, deep=True))
    lines = vtkCellArray()
    offsets = 2 * np.arange(len(mesh.lines) + 1)
    lines.SetData(
        numpy_to_vtkIdTypeArray(offsets, deep=True),
        numpy_to_vtkIdTypeArray(mesh.lines.ravel(), deep=True),
    )
    poly = vtkPolyData()
    poly.SetPoints(points)
    poly.SetLines(lines)
    for target, values in (
        (poly.GetPointData(), mesh.point_data),
        (poly.GetCellData(), mesh.line_data),
        (poly.GetFieldData(), {"TimeValue": np.array([step.time])}),
    ):
        for name, array in values.items():
            column = numpy_to_vtk(np.ascontiguousarray(array), deep=True)
            column.SetName(name)
            target.AddArray(column)
    return poly


def to_vtkhdf(fc: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write the chains of all steps as one temporal VTKHDF file of PolyData, with the arrays of `to_vtp`.

    Steps are computed and written one after the other.

    Parameters
    ----------
    fc : xarray.Dataset
        A result of `force_chains`.
    path : str or path
        The file, by custom ``*.vtkhdf``.
    overwrite : bool
        Replace a file that exists.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`.
    FileExistsError
        If the file exists and `overwrite` is False.
    FileNotFoundError
        If its folder does not exist.
    """
    require_chains(fc, "to_vtkhdf")
    path = Path(path)
    with whole_file(path, overwrite=overwrite) as part, hdf5_file(part, "w") as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = (2, 0)
        root.attrs["Type"] = np.bytes_("PolyData")  # the reader takes ASCII of fixed length only
        times = []
        for step in steps_of(fc, VTK_VARIABLES):
            _append_step(root, _Mesh.of(step))
            times.append(step.time)
        root["Steps"].attrs["NSteps"] = len(times)
        root["Steps/Values"] = times
    return path


def _append_step(root: h5py.Group, mesh: _Mesh) -> None:
    """Add the points, lines and values of one step, and where they begin."""
    points = _append(root, "Points", mesh.points)
    _append(root, "NumberOfPoints", [len(mesh.points)])
    _append(root, "Steps/PartOffsets", [root["NumberOfPoints"].shape[0] - 1])
    _append(root, "Steps/NumberOfParts", [1])
    _append(root, "Steps/PointOffsets", [points])
    first_cell = []
    first_end = []
    # the four kinds of cells of PolyData; only lines occur here
    cells = dict.fromkeys(("Vertices", "Lines", "Polygons", "Strips"), mesh.lines[:0])
    cells["Lines"] = mesh.lines
    for kind, lines in cells.items():
        ends = lines.ravel()
        # every step brings one offset more than cells, which the reader accounts for by itself
        before = _append(root, f"{kind}/Offsets", 2 * np.arange(len(lines) + 1))
        first_cell.append(before - root["NumberOfPoints"].shape[0] + 1)
        first_end.append(_append(root, f"{kind}/Connectivity", ends))
        _append(root, f"{kind}/NumberOfCells", [len(lines)])
        _append(root, f"{kind}/NumberOfConnectivityIds", [len(ends)])
    _append(root, "Steps/CellOffsets", [first_cell])
    _append(root, "Steps/ConnectivityIdOffsets", [first_end])
    for kind_of_data, data in (("Point", mesh.point_data), ("Cell", mesh.line_data)):
        for name, values in data.items():
            begin = _append(root, f"{kind_of_data}Data/{name}", values)
            _append(root, f"Steps/{kind_of_data}DataOffsets/{name}", [begin])


def _append(root: h5py.Group, name: str, values: ArrayLike) -> int:
    """Add rows to an array, made at its first use; return how many it had."""
    added = np.asarray(values)
    if name not in root:
        root.create_dataset(name, data=added, maxshape=(None, *added.shape[1:]), chunks=True)
        return 0
    target = root[name]
    before = target.shape[0]
    target.resize(before + len(added), axis=0)
    target[before:] = added
    return before
