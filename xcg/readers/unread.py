"""Formats that are not read, by their first bytes or suffix, and how to convert each."""

from __future__ import annotations

import re
from dataclasses import dataclass

from xcg.common.messages import SceneError
from xcg.readers.filenames import suffix_of
from xcg.readers.files.text import compression, scanned

_HEAD = 1 << 12  # bytes that are looked at
_ARRAYS = "xcg.scene_from_arrays"
_TABLE = "xcg.scene_from_table"


@dataclass(frozen=True)
class UnreadFormat:
    """A format that is not read.

    Attributes
    ----------
    what : str
        Its name, as "a LAMMPS data file".
    way : str
        What to do instead.
    head : bytes
        Regular expression that the first bytes match; any bytes by default.
    suffixes : tuple of str
        Suffixes of its files; any by default.
    """

    what: str
    way: str
    head: bytes = b""
    suffixes: tuple[str, ...] = ()

    def fits(self, head: bytes, suffix: str) -> bool:
        """Return whether a file has the first bytes and the suffix of this format."""
        return (not self.suffixes or suffix in self.suffixes) and bool(re.match(self.head, head))


_FORMATS = (
    UnreadFormat(
        "a file of LAMMPS' 'dump yaml'",
        "write 'dump custom' instead, or read it by yaml.safe_load_all and pass its columns to " + _TABLE,
        rb"---[ \t\r]*\n(?:\w[^\n]*\n)*?(?:creator: LAMMPS|timestep:)",
    ),
    UnreadFormat(
        "a LAMMPS data file (write_data)",
        "read it in LAMMPS by read_data, and write 'write_dump all custom p.dump id type x y z vx vy "
        "vz radius mass'",
        rb"[^\n]*\n(?:[ \t\r]*(?:#[^\n]*|\d+ [^\n]*)?\n)*?[ \t]*\d+[ \t]+atoms\b",
    ),
    UnreadFormat(
        "a LAMMPS restart file",
        "convert it: lmp -restart2dump FILE custom p.dump id type x y z vx vy vz radius mass",
        rb"LammpS RestartT",
    ),
    UnreadFormat(
        "a restart file of LIGGGHTS",
        "read it in LIGGGHTS by read_restart, and write 'dump p all custom 1 p.liggghts id type x y z "
        "ix iy iz vx vy vz radius density' and 'run 0'",
        rb"\0{4}(?s:.)\0{3}Version LIGGGHTS",
    ),
    UnreadFormat(
        "a log file of LAMMPS or LIGGGHTS",
        "give the files of its 'dump custom' instead",
        rb"(?:LAMMPS|LIGGGHTS) \(",
    ),
    UnreadFormat(
        "an AtomEye file (dump cfg)", "write 'dump custom' instead", rb"Number of particles\s*="
    ),
    UnreadFormat(
        "a saved simulation of YADE",
        "load it in YADE, and write text by the script in docs/other_codes.md",
        rb"(?:<\?xml[^>]*>\s*)?(?:<!DOCTYPE )?<?boost_serialization",
    ),
    UnreadFormat(
        "a GSD file of HOOMD", f"read it by gsd.hoomd and pass its arrays to {_ARRAYS}",
        rb"(?:\xdf\x65){4}",
    ),
    UnreadFormat(
        "a DCD trajectory", f"read it by MDAnalysis and pass its positions to {_ARRAYS}",
        rb".{4}(?:.{4})?(?:CORD|VELD)",
    ),
    UnreadFormat(
        "an XTC or TRR trajectory of GROMACS",
        f"read it by MDAnalysis and pass its positions to {_ARRAYS}",
        rb"\x00\x00\x07[\xcb\xc9]",
    ),
    UnreadFormat(
        "a PDB file", f"read it by MDAnalysis or ase.io.read and pass its positions to {_ARRAYS}",
        rb"(?:HEADER|TITLE |REMARK|CRYST1|MODEL |ATOM  |HETATM)[ \d]",
    ),
    UnreadFormat(
        "a deck of EDEM (.dem)",
        "its steps are the files in the folder NAME_data beside it: open_scene('NAME_data/*.h5', "
        "mapping={'position': '/TimestepData/{time}/ParticleTypes/*/position', ...}), "
        "docs/other_codes.md; or export CSV",
        suffixes=(".dem",),
    ),
    UnreadFormat(
        "a project of Rocky", "export the particles as CSV, one file a step",
        suffixes=(".rocky", ".rocky20", ".rocky21", ".rocky22", ".rocky23", ".rocky24", ".rocky25"),
    ),
    UnreadFormat(
        "a saved model of PFC", f"read its balls by itasca.ballarray and pass the arrays to {_ARRAYS}",
        suffixes=(".sav", ".p2sav", ".p3sav", ".p2dat", ".p3dat"),
    ),
    UnreadFormat(
        "a MATLAB file", f"read it by scipy.io.loadmat (version 7.3: h5py) and pass its arrays to {_ARRAYS}",
        rb"MATLAB [57]\.\d MAT-file",
    ),
    UnreadFormat(
        "a NumPy array", f"read it by numpy.load and pass its columns to {_ARRAYS}", rb"\x93NUMPY"
    ),
    UnreadFormat(
        "an archive of NumPy arrays", f"read it by numpy.load and pass its arrays to {_ARRAYS}",
        rb"PK\x03\x04", (".npz",),
    ),
    UnreadFormat(
        "an Excel workbook", f"save it as CSV, or read it by pandas.read_excel and pass the table to {_TABLE}",
        rb"PK\x03\x04|\xd0\xcf\x11\xe0", (".xlsx", ".xls", ".xlsm", ".ods"),
    ),
    UnreadFormat("a ZIP archive", "unpack it", rb"PK\x03\x04"),
    UnreadFormat("a tar archive", "unpack it", rb"(?s).{257}ustar"),
    UnreadFormat(
        "a file packed by bzip2 or xz", "unpack it; gzip and Zstandard are read as they are",
        rb"BZh[1-9]1AY|\xfd7zXZ\x00",
    ),
    UnreadFormat(
        "a pickle", "load it in the program that wrote it (pickles run code), and pass tables to "
        f"{_TABLE} or arrays to {_ARRAYS}",
        rb"\x80[\x02-\x05]",
    ),
    UnreadFormat(
        "an Arrow or Feather file", f"read it by pandas.read_feather and pass the table to {_TABLE}",
        rb"ARROW1|FEA1",
    ),
    UnreadFormat("a Parquet file", "call it .parquet", rb"PAR1"),
    UnreadFormat(
        "a database of SQLite", f"read it by pandas.read_sql and pass the table to {_TABLE}",
        rb"SQLite format 3\x00",
    ),
    UnreadFormat(
        "JSON", f"read it by pandas.read_json or json.load and pass tables to {_TABLE} or arrays to {_ARRAYS}",
        rb"\s*[\[{]", (".json", ".jsonl", ".ndjson", ".geojson"),
    ),
    UnreadFormat("text in UTF-16", "save it as UTF-8", rb"\xff\xfe|\xfe\xff"),
    UnreadFormat(
        "an HDF5 file", "say engine='hdf5' and mapping={'position': '/Step{time}/position', ...}",
        rb"\x89HDF\r\n\x1a\n",
    ),
    UnreadFormat(
        "a NetCDF file that neither LAMMPS nor xcg wrote",
        f"read it by xarray.open_dataset and pass its arrays to {_ARRAYS}",
        rb"CDF[\x01\x02\x05]",
    ),
    UnreadFormat(
        "a pointer of Git LFS in place of the file", "get the file by 'git lfs pull'",
        rb"version https://git-lfs",
    ),
    UnreadFormat(
        "a page of HTML, as when a download failed", "download the file again",
        rb"(?i)\s*<(?:!doctype )?html",
    ),
    UnreadFormat(
        "an XDMF file", "give the HDF5 files that it lists, with mapping=, docs/other_codes.md",
        rb"(?s)(?:<\?xml[^>]*>\s*)?(?:<!DOCTYPE[^>]*>\s*)?<Xdmf",
    ),
    UnreadFormat(
        "VTK XML without points of its own (a table, or a list of blocks)",
        "give the files of grains that it lists, or save .vtp or CSV in ParaView",
        rb"(?s)(?:<\?xml[^>]*>\s*)?(?:<!--.*?-->\s*)?<VTKFile",
    ),
    UnreadFormat(
        "a cloud of points or a mesh (PLY)",
        f"read it by pyvista.read or open3d and pass its points to {_ARRAYS}", rb"ply[\r\n]",
    ),
    UnreadFormat(
        "a cloud of points (PCD)", "save it as CSV with the names of FIELDS in the first line",
        rb"# \.PCD|VERSION \.?\d",
    ),
    UnreadFormat(
        "a surface of triangles (STL)", "walls are given by xcg.Surface, see docs/walls.md",
        rb"solid |(?s:.{80})", (".stl",),
    ),
)  # fmt: skip


def unread_format(path: str) -> UnreadFormat | None:
    """Return the format of a file if it is known and not read."""
    with scanned(path) as scanner:
        head = scanner.sample(_HEAD)
    if compression(path) and b"\0" in head:
        return UnreadFormat("a compressed binary file", "unpack it")
    return next((form for form in _FORMATS if form.fits(head, suffix_of(path))), None)


def refuse_unread(path: str) -> None:
    """Raise SceneError if a file is of a format that is known and not read."""
    form = unread_format(path)
    if form:
        raise SceneError(f"{path} is {form.what}, which xcg does not read; {form.way}")
