"""Samples and writers of files that the tests of the importers of tables share."""

import csv

import numpy as np
import pytest
import scipy.io

from srt.recording.import_options import parse_columns

N = 40
RNG = np.random.default_rng(5)
TIME = 0.25 + np.arange(1, N + 1) / 128.0  # exact in binary
STAMPS = 1_403_636_579_758_555_392 + 5_000_001 * np.arange(N)
GYRO, ACCEL = RNG.normal(size=(N, 3)), RNG.normal(size=(N, 3))
SI = {"gyro_unit": "rad/s", "accel_unit": "m/s^2"}
SI_TIME = {**SI, "time_unit": "s"}
COLUMNS = {
    "time": TIME,
    **{f"gyro_{axis}": GYRO[:, i] for i, axis in enumerate("xyz")},
    **{f"accel_{axis}": ACCEL[:, i] for i, axis in enumerate("xyz")},
}
EUROC = "#timestamp [ns]," + ",".join(
    [f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz"] + [f"a_RS_S_{axis} [m s^-2]" for axis in "xyz"]
)


def write_rows(path, header, columns, delimiter=","):
    """Write a table by Python's csv, which writes every digit of a float."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, delimiter=delimiter)
        if header is not None:
            writer.writerow(header.split(","))
        writer.writerows(zip(*(np.asarray(column).tolist() for column in columns), strict=True))


def assert_readings(found, gyro, accel, time=None):
    """Compare readings, and stamps, to the last bit."""
    np.testing.assert_array_equal(found.gyro, gyro)
    np.testing.assert_array_equal(found.accel, accel)
    if time is not None:
        np.testing.assert_array_equal(found.time, time)


def write_stamped(path, header):
    write_rows(path, header, [STAMPS, *GYRO.T, *ACCEL.T])


def write_npy(path):
    np.save(path, np.column_stack([TIME, GYRO, ACCEL]))


def write_hdf5(path):
    with pytest.importorskip("h5py").File(path, "w") as file:
        for name, column in COLUMNS.items():
            file.create_dataset(f"runs/first/{name}", data=column, compression="gzip")


def write_matlab_73(path):
    """HDF5 as MATLAB 7.3 has it: behind 512 bytes of its own header, with the axes of arrays in reverse."""
    with pytest.importorskip("h5py").File(path, "w", userblock_size=512) as file:
        for name, values in (("time", TIME[None, :]), ("gyro", GYRO), ("accel", ACCEL)):
            node = file.create_dataset(f"imu/{name}", data=values.T)
            node.attrs["MATLAB_class"] = np.bytes_("double")
        text = file.create_dataset("imu/title", data=np.zeros((3, 1), dtype=np.uint16))
        text.attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


ARRAYS = {"time": TIME, "gyro": GYRO, "accel": ACCEL}
PSINS = np.column_stack([GYRO, ACCEL, TIME])
NAMED = parse_columns("time,gyro,accel")

# name: (file, format, writer, options)
ROUND_TRIPS = {
    "csv": ("a.csv", "csv", lambda p: write_rows(p, ",".join(COLUMNS), COLUMNS.values()), SI_TIME),
    "tab separated": ("a.tsv", "csv", lambda p: write_rows(p, ",".join(COLUMNS), COLUMNS.values(), "\t"), SI_TIME),
    "no header": (
        "a.txt",
        "csv",
        lambda p: np.savetxt(p, np.column_stack([ACCEL, TIME, GYRO])),
        {**SI_TIME, "columns": parse_columns("accel,time,gyro")},
    ),
    "quoted": (
        "q.csv",
        "csv",
        lambda p: p.write_text(
            ",".join(f'"{name}"' for name in COLUMNS)
            + "\n"
            + "".join(",".join(f'"{v!r}"' for v in row) + "\n" for row in np.column_stack([*COLUMNS.values()]).tolist())
        ),
        SI_TIME,
    ),
    "npz": ("a.npz", "npz", lambda p: np.savez_compressed(p, **COLUMNS), SI_TIME),
    "npz of triads": ("a.npz", "npz", lambda p: np.savez(p, **ARRAYS), SI_TIME),
    "npy": ("a.npy", "npz", write_npy, {**SI_TIME, "columns": NAMED}),
    "hdf5": ("a.hdf5", "hdf5", write_hdf5, {**SI_TIME, "variable": "runs/first"}),
    "matlab 5": ("a.mat", "matlab", lambda p: scipy.io.savemat(p, ARRAYS), SI_TIME),
    "matlab 7, struct": (
        "a.mat",
        "matlab",
        lambda p: scipy.io.savemat(
            p, {"log": {"imu": {**ARRAYS, "name": "unit", "cells": np.array(["a", 1.0], dtype=object)}}},
            do_compression=True,
        ),
        {**SI_TIME, "variable": "log.imu"},
    ),
    "matlab 4": ("a.mat", "matlab", lambda p: scipy.io.savemat(p, ARRAYS, format="4"), SI_TIME),
    "matlab 5, one table": (
        "a.mat",
        "matlab",
        lambda p: scipy.io.savemat(p, {"data": np.column_stack([TIME, GYRO, ACCEL]), "other": np.eye(2)}),
        {**SI_TIME, "columns": NAMED},
    ),
    "matlab 7.3": ("a.mat", "matlab", write_matlab_73, {**SI_TIME, "variable": "imu"}),
    "psins mat": ("a.mat", "psins", lambda p: scipy.io.savemat(p, {"imu": PSINS}), {}),
    "psins binary": ("a.bin", "psins", lambda p: PSINS.astype("<f8").tofile(p), {}),
    "psins text": ("a.txt", "psins", lambda p: np.savetxt(p, PSINS), {}),
}  # fmt: skip
ROWS = [",".join(f"{v:.6f}" for v in row) for row in np.column_stack([*COLUMNS.values()])]
