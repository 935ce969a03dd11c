"""Fixtures: symbolic derivation, derivatives through the simulator, certificates, readers of logs in a fork."""

import contextlib
import gc
import importlib.util
import math
import os
import sys
from collections import Counter
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

import sims
from srt.estimation.options import Options
from srt.estimation.srt_measurements import SrtProcessor
from srt.model.table1 import SEQUENCES
from srt.recording.recording import Site
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors
from srt.sequences.preparation import PreparedRecording, prepare

with contextlib.suppress(ModuleNotFoundError):
    from threadpoolctl import threadpool_limits

    # Test workers are processes already: run without the Makefile, their threads would only wait for one another.
    threadpool_limits(limits=1)

DERIVATIONS = Path(__file__).parents[1] / "docs" / "derivations"

G = 9.80665
WINDOW_S = 2.0
RAMP_S = 1e-4
SAMPLE_RATE_HZ = 100.0
RATE_RAD_S = 0.5 * math.pi / (157 / SAMPLE_RATE_HZ - RAMP_S)
"""A quarter turn with its ramp takes 157 samples, every longer one a little less than a whole number of them."""

STEPS = np.full(N_PARAMETERS, 1e-6)
STEPS[GROUP_SLICES["accel_bias"]] = 1e-5
"""Half the central difference, SI: small beside what the third derivative would need to show (about 1e-10 of a
coefficient), large beside rounding (1e-16 · g / 1e-6 = 1e-10 of g)."""


@pytest.hookimpl(wrapper=True)
def pytest_collection(session):
    """Importing the tests makes objects that stay: the search for garbage among them took a quarter of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture
def saved(tmp_path):
    """Save a calibration and read it as a certificate does."""
    from certificate_cases import saved_calibration

    return partial(saved_calibration, tmp_path)


@pytest.fixture
def plain_page(monkeypatch):
    """Pages of certificates without the pictures, which take a hundred times as long as all else."""
    from srt.reports.certificate import html_page

    monkeypatch.setattr(html_page, "certificate_figures", lambda certificate: ())
    return html_page.html_page


@pytest.fixture(scope="session")
def derivation():
    """Import docs/derivations/signatures.py, which is no part of any package."""
    spec = importlib.util.spec_from_file_location("signatures", DERIVATIONS / "signatures.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class Simulated:
    """Table 1 executed by the simulator on a faultless fixture without Earth's rate, and played back at zero errors.

    ``J`` is dz/d(error in the data) by central differences over all 27 errors.
    """

    data: PreparedRecording
    z: np.ndarray
    J: np.ndarray
    rows: dict[tuple[str, str], int] = field(default_factory=dict)

    def row(self, sequence: str, component: str) -> np.ndarray:
        """Derivative of one component: "x", "y", "z" of Δa_H, or "start", "end" for Down."""
        return self.J[self.rows[sequence, component]]

    @staticmethod
    def tolerance(sequence: str) -> np.ndarray:
        """Largest difference of a component of a sequence from the ideal one, for each parameter.

        A rotation ends inside a sample of length dt, where the next one may begin: the sum over that sample
        then hides a non-commutation of at most (β̇ dt/2)²/2 rad, twice that per unit of scale error. Each
        rotation's ramps, and the rest of its last sample, add up to two ramps' time, over which a bias acts.
        """
        rotations = len(SEQUENCES[sequence].rotations)
        out = np.full(N_PARAMETERS, G * rotations * (0.5 * RATE_RAD_S / SAMPLE_RATE_HZ) ** 2)
        out[GROUP_SLICES["gyro_bias"]] = G * (rotations + 4) * RAMP_S
        out += 1e-9 * G  # rounding in the difference
        return out


def component_rows(data: PreparedRecording) -> dict[tuple[str, str], int]:
    """Place of every measured component in z."""
    rows = {}
    for k, name in enumerate(data.ids):
        horizontal = [a for a in "xyz" if a != data.catalogue[k].down]
        rows |= {(name, a): 2 * k + i for i, a in enumerate(horizontal)}
        rows |= {
            (name, "start"): 2 * data.K + int(data.start[k]),
            (name, "end"): 2 * data.K + int(data.end[k]),
        }
    return rows


@pytest.fixture(scope="session")
def simulated():
    """Give Simulated by window attitude, "held" or "integrated"; each is made once."""
    motion = sims.run_schedule(
        sims.Schedule(
            sims.table_sequences(tuple(sims.TABLE_1)),
            sims.RateProfile(RATE_RAD_S, RATE_RAD_S / RAMP_S),
            dwell_s=WINDOW_S,
        ),
        site=Site(G),
        sample_rate_hz=SAMPLE_RATE_HZ,
        earth_rate=False,
    )

    @cache
    def make(window_attitude: str) -> Simulated:
        options = Options(window_attitude=window_attitude)

        def measure(vector: np.ndarray) -> tuple[PreparedRecording, np.ndarray]:
            recording = sims.read_out(motion, SensorErrors(vector))
            data = prepare(recording, recording.sequences, options.average)
            integrated = np.full(len(data.windows.duration_s), window_attitude == "integrated")
            return data, SrtProcessor(data, options, integrated).process(SensorErrors()).z

        data, z = measure(np.zeros(N_PARAMETERS))
        columns = [(measure(step)[1] - measure(-step)[1]) / (2.0 * step.max()) for step in np.diag(STEPS)]
        return Simulated(data, z, np.stack(columns, axis=1), component_rows(data))

    return make


@pytest.fixture
def forked_readers(monkeypatch):
    """Readers of logs in a fork of this process: a new interpreter takes 0.3 s, and test_importers_child starts it."""
    import fuzz

    from srt.recording.importers import child_process

    if hasattr(os, "fork"):
        monkeypatch.setattr(child_process, "spawn", fuzz.Fork)


@pytest.fixture(scope="module")
def plain_layout():
    """Figures without the arrangement of their parts, half of the time of drawing: for tests that ask for the file."""
    with pytest.MonkeyPatch.context() as patch:
        with contextlib.suppress(ModuleNotFoundError):
            from matplotlib.layout_engine import ConstrainedLayoutEngine

            patch.setattr(ConstrainedLayoutEngine, "execute", lambda engine, figure: None)
        yield


def pytest_terminal_summary(terminalreporter):
    """Count the blocks of the documentation over all pages: tests/project/test_docs_run.py gives those of a page."""
    total = Counter()
    for report in terminalreporter.getreports("passed"):
        total.update(dict(report.user_properties).get("documentation", {}) if report.when == "call" else {})
    if total:
        kinds = ", ".join(f"{total[kind]} {kind}" for kind in ("run", "parsed", "skipped"))
        terminalreporter.write_line(f"Commands and blocks of README and docs: {kinds}")
