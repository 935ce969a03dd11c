"""Public recordings beside what others found in them: the table of docs/published.md.

``SRT_RECORDED_DATA=FOLDER python benchmarks/published_sets.py`` prints it. The folder holds the sets as the page
names them; a set that is absent is left out.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import harness
import numpy as np
from recorded_sets import CERTIFICATE, DATA_VARIABLE, IMU_TK, array_chip, data_folder, ferraris, mpu9150, xsens_mti
from scipy.linalg import rq

import srt
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.sensor_errors import GROUP_SLICES, NAMES

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from srt.result.calibration import Calibration
    from srt.types import Array

XSENS_ROWS: Final = ("accelerometer gain, counts/(m/s²)", "gyro gain, counts/(rad/s)")
XSENS_NOMINAL: Final = (415.0, 4770.0)
"""Gains by which :func:`recorded_sets.xsens_mti` makes SI of the counts."""
MPU_IMU_TK: Final = ((0.996039, 0.996707, 0.993673), (0.996812, 0.994279, 0.993738))
"""Factors of accelerometers and gyros that imu_tk's program finds for the first MPU-9150."""
IMUCAL: Final = ((0.996746, 1.002438, 1.023395), (1.027924, 0.982424, 0.998310))
"""Gains of accelerometers and gyros that imucal finds in its own example."""
CHIPS, REPEATS = range(1, 9), (1, 2, 4, 6)
"""Units of the array, and its recordings."""
BOTH: Final = ("accelerometer gain", "gyro gain")


class Row(NamedTuple):
    """Three values of one quantity beside those of another program."""

    what: str
    other: str
    theirs: Sequence[float]
    ours: Array
    sigma: Array

    def __str__(self) -> str:
        apart = (self.ours - np.array(self.theirs)) / self.sigma
        shown = (" ".join(f"{x:.6g}" for x in values) for values in (self.theirs, self.ours))
        sigmas = " ".join(f"{x:.1g}" for x in self.sigma)
        return (
            f"| {self.what} | {self.other} | {' | '.join(shown)} | {sigmas} | {' '.join(f'{x:+.1f}' for x in apart)} |"
        )


def upper_gains(found: Calibration) -> tuple[Array, Array]:
    """Gains in a frame in which the accelerometer matrix is upper triangular, that of imu_tk."""
    upper, turn = rq(accel_triad(found.errors).matrix)
    signs = np.diag(np.sign(np.diag(upper)))
    gyro = gyro_triad(found.errors).matrix @ (signs @ turn).T
    return np.diag(upper @ signs), 1.0 / np.diag(np.linalg.inv(gyro))


def row_gains(found: Calibration) -> tuple[Array, Array]:
    """Norms of the rows of both matrices, the gains of Ferraris' method."""
    matrices = accel_triad(found.errors).matrix, gyro_triad(found.errors).matrix
    return np.linalg.norm(matrices[0], axis=1), np.linalg.norm(matrices[1], axis=1)


def scale_sigmas(found: Calibration) -> tuple[Array, Array]:
    return found.sigma[GROUP_SLICES["accel_scale"]], found.sigma[GROUP_SLICES["gyro_scale"]]


def calibrated(title: str, recording: srt.Recording) -> Calibration:
    found = srt.calibrate(recording, "least-squares")
    print(f"\n{title}: {found.judgement}\n")
    print("| gain | other program | its x, y, z | here | 1 sigma | difference, sigma |\n|---|---|---|---|---|---|")
    return found


def xsens_rows(folder: Path) -> Iterator[Row]:
    recording = xsens_mti(folder)
    # The authors' gravity is none of Padova, so that the place is not stated.
    found = calibrated("Xsens MTi", replace(recording, site=replace(recording.site, latitude_rad=None)))
    both = zip(XSENS_ROWS, XSENS_NOMINAL, upper_gains(found), scale_sigmas(found), strict=True)
    for what, nominal, gain, sigma in both:
        for other, table in (("imu_tk", IMU_TK), ("certificate", CERTIFICATE)):
            yield Row(what, other, table[what], nominal * gain, nominal * sigma)


def mpu_rows(folder: Path) -> Iterator[Row]:
    for unit in (0, 1, 2):
        found = calibrated(f"MPU-9150, imu{unit}", mpu9150(folder, unit))
        if unit == 0:
            for what, theirs, gain, sigma in zip(
                BOTH, MPU_IMU_TK, upper_gains(found), scale_sigmas(found), strict=True
            ):
                yield Row(what, "imu_tk", [1.0 / factor for factor in theirs], gain, sigma)


def ferraris_rows(folder: Path) -> Iterator[Row]:
    found = calibrated("Ferraris session", ferraris(folder))
    for what, theirs, gain, sigma in zip(BOTH, IMUCAL, row_gains(found), scale_sigmas(found), strict=True):
        yield Row(what, "imucal", theirs, gain, sigma)


def array_repeats(folder: Path) -> None:
    """Scatter of the repeats over their sigmas, by group without the biases, and the verdicts."""
    words: dict[str, int] = defaultdict(int)
    ratios = defaultdict(list)
    for chip in CHIPS:
        found = [srt.calibrate(array_chip(folder, repeat, chip), "least-squares") for repeat in REPEATS]
        for one in found:
            words[one.judgement.word] += 1
        for k, name in enumerate(NAMES):
            seen = [one for one in found if one.observed[k]]
            if len(seen) > 2 and "bias" not in name:
                scatter = np.var([one.errors.vector[k] for one in seen], ddof=1)
                ratios[name.rsplit("_", 1)[0]].append(scatter / np.mean([one.sigma[k] ** 2 for one in seen]))
    print(f"\nArray, {len(CHIPS)} units, {len(REPEATS)} repeats: " + ", ".join(f"{n} {w}" for w, n in words.items()))
    print("\n| group | scatter of the repeats over sigma |\n|---|---|")
    for group in dict.fromkeys(name.rsplit("_", 1)[0] for name in NAMES):
        if group in ratios:
            print(f"| {group} | {np.sqrt(np.mean(ratios[group])):.2f} |")


def main() -> None:
    folder = data_folder()
    if folder is None:
        raise SystemExit(f"public recordings not found; set {DATA_VARIABLE} to their folder")
    for name, rows in (("xsens_mti", xsens_rows), ("mpu9150", mpu_rows), ("ferraris", ferraris_rows)):
        if (folder / name).is_dir():
            for row in rows(folder):
                print(row)
    if (folder / "array").is_dir():
        array_repeats(folder)


if __name__ == "__main__":
    harness.run(main, __doc__)
