"""Ferraris' sessions: our least squares beside imucal, on the same samples.

Six faces and three full turns about each axis, by the two-axis fixture with errors of 0.1, 1 and 5 mrad, as long as the
17 sequences of Table 1; tactical units with and without asymmetry. imucal gets the faces and the turns; least squares
the recording that holds them, with the flips between faces. ``python benchmarks/ferraris_sessions.py --units 20
--markdown docs/studies/ferraris-sessions.md`` writes the page that is committed. It needs
pip install 'strapdown-rotation-test[all,benchmark]'.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from accuracy_trials import GRADES, SITE, fixture_errors, normal_errors
from ferraris import TURN_RAD, Take, ferraris_motions, imucal_errors, signal_regions
from rivals import (
    ASYMMETRIES,
    ASYMMETRY_ROWS,
    FIRST_SEED,
    FIXTURES_RAD,
    GRADE,
    PROFILE,
    ROWS,
    SAMPLE_RATE_HZ,
    UnitErrors,
    figure,
    markdown_table,
    without_asymmetry,
)

import srt
from sims.physics.imu import read_out
from srt.constants import DEG_PER_H
from srt.recording.recording import Fixture, Recording
from srt.sensor_errors import SensorErrors

FACE_S = 79.0
"""Length of each face, s: with the turns as long as Table 1 in the comparison of ``benchmarks/rivals.py``."""
PAUSE_S = 5.0
OURS = {"least squares": {}, "asymmetry fixed": {"hold": ASYMMETRIES}}
POPULATIONS = ("no asymmetry", "asymmetry 1e-3")


def joined(first: Recording, second: Recording) -> Recording:
    """Both parts of a session as one recording with a gap."""
    offset = float(first.time[-1]) + PAUSE_S
    later = tuple(
        replace(
            label,
            start_static_s=(label.start_static_s[0] + offset, label.start_static_s[1] + offset),
            end_static_s=(label.end_static_s[0] + offset, label.end_static_s[1] + offset),
        )
        for label in second.sequences
    )
    return replace(
        first,
        time=np.concatenate([first.time, second.time + offset]),
        gyro=np.concatenate([first.gyro, second.gyro]),
        accel=np.concatenate([first.accel, second.accel]),
        sequences=first.sequences + later,
    )


def sessions(seed: int, sigma_rad: float) -> Iterator[tuple[str, SensorErrors, Recording, dict[str, np.ndarray]]]:
    """Population, truth, recording and imucal's regions of one unit, without and with its asymmetry."""
    for_unit, for_fixture, for_ferraris, for_noise = np.random.default_rng(seed).spawn(4)
    drawn = normal_errors(for_unit, 1e-3, 10.0 * DEG_PER_H)
    true_site = replace(SITE, gravity_m_s2=SITE.gravity_m_s2 + for_unit.standard_normal() * SITE.gravity_sigma_m_s2)
    motions = [
        motion.stated_as(site=SITE, fixture=Fixture(0.0, sigma_rad, sigma_rad))
        for motion in ferraris_motions(
            site=true_site,
            face_s=FACE_S,
            profile=PROFILE,
            sample_rate_hz=SAMPLE_RATE_HZ,
            fixture_draw=fixture_errors(for_fixture, sigma_rad),
            rotation_sigma_rad=sigma_rad,
            rng=for_ferraris,
        )
    ]
    seeds = for_noise.integers(2**63, size=2)
    for population in POPULATIONS:
        truth = without_asymmetry(drawn) if population == POPULATIONS[0] else drawn
        takes = [
            read_out(m, truth, GRADES[GRADE], np.random.default_rng(s)) for m, s in zip(motions, seeds, strict=True)
        ]
        regions = signal_regions(
            *(Take(take, m.windows) for take, m in zip(takes, motions, strict=True)), face_s=FACE_S
        )
        yield population, truth, joined(*takes), regions


def study(units: int, fixtures_rad: tuple[float, ...] = FIXTURES_RAD) -> dict[tuple[str, float], list[UnitErrors]]:
    """Errors of all units by population and fixture."""
    outcomes: dict[tuple[str, float], list[UnitErrors]] = {}
    for sigma_rad in fixtures_rad:
        for seed in range(FIRST_SEED, FIRST_SEED + units):
            for population, truth, recording, regions in sessions(seed, sigma_rad):
                outcome = UnitErrors()
                known = {"sample_rate_hz": SAMPLE_RATE_HZ, "gravity_m_s2": SITE.gravity_m_s2, "turn_rad": TURN_RAD}
                outcome.add("imucal", truth, lambda r=regions, k=known: imucal_errors(r, **k))
                for method, options in OURS.items():
                    outcome.add(
                        method,
                        truth,
                        lambda r=recording, o=options: srt.calibrate(r, "least-squares", checks=False, **o),
                    )
                outcomes.setdefault((population, sigma_rad), []).append(outcome)
    return outcomes


def rms(outcomes: list[UnitErrors], method: str, row: str) -> float:
    return float(np.sqrt(np.mean([np.square(o.errors[method][ROWS[row]]) for o in outcomes])))


def rows(outcomes: dict[tuple[str, float], list[UnitErrors]]) -> Iterator[list[str]]:
    """Rms of imucal and of ours in each group, for every population and fixture."""
    for (population, sigma_rad), some in outcomes.items():
        for row in ROWS:
            if row not in ASYMMETRY_ROWS:
                values = [rms(some, method, row) for method in ("imucal", *OURS)]
                ratio = values[0] / min(values[1:])
                yield [population, f"{1e3 * sigma_rad:g} mrad", row, *map(figure, values), figure(ratio, digits=2)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=20)
    parser.add_argument("--markdown", type=Path, help="Page to write.")
    options = parser.parse_args()
    outcomes = study(options.units)
    columns = ("units", "fixture", "rms error of", "imucal", *OURS, "imucal over the better")
    table = markdown_table(columns, rows(outcomes), text_columns=3)
    statuses = sum((sum((o.statuses for o in some), start=type(some[0].statuses)()) for some in outcomes.values()),
                   start=type(next(iter(outcomes.values()))[0].statuses)())  # fmt: skip
    said = ", ".join(f"{name} {count}" for name, count in sorted(statuses.items()))
    text = PAGE.format(units=options.units, table=table, statuses=said)
    print(text)
    if options.markdown is not None:
        options.markdown.write_text(text, encoding="utf-8")
    return 0


PAGE = """\
# Ferraris' sessions

`python benchmarks/ferraris_sessions.py --units {units} --markdown docs/studies/ferraris-sessions.md`: six faces of 79 s
and three full turns about each axis, on the two-axis fixture with 1-sigma errors of 0.1, 1 and 5 mrad; the tactical
units of [](../rivals.md), with and without an asymmetry of 1e-3. imucal computes Ferraris' calibration from the faces
and turns; least squares gets the same samples, as a recording with labels. The second form fixes the asymmetries at
zero (`--hold gyro_asymmetry --hold accel_asymmetry`), as imucal assumes. Rms error over all units:

{table}

Turns in one sense only do not show the gyro asymmetry, and a turn about the vertical does not change the specific
force. Least squares keeps what the nominal angles of the fixture give more accurately than the data, and weighs the
measurements by the uncertainty of what it keeps. Status: {statuses}.
"""


if __name__ == "__main__":
    sys.exit(main())
