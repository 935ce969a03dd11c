"""Soak: random commands on good and damaged recordings, with random kills and limits of disk and memory.

``python benchmarks/soak.py --minutes 120`` goes on for that long and lists what must not happen: a traceback, an input
that changed, a result that cannot be read, a sound recording that is refused, and a result beyond 6 sigma of the truth
without a warning. The exit code is 1 if there was any. The seed repeats a run but for the moments of kills.
"""

import argparse
import hashlib
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from fault_study import all_injections

import srt
from sims.faults.injection import GRADES, Case
from srt.exceptions import SrtError
from srt.recording.writing import write_recording
from srt.sensor_errors import GROUP_SLICES, SensorErrors

SRT = [sys.executable, "-m", "srt.cli"]
SIGMAS = 6.0
"""Largest error over its sigma of a result without a warning: by chance in 27 parameters, 5e-8 for each recording."""
DAMAGES = ("none", "none", "fault", "fault", "bit", "cut", "text")
LIMITS = ("none", "none", "kill", "disk", "memory")


def make(folder: Path, damage: str, rng: np.random.Generator) -> tuple[SensorErrors, str]:
    """Write a recording, damaged or not; give its truth and the name of the damage."""
    case = Case(str(rng.choice(GRADES)), int(rng.integers(1_000_000, 2_000_000)), {"schedule": {"dwell_s": 4.0}})
    recording = case.recording
    if damage == "fault":
        injections = [i for i in all_injections().values() if case.grade in i.severity and i.options is None]
        injection = injections[int(rng.integers(len(injections)))]
        damage = injection.fault
        try:
            recording = injection.recording(case)
        except SrtError:
            damage = "none"  # refused before there is a file
    write_recording(recording, folder, samples_format=str(rng.choice(["csv", "npz", "parquet", "h5"])))
    if damage in ("bit", "cut", "text"):
        path = folder / "recording.toml" if damage == "text" else next(folder.glob("samples.*"))
        data = bytearray(path.read_bytes())
        at = int(rng.integers(len(data)))
        data[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(data[:at] if damage == "cut" else data)
    return case.simulation.truth, damage


def limited(limit: str, rng: np.random.Generator) -> Callable[[], None] | None:
    """Limit of a process, set before it starts."""
    if limit not in ("disk", "memory"):
        return None
    what, low, high = (resource.RLIMIT_FSIZE, 1e2, 1e6) if limit == "disk" else (resource.RLIMIT_DATA, 2e8, 2e9)
    size = int(np.exp(rng.uniform(np.log(low), np.log(high))))
    return lambda: resource.setrlimit(what, (size, size))


def digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


def soak_once(place: Path, rng: np.random.Generator) -> Iterator[str]:
    """Calibrate, inspect or apply one recording under one limit; yield what must not happen."""
    unit, result = place / "unit", place / "unit.json"
    truth, damage = make(unit, str(rng.choice(DAMAGES)), rng)
    before = digests(unit)
    limit = str(rng.choice(LIMITS))
    commands = [["calibrate", str(unit), "-o", str(result)], ["inspect", str(unit)]]
    for command in [*commands, ["apply", str(result), str(unit), "-o", str(place / "corrected")]]:
        if command[0] == "apply" and not result.exists():
            continue
        process = subprocess.Popen(
            [*SRT, *command], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            preexec_fn=limited(limit, rng),  # noqa: PLW1509 - the parent has no threads
        )  # fmt: skip
        try:
            errors = process.communicate(timeout=float(rng.uniform(0.3, 4.0)) if limit == "kill" else 300.0)[1]
        except subprocess.TimeoutExpired:
            process.kill()
            errors = process.communicate()[1]
            if limit != "kill":
                yield f"{command[0]} of {damage} takes more than 300 s"
        name = f"{command[0]} of {damage}, limit {limit}, exit {process.returncode}"
        if "Traceback" in errors:
            yield f"{name}: {errors.strip().splitlines()[-1]}"
        if digests(unit) != before:
            yield f"{name}: the recording changed"
        if damage == limit == "none" and process.returncode != 0:
            yield f"{name}: {errors.strip()}"
        if command[0] == "calibrate" and result.exists():
            yield from (f"{name}: {wrong}" for wrong in judged(result, truth, "warning" in errors))


def judged(path: Path, truth: SensorErrors, warned: bool) -> Iterator[str]:
    """Defects of a written result: not readable, or far from the truth without a warning."""
    try:
        found = srt.load_calibration(path)
    except SrtError as error:
        yield f"unreadable result ({error})"
        return
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.nan_to_num(np.abs(found.errors.vector - truth.vector) / found.sigma, posinf=0.0)
    ratio[GROUP_SLICES["gyro_bias"]] = 0.0  # drifts over the test, so that it has no single true value
    # Faults of the recording are told among the result, not on standard error.
    if found.status == "converged" and not (warned or found.warnings) and ratio.max() > SIGMAS:
        yield f"{ratio.max():.1f} sigma from the truth without a warning"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    end, runs, findings = time.monotonic() + 60.0 * arguments.minutes, 0, Counter[str]()
    while time.monotonic() < end:
        with tempfile.TemporaryDirectory() as place:
            for sentence in soak_once(Path(place), np.random.default_rng([arguments.seed, runs])):
                findings[sentence] += 1
                print(f"recording {runs}: {sentence}", flush=True)
        runs += 1
    print(f"{runs} recordings in {arguments.minutes:g} min, {findings.total()} findings")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
