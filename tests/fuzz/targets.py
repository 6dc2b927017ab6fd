"""What is fuzzed: small valid files of each format, and what a user does with them first."""

from __future__ import annotations

import gzip
import json
import random
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

import dask
import h5py
import numpy as np
import pandas as pd
from vtkmodules.vtkCommonDataModel import vtkPolyData, vtkUnstructuredGrid

import xcg
from tests import ROOT, dumps, real_data
from tests.fuzz import names, unsaid
from tests.fuzz.mutators import mutate
from tests.lammps_forms import binary_step, rows_of, write_netcdf
from tests.readers.engines.test_mfix import (
    OLD_ASCII,
    write_by_vtk,
    write_contacts,
    write_particles,
    write_pvd,
    write_vtp,
)
from tests.readers.engines.test_vtk import write_lines, write_spheres
from tests.readers.public.test_vtk import (
    OF_PHASICFLOW,
    OF_YADE,
    vertices,
    write,
    write_pieces,
    write_temporal,
)
from tests.readers.public.test_vtk import write_pvd as write_parts


class Escaped(AssertionError):
    """A file appeared where none should."""


Damage = Callable[[bytes, random.Random, tuple[bytes, ...]], bytes]
"""From the bytes of a file, and those of the others of its set, to damaged ones."""


@dataclass(frozen=True)
class Target:
    """One format: the names of its files, the contents of a valid set, and what is done with them."""

    seeds: Callable[[Path], Mapping[str, bytes]]
    use: Callable[[Path], None]
    fixed: frozenset[str] = field(default_factory=frozenset)  # names of files that stay as they are
    damage: Damage = mutate


def fields_of(ds, **options) -> None:
    """Compute all of a scene, and fields on a mesh of a few nodes."""
    warnings.simplefilter("ignore")
    with dask.config.set(scheduler="synchronous"), np.errstate(all="ignore"):
        ds.load()
        bounds = dict.fromkeys(ds.attrs["plane"], (0.0, 1.0))
        if "mass" in ds and "velocity" in ds:
            names = [
                "velocity",
                "kinetic_stress",
                *(["contact_stress"] if "contact_force" in ds else []),
            ]
            ds.cg.coarse_grain(names, bounds=bounds, spacing=0.5, width=0.4)
        if "diameter" in ds and ds.sizes["particle"] < 10_000:
            ds.cg.find_contacts(max_contacts=20_000)


def load(ds) -> None:
    """Compute all of a scene, of formats whose scenes are like those of others."""
    warnings.simplefilter("ignore")
    with dask.config.set(scheduler="synchronous"):
        ds.load()


def _dumps(folder: Path) -> dict[str, bytes]:
    units = "ITEM: UNITS\nlj\n"  # as LAMMPS does it, before the first step only
    files = {}
    for name, text in (("p.dump", dumps.dump_text), ("c.dump", dumps.pairs_text)):
        steps = [
            text(step=k, before=f"{units}ITEM: TIME\n{k / 10}\n").removeprefix(units)
            for k in range(3)
        ]
        files[name] = (units + "".join(steps)).encode()
    return files


def _use_dumps(folder: Path) -> None:
    fields_of(xcg.open_scene(folder / "p.dump", contacts=folder / "c.dump", engine="lammps"))


def _use_local(folder: Path) -> None:
    fields_of(
        xcg.open_scene(
            folder / "p.dump", contacts=folder / "c.dump", engine="lammps", missing="empty"
        )
    )


def _dumps_gz(folder: Path) -> dict[str, bytes]:
    plain = {"p.7.dump.gz": dumps.dump_text(step=7), "c.7.dump.gz": dumps.pairs_text(step=7)}
    return {name: gzip.compress(text.encode(), mtime=0) for name, text in plain.items()}


def _use_dumps_gz(folder: Path) -> None:
    fields_of(xcg.open_scene(str(folder / "p.*.gz"), contacts=str(folder / "c.*.gz"), timestep=0.1))


def _lammps_bin(folder: Path) -> dict[str, bytes]:
    steps = [binary_step(rows_of(4, seed=k), step=k, time=k / 10, parts=2) for k in range(3)]
    return {"p.bin": b"".join(steps)}


def _use_lammps_bin(folder: Path) -> None:
    fields_of(xcg.open_scene(folder / "p.bin"))


def _lammps_nc(folder: Path) -> dict[str, bytes]:
    return {
        "p.nc": write_netcdf(
            folder / "n.nc", {k: rows_of(4, seed=k) for k in range(3)}
        ).read_bytes()
    }


def _use_lammps_nc(folder: Path) -> None:
    fields_of(xcg.open_scene(folder / "p.nc", engine="lammps"))


def _yade(folder: Path) -> dict[str, bytes]:
    head = "# time 0.5 step 7 cell 1 0.1 0 0 1 0 0 0 1\n"
    grains = (
        head + "# id x y z r mass v(3)\n0 0.4 0.5 0.5 0.1 1 0 0 1\n1 0.59 0.5 0.5 0.1 1 0 0 1\n"
    )
    pairs = head + "# id1 id2 n(3) c(3) fn(3) fs(3)\n0 1 1 0 0 0.5 0.5 0.5 5 0 0 0 2 0\n"
    return {"p.txt": grains.encode(), "c.txt": pairs.encode()}


def _use_yade(folder: Path) -> None:
    fields_of(
        xcg.open_scene(folder / "p.txt", contacts=folder / "c.txt", engine="yade", shear_rate={})
    )


def _csv(folder: Path) -> dict[str, bytes]:
    rows = [f"{k // 2},{k % 2},{0.4 + 0.19 * (k % 2)},0.5,0.5,0,0,1,0.1" for k in range(6)]
    pairs = [f"{k},0,1,{0.1 * k},2,3" for k in range(3)]
    return {"p.csv": "\n".join(["time,id,x,y,z,vx,vy,vz,radius", *rows, ""]).encode(),
            "c.csv": "\n".join(["time,id1,id2,fx,fy,fz", *pairs]).encode()}  # fmt: skip


def _use_csv(folder: Path) -> None:
    fields_of(
        xcg.open_scene(folder / "p.csv", contacts=folder / "c.csv", engine="table", density=2.0)
    )


def _parquet(folder: Path) -> dict[str, bytes]:
    grains = {"time": [0.0, 0, 1, 1], "id": [0, 1, 0, 1], "x": [0.4, 0.59, 0.4, 0.59], "y": [0.5] * 4, "z": [0.5] * 4,
              "vx": [1.0] * 4, "vy": [0.0] * 4, "vz": [0.0] * 4, "radius": [0.1] * 4}  # fmt: skip
    pairs = {
        "time": [0.0, 1.0],
        "id1": [0, 0],
        "id2": [1, 1],
        "fx": [1.0, 2.0],
        "fy": [0.0] * 2,
        "fz": [3.0] * 2,
    }
    for name, table in (("p", grains), ("c", pairs)):
        pd.DataFrame(table).to_parquet(folder / f"{name}.parquet")
    return {name: (folder / name).read_bytes() for name in ("p.parquet", "c.parquet")}


def _use_parquet(folder: Path) -> None:
    fields_of(
        xcg.open_scene(
            folder / "p.parquet", contacts=folder / "c.parquet", engine="table", density=2.0
        )
    )


def _hdf5(folder: Path) -> dict[str, bytes]:
    with h5py.File(folder / "run.h5", "w") as file:
        for k in range(2):
            group = file.create_group(f"S{k}")
            group["x"] = np.array([[0.4, 0.5, 0.5], [0.59, 0.5, 0.5]])
            group.create_dataset("v", data=np.ones((2, 3)), compression="gzip")
            group["r"], group["f"] = [0.1, 0.1], [[1.0, 2, 3]]
            group["n"], group["i"], group["j"] = [0, 1], [0], [1]
    return {"run.h5": (folder / "run.h5").read_bytes()}


def _use_hdf5(folder: Path) -> None:
    mapping = {
        "position": "x",
        "velocity": "v",
        "radius": "r",
        "particle_id": "n",
        "contact_i": "i",
        "contact_j": "j",
        "contact_force": "f",
    }
    path = folder / "run.h5"
    places = {name: f"/S{{step}}/{word}" for name, word in mapping.items()}
    fields_of(xcg.open_scene(path, contacts=path, engine="hdf5", mapping=places, density=2.0))


def _xyz(folder: Path) -> dict[str, bytes]:
    lattice = 'Lattice="2 0 0 0.1 2 0 0 0 2" Origin="0 0 0" pbc="T T F"'
    head = f"{lattice} Properties=species:S:1:pos:R:3:velo:R:3:radius:R:1:id:I:1 Time="
    rows = "A 0.4 0.5 0.5 1 0 0 0.1 1\nA 0.59 0.5 0.5 0 1 0 0.1 2\n"
    frames = "".join(f"2\n{head}{time}\n{rows}" for time in (0.0, 0.5))
    plain = "".join(f"2\nAtoms. Timestep: {k}\n1 0.4 0.5 0.5\n2 0.6 0.5 0.5\n" for k in (0, 10))
    return {"e.xyz": frames.encode(), "p.xyz": plain.encode()}


def _use_xyz(folder: Path) -> None:
    fields_of(xcg.open_scene(folder / "e.xyz", density=2.0, shear_rate={}))
    names = {"species": "particle_id"}
    fields_of(xcg.open_scene(folder / "p.xyz", names=names, timestep=0.1))


def _h5md(folder: Path) -> dict[str, bytes]:
    x = np.array([[0.4, 0.5, 0.5], [0.59, 0.5, 0.5]])
    with h5py.File(folder / "h.h5", "w") as file:
        file.create_group("h5md").attrs["version"] = [1, 1]
        group = file.create_group("particles/all")
        for name, values in (("position", np.stack([x, x])), ("velocity", np.ones((2, 2, 3)))):
            group[f"{name}/value"] = values
            group[f"{name}/step"] = [0, 10]
            group[f"{name}/time"] = [0.0, 0.5]
        group["diameter"] = [0.2, 0.2]
        ids = group.create_dataset("id/value", (2, 2), "i4", fillvalue=-1)
        ids[:] = [[1, 2], [2, 1]]
        group["id/step"] = 10
        box = group.create_group("box")
        box.attrs["boundary"] = np.array(["periodic", "periodic", "none"], "S")
        box["edges"] = [[2.0, 0, 0], [0.1, 2, 0], [0, 0, 2]]
    return {"h.h5": (folder / "h.h5").read_bytes()}


def _use_h5md(folder: Path) -> None:
    fields_of(xcg.open_scene(folder / "h.h5", density=2.0, shear_rate={}))


def _edem(folder: Path) -> dict[str, bytes]:
    with h5py.File(folder / "0.h5", "w") as file:
        for name, first in (("0", 0), ("1", 2)):
            group = file.create_group(f"TimestepData/0.05/ParticleTypes/{name}")
            group["position"] = np.array([[0.4, 0.5, 0.5], [0.59, 0.5, 0.5]]) + first
            group["ids"] = [first, first + 1]
            group["r"] = [0.1, 0.1]
    return {"0.h5": (folder / "0.h5").read_bytes()}


def _use_edem(folder: Path) -> None:
    base = "/TimestepData/{time}/ParticleTypes/*"
    mapping = {
        "position": f"{base}/position",
        "particle_id": f"{base}/ids",
        "radius": f"{base}/r",
        "species": base,
    }
    fields_of(xcg.open_scene(folder / "0.h5", mapping=mapping, density=2.0))


def _text(folder: Path) -> dict[str, bytes]:
    grains = "x;y;z;vx;vy;vz;radius;id\n0.4;0.5;0.5;0;0;1;0.1;1\n0.59;0.5;0.5;0;0;1;0.1;2\n"
    return {"p.txt": grains.encode(), "c.dat": b"id1 id2 fx fy fz\n1 2 1 2 3\n"}


def _use_text(folder: Path) -> None:
    """Without engine=: damaged headers are compared with the formats that are not read."""
    fields_of(xcg.open_scene(folder / "p.txt", contacts=folder / "c.dat", density=2.0))


def _vtu(folder: Path) -> dict[str, bytes]:
    x = np.array([[0.4, 0.5, 0.5], [0.59, 0.5, 0.5]])
    write_spheres(folder / "s.1.vtu", x, radii=[0.1, 0.1], id=[0, 1], linVelVec=x)
    write_lines(folder / "c.1.vtp", [x], "Binary", first=[0], second=[1], F=[[1.0, 2, 3]])
    return {name: (folder / name).read_bytes() for name in ("s.1.vtu", "c.1.vtp")}


def _use_vtu(folder: Path) -> None:
    names = {"first": "contact_i", "second": "contact_j", "F": "contact_force"}
    fields_of(
        xcg.open_scene(
            folder / "s.1.vtu", contacts=folder / "c.1.vtp", engine="vtk", names=names, density=2.0
        )
    )


def _legacy(folder: Path) -> dict[str, bytes]:
    """Files as VTK writes them, text and binary, and as others do."""
    files = {"s_other_8.vtk": OF_PHASICFLOW.encode(), "s_yade_9.vtk": OF_YADE.encode()}
    forms = [(vtkPolyData, "Binary", 42), (vtkUnstructuredGrid, "Binary", 51),
             (vtkPolyData, "ASCII", 51), (vtkUnstructuredGrid, "ASCII", 42)]  # fmt: skip
    for k, (kind, form, version) in enumerate(forms):
        path = folder / f"s_{k}.vtk"
        options = {f"FileTypeTo{form}": (), "FileVersion": (version,)}
        write(
            vertices(kind, order=[2, 0, 3, 1], of_cells=k % 2 == 0, time=0.5),
            path,
            "vtk",
            **options,
        )
        files[path.name] = path.read_bytes()
    return files


def _use_each(pattern: str) -> Callable[[Path], None]:
    """Open each file by itself, and raise the first fault when all were opened."""

    def use(folder: Path) -> None:
        faults = []
        for path in sorted(folder.glob(pattern)):
            try:
                load(xcg.open_scene(path, density=2.0, engine="vtk"))
            except xcg.SceneError as error:
                if path.name not in str(error):
                    raise
                faults.append(error)
        if faults:
            raise faults[0]

    return use


def _parallel(folder: Path) -> dict[str, bytes]:
    path, pieces = write_pieces(folder, vtkUnstructuredGrid, 1, time=0.5, ghosts=True)
    write_parts(folder / "a.pvd", [(0.5, k, file) for k, file in enumerate(pieces)])
    write_parts(folder / "b.pvd", [(0.5, 0, path.name)])
    listed = {"files": [{"name": pieces[0], "time": 0.5}, {"name": pieces[1], "time": 1.5}]}
    (folder / "c.vtu.series").write_text(json.dumps(listed))
    names = ("a.pvd", "b.pvd", "c.vtu.series", path.name, *pieces)
    return {name: (folder / name).read_bytes() for name in names}


def _use_parallel(folder: Path) -> None:
    faults = []
    for name in ("a.pvd", "b.pvd", "c.vtu.series", "out.00001.pvtu"):
        try:
            load(xcg.open_scene(folder / name, density=2.0, engine="vtk"))
        except (xcg.SceneError, FileNotFoundError) as error:
            faults.append(error)
    if faults:
        raise faults[0]


def _vtkhdf(folder: Path) -> dict[str, bytes]:
    files = {}
    for kind in ("PolyData", "UnstructuredGrid"):
        files[f"{kind}.vtkhdf"] = write_temporal(folder / f"{kind}.vtkhdf", kind).read_bytes()
    write(vertices(vtkPolyData, time=0.5), folder / "one.vtkhdf", "vtkhdf")
    return files | {"one.vtkhdf": (folder / "one.vtkhdf").read_bytes()}


def _liggghts(folder: Path) -> dict[str, bytes]:
    columns = " ".join(f"c_1[{k}]" for k in range(1, 14))
    particles = dumps.dump_text(columns="id type x y z vx vy vz radius density", rows=[
        "1 1 1 1 1 0.1 0.2 0.3 0.5 1", "2 1 1.9 1 1 0 0 0 0.5 1", "3 2 3 3 0.5 0 0 0 0.5 1"])  # fmt: skip
    pair = dumps.pairs_text(["1 1 1 1.9 1 1 1 2 0 -9 0 0 0.1"], columns)
    wall = dumps.pairs_text(["3 3 0 3 3 0.5 0 5 3 0 0 2 0.01"], columns)
    return {"p.liggghts": particles.encode(), "pair.txt": pair.encode(), "wall.txt": wall.encode()}


def _use_liggghts(folder: Path) -> None:
    fields_of(
        xcg.open_scene(folder / "p.liggghts", contacts=folder / "pair.txt", walls=folder / "wall.txt",
                       engine="liggghts", timestep=1e-5)
    )  # fmt: skip


def _mercury(folder: Path) -> dict[str, bytes]:
    real = real_data("mercury_synthetic")
    restart = (real / "syn200.restart").read_bytes()
    data = b"".join(
        f"3 {t} 0 0 0 2 2 2\n0.5 0.5 0.5 0 0 0 0.3 0 0 0 0 0 0 0\n1 0.5 0.5 1 0 0 0.3 0 0 0 0 0 0 1\n"
        f"1.5 1 1 0 1 0 0.3 0 0 0 0 0 0 0\n".encode()
        for t in (0, 0.1)
    )
    rows = (
        "{} 0 1 0.75 0.5 0.5 0.1 0 3 1 -1 0 0 0 1 0\n{} 1 0 0.75 0.5 0.5 0.1 0 3 1 1 0 0 0 -1 0\n"
    )
    rows += "{} 2 -1 1.5 1 1 0.1 0 2 0 0 0 1 1 0 0\n"
    contacts = b"".join(f"# {t} 0\n# a\n# b\n{rows.format(t, t, t)}".encode() for t in (0, 0.1))
    return {
        "run.data": data,
        "run.fstat": contacts,
        "run.restart": restart[: restart.index(b"Particles") + 20],
    }


def _use_mercury(folder: Path) -> None:
    fields_of(xcg.open_scene(folder / "run.data", contacts=folder / "run.fstat", engine="mercury"))


def _mfix(folder: Path) -> dict[str, bytes]:
    velocity = np.arange(9.0).reshape(3, 3)
    write_particles(folder / "P_1.vtp", Velocity=velocity, Density=np.full(3, 2.0), time=0.1)
    write_contacts(
        folder / "FC_1.vtp",
        [1, 2, 3],
        [2, 1, 1],
        np.eye(3),
        np.eye(3),
        FORCE_CHAIN_FN=np.eye(3),
        time=0.1,
    )
    write_pvd(folder / "P.pvd", {"P_1.vtp": "0.1"})
    return {name: (folder / name).read_bytes() for name in ("P_1.vtp", "FC_1.vtp", "P.pvd")}


def _use_mfix(folder: Path) -> None:
    fields_of(xcg.open_scene(folder / "P.pvd", contacts=folder / "FC_1.vtp", engine="mfix"))


def _vtp(folder: Path) -> dict[str, bytes]:
    files = {"A_DES_0.vtp": OLD_ASCII.encode()}
    for k, (mode, compressor) in enumerate(
        [
            ("Binary", "ZLib"),
            ("Binary", None),
            ("Appended", "LZ4"),
            ("AppendedRaw", "LZMA"),
            ("AppendedRaw", None),
        ],
        1,
    ):
        files[f"A_DES_{k}.vtp"] = write_by_vtk(
            folder / "v.vtp", mode, compressor, 32 + 32 * (k % 2), 40
        ).read_bytes()
    return files


def _use_vtp(folder: Path) -> None:
    faults = []
    for path in sorted(folder.glob("A_DES_*.vtp")):
        try:
            fields_of(xcg.open_scene(path, engine="mfix", density=2.0))
        except xcg.SceneError as error:
            if path.name not in str(error):
                raise
            faults.append(error)
    if faults:
        raise faults[0]


def _ini(folder: Path) -> dict[str, bytes]:
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 1, (20, 3))
    write_vtp(
        folder / "P_0150.vtp", x, time=1.5, Particle_ID=np.arange(1, 21), Velocity=x, Density=np.full(20, 2.0),
        Diameter=np.full(20, 0.2), Volume=np.full(20, 0.004),
    )  # fmt: skip
    text = (ROOT / "examples" / "config.ini").read_text()
    values = {
        "particles_path": "./P_",
        "contacts_path": "None",
        "t0": "150",
        "tf": "150",
        "dt": "1",
    }
    values |= {f"{a}_axis_periodic": "False" for a in "xyz"} | {"output_path": "out"}
    values |= {f"{a}_{end}": v for a in "xyz" for end, v in (("min", "0"), ("max", "1"))}
    lines = [next((f"{k} = {v}" for k, v in values.items() if line.startswith(f"{k} =")), line)
             for line in text.splitlines()]  # fmt: skip
    return {
        "job/config.ini": "\n".join(lines).encode(),
        "job/P_0150.vtp": (folder / "P_0150.vtp").read_bytes(),
    }


def _toml(folder: Path) -> dict[str, bytes]:
    text = """
[scene]
particles = "p.*.dump"
contacts = "c.*.dump"
engine = "lammps"
timestep = 0.1
periodic = "xy"
[phases]
mapping = { 1 = 0, 2 = 1 }
[fields]
fields = ["density", "stress"]
axes = "z"
bounds = { z = [0.0, 1.0] }
width = 0.5
spacing = 0.5
[slices]
axis = "z"
width = 1.0
[output]
folder = "out"
name = "fields"
netcdf = true
vtkhdf = "temporal"
"""
    return {"job/job.toml": text.encode(), "job/p.0.dump": dumps.dump_text().encode(),
            "job/c.0.dump": dumps.pairs_text().encode()}  # fmt: skip


def _use_job(name: str) -> Callable[[Path], None]:
    def use(folder: Path) -> None:
        from xcg.jobs.config import read_config
        from xcg.jobs.run import run_job

        warnings.simplefilter("ignore")
        before = {p for p in folder.rglob("*") if not p.is_relative_to(folder / "job")}
        try:
            with dask.config.set(scheduler="synchronous"), np.errstate(all="ignore"):
                job = read_config(folder / "job" / name)
                for _ in run_job(job, jobs=1):
                    pass
        finally:
            beyond = {p for p in folder.rglob("*") if not p.is_relative_to(folder / "job")} - before
            if beyond:
                msg = f"files outside the folder of the job: {sorted(map(str, beyond))}"
                raise Escaped(msg)

    return use


TARGETS = {
    "lammps": Target(_dumps, _use_dumps, frozenset({"c.dump"})),
    "local": Target(_dumps, _use_local, frozenset({"p.dump"})),
    "lammps_gz": Target(_dumps_gz, _use_dumps_gz),
    "lammps_bin": Target(_lammps_bin, _use_lammps_bin),
    "lammps_nc": Target(_lammps_nc, _use_lammps_nc),
    "yade": Target(_yade, _use_yade),
    "csv": Target(_csv, _use_csv),
    "hdf5": Target(_hdf5, _use_hdf5),
    "xyz": Target(_xyz, _use_xyz),
    "h5md": Target(_h5md, _use_h5md),
    "edem": Target(_edem, _use_edem),
    "text": Target(_text, _use_text),
    "names": Target(names.seeds, names.use, damage=names.damage),
    "unsaid": Target(unsaid.seeds, unsaid.use, damage=unsaid.damage),
    "vtu": Target(_vtu, _use_vtu),
    "legacy_vtk": Target(_legacy, _use_each("*.vtk")),
    "parallel_vtk": Target(_parallel, _use_parallel),
    "vtkhdf": Target(_vtkhdf, _use_each("*.vtkhdf")),
    "liggghts": Target(_liggghts, _use_liggghts),
    "mercury": Target(_mercury, _use_mercury),
    **({"parquet": Target(_parquet, _use_parquet)} if find_spec("pyarrow") else {}),
    "mfix": Target(_mfix, _use_mfix),
    "vtp": Target(_vtp, _use_vtp),
    "ini": Target(_ini, _use_job("config.ini"), frozenset({"job/P_0150.vtp"})),
    "toml": Target(_toml, _use_job("job.toml"), frozenset({"job/p.0.dump", "job/c.0.dump"})),
}
