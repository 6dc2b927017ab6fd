"""Formats that are not read are named, with what to do instead."""

import gzip
import io
import json
import pickle
import time

import numpy as np
import pytest
from scipy.io import savemat

import xcg
from xcg.readers.unread import refuse_unread


def made_by(write, *arguments, **options):
    """Return what a function writes into a file."""
    file = io.BytesIO()
    write(file, *arguments, **options)
    return file.getvalue()


FILES = {
    "dump.yaml": (b"---\ncreator: LAMMPS\ntimestep: 0\n", "'dump yaml'.*dump custom"),
    "old.yaml": (b"---\ntimestep: 0\nunits: lj\n", "'dump yaml'"),
    "data.lmp": (b"LAMMPS data file\n\n2 atoms\n1 atom types\n", "data file.*write_dump"),
    "data.comments": (b"\n# grains\n\n 10  atoms\n", "data file"),
    "data.late": (b"made by a script\n\n  0 bonds\n 4 atoms\n", "data file"),
    "liggghts.restart": (b"\0\0\0\0\x5a\0\0\0Version LIGGGHTS-PUBLIC 3.8.0", "read_restart"),
    "run.restart": (b"LammpS RestartT\0\0\0", "restart file.*-restart2dump"),
    "log.lammps": (b"LAMMPS (29 Aug 2024)\n", "log file"),
    "log.liggghts": (b"LIGGGHTS (Version LIGGGHTS-PUBLIC 3.8.0)\n", "log file"),
    "a.cfg": (b"Number of particles = 3\n", "AtomEye"),
    "y.xml": (b"<?xml version='1.0'?>\n<!DOCTYPE boost_serialization>\n", "YADE.*script"),
    "a.gsd": (b"\xdf\x65" * 4 + bytes(200), "GSD.*gsd.hoomd"),
    "a.dcd": (b"\x54\0\0\0CORD" + bytes(100), "DCD.*MDAnalysis"),
    "a.xtc": (b"\0\0\x07\xcb" + bytes(99), "XTC.*MDAnalysis"),
    "a.trr": (b"\0\0\x07\xc9" + bytes(99), "TRR"),
    "a.pdb": (b"ATOM      1  N   ALA A   1\n", "PDB"),
    "b.pdb": (b"CRYST1   10.0\n", "PDB"),
    "a.dem": (b"any bytes", "EDEM.*TimestepData"),
    "a.rocky": (b"any bytes", "Rocky.*CSV"),
    "a.p3sav": (b"any bytes", "PFC.*itasca"),
    "a.mat": (made_by(savemat, {"x": np.eye(3)}), "MATLAB.*loadmat"),
    "a.npy": (made_by(np.save, np.eye(3)), "NumPy.*scene_from_arrays"),
    "a.npz": (made_by(np.savez, x=np.eye(3)), "NumPy.*scene_from_arrays"),
    "b.npz": (made_by(np.savez_compressed, x=np.eye(3)), "NumPy.*scene_from_arrays"),
    "a.xlsx": (b"PK\x03\x04", "Excel.*CSV"),
    "a.xls": (b"\xd0\xcf\x11\xe0", "Excel"),
    "a.zip": (b"PK\x03\x04", "ZIP.*unpack"),
    "a.tar": (b"a" * 257 + b"ustar", "tar.*unpack"),
    "a.bz2": (b"BZh91AY&SY", "bzip2"),
    "a.xz": (b"\xfd7zXZ\0", "xz"),
    "a.pkl": (pickle.dumps({}), "pickle"),
    "a.feather": (b"ARROW1\0\0", "Feather"),
    "a.parq": (b"PAR1", "Parquet.*call it .parquet"),
    "a.db": (b"SQLite format 3\0", "SQLite"),
    "a.json": (json.dumps({"x": 1}).encode(), "JSON.*scene_from_table"),
    "a.jsonl": (b'{"x": 1}\n{"x": 2}\n', "JSON"),
    "a.txt": ("x,y,z\n1,2,3\n".encode("utf-16"), "UTF-16.*UTF-8"),
    "a.html": (b"<!doctype html>\n<html>", "HTML.*download"),
    "a.dump": (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS.*git lfs pull"),
    "a.xdmf": (b"<?xml version='1.0'?>\n<!DOCTYPE Xdmf>\n<Xdmf Version='3.0'>", "XDMF.*mapping="),
    "a.vtt": (b"<?xml version='1.0'?>\n<VTKFile type='Table'>", "VTK XML.*ParaView"),
    "a.ply": (b"ply\nformat ascii 1.0\n", "PLY.*scene_from_arrays"),
    "a.pcd": (b"# .PCD v.7\nVERSION .7\n", "PCD.*CSV"),
    "a.stl": (b"solid wall\n", "xcg.Surface"),
    "b.stl": (bytes(84), "xcg.Surface"),
}


@pytest.mark.parametrize("name", FILES)
def test_files_are_refused_by_what_they_are(tmp_path, name):
    content, message = FILES[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(xcg.SceneError, match=rf"{name} is .*{message}"):
        xcg.open_scene(tmp_path / name)


def test_compressed_files_are_refused_by_what_they_hold(tmp_path):
    (tmp_path / "a.json.gz").write_bytes(gzip.compress(b"[1, 2]"))
    with pytest.raises(xcg.SceneError, match="is JSON"):
        xcg.open_scene(tmp_path / "a.json.gz")


@pytest.mark.parametrize(
    "content", [b"\xf6\xff\xff\xff\xff\xff\xff\xffDUMPCUSTOM\1\0", b"\x89HDF\r\n\x1a\n\0"]
)
def test_compressed_binary_files_are_to_be_unpacked(tmp_path, content):
    (tmp_path / "a.gz").write_bytes(gzip.compress(content))
    with pytest.raises(xcg.SceneError, match=r"a\.gz is a compressed binary file.*unpack it"):
        xcg.open_scene(tmp_path / "a.gz")


def test_contacts_are_refused_beside_particles_that_are_read(tmp_path):
    (tmp_path / "p.csv").write_text("x,y,z\n0,0,0\n")
    np.save(tmp_path / "c.npy", np.eye(3))
    with pytest.raises(xcg.SceneError, match=r"c\.npy is a NumPy array"):
        xcg.open_scene(tmp_path / "p.csv", contacts=tmp_path / "c.npy")


@pytest.mark.parametrize("byte", [b"\n", b" ", b"1 \n", b"#\n", b"0", b"---\n", b"["])
def test_files_of_one_repeated_line_take_no_time(tmp_path, byte):
    (tmp_path / "a").write_bytes(byte * 4096)
    start = time.process_time()
    refuse_unread(str(tmp_path / "a"))
    assert time.process_time() - start < 1
